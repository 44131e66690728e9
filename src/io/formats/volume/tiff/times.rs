//! When the moments of a file are, as descriptions of pages say it.
//!
//! | | ImageJ | OME-XML |
//! |---|---|---|
//! | times | `finterval=`, from 0 on | `DeltaT` of the planes, else `TimeIncrement` from 0 on |
//! | unit | `tunit=`, else s | `DeltaTUnit`, `TimeIncrementUnit`, else s |
//!
//! A moment is when the first of its planes is, of any channel. ImageJ's `fps=` is no time: it says
//! how fast the moments are played.

use super::place::{imagej, ome, unescaped};
use crate::volume::units::Unit;
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use std::str::FromStr;

/// The times of moments.
#[derive(Default)]
pub(super) struct Times {
    /// One each, or none at all.
    list: Vec<f64>,
    pub(super) unit: Option<Unit>,
    /// Lines for the user.
    pub(super) notes: Vec<String>,
}

impl Times {
    /// Those that a description states.
    pub(super) fn of(description: &str, moments: u64) -> Self {
        if description.starts_with("ImageJ=") {
            Self::of_imagej(description, moments)
        } else {
            Self::of_ome(description, moments)
        }
    }

    /// The time of a moment, where it is known.
    pub(super) fn at(&self, moment: u64) -> Option<f64> {
        self.list.get(moment as usize).copied()
    }

    fn of_imagej(text: &str, moments: u64) -> Self {
        let unit = imagej(text, "tunit").map(unescaped);
        let times = Self::steps("finterval", imagej(text, "finterval"), unit, moments);
        if moments == 1 || !times.list.is_empty() || !times.notes.is_empty() || imagej(text, "fps").is_none()
        {
            return times;
        }
        let note =
            "its fps is how fast ImageJ plays the volumes, and there is no finterval: they have no times";
        Self { notes: vec![note.into()], ..times }
    }

    fn of_ome(text: &str, moments: u64) -> Self {
        let attribute = |key: &str| ome(text, key);
        let steps = || {
            let (step, unit) = (attribute("TimeIncrement"), attribute("TimeIncrementUnit"));
            Self::steps("TimeIncrement", step.as_deref(), unit, moments)
        };
        let Some(planes) = planes(text, moments) else { return steps() };
        planes.unwrap_or_else(|why| {
            let note = format!("the DeltaT of its planes {why}, and is not used");
            let steps = steps();
            Self { notes: [vec![note], steps.notes].concat(), ..steps }
        })
    }

    /// Times from 0 on. A step of 0 means that it is not known.
    fn steps(key: &str, step: Option<&str>, unit: Option<String>, moments: u64) -> Self {
        let number = step.map(|text| text.parse::<f64>().unwrap_or(f64::NAN));
        let Some(number) = number.filter(|number| *number != 0.0 && moments > 1) else {
            return Self::default();
        };
        if !(number.is_finite() && number > 0.0) {
            let note =
                format!("its {key}={} is no step of time: its volumes have no times", step.unwrap_or(""));
            return Self { notes: vec![note], ..Self::default() };
        }
        let list = (0..moments).map(|t| t as f64 * number).collect();
        Self { list, unit: Unit::time(unit.as_deref().unwrap_or("s")), notes: vec![] }
    }
}

/// The times that OME-XML's planes state; `None` where none does. An error is the reason why they
/// are no times of the moments, in words.
fn planes(text: &str, moments: u64) -> Option<Result<Times, String>> {
    let (mut first, mut units) = (vec![None::<f64>; moments as usize], vec![]);
    for plane in planes_with_times(text) {
        let time = plane.time.filter(|time| time.is_finite());
        let place = plane.moment.and_then(|moment| first.get_mut(moment as usize));
        let (Some(time), Some(place)) = (time, place) else {
            return Some(Err("has a plane of no moment, or is no number".into()));
        };
        *place = Some(place.map_or(time, |first| first.min(time)));
        if !units.contains(&plane.unit) {
            units.push(plane.unit);
        }
    }
    if units.is_empty() || moments == 1 {
        return None;
    }
    let Some(list) = first.into_iter().collect::<Option<Vec<f64>>>() else {
        return Some(Err("is missing at some moments".into()));
    };
    Some(match &units[..] {
        _ if list.windows(2).any(|pair| pair[0] >= pair[1]) => {
            Err("does not rise from moment to moment".into())
        }
        [unit] => Ok(Times { list, unit: Unit::time(unit), notes: vec![] }),
        _ => Err(format!("has several units ({})", units.join(", "))),
    })
}

/// A plane that states a time.
struct Plane {
    moment: Option<u64>,
    time: Option<f64>,
    unit: String,
}

impl Plane {
    fn of(tag: &BytesStart<'_>) -> Option<Self> {
        let text = |key: &str| {
            let found = tag.try_get_attribute(key).ok().flatten()?;
            Some(found.normalized_value(XmlVersion::Implicit1_0).ok()?.trim().to_owned())
        };
        let time = number(&text("DeltaT")?);
        let moment = text("TheT").and_then(|text| number(&text));
        Some(Self { moment, time, unit: text("DeltaTUnit").unwrap_or_else(|| "s".into()) })
    }
}

fn number<T: FromStr>(text: &str) -> Option<T> {
    text.parse().ok()
}

/// The planes of the first `Pixels` that state a time.
fn planes_with_times(text: &str) -> Vec<Plane> {
    let mut planes = vec![];
    if !text.contains("DeltaT") {
        return planes;
    }
    let mut reader = Reader::from_str(text);
    loop {
        match reader.read_event() {
            Ok(Event::Start(tag) | Event::Empty(tag)) if tag.local_name().as_ref() == "Plane" => {
                planes.extend(Plane::of(&tag));
            }
            Ok(Event::End(tag)) if tag.local_name().as_ref() == "Pixels" => return planes,
            Ok(Event::Eof) | Err(_) => return planes,
            Ok(_) => {}
        }
    }
}
