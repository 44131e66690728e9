//! Pages of several channels and moments, as ImageJ and OME-XML describe them.

use super::times::Times;
use super::{imagej, ome};
use crate::error::{Error, Result};
use crate::formats::shared::entries::{Channel, Entries, channels, field_name};
use crate::formats::shared::{Frames, OpenOptions, pick_field};
use crate::volume::{FieldInfo, ScalarType};
use std::fmt;
use std::path::Path;

/// Most channels times moments.
const MOST: u64 = 1 << 16;
/// The name of the array.
const ARRAY: &str = "data";

/// How the pages of a file follow each other.
pub(super) struct Planes {
    /// None where there is one.
    channels: Vec<Channel>,
    pub(super) slices: u64,
    moments: u64,
    /// The axes C, Z and T, the fastest first.
    order: [char; 3],
    /// When the moments are.
    pub(super) times: Times,
}

impl fmt::Display for Planes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let channels = self.channels.len().max(1);
        write!(f, "{channels} channels, {} slices, {} moments", self.slices, self.moments)
    }
}

impl Planes {
    /// Those that a description states; `None` of one channel and moment.
    pub(super) fn of(path: &Path, description: &str) -> Result<Option<Self>> {
        let number = |text: Option<&str>| text.and_then(|v| v.parse::<u64>().ok()).unwrap_or(1).max(1);
        let of_imagej = |key: &str| number(imagej(description, key));
        let of_ome = |key: &str| number(ome(description, key).as_deref());
        let count = of_imagej("channels").max(of_ome("SizeC"));
        let moments = of_imagej("frames").max(of_ome("SizeT"));
        if (count, moments) == (1, 1) {
            return Ok(None);
        }
        let got = || format!("{count} channels, {moments} moments");
        if count.checked_mul(moments).is_none_or(|n| n > MOST) {
            let expected = format!("at most {MOST} moments of all channels");
            return Err(Error::bad_input(path, "description", expected, got()));
        }
        let mut order = ['C', 'Z', 'T'];
        let slices = if description.starts_with("ImageJ=") {
            of_imagej("slices").max(of_imagej("images") / (count * moments))
        } else {
            let text = ome(description, "DimensionOrder").unwrap_or_else(|| "XYCZT".into());
            let axes: Vec<char> = text.chars().skip(2).collect();
            order = axes.try_into().unwrap_or(order);
            let mut sorted = order;
            sorted.sort_unstable();
            if !text.starts_with("XY") || sorted != ['C', 'T', 'Z'] {
                return Err(Error::bad_input(
                    path,
                    "DimensionOrder",
                    "XY, and C, T and Z in any order",
                    text,
                ));
            }
            of_ome("SizeZ")
        };
        let channels = if count > 1 { channels(&labels(description), count) } else { vec![] };
        Ok(Some(Self { channels, slices, moments, order, times: Times::of(description, moments) }))
    }

    /// The number of pages.
    pub(super) fn count(&self) -> u64 {
        self.slices.saturating_mul(self.moments * self.channels.len().max(1) as u64)
    }

    /// The page of a slice.
    pub(super) fn number(&self, channel: u64, slice: u64, moment: u64) -> u64 {
        let (mut number, mut step) = (0, 1);
        for axis in self.order {
            let (at, size) = match axis {
                'C' => (channel, self.channels.len().max(1) as u64),
                'Z' => (slice, self.slices),
                _ => (moment, self.moments),
            };
            number += at * step;
            step *= size;
        }
        number
    }

    /// Each channel and moment, as they are named.
    fn all(&self) -> impl Iterator<Item = (String, Option<&Channel>, Option<u64>)> {
        let channels: Vec<Option<&Channel>> =
            if self.channels.is_empty() { vec![None] } else { self.channels.iter().map(Some).collect() };
        let moments: Vec<Option<u64>> =
            if self.moments == 1 { vec![None] } else { (0..self.moments).map(Some).collect() };
        channels.into_iter().flat_map(move |c| {
            let named = |t| (field_name(ARRAY, c, t), c, t);
            moments.iter().map(|t| named(*t)).collect::<Vec<_>>()
        })
    }

    pub(super) fn fields(&self, scalar: ScalarType) -> Vec<FieldInfo> {
        self.all().map(|(name, ..)| FieldInfo { name, scalar, components: 1 }).collect()
    }

    /// What a user says, if that is of this file's array.
    fn wanted(options: &OpenOptions) -> Option<Entries> {
        let field = options.field.as_deref().unwrap_or(ARRAY);
        let rest = field.strip_prefix(ARRAY).filter(|rest| rest.is_empty() || rest.starts_with(':'))?;
        Some(Entries::of(rest, options))
    }

    /// The field that is asked for, and the numbers of its channel and moment.
    pub(super) fn choose(
        &self,
        path: &Path,
        scalar: ScalarType,
        options: &OpenOptions,
    ) -> Result<(FieldInfo, u64, u64)> {
        let fields = self.fields(scalar);
        let found = Self::wanted(options).and_then(|wanted| {
            let found = self.all().position(|(_, c, t)| wanted.are_of(c) && wanted.frame == t);
            found.map(Ok).or_else(|| wanted.no_channel(path, options, self.channels.iter()).map(Err))
        });
        let number = found.unwrap_or_else(|| pick_field(path, &fields, options.field.as_deref()))?;
        let (_, channel, moment) = self.all().nth(number).expect("one of the fields");
        Ok((fields[number].clone(), channel.map_or(0, |c| c.number), moment.unwrap_or(0)))
    }

    /// The moments of the channel that is asked for.
    pub(super) fn frames(&self, options: &OpenOptions) -> Frames {
        let Some(wanted) = Self::wanted(options).filter(|wanted| wanted.frame.is_none()) else {
            return vec![];
        };
        let of_channel = self.all().filter(|(_, c, t)| wanted.are_of(*c) && t.is_some());
        of_channel.map(|(name, _, t)| (name, t.and_then(|t| self.times.at(t)))).collect()
    }

    /// The moments of all channels.
    pub(super) fn all_frames(&self) -> Frames {
        self.all().map(|(name, _, t)| (name, t.and_then(|t| self.times.at(t)))).collect()
    }
}

/// The names of OME-XML's channels.
fn labels(description: &str) -> Vec<String> {
    let tags = description.split("<Channel").skip(1).filter_map(|tag| tag.split_once('>'));
    let name = |tag: &str| Some(tag.split_once(" Name=\"")?.1.split_once('"')?.0.trim().to_owned());
    tags.map(|(tag, _)| name(tag).unwrap_or_default()).collect()
}
