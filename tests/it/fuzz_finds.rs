//! Inputs that once led to a panic, a hang or a claim of memory, each by its name: found by
//! `tools/dev/fuzz`, or by looking for what it might find.

use crate::common::*;
use isospan::Error;
use isospan::archive::manifest::{Manifest, index_path};
use isospan::archive::segment::SegmentKind;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::index::{Entry, IndexBuilder, SpanIndex};
use isospan::pipeline::{self, Amount};
use isospan::points::SetKind;
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

fn archive(dir: &Path) -> PathBuf {
    let input = dir.join("waves.npy");
    write_npy(&input, [30, 6, 5], waves);
    let out = dir.join("a.isospan");
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(1.0), 200), &out, 1);
    out
}

/// Gives the archive an index of these entries, recorded in the manifest, all checksums good.
fn put_index(archive: &Path, change: impl Fn(&mut Vec<Entry>)) {
    let mut manifest = Manifest::read(archive).unwrap();
    let hash = manifest.steps[0].plan.hash(manifest.plan_hash);
    let path = index_path(archive, 0);
    let mut entries = SpanIndex::open(&path, Some(hash)).unwrap().entries().unwrap();
    change(&mut entries);
    let mut index = IndexBuilder::default();
    entries.into_iter().try_for_each(|e| index.push(e)).unwrap();
    std::fs::remove_file(&path).unwrap();
    manifest.steps[0].index = Some(index.finish(&path, hash).unwrap());
    manifest.write(archive).unwrap();
}

/// An isovalue of so many digits that its count is not stored: the index is asked.
const UNSTORED: f32 = 0.100_000_3;

fn refused(error: Error, words: &str) {
    assert_eq!(error.exit_code(), 5, "{error}");
    assert!(error.to_string().contains(words), "{error}");
}

#[test]
fn an_index_entry_of_a_chunk_that_is_not_there_panicked() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path());
    put_index(&archive, |entries| {
        let last = entries.len() - 1;
        entries[last] = Entry { min: -9.0, max: 9.0, chunk: 1 << 40, ..entries[last] };
    });
    refused(count_active(&archive, UNSTORED).unwrap_err(), "expected chunks below");
    refused(check_archive(&archive).unwrap_err(), "index.seg");
}

#[test]
fn an_index_that_names_a_block_twice_gave_its_triangles_twice() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path());
    put_index(&archive, |entries| {
        *entries = (0..66).map(|block| Entry { min: -9.0, max: 9.0, chunk: 0, block, tets: 1 }).collect();
    });
    let first = RefCell::new(None);
    reseal_all(
        &archive,
        |_| {},
        |kind, n, page| {
            // Behind the root and the inner page: two leaves of 33 entries each.
            match (kind, n) {
                (SegmentKind::Index, 2) => *first.borrow_mut() = Some(page.clone()),
                (SegmentKind::Index, 3) => *page = first.take().unwrap(),
                _ => {}
            }
        },
    );
    refused(count_active(&archive, UNSTORED).unwrap_err(), "twice");
    refused(check_archive(&archive).unwrap_err(), "index.seg: entries");
}

#[test]
fn a_summary_of_four_thousand_million_blocks_claimed_sixteen_gigabytes() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path());
    reseal_all(
        &archive,
        |_| {},
        |kind, _, block| {
            // The summary of a chunk's mesh is the only block of 56 bytes; its third field counts
            // the blocks.
            if kind == SegmentKind::Mesh && block.len() == 56 {
                block[8..12].fill(0xff);
            }
        },
    );
    refused(check_archive(&archive).unwrap_err(), "summary");
}

/// A brick's points are enumerated at once: 10^12 points in a small volume filled the memory.
#[test]
fn more_points_than_bricks_can_hold_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [20, 20, 20], waves);
    let out = dir.path().join("a.isospan");
    for kind in [SetKind::Hammersley, SetKind::Halton, SetKind::HyperbolicCross] {
        for count in [100_000_000_000, 1_000_000_000_000_000, 1 << 59] {
            let start = Instant::now();
            let settings = settings(kind, Amount::Count(count), 250_000);
            let made = pipeline::reduce_series(
                &[StepSource::new(&input, &OpenOptions::default())],
                &settings,
                &out,
                &run(1),
                &Silent,
            );
            match made {
                Err(e) => assert!(matches!(e.exit_code(), 2 | 4), "{kind} {count}: {e}"),
                Ok(_) => panic!("{kind}: {count} points were made"),
            }
            assert!(start.elapsed() < Duration::from_secs(600), "{kind} {count}: {:?}", start.elapsed());
            assert!(!out.exists(), "nothing is left");
        }
    }
}

/// A long thin volume was cut into a chunk for each of its bricks, all halo: a minute for a
/// second's work.
#[test]
fn long_thin_volumes_are_reduced_soon() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("thin.npy");
    for axis in 0..3 {
        let mut dims = [2; 3];
        dims[axis] = 1_000_001;
        write_npy(&input, dims, |x, y, z| x + y + z);
        let out = dir.path().join(format!("{axis}.isospan"));
        let made = reduce(&input, &settings(SetKind::Regular, Amount::Count(8_000), 1_000), &out, 2);
        assert!(made.chunks <= 20, "{} chunks of {} points", made.chunks, made.points);
        check_archive(&out).unwrap();
    }
}

/// Lines behind the end of a file are empty and come without end.
#[test]
fn a_gmsh_section_of_so_many_strings_was_read_for_ever() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.msh");
    let text = format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$NodeData\n{}\n\"f\"\n", u64::MAX / 2);
    std::fs::write(&path, text).unwrap();
    let opened = isospan::formats::open_mesh(&path, &isospan::formats::OpenOptions::default());
    refused(opened.map(drop).unwrap_err(), "strings");
}
