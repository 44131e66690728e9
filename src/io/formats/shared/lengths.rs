//! One unit for the lengths along all axes, where a file names a unit for each.
//!
//! The unit is that of the first axis (x, then y, then z) that has a known one. Lengths along axes
//! with other known units are converted to it, and a line says so. What is not known as a unit of
//! length is refused, or, by conventions in which an axis may be no length (degrees, pressure,
//! levels), its coordinates stay as they are: then the lengths have no unit in common.

use crate::error::{Error, Result};
use crate::volume::units::{Unit, common};
use std::path::Path;

/// How the lengths along x, y and z of the world become lengths in one unit.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::formats) struct Lengths {
    /// The unit of all of them.
    pub(in crate::formats) unit: Option<Unit>,
    /// A line for the user, where something was converted or is not comparable.
    pub(in crate::formats) note: Option<String>,
    factors: [Factor; 3],
}

/// A factor, as a ratio and a power of ten: decimal numbers stay decimal.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Factor {
    ratio: f64,
    power: i32,
}

const ONE: Factor = Factor { ratio: 1.0, power: 0 };
const NAMES: [&str; 3] = ["x", "y", "z"];

impl Factor {
    fn of(self, length: f64) -> f64 {
        let power = (0..self.power.abs()).fold(1.0, |power, _| power * 10.0);
        let length = if self.ratio == 1.0 { length } else { length * self.ratio };
        if self.power < 0 { length / power } else { length * power }
    }
}

impl Lengths {
    /// Lengths of axes that may be no lengths.
    pub(in crate::formats) fn of_any(units: [Option<Unit>; 3]) -> Self {
        let unit = common(units.clone());
        if unit.is_some() || units.iter().all(Option::is_none) {
            return Self { unit, note: None, factors: [ONE; 3] };
        }
        let metres = units.clone().map(|unit| unit.and_then(|unit| unit.metres()));
        let Some(first) = metres.iter().position(Option::is_some) else {
            return Self { unit: None, note: Some(not_comparable(&units)), factors: [ONE; 3] };
        };
        let (ratio, power) = metres[first].unwrap_or((1.0, 0));
        let factors = metres.map(|m| m.map_or(ONE, |(r, p)| Factor { ratio: r / ratio, power: p - power }));
        let unit = units[first].clone();
        if metres.iter().any(Option::is_none) {
            let more = if factors == [ONE; 3] { String::new() } else { converted(&units, &factors, first) };
            let note = Some([not_comparable(&units), more].join(if factors == [ONE; 3] { "" } else { "; " }));
            return Self { unit: None, note, factors };
        }
        // Two spellings of one unit are no difference.
        let note = (factors != [ONE; 3]).then(|| converted(&units, &factors, first));
        Self { unit, note, factors }
    }

    /// Lengths of axes that are all of space; `at` names what says their units.
    ///
    /// # Errors
    /// [`Error::BadInput`] where units differ and one of them is not known.
    pub(in crate::formats) fn of_space(path: &Path, at: &str, units: [Option<Unit>; 3]) -> Result<Self> {
        let found = Self::of_any(units.clone());
        let unknown = units.iter().flatten().find(|unit| unit.metres().is_none());
        match unknown.filter(|_| found.note.is_some()) {
            None => Ok(found),
            Some(unknown) => {
                let expected = "known units of length (m, mm, µm, nm, Å, inch …), or one unit for all axes";
                Err(Error::bad_input(path, at, expected, format!("'{unknown}' among {}", listed(&units)))
                    .with_help("write the lengths along all axes in one unit"))
            }
        }
    }

    /// A length along an axis of the world, in the unit of all.
    pub(in crate::formats) fn along(&self, axis: usize, length: f64) -> f64 {
        if self.is_as_stated(axis) { length } else { self.factors[axis].of(length) }
    }

    /// Whether lengths along an axis of the world are as the file states them.
    pub(in crate::formats) fn is_as_stated(&self, axis: usize) -> bool {
        self.factors[axis] == ONE
    }

    /// A position or a step in the world, in the unit of all.
    pub(in crate::formats) fn of_vector(&self, vector: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| self.along(axis, vector[axis]))
    }
}

/// "mm (x), mm (y), none (z)".
fn listed(units: &[Option<Unit>; 3]) -> String {
    let one = |(name, unit): (&str, &Option<Unit>)| {
        format!("{} ({name})", unit.as_ref().map_or("none", Unit::as_str))
    };
    NAMES.into_iter().zip(units).map(one).collect::<Vec<_>>().join(", ")
}

fn not_comparable(units: &[Option<Unit>; 3]) -> String {
    format!(
        "the units of the axes are {}: coordinates are taken as they are, and lengths have no unit",
        listed(units)
    )
}

fn converted(units: &[Option<Unit>; 3], factors: &[Factor; 3], first: usize) -> String {
    let unit = units[first].as_ref().map_or("", Unit::as_str);
    let others: Vec<String> = (0..3)
        .filter(|&axis| factors[axis] != ONE)
        .map(|axis| format!("{} from {}", NAMES[axis], units[axis].as_ref().map_or("", Unit::as_str)))
        .collect();
    format!("lengths are in {unit}, as those along {}: converted are {}", NAMES[first], others.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(names: [&str; 3]) -> [Option<Unit>; 3] {
        names.map(Unit::length)
    }

    #[test]
    fn known_units_become_that_of_the_first_axis() {
        for (names, unit, lengths, is_said) in [
            (["µm", "nm", "mm"], Some("µm"), [0.5, 0.5, 2.0], true),
            (["mm", "mm", "mm"], Some("mm"), [0.5, 500.0, 0.002], false),
            (["m", "km", "m"], Some("m"), [0.5, 500_000.0, 0.002], true),
            (["inch", "cm", "in"], Some("inch"), [0.5, 500.0 / 2.54, 0.002], true),
            (["nanometer", "nm", "Å"], Some("nm"), [0.5, 500.0, 0.0002], true),
            (["picometer", "pm", "pm"], Some("picometer"), [0.5, 500.0, 0.002], false),
            (["furlong", "furlong", "furlong"], Some("furlong"), [0.5, 500.0, 0.002], false),
            (["", "", ""], None, [0.5, 500.0, 0.002], false),
            (["mm", "", "mm"], None, [0.5, 500.0, 0.002], true),
            (["km", "m", "hPa"], None, [0.5, 0.5, 0.002], true),
        ] {
            let found = Lengths::of_any(units(names));
            assert_eq!(found.unit.as_ref().map(Unit::as_str), unit, "{names:?}");
            let got = found.of_vector([0.5, 500.0, 0.002]);
            assert!(got.iter().zip(lengths).all(|(a, b)| (a - b).abs() <= 1e-15 * b), "{names:?}: {got:?}");
            assert_eq!(found.note.is_some(), is_said, "{names:?}: {:?}", found.note);
        }
    }

    #[test]
    fn an_unknown_unit_beside_others_is_refused_by_name() {
        let of = |names| Lengths::of_space(Path::new("a.nrrd"), "space units", units(names));
        let error = of(["mm", "furlong", "mm"]).unwrap_err().to_string();
        assert!(error.contains("furlong") && error.contains("a.nrrd") && !error.contains('\n'), "{error}");
        assert!(of(["furlong", "furlong", "furlong"]).is_ok());
        assert!(of(["mm", "", "mm"]).unwrap().note.is_some());
    }
}
