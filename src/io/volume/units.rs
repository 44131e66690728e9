//! Units, as files and users name them. They are shown; only lengths along axes that have different
//! units are converted, by the readers of files.
//!
//! A name from a file reaches terminals, pictures and pages. So it is one line of bounded length,
//! without control characters, from the moment on at which it is a [`Unit`].

use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;
use std::str::FromStr;

/// The most characters of a unit's name.
const LONGEST: usize = 60;

/// The name of a unit: "K", "m s-1", "µm".
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(transparent)]
pub struct Unit(String);

/// Prefixes of the metre: name, symbol, power of ten.
const PREFIXES: [(&str, &str, i32); 19] = [
    ("", "", 0),
    ("exa", "E", 18),
    ("peta", "P", 15),
    ("tera", "T", 12),
    ("giga", "G", 9),
    ("mega", "M", 6),
    ("kilo", "k", 3),
    ("hecto", "h", 2),
    ("deca", "da", 1),
    ("deka", "da", 1),
    ("deci", "d", -1),
    ("centi", "c", -2),
    ("milli", "m", -3),
    ("micro", "µ", -6),
    ("micro", "u", -6),
    ("nano", "n", -9),
    ("pico", "p", -12),
    ("femto", "f", -15),
    ("atto", "a", -18),
];

/// Characters that are not seen, or that change the direction of what follows.
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}')
        || matches!(c, '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e0fff}')
}

impl Unit {
    /// A unit as it is written: without characters that are not seen, each run of spaces one, and
    /// cut off after 60 characters. `None` where nothing is left, and of "1", which says that a
    /// number has no unit.
    pub fn new(text: &str) -> Option<Self> {
        // More than enough of any length.
        let seen = text.chars().take(1 << 12).map(|c| if c.is_whitespace() { ' ' } else { c });
        let seen: String = seen.filter(|&c| !is_hidden(c)).collect();
        let words: Vec<&str> = seen.split(' ').filter(|word| !word.is_empty()).collect();
        let name: String = words.join(" ").chars().take(LONGEST).collect();
        (!["", "1"].contains(&&*name)).then(|| Self(name.trim_end().into()))
    }

    /// A unit of length, in the one spelling that it has here. Pixels are none.
    pub fn length(text: &str) -> Option<Self> {
        let unit = Self::new(text)?;
        let lower = unit.0.to_lowercase();
        // "µ" is a sign of its own, and a Greek letter.
        let one = match &*lower.replace('μ', "µ") {
            "pixel" | "pixels" | "px" | "voxel" | "voxels" | "arbitrary" | "unknown" | "none" => {
                return None;
            }
            "meter" | "meters" | "metre" | "metres" => "m",
            "kilometer" | "kilometers" | "kilometre" | "kilometres" => "km",
            "centimeter" | "centimeters" | "centimetre" | "centimetres" => "cm",
            "millimeter" | "millimeters" | "millimetre" | "millimetres" => "mm",
            "micrometer" | "micrometers" | "micrometre" | "micrometres" | "micron" | "microns" | "um"
            | "µm" => "µm",
            "nanometer" | "nanometers" | "nanometre" | "nanometres" => "nm",
            "angstrom" | "angstroms" | "ångström" | "ångströms" => "Å",
            _ if unit.0 == "\u{212b}" => "Å",
            _ => return Some(unit),
        };
        Some(Self(one.into()))
    }

    /// A unit of time, in the one spelling that it has here.
    pub fn time(text: &str) -> Option<Self> {
        let unit = Self::new(text)?;
        let one = match &*unit.0.to_lowercase().replace('μ', "µ") {
            "second" | "seconds" | "sec" => "s",
            "millisecond" | "milliseconds" | "msec" => "ms",
            "microsecond" | "microseconds" | "us" | "usec" | "µs" => "µs",
            "nanosecond" | "nanoseconds" => "ns",
            "minute" | "minutes" => "min",
            "hour" | "hours" => "h",
            _ => return Some(unit),
        };
        Some(Self(one.into()))
    }

    /// Metres in one of this unit of length, as a number times a power of ten; `None` of what is
    /// not known as one.
    pub fn metres(&self) -> Option<(f64, i32)> {
        let text = self.0.replace('μ', "µ");
        let symbol = |(_, prefix, _): &&(&str, &str, i32)| text.strip_suffix('m') == Some(*prefix);
        if let Some((.., power)) = PREFIXES.iter().find(symbol) {
            return Some((1.0, *power));
        }
        let lower = text.to_lowercase();
        // A plural, where it is no symbol.
        let name = if lower.len() > 4 { lower.strip_suffix('s').unwrap_or(&lower) } else { &lower };
        let prefix = name.strip_suffix("meter").or(name.strip_suffix("metre"));
        if let Some((.., power)) = prefix.and_then(|p| PREFIXES.iter().find(|(name, ..)| *name == p)) {
            return Some((1.0, *power));
        }
        Some(match name {
            "micron" => (1.0, -6),
            "å" | "angstrom" | "ångström" => (1.0, -10),
            "in" | "inch" | "inche" => (2.54, -2),
            "ft" | "foot" | "feet" => (3.048, -1),
            "yd" | "yard" => (9.144, -1),
            "mi" | "mile" => (1.609_344, 3),
            "thou" | "mil" => (2.54, -5),
            _ => return None,
        })
    }

    /// Its name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for Unit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::new(text).ok_or_else(|| "a unit has a name, as in K or mm".into())
    }
}

impl<'de> Deserialize<'de> for Unit {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        Self::new(&text).ok_or_else(|| serde::de::Error::custom(format!("{text:?} is no unit")))
    }
}

/// The units of a field, as far as they are known.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Units {
    /// Of its values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<Unit>,
    /// Of lengths in the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<Unit>,
    /// Of the times of steps; CF's have a date in it: "days since 2000-01-01".
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<Unit>,
}

impl Units {
    /// Only a unit of length.
    pub fn of_length(unit: Option<Unit>) -> Self {
        Self { length: unit, ..Self::default() }
    }

    /// Whether none is known.
    pub fn are_unknown(&self) -> bool {
        *self == Self::default()
    }

    /// These, and others where these are not known.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            value: self.value.or(other.value),
            length: self.length.or(other.length),
            time: self.time.or(other.time),
        }
    }
}

/// The unit that all have; `None` where one of them has none, or another one.
pub fn common<T: PartialEq>(all: impl IntoIterator<Item = Option<T>>) -> Option<T> {
    let mut all = all.into_iter();
    let first = all.next()??;
    all.all(|unit| unit.as_ref() == Some(&first)).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(unit: Option<Unit>) -> Option<String> {
        unit.map(|unit| unit.to_string())
    }

    #[test]
    fn names_are_one_printable_line() {
        for (written, shown) in [
            ("K", Some("K")),
            (" kg  m-3\n", Some("kg m-3")),
            ("\x1b[31mK\u{202e}\u{200b}\0", Some("[31mK")),
            ("1", None),
            (" \t\u{feff}", None),
        ] {
            assert_eq!(text(Unit::new(written)).as_deref(), shown, "{written:?}");
        }
        let long = Unit::new(&"µ".repeat(10_000)).unwrap();
        assert_eq!(long.as_str().chars().count(), LONGEST);
        let read = |json: &str| serde_json::from_str::<Unit>(json);
        assert_eq!(read(r#""a\u001bb""#).unwrap().as_str(), "ab");
        assert!(read(r#""""#).is_err());
    }

    #[test]
    fn lengths_and_times_have_one_spelling() {
        for micro in ["um", "µm", "μm", "micrometer", "Micron"] {
            assert_eq!(text(Unit::length(micro)).as_deref(), Some("µm"), "{micro}");
        }
        assert_eq!(text(Unit::length("angstrom")).as_deref(), Some("Å"));
        assert_eq!(text(Unit::length("furlong")).as_deref(), Some("furlong"));
        assert_eq!(Unit::length("pixel"), None);
        assert_eq!(text(Unit::time("seconds")).as_deref(), Some("s"));
        assert_eq!(text(Unit::time("μs")), text(Unit::time("µs")), "a Greek letter is the sign");
        assert_eq!(text(Unit::time("days since 2000-01-01")).as_deref(), Some("days since 2000-01-01"));
    }

    #[test]
    fn metres_of_known_units() {
        let of = |text: &str| Unit::length(text).and_then(|unit| unit.metres());
        for (text, metres) in [
            ("m", Some((1.0, 0))),
            ("Mm", Some((1.0, 6))),
            ("mm", Some((1.0, -3))),
            ("μm", Some((1.0, -6))),
            ("micrometer", Some((1.0, -6))),
            ("Microns", Some((1.0, -6))),
            ("Kilometres", Some((1.0, 3))),
            ("pm", Some((1.0, -12))),
            ("decimeter", Some((1.0, -1))),
            ("\u{212b}", Some((1.0, -10))),
            ("inches", Some((2.54, -2))),
            ("ms", None),
            ("hPa", None),
            ("degrees_east", None),
            ("MM", None),
            ("furlong", None),
        ] {
            assert_eq!(of(text), metres, "{text}");
        }
    }

    #[test]
    fn a_common_unit_is_that_of_all() {
        assert_eq!(common([Some(1), Some(1)]), Some(1));
        assert_eq!(common([Some(1), None]), None);
        assert_eq!(common([Some(1), Some(2)]), None);
        assert_eq!(common::<u8>([]), None);
    }
}
