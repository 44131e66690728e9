//! Colour maps: from a share of a range to a colour.
//!
//! Viridis, cividis and grey rise evenly in lightness, so equal steps of the value look equal, also
//! to those who do not distinguish all colours. Coolwarm goes through white in the middle of the
//! range: K. Moreland, Diverging Color Maps for Scientific Visualization, ISVC 2009.

use isospan_io::error::Error;
use std::f64::consts::FRAC_PI_3;
use std::str::FromStr;

/// A colour map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColourMap {
    /// From dark blue over green to yellow.
    #[default]
    Viridis,
    /// From dark blue to yellow, the same for those who do not distinguish red and green.
    Cividis,
    /// From blue over white to red: for values about a middle.
    Coolwarm,
    /// From black to white.
    Grey,
}

impl ColourMap {
    /// The colour of what has no value, sRGB.
    pub const NO_VALUE: [u8; 3] = [128; 3];

    /// All maps.
    pub const ALL: [Self; 4] = [Self::Viridis, Self::Cividis, Self::Coolwarm, Self::Grey];

    /// Its name, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Viridis => "viridis",
            Self::Cividis => "cividis",
            Self::Coolwarm => "coolwarm",
            Self::Grey => "grey",
        }
    }

    /// The colour of a share, sRGB; a share outside 0 to 1 is taken to the nearer end.
    pub fn colour(self, share: f64) -> [u8; 3] {
        let share = share.clamp(0.0, 1.0);
        let of = |map: colorous::Gradient| map.eval_continuous(share).as_array();
        match self {
            Self::Viridis => of(colorous::VIRIDIS),
            Self::Cividis => of(colorous::CIVIDIS),
            Self::Coolwarm => coolwarm(share),
            Self::Grey => [(255.0 * share).round() as u8; 3],
        }
    }
}

impl FromStr for ColourMap {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let found =
            Self::ALL.into_iter().find(|map| map.name() == text || text == "gray" && *map == Self::Grey);
        let names = Self::ALL.map(Self::name).join(", ");
        found.ok_or_else(|| Error::usage(format!("'{text}' is no colour map; there are {names}")))
    }
}

/// The ends of coolwarm, and the length of its white (Moreland, section 5).
const COOL: [f64; 3] = [59.0, 76.0, 192.0];
const WARM: [f64; 3] = [180.0, 4.0, 38.0];
const WHITE: f64 = 88.0;
/// White of daylight, D65.
const DAYLIGHT: [f64; 3] = [95.047, 100.0, 108.883];

/// A colour as Moreland's length, saturation and hue: CIELAB in polar coordinates.
#[derive(Clone, Copy)]
struct Polar {
    m: f64,
    s: f64,
    h: f64,
}

fn coolwarm(share: f64) -> [u8; 3] {
    let end = Polar::of(if share < 0.5 { COOL } else { WARM });
    // White, with the hue that lets the path to the end bend evenly (Moreland, figure 6).
    let spin = end.s * (WHITE * WHITE - end.m * end.m).max(0.0).sqrt() / (end.m * libm::sin(end.s));
    let white = Polar { m: WHITE, s: 0.0, h: if end.h > -FRAC_PI_3 { end.h + spin } else { end.h - spin } };
    let t = (2.0 * share - 1.0).abs();
    let between = |a: f64, b: f64| a + t * (b - a);
    Polar { m: between(white.m, end.m), s: between(white.s, end.s), h: between(white.h, end.h) }.to_rgb()
}

impl Polar {
    fn of(rgb: [f64; 3]) -> Self {
        let [r, g, b] = rgb.map(|c| {
            let c = c / 255.0;
            100.0 * if c > 0.04045 { libm::pow((c + 0.055) / 1.055, 2.4) } else { c / 12.92 }
        });
        let xyz = [
            0.4124 * r + 0.3576 * g + 0.1805 * b,
            0.2126 * r + 0.7152 * g + 0.0722 * b,
            0.0193 * r + 0.1192 * g + 0.9505 * b,
        ];
        let f = |n: usize| {
            let t = xyz[n] / DAYLIGHT[n];
            if t > 0.008856 { libm::cbrt(t) } else { 7.787 * t + 16.0 / 116.0 }
        };
        let (l, a, b) = (116.0 * f(1) - 16.0, 500.0 * (f(0) - f(1)), 200.0 * (f(1) - f(2)));
        let m = (l * l + a * a + b * b).sqrt();
        Self { m, s: libm::acos(l / m), h: libm::atan2(b, a) }
    }

    fn to_rgb(self) -> [u8; 3] {
        let Self { m, s, h } = self;
        let (l, a, b) = (m * libm::cos(s), m * libm::sin(s) * libm::cos(h), m * libm::sin(s) * libm::sin(h));
        let y = (l + 16.0) / 116.0;
        let inverse = |t: f64| if t > 0.206_893 { t * t * t } else { (t - 16.0 / 116.0) / 7.787 };
        let [x, y, z] = [a / 500.0 + y, y, y - b / 200.0].map(inverse);
        let [x, y, z] = [x * DAYLIGHT[0] / 100.0, y * DAYLIGHT[1] / 100.0, z * DAYLIGHT[2] / 100.0];
        let linear = [
            3.2406 * x - 1.5372 * y - 0.4986 * z,
            -0.9689 * x + 1.8758 * y + 0.0415 * z,
            0.0557 * x - 0.2040 * y + 1.0570 * z,
        ];
        linear.map(|c| {
            let c = if c > 0.003_130_8 { 1.055 * libm::pow(c, 1.0 / 2.4) - 0.055 } else { 12.92 * c };
            (255.0 * c.clamp(0.0, 1.0)).round() as u8
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Colours that Matplotlib 3.9 has at the ends and in the middle, of 256.
    #[test]
    fn maps_are_those_of_matplotlib() {
        let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(&a, b)| a.abs_diff(b) <= 3);
        for (map, at, expected) in [
            (ColourMap::Viridis, 0.0, [68, 1, 84]),
            (ColourMap::Viridis, 0.5, [33, 145, 140]),
            (ColourMap::Viridis, 1.0, [253, 231, 37]),
            (ColourMap::Coolwarm, 0.0, [59, 76, 192]),
            (ColourMap::Coolwarm, 0.25, [141, 176, 254]),
            (ColourMap::Coolwarm, 0.5, [221, 221, 221]),
            (ColourMap::Coolwarm, 0.75, [244, 154, 123]),
            (ColourMap::Coolwarm, 1.0, [180, 4, 38]),
            (ColourMap::Grey, 0.5, [128, 128, 128]),
        ] {
            let found = map.colour(at);
            assert!(near(found, expected), "{} at {at}: {found:?}, not {expected:?}", map.name());
        }
    }

    #[test]
    fn names_are_read_back() {
        for map in ColourMap::ALL {
            assert_eq!(map.name().parse::<ColourMap>().unwrap(), map);
        }
        assert_eq!("jet".parse::<ColourMap>().unwrap_err().exit_code(), 2);
    }
}
