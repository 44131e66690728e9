//! Tests images in every encoding.

use super::*;
use crate::bytes::{ByteSource, IoMode};
use crate::fixtures::{Encoding, Number, every_encoding, survive};
use crate::formats::open_volume;
use crate::formats::tests::{read_all, try_read_all};
use crate::volume::ScalarType;
use std::sync::Arc;

const WHOLE: &str = "WholeExtent=\"-1 3 2 5 0 2\" Origin=\"1 2 3\" Spacing=\"0.5 2 4\"";

/// 5 x 4 x 3 samples, no two alike; x counts ones, y tens, z hundreds.
fn value(x: i64, y: i64, z: i64) -> i64 {
    x + 10 * y + 100 * z
}

fn expected() -> Vec<f32> {
    let mut out = vec![];
    for z in 0..3 {
        for y in 0..4 {
            out.extend((0..5).map(|x| value(x, y, z) as f32));
        }
    }
    out
}

/// An image in pieces, each with a decoy array before and after the one to read.
fn image(encoding: Encoding, pieces: &[[i64; 6]]) -> Vec<u8> {
    let mut file = encoding.file("ImageData", WHOLE);
    file.text("<FieldData>");
    file.array("t", 1, &[0.5f64]);
    file.text("</FieldData>\n");
    for p in pieces {
        let text: Vec<String> = p.iter().map(ToString::to_string).collect();
        file.text(&format!("<Piece Extent=\"{}\">\n<PointData Scalars=\"b\">\n", text.join(" ")));
        let mut values = vec![];
        for z in p[4]..=p[5] {
            for y in p[2]..=p[3] {
                values.extend((p[0]..=p[1]).map(|x| value(x + 1, y - 2, z) as i16));
            }
        }
        file.array("a &amp; c", 1, &values.iter().map(|v| v + 1).collect::<Vec<i16>>());
        file.array("b", 1, &values);
        file.array("v", 2, &values.iter().flat_map(|&v| [f32::from(v), 0.5]).collect::<Vec<f32>>());
        file.text("</PointData>\n<CellData>");
        file.array("cell", 1, &[1u8]);
        file.text("</CellData></Piece>\n");
    }
    file.finish()
}

const ONE: [[i64; 6]; 1] = [[-1, 3, 2, 5, 0, 2]];

fn open_bytes(bytes: &[u8], field: Option<&str>) -> Result<VolumeSource> {
    let source = ByteSource::from_vec("f.vti", bytes.to_vec());
    image::volume(&Image::open(&Arc::new(source))?, field)
}

#[test]
fn every_encoding_gives_the_samples_in_order() {
    for encoding in every_encoding() {
        let source = open_bytes(&image(encoding, &ONE), None).unwrap();
        let mapped = encoding.format == "raw" && encoding.compressor.is_empty();
        assert_eq!(matches!(source, VolumeSource::Random(_)), mapped);
        let (info, values) = read_all(source);
        assert_eq!((info.dims, &info.field.name[..]), ([5, 4, 3], "b"), "{encoding:?}");
        assert_eq!((info.field.scalar, info.fields.len()), (ScalarType::I16, 4));
        assert_eq!(values, expected(), "{encoding:?}");
        let (_, other) = read_all(open_bytes(&image(encoding, &ONE), Some("a & c")).unwrap());
        assert_eq!(other[7], expected()[7] + 1.0);
    }
}

#[test]
fn every_type_is_read() {
    fn one<T: Number>(encoding: Encoding, values: [T; 4], scalar: ScalarType, read: [f32; 4]) {
        let mut file = encoding.file("ImageData", "WholeExtent=\"0 3 0 0 0 0\"");
        file.text("<Piece Extent=\"0 3 0 0 0 0\"><PointData>");
        file.array("x", 1, &values);
        file.text("</PointData></Piece>");
        let (info, found) = read_all(open_bytes(&file.finish(), None).unwrap());
        assert_eq!((info.field.scalar, &found[..]), (scalar, &read[..]), "{encoding:?}");
    }
    for e in every_encoding() {
        one(e, [0u8, 1, 128, 255], ScalarType::U8, [0.0, 1.0, 128.0, 255.0]);
        one(e, [0i8, 1, -128, 127], ScalarType::I8, [0.0, 1.0, -128.0, 127.0]);
        one(e, [0u16, 1, 256, 65535], ScalarType::U16, [0.0, 1.0, 256.0, 65535.0]);
        one(e, [0i16, 1, -256, 32767], ScalarType::I16, [0.0, 1.0, -256.0, 32767.0]);
        one(e, [0u32, 1, 65536, 1 << 31], ScalarType::U32, [0.0, 1.0, 65536.0, 2147483648.0]);
        one(e, [0i32, 1, -65536, -7], ScalarType::I32, [0.0, 1.0, -65536.0, -7.0]);
        one(
            e,
            [0u64, 1, 1 << 40, 1 << 63],
            ScalarType::U64,
            [0.0, 1.0, 1099511627776.0, 9223372036854775808.0],
        );
        one(e, [0i64, 1, -1 << 40, -7], ScalarType::I64, [0.0, 1.0, -1099511627776.0, -7.0]);
        one(e, [0f32, 1.5, -1e-20, 3e30], ScalarType::F32, [0.0, 1.5, -1e-20, 3e30]);
        one(e, [0f64, 1.5, -1e-20, 0.1], ScalarType::F64, [0.0, 1.5, -1e-20, 0.1]);
    }
}

#[test]
fn pieces_are_joined_in_any_order_and_arrangement() {
    let shared_layers = [
        [1, 3, 4, 5, 1, 2],
        [-1, 1, 4, 5, 1, 2],
        [1, 3, 2, 4, 1, 2],
        [-1, 1, 2, 4, 1, 2],
        [1, 3, 4, 5, 0, 1],
        [-1, 1, 4, 5, 0, 1],
        [1, 3, 2, 4, 0, 1],
        [-1, 1, 2, 4, 0, 1],
    ];
    let apart = [[-1, 3, 2, 5, 0, 0], [-1, 3, 2, 5, 1, 1], [-1, 3, 2, 5, 2, 2]];
    let uneven = [[-1, 0, 2, 5, 0, 2], [1, 3, 2, 2, 0, 2], [1, 3, 3, 5, 0, 0], [1, 3, 3, 5, 1, 2]];
    for encoding in every_encoding() {
        for pieces in [&shared_layers[..], &apart, &uneven] {
            let (_, values) = read_all(open_bytes(&image(encoding, pieces), None).unwrap());
            assert_eq!(values, expected(), "{encoding:?}");
        }
    }
    let hole = [[-1, 0, 2, 5, 0, 2], [1, 3, 2, 2, 0, 2], [2, 3, 3, 5, 0, 0], [1, 3, 3, 5, 1, 2]];
    let error = open_bytes(&image(every_encoding()[0], &hole), None).err().unwrap().to_string();
    assert!(error.contains("none for sample (2, 1, 0)"), "{error}");
}

#[test]
fn the_first_sample_of_the_extent_is_ours_and_in_its_place() {
    let (info, _) = read_all(open_bytes(&image(every_encoding()[0], &ONE), None).unwrap());
    assert_eq!(info.geometry.to_world([0.0; 3]), [0.5, 6.0, 3.0]);
    assert_eq!(info.geometry.to_world([1.0, 1.0, 1.0]), [1.0, 8.0, 7.0]);
    // The columns of the matrix are the directions of the axes: x goes along world y, y along -x.
    let turned = String::from_utf8(image(every_encoding()[0], &ONE)).unwrap();
    let turned = turned.replace(" Spacing", " Direction=\"0 -1 0 1 0 0 0 0 1\" Spacing");
    let (info, _) = read_all(open_bytes(turned.as_bytes(), None).unwrap());
    assert_eq!(info.geometry.direction, [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
    // Index (-1, 2, 0): one step back along world y, two of 2 along -x.
    assert_eq!(info.geometry.to_world([0.0; 3]), [-3.0, 1.5, 3.0]);
}

/// An image of cells alone: 4 x 3 x 2 of them, at most, those of each piece by where they are.
fn cells(encoding: Encoding, points: [i64; 6], pieces: &[[i64; 6]]) -> Vec<u8> {
    let text = |e: &[i64; 6]| e.map(|n| n.to_string()).join(" ");
    let mut file =
        encoding.file("ImageData", &format!("WholeExtent=\"{}\" Spacing=\"2 1 1\"", text(&points)));
    for p in pieces {
        file.text(&format!("<Piece Extent=\"{}\">\n<PointData/><CellData Scalars=\"c\">\n", text(p)));
        let along = |a: usize| {
            p[2 * a]..p[2 * a + 1].max(points[2 * a] + i64::from(points[2 * a] == points[2 * a + 1]))
        };
        let mut values = vec![];
        for z in along(2) {
            for y in along(1) {
                values.extend(along(0).map(|x| (x + 10 * y + 100 * z) as f32));
            }
        }
        file.array("other", 1, &values.iter().map(|v| v + 0.5).collect::<Vec<f32>>());
        file.array("c", 1, &values);
        file.text("</CellData></Piece>\n");
    }
    file.finish()
}

#[test]
fn cell_data_of_an_image_are_samples_in_the_middles() {
    let whole = [0, 4, 0, 3, 0, 2];
    let expected: Vec<f32> = (0..24).map(|i| (i % 4 + 10 * (i / 4 % 3) + 100 * (i / 12)) as f32).collect();
    for encoding in every_encoding() {
        // The third piece is a plane of points, which has no cells.
        for pieces in
            [&[whole][..], &[[0, 4, 0, 3, 1, 2], [0, 2, 0, 3, 0, 1], [4, 4, 0, 3, 0, 2], [2, 4, 0, 3, 0, 1]]]
        {
            let (info, values) = read_all(open_bytes(&cells(encoding, whole, pieces), None).unwrap());
            assert_eq!(
                (info.dims, &info.field.name[..], values),
                ([4, 3, 2], "c", expected.clone()),
                "{encoding:?}"
            );
            assert_eq!(info.geometry.to_world([0.0; 3]), [1.0, 0.5, 0.5]);
            assert!(info.format.contains("cell data"), "{}", info.format);
        }
    }
    let encoding = every_encoding()[0];
    let (_, other) = read_all(open_bytes(&cells(encoding, whole, &[whole]), Some("other")).unwrap());
    assert_eq!(other[5], expected[5] + 0.5);
    // One point thick: so are the cells.
    let flat = [0, 4, 0, 3, 0, 0];
    let (info, values) = read_all(open_bytes(&cells(encoding, flat, &[flat]), None).unwrap());
    assert_eq!((info.dims, &values[..]), ([4, 3, 1], &expected[..12]));
    assert_eq!(info.geometry.to_world([0.0; 3]), [1.0, 0.5, 0.0]);
    // Points side by side do not make cells.
    let apart = cells(encoding, whole, &[[0, 1, 0, 3, 0, 2], [2, 4, 0, 3, 0, 2]]);
    assert!(refused(&apart, None).contains("none for sample (1, 0, 0)"));
}

/// A grid of 5 x 4 x 3 points with cell data alone: x is uneven, points of a curvilinear one are
/// sheared besides.
fn grid_of_cells(encoding: Encoding, kind: &str) -> Vec<u8> {
    let mut file = encoding.file(kind, "WholeExtent=\"0 4 0 3 0 2\"");
    file.text("<Piece Extent=\"0 4 0 3 0 2\">\n<CellData>\n");
    file.array("c", 1, &(0..24).collect::<Vec<i16>>());
    file.text("</CellData>\n");
    if kind == "RectilinearGrid" {
        file.text("<Coordinates>\n");
        file.array("x", 1, &[0.0f32, 1.0, 4.0, 9.0, 16.0]);
        file.array("y", 1, &[0.0f32, 2.0, 4.0, 6.0]);
        file.array("z", 1, &[5.0f32, 4.0, 2.0]);
        file.text("</Coordinates></Piece>\n");
    } else {
        let each = (0..3).flat_map(|z| (0..4).flat_map(move |y| (0..5).map(move |x| [x, y, z])));
        let points = each.map(|p| p.map(|n: u8| f32::from(n))).flat_map(|[x, y, z]| [x * x + y, 2.0 * y, z]);
        file.text("<Points>\n");
        file.array("p", 3, &points.collect::<Vec<f32>>());
        file.text("</Points></Piece>\n");
    }
    file.finish()
}

#[test]
fn cell_data_of_grids_are_samples_in_the_middles() {
    for encoding in every_encoding() {
        for kind in ["RectilinearGrid", "StructuredGrid"] {
            let bytes = grid_of_cells(encoding, kind);
            let (info, values) = read_all(open_bytes(&bytes, None).unwrap());
            assert_eq!(
                (info.dims, &info.field.name[..], values),
                ([4, 3, 2], "c", (0..24).map(|i| i as f32).collect()),
                "{encoding:?}"
            );
            let dir = tempfile::tempdir().unwrap();
            let path = crate::formats::tests::write(&dir, "a.vtr", &bytes);
            let found =
                crate::formats::tests::open_coordinates(&path, &OpenOptions::default()).unwrap().unwrap();
            match found {
                GridCoordinates::Axes(axes) => {
                    assert_eq!(axes, [vec![0.5, 2.5, 6.5, 12.5], vec![1.0, 3.0, 5.0], vec![4.5, 3.0]])
                }
                GridCoordinates::Points(mut stream) => {
                    let mut points = vec![0.0; 3 * 24];
                    stream.fill(&mut points).unwrap();
                    stream.finish().unwrap();
                    assert_eq!(points[..6], [1.0, 1.0, 0.5, 3.0, 1.0, 0.5]);
                    assert_eq!(points[3 * 23..], [12.5 + 2.5, 5.0, 1.5]);
                }
            }
        }
    }
}

fn refused(bytes: &[u8], field: Option<&str>) -> String {
    let source = open_bytes(bytes, field);
    let error = source.and_then(try_read_all).expect_err("the file is refused");
    assert!(matches!(error.exit_code(), 2 | 5));
    error.to_string()
}

#[test]
fn the_field_is_chosen_or_asked_for() {
    let good = String::from_utf8(image(every_encoding()[0], &ONE)).unwrap();
    let no_active = good.replace(" Scalars=\"b\"", "");
    assert!(
        refused(no_active.as_bytes(), None).contains("a & c (int16), b (int16), v (2 x float32, not scalar)")
    );
    assert!(open_bytes(no_active.as_bytes(), Some("b")).is_ok());
    assert!(refused(good.as_bytes(), Some("v")).contains("no scalar field v"));
    assert!(refused(good.as_bytes(), Some("w")).contains("no scalar field w"));
    // The only scalar array needs no mark.
    let one = no_active
        .replace("Name=\"a &amp; c\" NumberOfComponents=\"1\"", "Name=\"a\" NumberOfComponents=\"3\"");
    assert_eq!(read_all(open_bytes(one.as_bytes(), None).unwrap()).1, expected());
}

#[test]
fn malformed_files_are_refused() {
    let good = String::from_utf8(image(every_encoding()[0], &ONE)).unwrap();
    for (from, to, says) in [
        ("type=\"ImageData\"", "type=\"RectilinearGrid\"", "an element 'RectilinearGrid'"),
        ("type=\"ImageData\"", "type=\"PImageData\"", "an element 'PImageData'"),
        ("type=\"ImageData\"", "type=\"UnstructuredGrid\"", ".vtu"),
        ("<VTKFile", "<File", "an element 'File'"),
        ("LittleEndian", "MiddleEndian", "byte_order"),
        ("UInt32", "UInt16", "header_type"),
        ("header_type", "compressor=\"vtkLZMADataCompressor\" header_type", "vtkLZMADataCompressor"),
        ("WholeExtent=\"-1 3", "WholeExtent=\"3 -1", "WholeExtent: x0 <= x1"),
        ("WholeExtent=\"-1 3", "WholeExtent=\"-1 4", "cover WholeExtent"),
        ("WholeExtent=\"-1 3", "WholeExtent=\"-1", "6 numbers"),
        ("WholeExtent=\"-1 3", "WholeExtent=\"-1 9999999999", "32 bits"),
        (" Extent=\"-1 3", " Extent=\"-1 4", "within WholeExtent"),
        ("Spacing=\"0.5", "Spacing=\"0", "axes that span space"),
        ("Spacing=\"0.5", "Spacing=\"nan", "axes that span space"),
        ("format=\"ascii\"", "format=\"octal\"", "'octal'"),
        ("format=\"ascii\"", "format=\"appended\" offset=\"0\"", "AppendedData"),
        ("Name=\"b\" NumberOfComponents=\"1\"", "Name=\"b\" NumberOfComponents=\"0\"", "NumberOfComponents"),
        (" 234", "", "more numbers"),
        (" 234", " 234 5", "the end of the array"),
        (" 234", " 2x4", "a number of type int16"),
        (" 234", " 99999", "a number of type int16"),
        ("</VTKFile>", "", "the end of the file"),
        ("</Piece>", "</Peace>", "the head of a VTK XML file"),
    ] {
        // The array that is read is the last with these values but the vectors.
        let at = if from == " 234" { good.find("Name=\"b\"").unwrap() } else { 0 };
        let at = if from.starts_with("format") { good.find("Name=\"b\"").unwrap() } else { at };
        let bad = good[..at].to_string() + &good[at..].replacen(from, to, 1);
        assert_ne!(good, bad, "{from}");
        let error = refused(bad.as_bytes(), None);
        assert!(error.contains(says), "{says}: {error}");
    }
    let whole = [
        ["WholeExtent=\"-1 3 2 5 0 2\"", "WholeExtent=\"0 2147483647 0 2147483647 0 9\""],
        ["Extent=\"-1 3 2 5 0 2\"", "Extent=\"0 2147483647 0 2147483647 0 9\""],
    ];
    let huge = whole.iter().fold(good, |text, [from, to]| text.replace(from, to));
    assert!(refused(huge.as_bytes(), None).contains("fewer than 2^63 bytes"));
}

#[test]
fn damage_does_not_panic() {
    let read = |b: &[u8]| drop(open_bytes(b, None).and_then(try_read_all));
    let chosen = |e: &Encoding| e.block != 24 && e.big_endian != e.wide;
    for encoding in every_encoding().into_iter().filter(|e| e.format == "ascii" || chosen(e)) {
        survive(&image(encoding, &ONE), read);
    }
}

#[test]
fn a_cut_within_the_data_is_an_error() {
    for encoding in every_encoding() {
        let bytes = image(encoding, &ONE);
        let field = "a & c";
        let whole = |b: &[u8]| open_bytes(b, Some(field)).and_then(try_read_all);
        assert!(whole(&bytes).is_ok());
        // The head, and for appended data what is stored of the first array, is a part of every
        // good file.
        let start = bytes.windows(4).position(|w| w == b"</Im").unwrap();
        let least = if matches!(encoding.format, "raw" | "base64") { start + 50 } else { start };
        assert!((0..least).all(|cut| whole(&bytes[..cut]).is_err()), "{encoding:?}");
    }
}

#[test]
fn compressed_data_with_a_flipped_bit_are_an_error() {
    for encoding in every_encoding().into_iter().filter(|e| e.compressor == "ZLib" && e.format == "raw") {
        let bytes = image(encoding, &ONE);
        let start = bytes.windows(3).position(|w| w == b"  _").unwrap() + 3;
        let blocks = start + (bytes.len() - start) / 2;
        for at in blocks - 40..blocks {
            let mut bad = bytes.clone();
            bad[at] ^= 4;
            let values = open_bytes(&bad, None).and_then(try_read_all);
            assert!(
                values.is_err() || values.unwrap() == expected(),
                "checksums see it, or it was another array"
            );
        }
    }
}

#[test]
fn an_lz4_block_of_an_absurd_length_is_refused() {
    let encoding =
        Encoding { format: "raw", compressor: "LZ4", big_endian: false, wide: true, block: 1 << 20 };
    let mut file = encoding.file("ImageData", "WholeExtent=\"0 99999999 0 0 0 0\"");
    file.text("<Piece Extent=\"0 99999999 0 0 0 0\"><PointData>");
    file.array("x", 1, &[1u8]);
    file.text("</PointData></Piece>");
    let mut bytes = file.finish();
    let start = bytes.windows(3).position(|w| w == b"  _").unwrap() + 3;
    bytes[start + 8..start + 16].copy_from_slice(&100_000_000u64.to_le_bytes());
    bytes[start + 16..start + 24].copy_from_slice(&0u64.to_le_bytes());
    let error = refused(&bytes, None);
    assert!(error.contains("too short"), "{error}");
}

#[test]
fn an_lz4_block_is_not_stored_longer_than_lz4_makes_it() {
    let encoding =
        Encoding { format: "raw", compressor: "LZ4", big_endian: false, wide: true, block: 1 << 10 };
    let mut file = encoding.file("ImageData", "WholeExtent=\"0 3 0 0 0 0\"");
    file.text("<Piece Extent=\"0 3 0 0 0 0\"><PointData>");
    file.array("x", 1, &[1u8, 2, 3, 4]);
    file.text("</PointData></Piece>");
    let mut bytes = file.finish();
    let start = bytes.windows(3).position(|w| w == b"  _").unwrap() + 3;
    // The file has room for so much.
    bytes[start + 24..start + 32].copy_from_slice(&100u64.to_le_bytes());
    bytes.extend([b' '; 200]);
    let error = refused(&bytes, None);
    assert!(error.contains("at most 20 bytes"), "{error}");
}

#[test]
fn decoders_that_are_open_together_need_memory_together() {
    let needs = |compressor: &'static str, pieces: &[[i64; 6]]| {
        let encoding = Encoding { format: "raw", compressor, big_endian: false, wide: true, block: 16 << 20 };
        open_bytes(&image(encoding, pieces), None).unwrap().into_stream().working_bytes()
    };
    let (above, beside) =
        ([[-1, 3, 2, 5, 0, 0], [-1, 3, 2, 5, 1, 2]], [[-1, 0, 2, 5, 0, 2], [1, 3, 2, 5, 0, 2]]);
    let one = needs("LZ4", &ONE);
    assert!(one > 32 << 20 && one < 38 << 20, "a block stored and decoded: {one}");
    assert_eq!(needs("LZ4", &above), one);
    assert!(needs("LZ4", &beside) > one + (32 << 20));
    assert!(needs("ZLib", &beside) < 6 << 20, "inflated piece by piece");
}

#[test]
fn a_head_beyond_all_reason_is_refused() {
    let many = "<Piece/>".repeat(1 << 18);
    let deep = "<Piece>".repeat(40);
    let wide = format!("<Piece {}/>", (0..9000).map(|i| format!("a{i}=\"\" ")).collect::<String>());
    for (inside, says) in [(many, "elements"), (deep, "nested deeper"), (wide, "a tag of")] {
        let error = refused(format!("<VTKFile type=\"ImageData\">{inside}").as_bytes(), None);
        assert!(error.contains(says), "{error}");
    }
}

/// A file of the shared test data.
pub(in crate::formats) fn shared(name: &str) -> std::path::PathBuf {
    crate::formats::tests::shared_data().join(name)
}

/// Smallest and largest value, as printed with six significant digits.
pub(in crate::formats) fn range(values: &[f32]) -> (f32, f32) {
    values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), &v| (lo.min(v), hi.max(v)))
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_files_have_the_published_dimensions_and_ranges() {
    let viscous = |n: u32| format!("series/viscous_fingers_f32/density_t0{n}.vti");
    let mut files = vec![
        ("volumes/hydrogen_f32.vti".to_string(), [64, 64, 64], ScalarType::F32, (0.0, 1.0)),
        ("volumes/isabel_wind_f64_t02.vti".to_string(), [125, 125, 25], ScalarType::F64, (0.0, 68.2455)),
        ("variants/vtkio/volume_complex.vti".to_string(), [3, 4, 6], ScalarType::I8, (0.0, 50.0)),
    ];
    let largest = [90.4581, 100.289, 108.485, 113.59, 107.936, 110.958, 117.521, 124.81];
    for (i, hi) in largest.into_iter().enumerate() {
        files.push((viscous(10 * (i as u32 + 1)), [64; 3], ScalarType::F32, (0.0, hi)));
    }
    for (name, dims, scalar, (lo, hi)) in files {
        let path = shared(&name);
        let (info, values) = read_all(open_volume(&path, &OpenOptions::default()).unwrap());
        assert_eq!((info.dims, info.field.scalar), (dims, scalar), "{name}");
        let found = range(&values);
        assert!((found.0 - lo).abs() < 1e-4 && (found.1 - hi).abs() < hi * 5e-6, "{name}: {found:?}");
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_files_that_are_no_scalar_image_are_refused_by_name() {
    for (name, says) in [
        ("variants/vase_4component_u8.vti", "Scalars_ (4 x uint8, not scalar)"),
        ("variants/QuadraticTetra.vtu", "an unstructured grid (.vtu)"),
        ("variants/vtkio/hexahedron_lzma_inline_binary.vtu", "UnstructuredGrid"),
        ("variants/vtkio/polyEx0.vtp", "a surface (.vtp)"),
        ("variants/vtkio/cube.pvtp", "PPolyData"),
    ] {
        let source = Arc::new(ByteSource::open(shared(name), IoMode::Auto).unwrap());
        let error = Image::open(&source).and_then(|image| image::volume(&image, None)).err().unwrap();
        assert!(error.exit_code() == 5 && error.to_string().contains(says), "{error}");
    }
}
