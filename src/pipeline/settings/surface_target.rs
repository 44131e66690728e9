//! How far a surface may be from that of the samples, and lengths in the world.

use super::FieldValue;
use isospan_io::error::{Error, Result};
use isospan_io::setting::Setting;
use isospan_io::volume::units::Unit;
use serde::{Deserialize, Serialize};

/// A length in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Length {
    /// In world units.
    World(f64),
    /// As a part of the diagonal of the domain.
    OfDiagonal(f64),
    /// In a unit of length, whatever those of the world are.
    Metric {
        /// The number of units.
        value: f64,
        /// The unit is so many metres,
        metres: f64,
        /// times this power of ten.
        power: i32,
    },
}

impl Length {
    /// A number of some unit; `None` where that is no known unit of length.
    pub fn of(value: f64, unit: &Unit) -> Option<Self> {
        let (metres, power) = unit.metres()?;
        Some(Self::Metric { value, metres, power })
    }

    /// The length in world units, which are this unit, in a domain of this diagonal.
    ///
    /// # Errors
    /// [`Error::Usage`] where the unit, or the diagonal, is not known.
    pub fn in_world(self, unit: Option<&Unit>, diagonal: Option<f64>) -> Result<f64> {
        match self {
            Self::World(length) => Ok(length),
            Self::OfDiagonal(share) => diagonal.map(|diagonal| share * diagonal).ok_or_else(|| {
                Error::usage(
                    "a length in % of the diagonal is not possible on a grid with coordinates: \
                     give it in world units",
                )
            }),
            Self::Metric { value, metres, power } => {
                let Some((own, own_power)) = unit.and_then(Unit::metres) else {
                    return Err(Error::usage(format!(
                        "the unit of lengths in the world is not known: give the length in world units, \
                         or name the unit with {} as the archive is made",
                        Setting::LengthUnit
                    )));
                };
                let value = if metres == own { value } else { value * metres / own };
                // Powers of ten up to 22 are exact, and tenths are not.
                let shift = power - own_power;
                let ten = 10f64.powi(shift.abs());
                Ok(if shift < 0 { value / ten } else { value * ten })
            }
        }
    }
}

/// A largest distance of an isosurface from that of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceTarget {
    /// The isovalue; a share is one of the range of the samples.
    pub isovalue: FieldValue,
    /// The distance: 99 % of the area of each of the two surfaces is at most so far from the other.
    pub distance: Length,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_those_of_the_world() {
        let unit = |text: &str| Unit::length(text).unwrap();
        let length = |value, of: &str| Length::of(value, &unit(of)).unwrap();
        let world = |length: Length, of: &str| length.in_world(Some(&unit(of)), None).unwrap();
        assert_eq!(world(length(0.2, "mm"), "mm"), 0.2);
        assert_eq!(world(length(200.0, "um"), "mm"), 0.2);
        assert_eq!(world(length(0.2, "mm"), "µm"), 200.0);
        assert!((world(length(1.0, "in"), "mm") - 25.4).abs() < 1e-12);
        assert_eq!(world(length(1.0, "in"), "in"), 1.0);
        let refused = |unknown: Option<&Unit>| length(1.0, "mm").in_world(unknown, Some(1.0)).unwrap_err();
        assert!(refused(None).to_string().contains("`length_unit`"));
        assert!(refused(Unit::new("furlong").as_ref()).to_string().contains("not known"));
        assert_eq!(Length::OfDiagonal(0.01).in_world(None, Some(50.0)).unwrap(), 0.5);
        assert!(Length::OfDiagonal(0.01).in_world(None, None).is_err());
    }
}
