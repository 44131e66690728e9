//! Volumes that a program has in memory.
//!
//! ```
//! use isospan_io::volume::memory::volume_of;
//!
//! # fn main() -> isospan_io::Result<()> {
//! let samples: Vec<f32> = (0..6 * 5 * 4).map(|i| i as f32).collect();
//! let volume = volume_of("a ramp", [6, 5, 4], samples)?;
//! # Ok(())
//! # }
//! ```

use super::strided::StridedVolume;
use super::units::Units;
use super::{Assumed, FieldInfo, ScalarType, VolumeInfo};
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::grid::{Geometry, IndexBox};
use std::marker::PhantomData;
use std::sync::Arc;

/// A type of samples.
pub trait Sample: bytemuck::Pod + Send + Sync {
    /// Its name in an archive.
    const SCALAR: ScalarType;
}

macro_rules! samples {
    ($($t:ty: $scalar:ident),*) => { $(impl Sample for $t { const SCALAR: ScalarType = ScalarType::$scalar; })* };
}

samples!(u8: U8, i8: I8, u16: U16, i16: I16, u32: U32, i32: I32, u64: U64, i64: I64, f32: F32, f64: F64);

/// A volume of `dims` samples along x, y, z, x fastest, which `samples` owns: a vector, a shared
/// slice, a mapped file. Nothing is copied. `name` stands for it in messages and in the archive.
/// Samples lie at whole numbers; [`StridedVolume::placed`] moves them.
///
/// # Errors
/// [`Error::Usage`] where the number of samples is not the product of `dims`, or that is 0.
pub fn volume_of<T: Sample>(
    name: &str,
    dims: [u64; 3],
    samples: impl AsRef<[T]> + Send + Sync + 'static,
) -> Result<StridedVolume> {
    let count = samples.as_ref().len();
    if count == 0 || IndexBox::whole(dims).checked_len() != Some(count as u64) {
        let [x, y, z] = dims;
        return Err(Error::usage(format!("{name}: {x} x {y} x {z} samples expected, got {count}")));
    }
    let source = ByteSource::in_memory(name, AsBytes(samples, PhantomData::<T>));
    let strides = StridedVolume::packed_strides(dims, T::SCALAR).expect("as many bytes are in memory");
    StridedVolume::new(info_of(name, dims, T::SCALAR), Arc::new(source), 0, false, strides)
}

/// The description of a volume in memory: one field, "data", at whole numbers.
pub fn info_of(name: &str, dims: [u64; 3], scalar: ScalarType) -> VolumeInfo {
    let field = FieldInfo { name: "data".to_owned(), scalar, components: 1 };
    VolumeInfo {
        path: name.into(),
        format: "in memory".to_owned(),
        dims,
        fields: vec![field.clone()],
        field,
        geometry: Geometry::default(),
        slope: 1.0,
        intercept: 0.0,
        missing: None,
        units: Units::default(),
        notes: vec![],
        data_files: vec![],
        assumed: Assumed::default(),
        is_labels: false,
    }
}

/// The bytes of samples.
struct AsBytes<S, T>(S, PhantomData<T>);

impl<T: Sample, S: AsRef<[T]>> AsRef<[u8]> for AsBytes<S, T> {
    fn as_ref(&self) -> &[u8] {
        bytemuck::cast_slice(self.0.as_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::VolumeReader;

    #[test]
    fn samples_are_read_where_they_lie() {
        let volume = volume_of("v", [3, 2, 2], (0..12i16).collect::<Vec<_>>()).unwrap();
        let mut out = [0.0; 4];
        volume.read_box(IndexBox { lo: [1, 0, 1], hi: [3, 2, 2] }, &mut out).unwrap();
        assert_eq!(out, [7.0, 8.0, 10.0, 11.0]);
        assert_eq!(volume.info().field.scalar, ScalarType::I16);
        let shared: Arc<[f64]> = (0..8).map(f64::from).collect();
        assert!(volume_of("v", [2; 3], shared).is_ok());
    }

    #[test]
    fn other_numbers_of_samples_are_refused() {
        for (dims, count) in [([2, 2, 2], 7), ([0, 1, 1], 0), ([u64::MAX, 2, 1], 2)] {
            let error = volume_of("v", dims, vec![0.0f32; count]).expect_err("refused");
            assert_eq!(error.exit_code(), 2, "{error}");
        }
    }
}
