//! Tests of the NIfTI reader.

use super::*;
use crate::formats::open_volume;
use crate::formats::tests::{gzip, ramp, read_all, torture, write};

/// A header of either version and byte order, to be filled in.
struct Maker {
    bytes: Vec<u8>,
    big: bool,
    v2: bool,
}

impl Maker {
    fn new(v2: bool, big: bool, magic: &[u8; 4], dim: &[i64]) -> Self {
        let mut m = Self { bytes: vec![0; if v2 { 544 } else { 352 }], big, v2 };
        let size = m.bytes.len() as i64 - 4;
        m.put(0, &(size as i32).to_le_bytes());
        let at = if v2 { 4 } else { 344 };
        m.bytes[at..at + 4].copy_from_slice(magic);
        m.int(40, 16, 0, dim.len() as i64);
        (0..dim.len()).for_each(|i| m.int(40, 16, i + 1, dim[i]));
        m.int(70, 12, 0, 512);
        m.offset(if &magic[..2] == b"n+" { size + 4 } else { 0 });
        m
    }

    fn put(&mut self, at: usize, little: &[u8]) {
        let mut b = little.to_vec();
        if self.big {
            b.reverse();
        }
        self.bytes[at..at + b.len()].copy_from_slice(&b);
    }

    fn int(&mut self, one: usize, two: usize, i: usize, v: i64) {
        match (self.v2, two) {
            (false, _) => self.put(one + 2 * i, &(v as i16).to_le_bytes()),
            (true, 12) => self.put(12, &(v as i16).to_le_bytes()),
            (true, 344 | 348) => self.put(two, &(v as i32).to_le_bytes()),
            (true, _) => self.put(two + 8 * i, &v.to_le_bytes()),
        }
    }

    fn float(&mut self, one: usize, two: usize, i: usize, v: f64) {
        if self.v2 {
            self.put(two + 8 * i, &v.to_le_bytes())
        } else {
            self.put(one + 4 * i, &(v as f32).to_le_bytes())
        }
    }

    fn offset(&mut self, v: i64) {
        if self.v2 { self.put(168, &v.to_le_bytes()) } else { self.put(108, &(v as f32).to_le_bytes()) }
    }

    fn with(&self, data: &[u8]) -> Vec<u8> {
        [&self.bytes[..], data].concat()
    }
}

fn magic(v2: bool, pair: bool) -> &'static [u8; 4] {
    match (v2, pair) {
        (false, false) => b"n+1\0",
        (false, true) => b"ni1\0",
        (true, false) => b"n+2\0",
        (true, true) => b"ni2\0",
    }
}

const DIM: [i64; 3] = [4, 3, 2];

fn check(path: &Path, format: &str) -> VolumeInfo {
    let (info, values) = read_all(open_volume(path, &OpenOptions::default()).unwrap());
    assert_eq!((info.dims, info.field.scalar), ([4, 3, 2], ScalarType::U16));
    assert_eq!(info.format, format);
    let scaled = |i: u32| (info.slope * f64::from(1000 + i) + info.intercept) as f32;
    assert_eq!(values, (0..24).map(scaled).collect::<Vec<_>>());
    info
}

#[test]
fn one_file_or_a_pair_compressed_or_not() {
    for (v2, big) in [(false, false), (false, true), (true, false), (true, true)] {
        let version = if v2 { 2 } else { 1 };
        let dir = tempfile::tempdir().unwrap();
        let one = Maker::new(v2, big, magic(v2, false), &DIM).with(&ramp(big));
        check(&write(&dir, "a.nii", &one), &format!("NIfTI-{version} (one file)"));
        check(&write(&dir, "unnamed", &one), &format!("NIfTI-{version} (one file)"));
        check(&write(&dir, "a.nii.gz", &gzip(&one)), &format!("NIfTI-{version} (one file, gzip)"));
        let head = Maker::new(v2, big, magic(v2, true), &DIM).bytes;
        let hdr = write(&dir, "b.hdr", &head[..head.len() - 4]);
        let error = open_volume(&hdr, &OpenOptions::default()).err().expect("no image");
        assert!(error.to_string().contains("b.img or b.img.gz"), "{error}");
        let gz = write(&dir, "b.img.gz", &gzip(&ramp(big)));
        check(&hdr, &format!("NIfTI-{version} (header and image, gzip)"));
        check(&gz, &format!("NIfTI-{version} (header and image, gzip)"));
        let img = write(&dir, "b.img", &ramp(big));
        check(&hdr, &format!("NIfTI-{version} (header and image)"));
        check(&img, &format!("NIfTI-{version} (header and image)"));
    }
}

#[test]
fn extensions_and_scaling() {
    let dir = tempfile::tempdir().unwrap();
    for v2 in [false, true] {
        let mut m = Maker::new(v2, true, magic(v2, false), &[4, 3, 2, 1, 1]);
        m.float(112, 176, 0, 0.5);
        m.float(116, 184, 0, -3.0);
        m.offset(m.bytes.len() as i64 + 16);
        let file = m.with(&[&[9; 16][..], &ramp(true)].concat());
        let info =
            check(&write(&dir, "a.nii", &file), if v2 { "NIfTI-2 (one file)" } else { "NIfTI-1 (one file)" });
        assert_eq!((info.slope, info.intercept), (0.5, -3.0));
        m.float(112, 176, 0, 0.0);
        let info = open_volume(&write(&dir, "a.nii", &m.with(&[1; 64])), &OpenOptions::default()).unwrap();
        assert_eq!((info.info().slope, info.info().intercept), (1.0, 0.0));
    }
}

#[test]
fn frames_are_fields() {
    let dir = tempfile::tempdir().unwrap();
    let m = Maker::new(false, false, b"n+1\0", &[4, 3, 2, 3]);
    let second: Vec<u8> = [vec![0; 48], ramp(false), vec![0; 48]].concat();
    for (name, file) in [("a.nii", m.with(&second)), ("a.nii.gz", gzip(&m.with(&second)))] {
        let path = write(&dir, name, &file);
        let error = open_volume(&path, &OpenOptions::default()).err().expect("several frames");
        assert!(
            error.exit_code() == 2 && error.to_string().contains("t0 (uint16), t1 (uint16), t2 (uint16)"),
            "{error}"
        );
        let options = OpenOptions { field: Some("t1".into()), ..OpenOptions::default() };
        let (info, values) = read_all(open_volume(&path, &options).unwrap());
        assert_eq!((values[0], values[23], info.fields.len()), (1000.0, 1023.0, 3));
    }
}

#[test]
fn the_map_to_the_world() {
    let dir = tempfile::tempdir().unwrap();
    for v2 in [false, true] {
        let mut m = Maker::new(v2, false, magic(v2, false), &DIM);
        let read = |m: &Maker| {
            let path = write(&dir, "a.nii", &m.with(&ramp(false)));
            open_volume(&path, &OpenOptions::default()).unwrap().info().geometry
        };
        assert_eq!(read(&m).spacing, [1.0; 3]);
        for (i, v) in [-1.0, 2.0, 0.5, 3.0].into_iter().enumerate() {
            m.float(76, 104, i, v);
        }
        assert_eq!(read(&m).spacing, [2.0, 0.5, 3.0]);
        // A half turn about z, third axis mirrored.
        m.int(252, 344, 0, 1);
        for (i, v) in [0.0, 0.0, 1.0, 10.0, 20.0, 30.0].into_iter().enumerate() {
            m.float(256, 352, i, v);
        }
        let g = read(&m);
        assert_eq!((g.origin, g.to_world([1.0, 1.0, 1.0])), ([10.0, 20.0, 30.0], [8.0, 19.5, 27.0]));
        // The affine map goes before the quaternion.
        m.int(254, 348, 0, 2);
        for (i, v) in [0.0, 2.0, 0.0, 1.0, 3.0, 0.0, 0.0, 2.0, 0.0, 0.0, 4.0, 3.0].into_iter().enumerate() {
            m.float(280, 400, i, v);
        }
        let g = read(&m);
        assert_eq!((g.origin, g.to_world([1.0, 10.0, 100.0])), ([1.0, 2.0, 3.0], [21.0, 5.0, 403.0]));
    }
}

#[test]
fn what_is_not_read_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |change: &dyn Fn(&mut Maker), dim: &[i64], message: &str| {
        let mut m = Maker::new(false, false, b"n+1\0", dim);
        change(&mut m);
        let error = open_volume(&write(&dir, "a.nii", &m.with(&ramp(false))), &OpenOptions::default())
            .err()
            .expect(message);
        assert!(error.exit_code() == 5 && error.to_string().contains(message), "{error}");
    };
    let same = |_: &mut Maker| ();
    refused(&same, &[4, 3], "dim[0]");
    refused(&same, &[4, 3, 2, 1, 3], "dim[5]");
    refused(&same, &[4, 3, 2, 0], "dim[4]");
    refused(&same, &[4, -3, 2], "-3");
    refused(&same, &[4, 0, 2], "dimensions");
    refused(&same, &[4, 3, 3], "cut short");
    refused(&same, &[32767, 32767, 32767, 32767], "cut short");
    for (code, name) in [
        (1, "bits"),
        (32, "complex"),
        (128, "RGB"),
        (2304, "RGBA"),
        (1536, "long double"),
        (-9510, "unknown"),
    ] {
        refused(&|m: &mut Maker| m.int(70, 12, 0, code), &DIM, name);
    }
    for offset in [0, 100, -352, 1 << 40] {
        refused(
            &|m: &mut Maker| m.offset(offset),
            &DIM,
            if offset < 352 { "vox_offset" } else { "cut short" },
        );
    }
    refused(&|m: &mut Maker| m.put(108, &352.5f32.to_le_bytes()), &DIM, "vox_offset");
    refused(&|m: &mut Maker| m.bytes[344] = b'x', &DIM, "magic");
    refused(&|m: &mut Maker| m.bytes[0] = 1, &DIM, "sizeof_hdr");
    refused(&|m: &mut Maker| m.int(254, 348, 0, 1), &DIM, "span");
    refused(
        &|m: &mut Maker| {
            m.float(112, 176, 0, 1.0);
            m.float(116, 184, 0, f64::NAN);
        },
        &DIM,
        "scl_inter",
    );
}

#[test]
fn damage_is_refused() {
    let file = Maker::new(false, true, b"n+1\0", &DIM).with(&ramp(true));
    torture("a.nii", &file, file.len());
    let file = gzip(&file);
    torture("a.nii.gz", &file, file.len());
    let file = Maker::new(true, false, b"n+2\0", &DIM).with(&ramp(false));
    torture("a.nii", &file, file.len());
}

/// As of a file that is not packed, and as nibabel, ITK and VTK read it.
#[test]
fn what_follows_the_last_sample_is_passed_over() {
    let dir = tempfile::tempdir().unwrap();
    for frames in [1, 2] {
        let m = Maker::new(false, false, b"n+1\0", &[4, 3, 2, frames]);
        let samples = ramp(false).repeat(frames as usize);
        let file = gzip(&m.with(&[&samples[..], &[7; 100]].concat()));
        let path = write(&dir, "a.nii.gz", &file);
        let options = OpenOptions { field: (frames > 1).then(|| "t1".into()), ..OpenOptions::default() };
        let (_, values) = read_all(open_volume(&path, &options).unwrap());
        assert_eq!((values[0], values[23]), (1000.0, 1023.0));
        // The checksum of all is still looked at.
        let mut damaged = file.clone();
        let crc = file.len() - 8;
        damaged[crc] ^= 1;
        let VolumeSource::Stream(mut stream) =
            open_volume(&write(&dir, "b.nii.gz", &damaged), &options).unwrap()
        else {
            panic!("a stream")
        };
        let mut slab = vec![];
        let read = std::iter::from_fn(|| stream.next_slab(&mut slab).transpose()).find_map(|slab| slab.err());
        assert!(read.expect("damaged").to_string().contains("gzip"));
    }
}

#[test]
fn units_of_space_and_time() {
    let dir = tempfile::tempdir().unwrap();
    for (v2, big) in [(false, false), (false, true), (true, false), (true, true)] {
        for (code, length, time) in [
            (0, None, None),
            (2 + 8, Some("mm"), Some("s")),
            (3 + 16, Some("µm"), Some("ms")),
            (1 + 24, Some("m"), Some("µs")),
            (4 + 32, None, None),
        ] {
            let mut m = Maker::new(v2, big, magic(v2, false), &DIM);
            if v2 {
                m.put(500, &i32::from(code).to_le_bytes())
            } else {
                m.put(123, &[code])
            }
            let path = write(&dir, "a.nii", &m.with(&ramp(big)));
            let units = open_volume(&path, &OpenOptions::default()).unwrap().info().units.clone();
            let found =
                [&units.value, &units.length, &units.time].map(|unit| unit.as_ref().map(Unit::as_str));
            assert_eq!(found, [None, length, time], "{code}");
        }
    }
}
