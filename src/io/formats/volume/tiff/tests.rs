use super::*;
use crate::formats::open_volume;
use crate::formats::tests::{read_all, survives, torture, write};
use crate::grid::IndexBox;
use crate::volume::ScalarType;
use crate::volume::units::Unit;
use std::io::Write;

/// How a page is written.
#[derive(Clone, Copy)]
struct Style {
    big_endian: bool,
    big: bool,
    compression: u64,
    predictor: u64,
    tile: Option<[usize; 2]>,
    rows_per_strip: usize,
}

const PLAIN: Style =
    Style { big_endian: false, big: false, compression: 1, predictor: 1, tile: None, rows_per_strip: 2 };

/// A TIFF file of pages of `dims` samples; a page's samples are little-endian.
struct Writer {
    style: Style,
    bytes: Vec<u8>,
    /// Where the place of the next directory belongs.
    link: usize,
}

impl Writer {
    fn new(style: Style) -> Self {
        let mut w = Self { style, bytes: if style.big_endian { b"MM" } else { b"II" }.to_vec(), link: 0 };
        w.push(if style.big { 43 } else { 42 }, 2);
        if style.big {
            w.push(8, 2);
            w.push(0, 2);
        }
        w.link = w.bytes.len();
        w.push(0, w.wide());
        w
    }

    fn wide(&self) -> usize {
        if self.style.big { 8 } else { 4 }
    }

    fn number(&self, value: u64, size: usize) -> Vec<u8> {
        if self.style.big_endian {
            value.to_be_bytes()[8 - size..].to_vec()
        } else {
            value.to_le_bytes()[..size].to_vec()
        }
    }

    fn push(&mut self, value: u64, size: usize) {
        let bytes = self.number(value, size);
        self.bytes.extend(bytes);
    }

    /// Strips or tiles of a page, encoded.
    fn parts(&self, dims: [usize; 2], size: usize, samples: &[u8]) -> Vec<Vec<u8>> {
        let [w, h] = self.style.tile.unwrap_or([dims[0], self.style.rows_per_strip]);
        let mut parts = vec![];
        for (y0, x0) in (0..dims[1]).step_by(h).flat_map(|y| (0..dims[0]).step_by(w).map(move |x| (y, x))) {
            let rows = if self.style.tile.is_some() { h } else { h.min(dims[1] - y0) };
            let mut part = vec![];
            for (y, x) in (y0..y0 + rows).flat_map(|y| (x0..x0 + w).map(move |x| (y, x))) {
                let at = (y.min(dims[1] - 1) * dims[0] + x.min(dims[0] - 1)) * size;
                part.extend_from_slice(&samples[at..at + size]);
            }
            part.chunks_exact_mut(w * size).for_each(|row| self.predict(row, size));
            parts.push(compress(self.style.compression, &part));
        }
        parts
    }

    fn predict(&self, row: &mut [u8], size: usize) {
        let get = |s: &[u8]| s.iter().rev().fold(0u64, |n, &b| n << 8 | u64::from(b));
        match self.style.predictor {
            3 => {
                let (old, count) = (row.to_vec(), row.len() / size);
                for (i, byte) in row.iter_mut().enumerate() {
                    *byte = old[i % count * size + size - 1 - i / count];
                }
                for i in (1..row.len()).rev() {
                    row[i] = row[i].wrapping_sub(row[i - 1]);
                }
                return;
            }
            2 => {
                for i in (1..row.len() / size).rev() {
                    let diff =
                        get(&row[i * size..][..size]).wrapping_sub(get(&row[(i - 1) * size..][..size]));
                    row[i * size..][..size].copy_from_slice(&diff.to_le_bytes()[..size]);
                }
            }
            _ => {}
        }
        if self.style.big_endian {
            crate::volume::strided::swap_bytes(row, size);
        }
    }

    fn page(&mut self, dims: [usize; 2], scalar: ScalarType, samples: &[u8], more: &[(u16, u16, Vec<u8>)]) {
        let size = scalar.bytes();
        let parts = self.parts(dims, size, samples);
        let places: Vec<u64> = parts
            .iter()
            .map(|p| {
                let at = self.bytes.len() as u64;
                self.bytes.extend(p);
                at
            })
            .collect();
        let wide = self.wide();
        let short = |v: u64| self.number(v, 2);
        let long = |v: u64| self.number(v, 4);
        let list = |v: Vec<u64>| v.into_iter().flat_map(|n| self.number(n, wide)).collect::<Vec<u8>>();
        let format = match scalar.name().as_bytes()[0] {
            b'u' => 1,
            b'i' => 2,
            _ => 3,
        };
        let wide_kind = if wide == 8 { 16 } else { 4 };
        let lengths = parts.iter().map(|p| p.len() as u64).collect();
        let mut tags = vec![
            (256, 4, long(dims[0] as u64)),
            (257, 4, long(dims[1] as u64)),
            (258, 3, short(8 * size as u64)),
            (259, 3, short(self.style.compression)),
            (262, 3, short(1)),
            (277, 3, short(1)),
            (317, 3, short(self.style.predictor)),
            (339, 3, short(format)),
        ];
        match self.style.tile {
            Some([w, h]) => tags.extend([
                (322, 3, short(w as u64)),
                (323, 3, short(h as u64)),
                (324, wide_kind, list(places)),
                (325, wide_kind, list(lengths)),
            ]),
            None => tags.extend([
                (273, wide_kind, list(places)),
                (278, 3, short(self.style.rows_per_strip as u64)),
                (279, wide_kind, list(lengths)),
            ]),
        }
        tags.retain(|t| more.iter().all(|m| m.0 != t.0));
        tags.extend(more.iter().cloned());
        tags.sort_by_key(|t| t.0);
        self.directory(&tags);
    }

    fn directory(&mut self, tags: &[(u16, u16, Vec<u8>)]) {
        let wide = self.wide();
        let mut entries = vec![];
        for (tag, kind, values) in tags {
            let size = match kind {
                3 => 2,
                4 => 4,
                5 | 16 => 8,
                _ => 1,
            };
            entries.extend(self.number(u64::from(*tag), 2));
            entries.extend(self.number(u64::from(*kind), 2));
            entries.extend(self.number((values.len() / size) as u64, wide));
            let mut inline = values.clone();
            if values.len() > wide {
                inline = self.number(self.bytes.len() as u64, wide);
                self.bytes.extend(values);
            }
            inline.resize(wide, 0);
            entries.extend(inline);
        }
        let at = self.number(self.bytes.len() as u64, wide);
        self.bytes[self.link..self.link + wide].copy_from_slice(&at);
        self.push(tags.len() as u64, if wide == 8 { 8 } else { 2 });
        self.bytes.extend(entries);
        self.link = self.bytes.len();
        self.push(0, wide);
    }
}

fn compress(how: u64, bytes: &[u8]) -> Vec<u8> {
    match how {
        5 => weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(bytes).unwrap(),
        8 => {
            let mut z = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::fast());
            z.write_all(bytes).unwrap();
            z.finish().unwrap()
        }
        32773 => bytes.chunks(100).flat_map(|c| [&[c.len() as u8 - 1][..], c].concat()).collect(),
        50000 => zstd::bulk::compress(bytes, 1).unwrap(),
        _ => bytes.to_vec(),
    }
}

/// Sample (x, y, z) is 100 z + 10 y + x + 3, of any type.
fn slice(dims: [usize; 2], scalar: ScalarType, z: usize) -> Vec<u8> {
    let mut out = vec![];
    for (y, x) in (0..dims[1]).flat_map(|y| (0..dims[0]).map(move |x| (y, x))) {
        let text = (100 * z + 10 * y + x + 3).to_string();
        assert!(crate::formats::shared::stream::push_number(text.as_bytes(), scalar, &mut out));
    }
    out
}

const DIMS: [usize; 2] = [7, 5];

fn pages(style: Style, scalar: ScalarType, count: usize, more: &[(u16, u16, Vec<u8>)]) -> Vec<u8> {
    let mut w = Writer::new(style);
    for z in 0..count {
        w.page(DIMS, scalar, &slice(DIMS, scalar, z), if z == 0 { more } else { &[] });
    }
    w.bytes
}

fn expected(count: usize) -> Vec<f32> {
    let value = |i: usize| (100 * (i / 35) + 10 * (i / 7 % 5) + i % 7 + 3) as f32;
    (0..35 * count).map(value).collect()
}

fn open_ok(path: &Path) -> (VolumeInfo, Vec<f32>) {
    read_all(open_volume(path, &OpenOptions::default()).unwrap())
}

fn refusal(path: &Path) -> String {
    let error = match open_volume(path, &OpenOptions::default()) {
        Ok(source) => crate::formats::tests::try_read_all(source).expect_err("refused"),
        Err(e) => e,
    };
    assert_eq!(error.exit_code(), 5, "{error}");
    error.to_string()
}

#[test]
fn every_way_of_writing_gives_the_same_samples() {
    let dir = tempfile::tempdir().unwrap();
    for (big_endian, big) in [(false, false), (true, false), (false, true), (true, true)] {
        for (compression, tile, rows) in [
            (1, None, 5),
            (1, None, 2),
            (1, Some([4, 3]), 0),
            (5, None, 2),
            (8, None, 3),
            (8, Some([16, 16]), 0),
            (32773, None, 5),
            (50000, Some([2, 4]), 0),
        ] {
            for (scalar, predictor) in [
                (ScalarType::U16, 1),
                (ScalarType::I32, 2),
                (ScalarType::F32, 3),
                (ScalarType::F64, 3),
                (ScalarType::U64, 2),
            ] {
                let predictor = if compression == 1 && tile.is_none() { 1 } else { predictor };
                let style = Style { big_endian, big, compression, predictor, tile, rows_per_strip: rows };
                let path = write(&dir, "a.tif", &pages(style, scalar, 3, &[]));
                let source = open_volume(&path, &OpenOptions::default()).unwrap();
                let mapped = matches!(source, VolumeSource::Random(_));
                assert_eq!(mapped, compression == 1 && tile.is_none(), "mapped exactly where it can be");
                let (info, values) = read_all(source);
                assert_eq!((info.dims, info.field.scalar), ([7, 5, 3], scalar));
                assert_eq!(values, expected(3), "{compression} {tile:?} {scalar:?} {big_endian} {big}");
            }
        }
    }
}

#[test]
fn rows_of_a_page_begin_anywhere() {
    for (tile, rows_per_strip) in [(None, 2), (Some([4, 3]), 0), (Some([16, 16]), 0)] {
        let style = Style { compression: 8, tile, rows_per_strip, ..PLAIN };
        let bytes = pages(style, ScalarType::U16, 2, &[]);
        let tiff = Tiff::open(Arc::new(ByteSource::from_vec("a.tif", bytes))).unwrap();
        let page = Page::parse(&tiff, tiff.places().unwrap()[1]).unwrap();
        let all = slice(DIMS, ScalarType::U16, 1);
        for (y0, y1) in (0..5).flat_map(|y0| (y0 + 1..=5).map(move |y1| (y0, y1))) {
            let mut out = vec![];
            page.rows(&tiff, y0 as u64, y1 as u64, &mut out).unwrap();
            assert_eq!(out, all[y0 * 14..y1 * 14], "{y0} to {y1}, {tile:?}");
        }
    }
}

#[test]
fn all_types_are_read() {
    let dir = tempfile::tempdir().unwrap();
    for scalar in ScalarType::ALL {
        let count = if scalar.bytes() == 1 { 1 } else { 2 };
        let mut style = PLAIN;
        for compression in [1, 8] {
            style.compression = compression;
            let one = pages(style, scalar, count, &[]);
            for z in 0..2 {
                write(&dir, &format!("s{z}.tif"), &one);
            }
            if count == 1 {
                let (info, values) = open_ok(dir.path());
                assert_eq!((info.dims, info.field.scalar), ([7, 5, 2], scalar));
                assert_eq!(values, [expected(1), expected(1)].concat());
            } else {
                assert_eq!(open_ok(&dir.path().join("s0.tif")).1, expected(2));
            }
        }
    }
}

#[test]
fn slices_of_a_folder_or_a_pattern() {
    let dir = tempfile::tempdir().unwrap();
    for compression in [1, 5] {
        for z in 0..12 {
            let style = Style { compression, big_endian: true, ..PLAIN };
            let mut w = Writer::new(style);
            w.page(DIMS, ScalarType::U16, &slice(DIMS, ScalarType::U16, z), &[]);
            write(&dir, &format!("slice_{z}.TIF"), &w.bytes);
        }
        for path in [dir.path().to_path_buf(), dir.path().join("sl*_*.TIF")] {
            let (info, values) = open_ok(&path);
            assert_eq!((info.dims, &info.path), ([7, 5, 12], &path));
            assert_eq!(values, expected(12));
            assert_eq!(info.files(), info.data_files);
            assert!(info.files().len() == 12 && info.files()[10].ends_with("slice_10.TIF"));
        }
        assert_eq!(open_ok(&dir.path().join("slice_?.TIF")).0.dims, [7, 5, 10]);
    }
    std::fs::remove_file(dir.path().join("slice_5.TIF")).unwrap();
    assert!(refusal(dir.path()).contains("1 missing: 5;"));
    assert!(refusal(&dir.path().join("none_*")).contains("pattern"));
    write(&dir, "slice_5.TIF", &pages(PLAIN, ScalarType::U16, 1, &[]));
    assert_eq!(open_ok(dir.path()).0.dims, [7, 5, 12], "a slice may be stored in another way");
    write(&dir, "slice_5.TIF", &pages(PLAIN, ScalarType::U8, 1, &[]));
    let line = refusal(dir.path());
    assert!(
        line.contains("slice_5.TIF")
            && line.contains("7 x 5 samples of uint16, as in the first one, got 7 x 5 samples of uint8"),
        "{line}"
    );
    write(&dir, "slice_5.TIF", &pages(PLAIN, ScalarType::U16, 2, &[]));
    assert!(refusal(dir.path()).contains("several"));
}

#[test]
fn long_stacks_keep_few_files_open() {
    let dir = tempfile::tempdir().unwrap();
    let mut w = Writer::new(PLAIN);
    w.page(DIMS, ScalarType::U16, &slice(DIMS, ScalarType::U16, 0), &[]);
    let first = write(&dir, "s_0.tif", &w.bytes);
    for z in 1..900 {
        std::fs::hard_link(&first, dir.path().join(format!("s_{z}.tif"))).unwrap();
    }
    let files = crate::formats::volume::stack::in_folder(dir.path(), &SUFFIXES).unwrap();
    let (tiff, page) = only_page(&first, IoMode::Read).unwrap();
    let options = OpenOptions { io: IoMode::Read, ..OpenOptions::default() };
    let info = info_at(dir.path(), "TIFF (stack", &tiff, &page, 900, &options).unwrap();
    let at = page.in_place().unwrap();
    let volume = SliceFiles::new(info, files, vec![at; 900], false, IoMode::Read);
    let whole = IndexBox::whole([7, 5, 900]);
    let mut values = vec![0.0; whole.len()];
    for _ in 0..2 {
        crate::volume::VolumeReader::read_box(&volume, whole, &mut values).unwrap();
        assert!(volume.open_files() <= 400);
    }
    assert_eq!(values, expected(1).repeat(900));
}

#[test]
fn what_is_no_volume_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let short = |v: u16| v.to_le_bytes().to_vec();
    for (more, message) in [
        ((262, 3, short(2)), "RGB"),
        ((262, 3, short(3)), "a palette"),
        ((277, 3, short(3)), "samples a pixel"),
        ((258, 3, short(12)), "12 bits"),
        ((259, 3, short(7)), "JPEG"),
        ((266, 3, short(2)), "fill order"),
        ((317, 3, short(3)), "predictor"),
        ((278, 3, short(1)), "5 of them, got 3 places"),
        ((257, 4, vec![255; 4]), "2^31"),
        ((256, 3, short(0)), "2^31"),
        ((270, 2, b"ImageJ=1.53t\nimages=2\nchannels=2\n\0".to_vec()), "channels"),
        ((270, 2, b"ImageJ=1.53t\nimages=5\n\0".to_vec()), "5 images, as the description says, got 2"),
    ] {
        let path = write(&dir, "a.tif", &pages(PLAIN, ScalarType::U16, 2, &[more]));
        let line = refusal(&path);
        assert!(line.contains(message), "{line}");
    }
    assert!(
        refusal(&write(&dir, "a.tif", &pages(PLAIN, ScalarType::U16, 1, &[]))).contains("name their folder")
    );
    let mut w = Writer::new(PLAIN);
    w.page(DIMS, ScalarType::U8, &slice(DIMS, ScalarType::U8, 0), &[]);
    w.page([5, 7], ScalarType::U8, &slice(DIMS, ScalarType::U8, 1), &[]);
    assert!(refusal(&write(&dir, "a.tif", &w.bytes)).contains("page 1"));
    let empty = tempfile::tempdir().unwrap();
    assert!(refusal(empty.path()).contains("none of these"));
    std::fs::write(empty.path().join("manifest.zst"), "{}").unwrap();
    assert!(refusal(empty.path()).contains("an isospan archive"));
}

/// A file of 2 channels, 3 slices and `moments`, page n is slice n of the usual, and its channel
/// and moment are chosen.
#[test]
fn channels_and_moments_are_fields() {
    let dir = tempfile::tempdir().unwrap();
    let ome = |order: &str, moments: u64| {
        format!(
            "<?xml version=\"1.0\"?><OME><Image><Pixels SizeC=\"2\" SizeZ=\"3\" SizeT=\"{moments}\" DimensionOrder=\"{order}\">\
             <Channel ID=\"a\" Name=\"DAPI\"/><Channel ID=\"b\" Name=\"GFP\"></Channel></Pixels></Image></OME>\0"
        )
    };
    let imagej = "ImageJ=1.53t\nimages=12\nchannels=2\nslices=3\nframes=2\nhyperstack=true\n\0".to_owned();
    // The page of channel c, slice z, moment t.
    type Place = fn(usize, usize, usize) -> usize;
    let cases: [(String, usize, [&str; 2], Place); 3] = [
        (imagej, 2, ["c0", "c1"], |c, z, t| c + 2 * z + 6 * t),
        (ome("XYZCT", 1), 1, ["DAPI", "GFP"], |c, z, _| z + 3 * c),
        (ome("XYTZC", 2), 2, ["DAPI", "GFP"], |c, z, t| t + 2 * z + 6 * c),
    ];
    for ((text, moments, labels, place), style) in cases
        .into_iter()
        .flat_map(|case| [PLAIN, Style { compression: 8, ..PLAIN }].map(|s| (case.clone(), s)))
    {
        let mut w = Writer::new(style);
        for n in 0..6 * moments {
            let more = if n == 0 { vec![(270, 2, text.clone().into_bytes())] } else { vec![] };
            w.page(DIMS, ScalarType::U16, &slice(DIMS, ScalarType::U16, n), &more);
        }
        let path = write(&dir, "a.tif", &w.bytes);
        let open = |field: Option<String>, channel: Option<&str>| {
            let channel = channel.map(str::to_owned);
            open_volume(&path, &OpenOptions { field, channel, ..OpenOptions::default() })
        };
        for (c, t) in (0..2).flat_map(|c| (0..moments).map(move |t| (c, t))) {
            let frame = if moments > 1 { format!(":t{t}") } else { String::new() };
            let name = format!("data:{}{frame}", labels[c]);
            let pages: Vec<f32> = (0..3)
                .flat_map(|z| {
                    let n = place(c, z, t);
                    expected(12)[n * DIMS[0] * DIMS[1]..][..DIMS[0] * DIMS[1]].to_vec()
                })
                .collect();
            for source in [
                open(Some(name.clone()), None),
                open(Some(format!("data{frame}")), Some(&c.to_string())),
                open(Some(format!("data:c{c}{frame}")), Some(labels[c])),
            ] {
                let (info, values) = read_all(source.unwrap());
                assert_eq!((&*info.field.name, info.dims[2], info.fields.len()), (&*name, 3, 2 * moments));
                assert_eq!(values, pages, "{name}");
            }
        }
        let options = OpenOptions { channel: Some("1".into()), ..OpenOptions::default() };
        let steps = crate::formats::steps_of(std::slice::from_ref(&path), &options).unwrap();
        assert_eq!(steps.len(), moments);
        assert!(open(None, None).err().unwrap().to_string().contains(labels[1]));
        assert!(open(None, Some("RFP")).err().unwrap().to_string().contains(labels[1]));
    }
}

/// Times of the volumes of a series of three moments with a description, their unit, and notes.
fn times_of(text: &str) -> (Vec<Option<f64>>, Option<String>, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let more = [(270, 2, format!("{text}\0").into_bytes())];
    let path = write(&dir, "a.tif", &pages(PLAIN, ScalarType::U16, 6, &more));
    let steps = |field: Option<&str>| {
        let options = OpenOptions { field: field.map(str::to_owned), ..OpenOptions::default() };
        crate::formats::steps_of(std::slice::from_ref(&path), &options).unwrap()
    };
    let times = |steps: &[crate::formats::StepSource]| steps.iter().map(|s| s.time).collect::<Vec<_>>();
    let all = steps(None);
    assert_eq!(times(&all), times(&steps(Some("data:t*"))), "by a pattern as by the array");
    let info = open_volume(&path, &all[0].options).unwrap().info().clone();
    (times(&all), info.units.time.map(|unit| unit.to_string()), info.notes)
}

const NO_TIMES: [Option<f64>; 3] = [None; 3];

#[test]
fn moments_of_imagej_have_times() {
    let imagej = |lines: &str| times_of(&format!("ImageJ=1.53t\nimages=6\nslices=2\nframes=3\n{lines}"));
    let known = vec![Some(0.0), Some(0.5), Some(1.0)];
    assert_eq!(imagej("finterval=0.5\nfps=7\n"), (known.clone(), Some("s".into()), vec![]));
    assert_eq!(imagej("finterval=0.5\ntunit=\\u00B5s\n"), (known, Some("µs".into()), vec![]));
    for (lines, note) in
        [("fps=7\n", "how fast"), ("finterval=-1\n", "finterval=-1"), ("finterval=x\n", "=x")]
    {
        let (times, unit, notes) = imagej(lines);
        assert_eq!((&times[..], unit), (&NO_TIMES[..], None));
        assert!(notes.iter().any(|n| n.contains(note) && n.contains("no times")), "{notes:?}");
    }
    assert_eq!(imagej("finterval=0\n"), (NO_TIMES.to_vec(), None, vec![]), "0 is none");
}

#[test]
fn moments_of_ome_have_times() {
    let ome = |attributes: &str, planes: &str| {
        times_of(&format!(
            "<OME><Image><Pixels SizeC=\"1\" SizeZ=\"2\" SizeT=\"3\" DimensionOrder=\"XYZTC\" {attributes}>\
             {planes}</Pixels></Image><Image><Pixels><Plane TheT=\"7\" DeltaT=\"1\"/></Pixels></Image></OME>"
        ))
    };
    let steps = "TimeIncrement=\"0.5\" TimeIncrementUnit=\"min\"";
    let by_steps = (vec![Some(0.0), Some(0.5), Some(1.0)], Some("min".to_owned()));
    let (times, unit, notes) = ome(steps, "");
    assert_eq!(((times, unit), notes), (by_steps.clone(), vec![]));
    assert_eq!(ome("TimeIncrement=\"0.5\"", "").1.as_deref(), Some("s"), "as OME's schema says");
    let plane = |t: u8, time: &str, unit: &str| {
        format!("<Plane TheT=\"{t}\" TheZ=\"0\" TheC=\"0\" DeltaT=\"{time}\"{unit}/>")
    };
    let planes = |of: &[(u8, &str, &str)]| of.iter().map(|(t, time, unit)| plane(*t, time, unit)).collect();
    let of_planes = |list: &[(u8, &str, &str)]| -> (Vec<Option<f64>>, Option<String>, Vec<String>) {
        let planes: String = planes(list);
        ome(steps, &planes)
    };
    // The first plane of a moment counts, in any order.
    let good = [(1, "4", ""), (0, "1.5", ""), (0, "1", ""), (2, "8", "")];
    assert_eq!(of_planes(&good), (vec![Some(1.0), Some(4.0), Some(8.0)], Some("s".into()), vec![]));
    for (list, why) in [
        (vec![(0, "1", ""), (2, "4", "")], "missing"),
        (vec![(0, "1", ""), (1, "1", ""), (2, "4", "")], "does not rise"),
        (vec![(0, "1", ""), (1, "2", " DeltaTUnit=\"ms\""), (2, "4", "")], "several units (s, ms)"),
        (vec![(0, "1", ""), (1, "x", ""), (2, "4", "")], "no number"),
        (vec![(0, "1", ""), (1, "2", ""), (9, "4", "")], "no moment"),
    ] {
        let (times, unit, notes) = of_planes(&list);
        assert_eq!((times, unit), by_steps);
        assert!(notes.len() == 1 && notes[0].contains(why), "{notes:?}");
    }
}

#[test]
fn thumbnails_are_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let mut w = Writer::new(PLAIN);
    for z in 0..3 {
        w.page(DIMS, ScalarType::U16, &slice(DIMS, ScalarType::U16, z), &[]);
        w.page([2, 2], ScalarType::U8, &[0; 4], &[(254, 4, vec![1, 0, 0, 0]), (262, 3, vec![2, 0])]);
    }
    let (info, values) = open_ok(&write(&dir, "a.tif", &w.bytes));
    assert_eq!((info.dims, values), ([7, 5, 3], expected(3)));
}

#[test]
fn imagej_stacks_of_one_page() {
    let dir = tempfile::tempdir().unwrap();
    let text = b"ImageJ=1.53t\nimages=4\nslices=4\nunit=micron\nspacing=2.5\n\0".to_vec();
    let rational = |n: u32, d: u32| [n.to_le_bytes(), d.to_le_bytes()].concat();
    let more = [(270, 2, text), (282, 5, rational(2, 1)), (283, 5, rational(4, 1))];
    let one = pages(Style { rows_per_strip: 5, ..PLAIN }, ScalarType::U16, 1, &more);
    // The other images follow the first one, so the directory must not: the page is written anew
    // after them.
    let mut w = Writer::new(Style { rows_per_strip: 5, ..PLAIN });
    let all: Vec<u8> = (0..4).flat_map(|z| slice(DIMS, ScalarType::U16, z)).collect();
    w.bytes.extend(&all);
    let at = (8u32).to_le_bytes().to_vec();
    let more = [&more[..], &[(273, 4, at)]].concat();
    w.page(DIMS, ScalarType::U16, &slice(DIMS, ScalarType::U16, 0), &more);
    let (info, values) = open_ok(&write(&dir, "a.tif", &w.bytes));
    assert_eq!((info.dims, values), ([7, 5, 4], expected(4)));
    assert_eq!(info.geometry.spacing, [0.5, 0.25, 2.5]);
    assert_eq!(info.units, Units::of_length(Unit::length("µm")));
    let line = refusal(&write(&dir, "a.tif", &one));
    assert!(line.contains("among 4 images"), "{line}");
}

#[test]
fn channels_of_imagej_stacks_of_one_page() {
    let dir = tempfile::tempdir().unwrap();
    let text = b"ImageJ=1.53t\nimages=12\nchannels=2\nslices=3\nframes=2\n\0".to_vec();
    let mut w = Writer::new(Style { rows_per_strip: 5, ..PLAIN });
    (0..12).for_each(|n| w.bytes.extend(slice(DIMS, ScalarType::U16, n)));
    let more = [(270, 2, text), (273, 4, 8u32.to_le_bytes().to_vec())];
    w.page(DIMS, ScalarType::U16, &slice(DIMS, ScalarType::U16, 0), &more);
    let path = write(&dir, "a.tif", &w.bytes);
    for (c, t) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let options = OpenOptions { field: Some(format!("data:c{c}:t{t}")), ..OpenOptions::default() };
        let (info, values) = read_all(open_volume(&path, &options).unwrap());
        let image = |n: usize| expected(12)[n * DIMS[0] * DIMS[1]..][..DIMS[0] * DIMS[1]].to_vec();
        let wanted: Vec<f32> = (0..3).flat_map(|z| image(c + 2 * z + 6 * t)).collect();
        assert_eq!((info.dims, info.fields.len()), ([7, 5, 3], 4));
        assert_eq!(values, wanted, "channel {c}, moment {t}");
    }
}

/// Spacing, unit and notes of a file with a description, or the error.
fn described(text: &str, more: &[(u16, u16, Vec<u8>)]) -> Result<([f64; 3], Option<String>, Vec<String>)> {
    let info = info_of(text, more)?;
    Ok((info.geometry.spacing, info.units.length.map(|unit| unit.to_string()), info.notes))
}

fn info_of(text: &str, more: &[(u16, u16, Vec<u8>)]) -> Result<VolumeInfo> {
    let dir = tempfile::tempdir().unwrap();
    let more = [&[(270, 2, format!("{text}\0").into_bytes())], more].concat();
    let path = write(&dir, "a.tif", &pages(PLAIN, ScalarType::U16, 2, &more));
    Ok(crate::formats::open_volume(&path, &OpenOptions::default())?.info().clone())
}

#[test]
fn units_of_single_axes_become_one() {
    let ome = |sizes: &str| format!("<OME><Image><Pixels SizeC=\"1\" SizeT=\"1\" {sizes}>");
    let of = |x: &str, y: &str, z: &str| {
        ome(&format!(
            "PhysicalSizeX=\"0.5\" PhysicalSizeXUnit=\"{x}\" PhysicalSizeY=\"500\" PhysicalSizeYUnit=\"{y}\" \
             PhysicalSizeZ=\"0.002\" PhysicalSizeZUnit=\"{z}\""
        ))
    };
    let (spacing, unit, notes) = described(&of("&#181;m", "nm", "mm"), &[]).unwrap();
    assert_eq!((spacing, unit.as_deref()), ([0.5, 0.5, 2.0], Some("µm")));
    assert!(notes[0].contains("y from nm, z from mm"), "{notes:?}");
    let (spacing, unit, notes) = described(&of("mm", "mm", "mm"), &[]).unwrap();
    assert_eq!((spacing, unit.as_deref(), notes), ([0.5, 500.0, 0.002], Some("mm"), vec![]));
    let error = described(&of("mm", "furlong", "mm"), &[]).unwrap_err().to_string();
    assert!(error.contains("furlong"), "{error}");

    let resolution = [
        (282, 5, [2u32, 1].map(u32::to_le_bytes).concat()),
        (283, 5, [4u32, 1].map(u32::to_le_bytes).concat()),
    ];
    let imagej = "ImageJ=1.53t\nimages=2\nslices=2\nspacing=2.5\n";
    let (spacing, unit, _) =
        described(&format!("{imagej}unit=nm\nyunit=\\u00B5m\nzunit=\\u03BCm\n"), &resolution).unwrap();
    assert_eq!((spacing, unit.as_deref()), ([0.5, 250.0, 2500.0], Some("nm")));
    let (spacing, unit, notes) = described(&format!("{imagej}unit=\\u03BCm\n"), &resolution).unwrap();
    assert_eq!((spacing, unit.as_deref(), notes), ([0.5, 0.25, 2.5], Some("µm"), vec![]));
}

#[test]
fn a_size_that_is_missing_is_named_and_the_others_stay() {
    let ome = "<OME><Image><Pixels SizeC=\"1\" SizeT=\"1\" PhysicalSizeX=\"0.5\" PhysicalSizeY=\"0.25\">";
    let info = info_of(ome, &[]).unwrap();
    assert_eq!((info.geometry.spacing, info.assumed.axes), ([0.5, 0.25, 1.0], [false, false, true]));
    assert_eq!(info.units, Units::of_length(Unit::length("µm")));
    let imagej = "ImageJ=1.53t\nimages=2\nslices=2\nunit=mm\n";
    let info = info_of(imagej, &[]).unwrap();
    assert_eq!((info.geometry.spacing, info.assumed.axes), ([1.0; 3], [false, false, true]));
    assert!(info.assumed.can_be_given);
}

#[test]
fn units_of_descriptions() {
    let dir = tempfile::tempdir().unwrap();
    let read = |text: &str, options: &OpenOptions| {
        let more = [(270, 2, format!("{text}\0").into_bytes())];
        let path = write(&dir, "a.tif", &pages(PLAIN, ScalarType::U16, 2, &more));
        let units = crate::formats::open_volume(&path, options).unwrap().info().units.clone();
        units.length.map(|unit| unit.to_string())
    };
    let length = |text: &str| read(text, &OpenOptions::default());
    let imagej = "ImageJ=1.53t\nimages=2\nslices=2\nspacing=2.5\n";
    assert_eq!(length(&format!("{imagej}unit=\\u00B5m\n")).as_deref(), Some("µm"));
    assert_eq!(length(&format!("{imagej}unit=pixel\n")), None);
    assert_eq!(length(imagej), None);
    let ome = "<OME><Image><Pixels SizeC=\"1\" SizeT=\"1\" PhysicalSizeX=\"1\" PhysicalSizeY=\"1\" PhysicalSizeZ=\"2\"";
    assert_eq!(length(&format!("{ome}>")).as_deref(), Some("µm"), "as OME's schema says");
    let nano: String = ["X", "Y", "Z"].iter().map(|a| format!(" PhysicalSize{a}Unit=\"nm\"")).collect();
    assert_eq!(length(&format!("{ome}{nano}>")).as_deref(), Some("nm"));
    // A spacing that the user gives is not in the file's unit.
    let given = OpenOptions { spacing: Some([1.0; 3]), ..OpenOptions::default() };
    assert_eq!(read(&format!("{ome}{nano}>"), &given), None);
}

#[test]
fn damage_is_refused() {
    for compression in [1, 8, 5] {
        for big in [false, true] {
            let style = Style { compression, big, ..PLAIN };
            let file = pages(style, ScalarType::U16, 2, &[]);
            // The directory of the last page, with the end of the chain, is the end of the file.
            torture("a.tif", &file, file.len());
        }
    }
}

#[test]
fn a_chain_without_an_end_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut w = Writer::new(PLAIN);
    w.page(DIMS, ScalarType::U8, &slice(DIMS, ScalarType::U8, 0), &[]);
    let (first, link) = (w.bytes[4..8].to_vec(), w.link);
    w.bytes[link..link + 4].copy_from_slice(&first);
    assert!(refusal(&write(&dir, "a.tif", &w.bytes)).contains("comes again"));
    assert!(!survives(&write(&dir, "b.tif", b"II*\0\0\0\0\0")));
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_slices() {
    let root = crate::formats::tests::shared_data();
    let (info, values) = open_ok(&root.join("volumes/bone_uct_u8_tiff"));
    assert_eq!((info.dims, info.field.scalar), ([200, 200, 96], ScalarType::U8));
    let range = values.iter().fold((f32::MAX, f32::MIN), |(lo, hi), &v| (lo.min(v), hi.max(v)));
    assert_eq!(range, (0.0, 253.0));
}
