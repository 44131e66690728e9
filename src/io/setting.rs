//! The settings of a run by their names, as messages say them: each door words them its own way.
//!
//! A message has a setting between backticks, as `` `memory` ``, and one with a value as
//! `` `memory=4GiB` ``. These are the names of Rust and of JSON. The program makes a flag of each
//! ([`worded`]), `--memory 4GiB`, and Python a keyword, `memory="4GiB"`.

use std::fmt;

macro_rules! settings {
    ($($variant:ident $name:literal,)*) => {
        /// Something that a user chooses.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        #[allow(missing_docs, reason = "each has its name")]
        pub enum Setting {
            $($variant,)*
        }

        impl Setting {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// Its name.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }
        }
    };
}

settings! {
    Adapt "adapt",
    Channel "channel",
    ChunkPoints "chunk_points",
    ColourBy "colour_by",
    Compress "compress",
    Count "count",
    CrossK "cross_k",
    CrossM "cross_m",
    CrossR "cross_r",
    Dims "dims",
    Endian "endian",
    Error "error",
    Field "field",
    Fields "fields",
    Focus "focus",
    Fraction "fraction",
    Grid "grid",
    Interpolation "interpolation",
    Isovalue "isovalue",
    Jumps "jumps",
    KeepGoing "keep_going",
    Keyframes "keyframes",
    LabelSurface "label_surface",
    Labels "labels",
    LengthUnit "length_unit",
    Level "level",
    Lossless "lossless",
    Measure "measure",
    Memory "memory",
    Missing "missing",
    Nan "nan",
    Offset "offset",
    Origin "origin",
    Points "points",
    Replace "replace",
    ReplaceSteps "replace_steps",
    Roi "roi",
    Scale "scale",
    Shards "shards",
    Shift "shift",
    SmoothLimit "smooth_limit",
    Spacing "spacing",
    Step "step",
    TargetMax "target_max",
    TargetRms "target_rms",
    TargetSurface "target_surface",
    Time "time",
    TimeUnit "time_unit",
    Times "times",
    Triangles "triangles",
    Type "type",
    Unit "unit",
    ValueBits "value_bits",
    ValueFile "value_file",
    Values "values",
}

impl Setting {
    /// The setting with a value, for a message.
    pub fn of(self, value: impl fmt::Display) -> String {
        format!("`{}={value}`", self.name())
    }

    /// The setting of a name.
    fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|setting| setting.name() == name).copied()
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}`", self.name())
    }
}

/// A message with each setting in the words of a door, which are given the setting and its value.
///
/// ```
/// use isospan_io::setting::{Setting, worded};
/// let text = format!("choose one with {}", Setting::Field.of("NAME"));
/// assert_eq!(text, "choose one with `field=NAME`");
/// let flag = |setting: Setting, value: Option<&str>| format!("--{} {}", setting.name(), value.unwrap());
/// assert_eq!(worded(&text, flag), "choose one with --field NAME");
/// ```
pub fn worded(text: &str, word: impl Fn(Setting, Option<&str>) -> String) -> String {
    let (mut out, mut rest) = (String::with_capacity(text.len()), text);
    while let Some((before, after)) = rest.split_once('`') {
        out += before;
        let found = after.split_once('`').and_then(|(inside, behind)| {
            let (name, value) = inside.split_once('=').map_or((inside, None), |(n, v)| (n, Some(v)));
            Some((word(Setting::named(name)?, value), behind))
        });
        // A name of a file may have a backtick in it, too.
        let (words, behind) = found.unwrap_or_else(|| ("`".into(), after));
        out += &words;
        rest = behind;
    }
    out + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_found_among_other_backticks() {
        let word = |setting: Setting, value: Option<&str>| match value {
            Some(value) => format!("<{} {value}>", setting.name()),
            None => format!("<{}>", setting.name()),
        };
        let cases = [
            ("no setting", "no setting"),
            ("`memory`", "<memory>"),
            ("a`b.raw: give `dims=X,Y,Z` and `type`", "a`b.raw: give <dims X,Y,Z> and <type>"),
            ("`other` or `nan=mask`", "`other` or <nan mask>"),
            ("one ` alone", "one ` alone"),
            ("`field=a=b`", "<field a=b>"),
        ];
        for (text, expected) in cases {
            assert_eq!(worded(text, word), expected);
        }
        for setting in Setting::ALL {
            assert_eq!(worded(&setting.to_string(), word), word(*setting, None));
        }
    }
}
