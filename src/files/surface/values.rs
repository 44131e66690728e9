//! Values of a field at the vertices of a surface, and the colours that they have.

use crate::render::ColourMap;
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::error::{Error, Result};
use isospan_io::volume::shifted::shortest;
use std::path::Path;

/// A value at each vertex of a surface, NaN where there is none. What memory does not hold is on
/// disk. Values are `f32` less an offset, which is not 0 where `f32` would lose their differences:
/// then files have them as doubles, but for GLB.
#[derive(Debug)]
pub struct VertexValues {
    name: String,
    range: [f64; 2],
    map: ColourMap,
    offset: f64,
    values: Store<f32>,
    without: u64,
}

/// Colours of a map in formats that number them.
const PALETTE: usize = 256;
/// Bytes of values that are kept of those on disk.
const CACHE: usize = 1 << 20;

impl VertexValues {
    /// No values yet, of a field of this name. A value at an end of `range` has the colour at that
    /// end of the map. Up to `memory` bytes are in memory, the rest is in the folder `scratch`.
    ///
    /// # Errors
    /// [`Error::Usage`] where the range is not finite or falls.
    pub fn new(name: &str, range: [f64; 2], map: ColourMap, memory: usize, scratch: &Path) -> Result<Self> {
        if !(range[0].is_finite() && range[1].is_finite() && range[0] <= range[1]) {
            return Err(Error::usage(format!(
                "the range of colours must be two numbers that rise; not {} and {}",
                range[0], range[1]
            )));
        }
        let values = Store::new(memory, scratch);
        Ok(Self { name: name.into(), range, map, offset: 0.0, values, without: 0 })
    }

    /// The same, of values that will be given less an offset.
    #[must_use]
    pub fn less(self, offset: f64) -> Self {
        Self { offset, ..self }
    }

    /// Appends the values of the next vertices, less the offset.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch folder cannot be written.
    pub fn extend(&mut self, values: &[f32]) -> Result<()> {
        self.without += values.iter().filter(|v| v.is_nan()).count() as u64;
        self.values.extend(values)
    }

    /// How many vertices have no value.
    pub fn without_value(&self) -> u64 {
        self.without
    }

    /// The field's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The field's name of letters, digits and underscores.
    pub(super) fn plain_name(&self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        let name: String = self.name.chars().map(plain).collect();
        if name.is_empty() { "value".into() } else { name }
    }

    /// A value as the field has it, given less the offset.
    pub(super) fn whole(&self, value: f32) -> f64 {
        if self.offset == 0.0 { f64::from(value) } else { self.offset + shortest(value) }
    }

    /// Bytes of a value in a file of a format that has doubles.
    pub(super) fn bytes(&self) -> u64 {
        if self.offset == 0.0 { 4 } else { 8 }
    }

    /// Appends a value, as the field has it.
    pub(super) fn put(&self, value: f32, out: &mut Vec<u8>) {
        match self.bytes() {
            4 => out.extend_from_slice(&value.to_le_bytes()),
            _ => out.extend_from_slice(&self.whole(value).to_le_bytes()),
        }
    }

    /// The colour of a value, sRGB.
    pub(super) fn colour(&self, value: f32) -> [u8; 3] {
        let [lo, hi] = self.range;
        let share = (self.whole(value) - lo) / (hi - lo);
        match value {
            v if v.is_nan() => ColourMap::NO_VALUE,
            _ if hi > lo => self.map.colour(share),
            _ => self.map.colour(0.5),
        }
    }

    /// The colours that [`Self::index`] numbers: those of the map, and that of no value.
    pub(super) fn palette(&self) -> impl Iterator<Item = [u8; 3]> {
        let map = self.map;
        let colours = (0..PALETTE).map(move |n| map.colour(n as f64 / (PALETTE - 1) as f64));
        colours.chain([ColourMap::NO_VALUE])
    }

    /// The number of the colour of a value in the palette.
    pub(super) fn index(&self, value: f32) -> usize {
        let [lo, hi] = self.range;
        let share = (self.whole(value) - lo) / (hi - lo);
        match value {
            v if v.is_nan() => PALETTE,
            _ if hi > lo => (share.clamp(0.0, 1.0) * (PALETTE - 1) as f64).round() as usize,
            _ => PALETTE / 2,
        }
    }

    /// Single values, through a small cache.
    pub(super) fn cached(&self) -> Cached<'_, f32> {
        Cached::new(&self.values, CACHE)
    }

    /// Reads the values of some vertices.
    pub(super) fn read(&self, first: u64, out: &mut [f32]) -> Result<()> {
        if first + out.len() as u64 > self.values.len() {
            return Err(Error::usage(format!("{} values for more vertices", self.values.len())));
        }
        self.values.read_from(first, out)
    }

    /// What a file says of them: the range, and the map.
    pub(super) fn line(&self) -> String {
        format!("colours {} of {}, {} to {}", self.map.name(), self.name, self.range[0], self.range[1])
    }
}

/// The share of light, 0 to 1, of a colour component in sRGB (IEC 61966-2-1): glTF has linear
/// colours.
pub(super) fn light(component: u8) -> f64 {
    let c = f64::from(component) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { libm::pow((c + 0.055) / 1.055, 2.4) }
}

/// That share, of 255.
pub(super) fn linear(component: u8) -> u8 {
    (light(component) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_colours_of_their_place_in_the_range() {
        let folder = std::env::temp_dir();
        // Two values in memory, three on disk.
        let mut values = VertexValues::new("a b", [1.0, 3.0], ColourMap::Grey, 8, &folder).unwrap();
        values.extend(&[0.0, 1.0, 2.0, 3.0, f32::NAN]).unwrap();
        let colours: Vec<u8> = [0.0, 1.0, 2.0, 3.0, f32::NAN].map(|v| values.colour(v)[0]).to_vec();
        assert_eq!(colours, [0, 0, 128, 255, 128]);
        let mut some = [0.0; 3];
        values.read(1, &mut some).unwrap();
        assert_eq!((some, values.plain_name()), ([1.0, 2.0, 3.0], "a_b".into()));
        assert!(values.read(3, &mut some).is_err());
        assert!(VertexValues::new("f", [2.0, 1.0], ColourMap::Grey, 8, &folder).is_err());
        assert_eq!([0, 128, 255].map(linear), [0, 55, 255]);
        let palette: Vec<[u8; 3]> = values.palette().collect();
        let same = |v: f32| palette[values.index(v)] == values.colour(v);
        assert!([0.0, 1.0, 2.0, 3.0, f32::NAN].into_iter().all(same));
    }

    #[test]
    fn values_less_an_offset_are_doubles() {
        let range = [101_325_000.0, 101_325_004.0];
        let values = VertexValues::new("p", range, ColourMap::Grey, 8, &std::env::temp_dir()).unwrap();
        let values = values.less(101_325_002.0);
        assert_eq!([-2.0, 0.0, 2.0].map(|v| values.colour(v)[0]), [0, 128, 255]);
        let mut bytes = vec![];
        values.put(1.0, &mut bytes);
        assert_eq!((bytes, values.bytes()), (101_325_003f64.to_le_bytes().to_vec(), 8));
    }
}
