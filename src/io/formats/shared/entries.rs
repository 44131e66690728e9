//! Channels and frames of an array, as parts of the names of its fields.
//!
//! ```text
//!  data              an array of one volume        data:DAPI       a channel with a label
//!  data:t0           a frame                       data:c1:t0      a frame of a channel without
//! ```

use super::OpenOptions;
use crate::error::Error;
use std::collections::HashSet;
use std::path::Path;

/// A channel of an array.
#[derive(Clone, Debug)]
pub(in crate::formats) struct Channel {
    pub(in crate::formats) label: String,
    pub(in crate::formats) number: u64,
}

/// All channels of an array of `count`: with the labels of the file, if it has good ones for all,
/// that can be part of a field's name; else c0, c1, ….
pub(in crate::formats) fn channels(of_file: &[String], count: u64) -> Vec<Channel> {
    let is_good = |label: &String| !label.is_empty() && !label.contains([':', '/', ',', '*', '?', '[']);
    let all_good = of_file.len() as u64 == count
        && of_file.iter().all(is_good)
        && of_file.iter().collect::<HashSet<_>>().len() == of_file.len();
    let label = |number: u64| match all_good {
        true => of_file[number as usize].clone(),
        false => format!("c{number}"),
    };
    (0..count).map(|number| Channel { label: label(number), number }).collect()
}

/// The name of a field.
pub(in crate::formats) fn field_name(array: &str, channel: Option<&Channel>, frame: Option<u64>) -> String {
    let of_channel = channel.iter().map(|c| format!(":{}", c.label));
    let of_frame = frame.iter().map(|t| format!(":t{t}"));
    std::iter::once(array.to_owned()).chain(of_channel).chain(of_frame).collect()
}

/// What a user says of the entries of an array.
#[derive(Debug, Default)]
pub(in crate::formats) struct Entries {
    /// What the flag and the field say of the channel: a label, a number, or c and a number.
    words: Vec<String>,
    pub(in crate::formats) frame: Option<u64>,
}

impl Entries {
    /// Those of the flag, and of what follows the array's name in that of a field.
    pub(in crate::formats) fn of(after_name: &str, options: &OpenOptions) -> Self {
        let mut found = Self { words: options.channel.iter().cloned().collect(), frame: None };
        for part in after_name.split(':').filter(|part| !part.is_empty()) {
            match part.strip_prefix('t').and_then(|n| n.parse().ok()) {
                Some(frame) => found.frame = Some(frame),
                None => found.words.push(part.to_owned()),
            }
        }
        found
    }

    /// Whether they name a channel.
    pub(in crate::formats) fn name_channel(&self) -> bool {
        !self.words.is_empty()
    }

    /// Whether they name this channel, or none of an array without channels.
    pub(in crate::formats) fn are_of(&self, channel: Option<&Channel>) -> bool {
        let names = |word: &String, c: &Channel| {
            *word == c.label || word.strip_prefix('c').unwrap_or(word) == c.number.to_string()
        };
        self.words.is_empty() == channel.is_none()
            && channel.iter().all(|c| self.words.iter().all(|word| names(word, c)))
    }

    /// The error of a channel that is not there, or must be chosen; `None` where channels are not
    /// what is wrong.
    pub(in crate::formats) fn no_channel<'a>(
        &self,
        path: &Path,
        options: &OpenOptions,
        channels: impl Iterator<Item = &'a Channel>,
    ) -> Option<Error> {
        let labels = channels.map(|c| c.label.as_str()).collect::<Vec<_>>().join(", ");
        let path = path.display();
        let text = match (&options.channel, labels.is_empty()) {
            (Some(_), true) => format!("{path}: an array without channels: leave out `channel`"),
            (Some(channel), false) => {
                let field = options.field.as_deref().unwrap_or("it");
                format!("{path}: {field} has no channel {channel}; its channels: {labels}")
            }
            (None, false) if !self.name_channel() => {
                format!("{path}: several channels: {labels}; choose one with `channel=NAME`")
            }
            _ => return None,
        };
        Some(Error::usage(text))
    }
}
