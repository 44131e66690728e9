//! NPZ (NumPy): a zip archive whose members are NPY files. Each three-dimensional array in it is a
//! field.
//!
//! A stored member (`numpy.savez`) is mapped where it lies in the archive; a deflated one
//! (`numpy.savez_compressed`) is a stream, whose CRC-32 is checked at its end. Deflated arrays in
//! Fortran order are refused, because they would have to be transposed out of core; once unpacked,
//! they can be read.

use super::npy::Array;
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::{given_geometry, plain_info};
use crate::formats::shared::stream::{ByteSlabs, Codec, Tail};
use crate::formats::shared::zip::{Directory, Stored};
use crate::formats::shared::{OpenOptions, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::{FieldInfo, VolumeSource};
use std::io::Read;
use std::sync::Arc;

/// Several arrays of NumPy.
pub(in crate::formats) struct Npz;

static ABOUT: About = About {
    volumes: &["NPZ"],
    suffixes: &[".npz"],
    magic: &[b"PK\x03\x04"],
    on_servers: true,
    has_spacing: false,
    ..About::named("an NPZ file")
};

impl Format for Npz {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let source = Arc::clone(head.file()?);
        let (mut arrays, mut refused) = (vec![], None);
        for member in members(&source)? {
            match member.array(&source) {
                Ok(array) => arrays.push((member, array)),
                Err(e) => refused = refused.or(Some(e)),
            }
        }
        if arrays.is_empty() {
            let none = || Error::bad_input(head.path, "members", "an array (.npy)", "none");
            return Err(refused.unwrap_or_else(none));
        }
        Ok(Box::new(Archive { source, arrays }))
    }
}

/// An NPZ archive, and the arrays in it that can be read.
struct Archive {
    source: Arc<ByteSource>,
    arrays: Vec<(NpyMember, Array)>,
}

impl Dataset for Archive {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let path = self.source.path();
        let field =
            |(m, a): &(NpyMember, Array)| FieldInfo { name: m.name.clone(), scalar: a.scalar, components: 1 };
        let fields: Vec<FieldInfo> = self.arrays.iter().map(field).collect();
        let number = pick_field(path, &fields, options.field.as_deref())?;
        let (member, array) = &self.arrays[number];
        let format = if member.stored.deflated { "NPZ (deflated)" } else { "NPZ (stored)" };
        let geometry = given_geometry(path, options, Geometry::default())?;
        let mut info = plain_info(path, format, array.dims, array.scalar, geometry);
        info.assumed = options.assumed([true; 3]);
        (info.field, info.fields) = (fields[number].clone(), fields);
        if !member.stored.deflated {
            let source = member.check_length(array, Arc::clone(&self.source))?;
            let at = member.stored.bytes.start + array.data_at as u64;
            let volume = StridedVolume::new(info, source, at, array.big_endian, array.strides(path)?)?;
            return Ok(volume.source());
        }
        if array.z_fastest {
            let expected = "C order in a compressed archive";
            return Err(Error::bad_input(path, &member.name, expected, "Fortran order")
                .with_help("unpack it: `unzip` the member, whose .npy file is read in either order"));
        }
        let codec = Codec::Deflate { crc32: member.stored.crc32 };
        let (range, skip) = (member.stored.bytes.clone(), array.data_at as u64);
        // As NumPy does, what follows an array in its member is passed over.
        let slabs = ByteSlabs::new(info, &self.source, range, codec, skip, array.big_endian, Tail::Checked)?;
        Ok(VolumeSource::Stream(Box::new(slabs)))
    }
}

/// A member of the archive that is an NPY file.
struct NpyMember {
    /// Without ".npy".
    name: String,
    stored: Stored,
}

impl NpyMember {
    /// The array's header. NumPy writes at most 64 KiB of it unless more is asked for.
    fn array(&self, source: &Arc<ByteSource>) -> Result<Array> {
        let mut head = vec![];
        let reader: Box<dyn Read> = if self.stored.deflated {
            Codec::Deflate { crc32: self.stored.crc32 }.reader(source, self.stored.bytes.clone())?
        } else {
            Box::new(source.reader(self.stored.bytes.clone())?)
        };
        let read = reader.take(1 << 17).read_to_end(&mut head);
        let array = Array::parse(source.path(), &head);
        match (array, read) {
            (Err(_), Err(e)) => {
                Err(Error::bad_input(source.path(), &self.name, "good deflate data", e.to_string()))
            }
            (array, _) => array,
        }
    }

    /// Refuses a stored member that is shorter than its array: what follows it in the archive are
    /// no samples.
    fn check_length(&self, array: &Array, source: Arc<ByteSource>) -> Result<Arc<ByteSource>> {
        let samples = array.dims.iter().product::<u64>() * array.scalar.bytes() as u64;
        let (needed, got) = (array.data_at as u64 + samples, self.stored.bytes.end - self.stored.bytes.start);
        if got >= needed {
            return Ok(source);
        }
        Err(Error::bad_input(source.path(), &self.name, format!("{needed} bytes"), format!("{got} bytes")))
    }
}

/// The NPY members of an archive, in the order of its directory.
fn members(source: &ByteSource) -> Result<Vec<NpyMember>> {
    let (directory, mut places) = (Directory::of(source)?, vec![]);
    directory.each(source, |at, name| {
        if name.ends_with(b".npy") {
            places.push(at);
        }
    })?;
    let member = |at| {
        let member = directory.member(source, at)?;
        let name = member.name.strip_suffix(".npy").unwrap_or(&member.name).to_owned();
        Ok(NpyMember { name, stored: member.stored(source, &[])? })
    };
    places.into_iter().map(member).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::open_volume;
    use crate::formats::shared::zip::tests::zip;
    use crate::formats::tests::{torture, write};
    use crate::formats::volume::npy::tests::{check, npy, samples};

    fn volume() -> Vec<u8> {
        npy(1, "'>u2'", false, "(2, 3, 4)", &samples(true, false))
    }

    fn options(field: Option<&str>) -> OpenOptions {
        OpenOptions { field: field.map(str::to_string), ..OpenOptions::default() }
    }

    #[test]
    fn members_stored_or_deflated() {
        let dir = tempfile::tempdir().unwrap();
        for (deflate, long) in [(false, false), (true, false), (false, true), (true, true)] {
            let path = write(
                &dir,
                "a.npz",
                &zip(&[("readme.txt", vec![1]), ("a/vol.npy", volume())], deflate, long),
            );
            let info = check(&path, &options(None));
            assert_eq!(info.format, if deflate { "NPZ (deflated)" } else { "NPZ (stored)" });
            check(&path, &options(Some("a/vol")));
            assert_eq!(open_volume(&path, &options(Some("b"))).err().expect("refused").exit_code(), 2);
        }
    }

    #[test]
    fn arrays_are_fields() {
        let dir = tempfile::tempdir().unwrap();
        let other = npy(1, "'<f4'", false, "(1, 1, 2)", &[0; 8]);
        let spacing = npy(1, "'<f8'", false, "(3,)", &[0; 24]);
        let both = [("spacing.npy", spacing.clone()), ("a.npy", volume()), ("b.npy", other)];
        let path = write(&dir, "a.npz", &zip(&both, true, false));
        let error = open_volume(&path, &options(None)).err().expect("two fields").to_string();
        assert!(error.contains("a (uint16), b (float32)"), "{error}");
        check(&path, &options(Some("a")));
        for (members, message) in [
            (vec![("spacing.npy", spacing)], "shape"),
            (vec![("a.txt", vec![1])], "members"),
            (vec![("a.npy", npy(1, "'<u2'", true, "(2, 3, 4)", &samples(false, true)))], "Fortran"),
            (vec![], "end"),
        ] {
            let path = write(&dir, "a.npz", &zip(&members, true, false));
            let error = open_volume(&path, &options(None)).err().expect(message);
            assert!(error.exit_code() == 5, "{error}");
        }
        let stored =
            zip(&[("a.npy", npy(1, "'<u2'", true, "(2, 3, 4)", &samples(false, true)))], false, false);
        check(&write(&dir, "a.npz", &stored), &options(None));
    }

    #[test]
    fn bytes_after_an_array_are_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        for deflate in [false, true] {
            let longer = [volume(), vec![7; 70_000]].concat();
            let mut file = zip(&[("a.npy", longer)], deflate, false);
            check(&write(&dir, "a.npz", &file), &options(None));
            let entry = file.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
            file[entry + 16] ^= 1;
            let source = open_volume(&write(&dir, "a.npz", &file), &options(None)).unwrap();
            let read = crate::formats::tests::try_read_all(source);
            assert_eq!(read.is_err(), deflate, "the checksum is that of all bytes");
        }
    }

    #[test]
    fn damage_is_refused() {
        for deflate in [false, true] {
            let file = zip(&[("a.npy", volume())], deflate, false);
            // The last two bytes are the archive's comment.
            torture("a.npz", &file, file.len() - 2);
        }
    }

    #[test]
    fn a_wrong_checksum_is_seen() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = zip(&[("a.npy", volume())], true, false);
        let entry = file.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
        file[entry + 16] ^= 1;
        let source = open_volume(&write(&dir, "a.npz", &file), &options(None)).unwrap();
        let error = crate::formats::tests::try_read_all(source).unwrap_err().to_string();
        assert!(error.contains("CRC-32"), "{error}");
    }
}
