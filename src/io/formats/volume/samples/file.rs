//! A file of samples while it is written.

use super::pack::{Packed, Packer, Stream};
use super::{FileLayout, GridMeta, GridPlace, SampleField, SampleFormat, heads, nifti, tiff, vtk};
use crate::bytes::publish::{Unpublished, folder_of};
use crate::bytes::store::{read_at, write_at};
use crate::error::{Error, Result};
use crate::exec::CancelToken;
use crate::formats::shared::sink::resolve;
use crate::volume::ScalarType;
use half::f16;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Samples that are being written.
pub struct SampleFile {
    /// The file of the samples.
    out: Unpublished,
    /// The file that was named, where that is another one.
    header: Option<Unpublished>,
    meta: GridMeta,
    format: SampleFormat,
    path: PathBuf,
    /// Where the arrays begin, and their bytes.
    arrays: Vec<[u64; 2]>,
    /// The arrays that are compressed at the end.
    waiting: Option<Waiting>,
    bytes: u64,
}

/// Arrays in a nameless file, and the folder of that.
struct Waiting {
    file: File,
    folder: PathBuf,
}

impl SampleFile {
    /// Begins a file of samples on a grid. What is to be compressed waits in a folder for
    /// temporary files, or next to the target.
    ///
    /// # Errors
    /// [`Error::Usage`] when the target is a folder, there are too many samples, or the format has
    /// no place for them; [`Error::Io`] when the system refuses to write.
    pub fn create(
        path: &Path,
        format: SampleFormat,
        meta: &GridMeta,
        compress: bool,
        scratch: Option<&Path>,
    ) -> Result<Self> {
        format.expect(path, meta, compress)?;
        let lengths = meta.array_bytes()?;
        let (out, header) = match &format.files(path)[..] {
            [header, samples] => (publishable(samples)?, Some(publishable(header)?)),
            _ => (publishable(path)?, None),
        };
        let (meta, path) = (meta.clone(), path.to_path_buf());
        let mut file = Self { out, header, meta, format, path, arrays: vec![], waiting: None, bytes: 0 };
        if compress || format == SampleFormat::NiftiGz {
            file.wait(&lengths, scratch)?;
        } else {
            let stored: Vec<Packed> = lengths.iter().map(|&bytes| Packed::plain(bytes)).collect();
            file.lay_out(&stored)?;
        }
        if let GridPlace::Axes(axes) = &file.meta.place {
            for (n, axis) in axes.iter().enumerate() {
                let bytes: Vec<u8> = axis.iter().flat_map(|x| x.to_le_bytes()).collect();
                file.put(file.meta.fields.len() + n, &bytes, 0)?;
            }
        }
        Ok(file)
    }

    /// Begins a file of a list of samples, as NPY; with an offset they are written as `f64`.
    ///
    /// # Errors
    /// As [`SampleFile::create`].
    pub fn create_list(path: &Path, samples: u64, offset: f64) -> Result<Self> {
        let field = SampleField::floats("", offset);
        let (format, bytes) = (SampleFormat::Npy, field.scalar.bytes() as u64 * samples);
        let head = heads::npy(&format!("({samples},)"), field.scalar);
        let meta = GridMeta::even([samples, 1, 1], Default::default(), field);
        let (out, path) = (publishable(path)?, path.to_path_buf());
        let mut file =
            Self { out, header: None, meta, format, path, arrays: vec![], waiting: None, bytes: 0 };
        file.write_around(&FileLayout { head, ..FileLayout::default() }, &[bytes])?;
        Ok(file)
    }

    /// Keeps the arrays for the end.
    fn wait(&mut self, lengths: &[u64], scratch: Option<&Path>) -> Result<()> {
        let folder = scratch.unwrap_or_else(|| folder_of(&self.path)).to_path_buf();
        let file = temporary_in(&folder)?;
        for &length in lengths {
            self.arrays.push([self.arrays.last().map_or(0, |[at, before]| at + before), length]);
        }
        file.set_len(lengths.iter().sum()).map_err(|e| Error::io("write to", &folder, e))?;
        self.waiting = Some(Waiting { file, folder });
        Ok(())
    }

    fn layout(&self, stored: &[Packed]) -> Result<FileLayout> {
        let (meta, path) = (&self.meta, &self.path);
        Ok(match self.format {
            SampleFormat::Npy => {
                let [x, y, z] = meta.dims;
                let head = heads::npy(&format!("({z}, {y}, {x})"), meta.field().scalar);
                FileLayout { head, ..FileLayout::default() }
            }
            SampleFormat::Nrrd => {
                FileLayout { head: heads::nrrd(meta, stored[0].is_packed())?, ..FileLayout::default() }
            }
            SampleFormat::Mha | SampleFormat::Mhd => heads::metaimage(meta, self.format, path, &stored[0])?,
            SampleFormat::Nifti | SampleFormat::NiftiGz => {
                FileLayout { head: nifti::head(meta, path)?, ..FileLayout::default() }
            }
            SampleFormat::Tiff => tiff::layout(meta)?,
            SampleFormat::Vti | SampleFormat::Vtr | SampleFormat::Vts => vtk::layout(meta, stored)?,
        })
    }

    /// Writes all but the arrays, which have these lengths.
    fn lay_out(&mut self, stored: &[Packed]) -> Result<()> {
        let layout = self.layout(stored)?;
        let lengths: Vec<u64> = stored.iter().map(Packed::bytes).collect();
        self.write_around(&layout, &lengths)
    }

    fn write_around(&mut self, layout: &FileLayout, lengths: &[u64]) -> Result<()> {
        self.out.write(&layout.head)?;
        self.out.flush()?;
        let (mut at, mut arrays) = (layout.head.len() as u64, vec![]);
        for (n, &length) in lengths.iter().enumerate() {
            let before = layout.before.get(n).map_or(&[][..], |bytes| bytes);
            self.put_at(before, at)?;
            at += before.len() as u64;
            arrays.push([at, length]);
            at += length;
        }
        self.put_at(&layout.tail, at)?;
        self.bytes = at + layout.tail.len() as u64;
        let fits = self.out.file().set_len(self.bytes);
        fits.map_err(|e| Error::io("write", self.out.temporary(), e))?;
        if let (Some(header), Some(text)) = (&mut self.header, &layout.header) {
            header.write(text)?;
            self.bytes += text.len() as u64;
        }
        self.arrays = arrays;
        Ok(())
    }

    fn put_at(&self, bytes: &[u8], offset: u64) -> Result<()> {
        write_at(self.out.file(), bytes, offset).map_err(|e| Error::io("write", self.out.temporary(), e))
    }

    /// Writes bytes of an array.
    fn put(&self, array: usize, bytes: &[u8], offset: u64) -> Result<()> {
        let at = self.arrays[array][0] + offset;
        match &self.waiting {
            None => self.put_at(bytes, at),
            Some(Waiting { file, folder }) => write_at(file, bytes, at)
                .map_err(|e| Error::io("write samples to a temporary file in", folder, e)),
        }
    }

    /// Writes samples of a field, less its offset, from number `first` on; any thread may, in any
    /// order.
    ///
    /// # Errors
    /// When the system refuses to write; [`Error::Usage`] for a value that the type of the samples
    /// does not have.
    pub fn write_field(&self, field: usize, first: u64, samples: &[f32]) -> Result<()> {
        let SampleField { scalar, offset, .. } = self.meta.fields[field];
        let at = first * scalar.bytes() as u64;
        if scalar == ScalarType::F32 && offset == 0.0 && cfg!(target_endian = "little") {
            return self.put(field, bytemuck::cast_slice(samples), at);
        }
        let mut bytes = Vec::with_capacity(samples.len() * scalar.bytes());
        push_samples(&mut bytes, scalar, offset, samples)?;
        self.put(field, &bytes, at)
    }

    /// Writes samples of the first field.
    ///
    /// # Errors
    /// As [`SampleFile::write_field`].
    pub fn write(&self, first: u64, samples: &[f32]) -> Result<()> {
        self.write_field(0, first, samples)
    }

    /// Writes the positions of samples from number `first` on, of a grid of points.
    ///
    /// # Errors
    /// When the system refuses to write.
    pub fn write_points(&self, first: u64, points: &[[f64; 3]]) -> Result<()> {
        let bytes: Vec<u8> = points.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        self.put(self.meta.fields.len(), &bytes, 24 * first)
    }

    /// Compresses what is to be compressed, on the threads of a pool or on this one; then makes
    /// the file durable, and visible. Returns its bytes.
    ///
    /// # Errors
    /// When the system refuses; [`Error::Cancelled`].
    pub fn publish(mut self, pool: Option<&rayon::ThreadPool>, cancel: &CancelToken) -> Result<u64> {
        if let Some(waiting) = self.waiting.take() {
            self.pack(&waiting, pool, cancel)?;
        }
        self.out.publish()?;
        self.header.map_or(Ok(()), Unpublished::publish)?;
        Ok(self.bytes)
    }

    fn pack(
        &mut self,
        waiting: &Waiting,
        pool: Option<&rayon::ThreadPool>,
        cancel: &CancelToken,
    ) -> Result<()> {
        let failed = |e| Error::io("compress samples in", &waiting.folder, e);
        let stream = match self.format {
            SampleFormat::Nrrd | SampleFormat::NiftiGz => Stream::Gzip,
            SampleFormat::Mha | SampleFormat::Mhd => Stream::Zlib,
            _ => Stream::Blocks,
        };
        let packer = Packer { stream, pool, cancel, failed: &failed };
        // All of such a file is compressed.
        let whole = self.format == SampleFormat::NiftiGz;
        let prefix = if whole { nifti::head(&self.meta, &self.path)? } else { vec![] };
        let (packed, mut at, mut stored) = (temporary_in(&waiting.folder)?, 0, vec![]);
        for &[start, length] in &self.arrays {
            let mut put = |bytes: &[u8]| {
                write_at(&packed, bytes, at)?;
                at += bytes.len() as u64;
                Ok(())
            };
            let read = |offset: u64, out: &mut [u8]| read_at(&waiting.file, out, start + offset);
            stored.push(packer.pack(&prefix, length, &read, &mut put)?);
        }
        match whole {
            true => self.write_around(&FileLayout::default(), &[stored[0].bytes()])?,
            false => self.lay_out(&stored)?,
        }
        let mut from = 0;
        for n in 0..self.arrays.len() {
            let [to, length] = self.arrays[n];
            copy(&packed, from, length, |bytes, at| self.put_at(bytes, to + at), &failed)?;
            from += length;
        }
        Ok(())
    }
}

/// Hands a part of a file on.
fn copy(
    from: &File,
    start: u64,
    length: u64,
    mut put: impl FnMut(&[u8], u64) -> Result<()>,
    failed: &dyn Fn(std::io::Error) -> Error,
) -> Result<()> {
    let mut buffer = vec![0; 1 << 20];
    let mut at = 0;
    while at < length {
        let part = &mut buffer[..(length - at).min(1 << 20) as usize];
        read_at(from, part, start + at).map_err(failed)?;
        put(part, at)?;
        at += part.len() as u64;
    }
    Ok(())
}

fn temporary_in(folder: &Path) -> Result<File> {
    tempfile::tempfile_in(folder).map_err(|e| Error::io("make a temporary file in", folder, e))
}

/// A file that gets its name when it is complete.
pub(in crate::formats) fn publishable(path: &Path) -> Result<Unpublished> {
    Unpublished::create(&resolve(path)?)
}

/// Appends samples, with an offset, as little-endian numbers of a type.
pub fn push_samples(bytes: &mut Vec<u8>, scalar: ScalarType, offset: f64, samples: &[f32]) -> Result<()> {
    let value = |v: &f32| offset + f64::from(*v);
    match scalar {
        ScalarType::F16 => bytes.extend(samples.iter().flat_map(|v| f16::from_f64(value(v)).to_le_bytes())),
        ScalarType::F32 => bytes.extend(samples.iter().flat_map(|v| (value(v) as f32).to_le_bytes())),
        ScalarType::F64 => bytes.extend(samples.iter().flat_map(|v| value(v).to_le_bytes())),
        _ => {
            for v in samples {
                let number = whole(scalar, offset, *v)?;
                bytes.extend_from_slice(&number.to_le_bytes()[..scalar.bytes()]);
            }
        }
    }
    Ok(())
}

/// The least and the largest number of an integer type; none of others.
pub fn limits(scalar: ScalarType) -> Option<[i128; 2]> {
    let bits = 8 * scalar.bytes() as u32;
    match scalar {
        ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => Some([0, (1 << bits) - 1]),
        ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64 => {
            Some([-(1 << (bits - 1)), (1 << (bits - 1)) - 1])
        }
        ScalarType::F16 | ScalarType::F32 | ScalarType::F64 => None,
    }
}

/// A whole number of a type, from a value less an offset, which is one too.
fn whole(scalar: ScalarType, offset: f64, v: f32) -> Result<i128> {
    let number = (v.fract() == 0.0).then(|| offset as i128 + v as i128);
    let fits = |n: &i128| limits(scalar).is_some_and(|[least, most]| (least..=most).contains(n));
    number.filter(fits).ok_or_else(|| {
        let value = offset + f64::from(v);
        Error::usage(format!("a value of {value} cannot be written as {}", scalar.name()))
    })
}
