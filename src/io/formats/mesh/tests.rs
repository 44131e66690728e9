//! Helpers for the tests of all mesh readers, and tests on real files.

use crate::cells::CellMesh;
use crate::cells::scan::{FieldScan, MeshScan, scan, scan_field};
use crate::cells::{CellBlock, CellKind};
use crate::error::Result;
use crate::formats::tests::is_mesh;
use crate::formats::{OpenOptions, open_mesh};
use std::path::PathBuf;

/// All points, cells and values of a mesh.
#[derive(Debug, Default, PartialEq)]
pub(in crate::formats) struct Whole {
    pub(in crate::formats) points: Vec<[f64; 3]>,
    pub(in crate::formats) cells: Vec<(CellKind, Vec<u64>)>,
    /// Without a field, empty.
    pub(in crate::formats) values: Vec<f32>,
}

pub(in crate::formats) fn read_whole(mesh: &CellMesh) -> Result<Whole> {
    let mut out = Whole::default();
    let (mut points, mut block) = (mesh.points()?, vec![]);
    while points.next_block(&mut block)? {
        out.points.extend_from_slice(&block);
    }
    let (mut cells, mut block) = (mesh.cells()?, CellBlock::default());
    while cells.next_block(&mut block)? {
        out.cells.extend(block.iter().map(|(kind, v)| (kind, v.to_vec())));
    }
    if mesh.field().is_ok() {
        let (mut values, mut block) = (mesh.values(0, |_| false)?, vec![]);
        while values.next_block(&mut block)? {
            out.values.extend(block.iter().map(|&v| v as f32));
        }
        assert_eq!(out.values.len() as u64, mesh.info().points);
    }
    assert_eq!((out.points.len() as u64, out.cells.len() as u64), (mesh.info().points, mesh.info().cells));
    Ok(out)
}

/// Damages a small file in every way: nothing panics, and every error is one line with the file's
/// name.
pub(in crate::formats) fn torture(name: &str, bytes: &[u8]) {
    torture_with(name, bytes, &[]);
}

/// The same, with other files next to the damaged one.
pub(in crate::formats) fn torture_with(name: &str, bytes: &[u8], beside: &[(&str, &[u8])]) {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in beside {
        std::fs::write(dir.path().join(name), bytes).unwrap();
    }
    let path = dir.path().join(name);
    let read = |damaged: &[u8]| {
        let _ = std::fs::remove_file(&path);
        std::fs::write(&path, damaged).unwrap();
        let options = OpenOptions::default();
        let outcome = open_mesh(&path, &options).and_then(|mesh| {
            (0..mesh.info().fields.len()).try_for_each(|f| scan_field(&mesh, f).map(drop))?;
            read_whole(&mesh)
        });
        if let Err(e) = outcome {
            let line = e.to_string();
            assert!(!line.contains('\n') && line.contains(&dir.path().display().to_string()), "{line}");
        }
    };
    (1..bytes.len()).step_by(5).for_each(|cut| read(&bytes[..cut]));
    for at in 0..bytes.len() {
        let mut bad = bytes.to_vec();
        bad[at] ^= [0x01, 0x10, 0x80, 0xff][at % 4];
        read(&bad);
    }
}

/// A row of the manifest of the shared data.
struct Row {
    file: String,
    path: PathBuf,
    cells: Vec<String>,
}

fn rows() -> Vec<Row> {
    let root = crate::formats::tests::shared_data();
    let text = std::fs::read_to_string(root.join("MANIFEST.tsv")).expect("the manifest is there");
    let row = |line: &str| {
        let cells: Vec<String> = line.split('\t').map(str::to_string).collect();
        Row { file: cells[0].clone(), path: root.join(&cells[0]), cells }
    };
    text.lines().filter(|l| l.contains('\t') && !l.starts_with("file\t")).map(row).collect()
}

fn read(row: &Row) -> Result<(CellMesh, MeshScan, Vec<FieldScan>)> {
    let mesh = open_mesh(&row.path, &OpenOptions::default())?;
    let found = scan(&mesh)?;
    let fields = (0..mesh.info().fields.len()).map(|f| scan_field(&mesh, f)).collect::<Result<_>>()?;
    Ok((mesh, found, fields))
}

/// "32505 vertices; 128976 tet" or "189 points; 96 cells".
fn counts(size: &str) -> Option<(u64, u64)> {
    let (points, cells) = size.split_once(';')?;
    let number = |s: &str| s.split_whitespace().next()?.parse().ok();
    number(points).zip(number(cells))
}

/// Numbers of the manifest have six digits.
fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-5 * a.abs().max(b.abs())
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn meshes_have_the_manifests_counts_fields_and_ranges() {
    for row in rows().iter().filter(|r| r.file.starts_with("meshes/") || r.file.starts_with("series/")) {
        let Some((points, cells)) = counts(&row.cells[4]) else { continue };
        let (mesh, found, fields) = read(row).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((mesh.info().points, mesh.info().cells), (points, cells), "{}", row.file);
        if row.cells[4].contains("tet") {
            assert_eq!(found.kinds.get(&CellKind::Tetrahedron), Some(&cells), "{}", row.file);
        }
        let (lo, hi) = row.cells[6].split_once("..").expect("a range");
        let (lo, hi): (f64, f64) = (lo.parse().unwrap(), hi.parse().unwrap());
        let name = row.cells[12].strip_prefix("field ").and_then(|n| n.split([';', ' ']).next());
        let is_it = |i: usize| {
            let range = fields[i].min.zip(fields[i].max);
            name.is_none_or(|n| mesh.info().fields[i].name == n)
                && range.is_some_and(|(a, b)| close(a, lo) && close(b, hi))
        };
        // The range of a series is that of all steps, and that of a vector depends on what is taken
        // of it.
        let vague = row.file.starts_with("series/") || row.cells[5].ends_with("x3");
        assert!(vague || (0..fields.len()).any(is_it), "{}: {fields:?}", row.file);
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn variants_are_read_right_or_refused_in_a_line() {
    for row in rows().iter().filter(|r| r.file.starts_with("variants/")) {
        if !row.path.is_file() {
            continue;
        }
        // A damaged head is refused before there is a mesh.
        let opened = match is_mesh(&row.path, &OpenOptions::default()) {
            Ok(false) => continue,
            Ok(true) => read(row),
            // One of no points and cells may be a volume: shared_data.rs looks at those.
            Err(e) if counts(&row.cells[4]).is_none() => {
                assert!(!e.to_string().contains('\n'), "{e}");
                continue;
            }
            Err(e) => Err(e),
        };
        match opened {
            Ok((mesh, ..)) => {
                if let Some(expected) = counts(&row.cells[4]) {
                    assert_eq!((mesh.info().points, mesh.info().cells), expected, "{}", row.file);
                }
            }
            Err(e) => {
                let line = e.to_string();
                assert!(e.exit_code() == 5 && !line.contains('\n'), "{line}");
                let loads = row.cells[12].starts_with("loads");
                // VTK passes over an array that is too long, and loads surfaces too, which we
                // refuse by name.
                let known = ["LZMA", "PolyData", "POLYDATA"].iter().any(|word| line.contains(word))
                    || row.file.ends_with("box_para.vtu");
                assert!(!loads || known, "refused: {line}");
            }
        }
    }
}
