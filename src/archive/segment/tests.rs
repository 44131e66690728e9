//! Segments come back, and damage is found.

use super::*;
use std::path::Path;

const PLAN: PlanHash = PlanHash(0x0123_4567_89ab_cdef_0011_2233_4455_6677);

fn blocks(n: usize) -> Vec<Vec<u8>> {
    (0..n).map(|i| (0..i * 7 % 23).map(|j| (i * 31 + j * 17) as u8).collect()).collect()
}

fn write(path: &Path, blocks: &[Vec<u8>]) -> SegmentInfo {
    let mut w = SegmentWriter::create(path, SegmentKind::Mesh, PLAN).unwrap();
    for (i, b) in blocks.iter().enumerate() {
        assert_eq!(w.push_block(b).unwrap(), i as u64);
    }
    w.finish().unwrap()
}

#[test]
fn blocks_come_back_in_any_order() {
    let dir = tempfile::tempdir().unwrap();
    for n in [0, 1, 2, 61, 62, 63, 125, 1021] {
        let path = dir.path().join(format!("{n}.seg"));
        let expected = blocks(n);
        let info = write(&path, &expected);
        let s = Segment::open(&path, SegmentKind::Mesh, Some(PLAN)).unwrap();
        assert_eq!((s.block_count(), s.info(), s.plan()), (n as u64, info, PLAN));
        assert_eq!(info.bytes, std::fs::metadata(&path).unwrap().len());
        assert_eq!(s.bytes_read(), HEADER_BYTES + FOOTER_BYTES, "opening reads no block and no directory");
        s.verify().unwrap();
        let mut out = vec![1, 2, 3];
        for i in (0..n).rev() {
            s.block(i as u64, &mut out).unwrap();
            assert_eq!(out, expected[i]);
        }
    }
}

#[test]
fn threads_read_a_directory_page_once() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.seg");
    let blocks = blocks(3);
    write(&path, &blocks);
    let alone = Segment::open(&path, SegmentKind::Mesh, None).unwrap();
    let mut out = vec![];
    (0..3).for_each(|n| alone.block(n, &mut out).unwrap());
    let payload: u64 = blocks.iter().map(|b| b.len() as u64).sum();
    for _ in 0..200 {
        let shared = Segment::open(&path, SegmentKind::Mesh, None).unwrap();
        let start = std::sync::Barrier::new(4);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let mut out = vec![];
                    start.wait();
                    (0..3).for_each(|n| shared.block(n, &mut out).unwrap());
                });
            }
        });
        assert_eq!(shared.bytes_read(), alone.bytes_read() + 3 * payload);
    }
}

#[test]
fn other_kinds_plans_and_versions_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.seg");
    write(&path, &blocks(3));
    let error = |kind, plan| Segment::open(&path, kind, plan).err().map(|e| e.to_string()).unwrap();
    let e = error(SegmentKind::Index, None);
    assert!(e.contains("kind") && e.contains("index") && e.contains("mesh"), "{e}");
    let e = error(SegmentKind::Mesh, Some(PlanHash(1)));
    assert!(e.contains(&PLAN.to_string()) && e.contains("other input or parameters"), "{e}");
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[10] = 8;
    std::fs::write(&path, &bytes).unwrap();
    let e = error(SegmentKind::Mesh, None);
    assert!(e.contains("format 8 and later"), "{e}");
    bytes[8..12].copy_from_slice(&[5, 0, 5, 0]);
    std::fs::write(&path, bytes).unwrap();
    let e = error(SegmentKind::Mesh, None);
    assert!(e.contains("(7 and later), got version 5"), "{e}");
    std::fs::write(&path, vec![b'x'; 500]).unwrap();
    assert!(error(SegmentKind::Mesh, None).contains("magic"));
    assert!(Segment::open(dir.path(), SegmentKind::Mesh, None).is_err());
}

#[test]
fn every_flipped_byte_and_every_cut_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.seg");
    write(&path, &blocks(9));
    let good = std::fs::read(&path).unwrap();
    let check = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        Segment::open(&path, SegmentKind::Mesh, Some(PLAN)).and_then(|s| s.verify())
    };
    check(&good).unwrap();
    for i in 0..good.len() {
        for bit in [1, 0x80] {
            let mut bad = good.clone();
            bad[i] ^= bit;
            let e = check(&bad).expect_err("a flipped byte").to_string();
            assert!(!e.contains('\n') && e.contains("a.seg"), "{e}");
        }
        assert!(check(&good[..i]).is_err(), "cut at {i}");
    }
    assert!(check(&[&good[..], &[0]].concat()).is_err(), "a byte too many");
}

#[test]
fn plan_hashes_are_text_and_back() {
    let json = serde_json::to_string(&PLAN).unwrap();
    assert_eq!(json, "\"0123456789abcdef0011223344556677\"");
    assert_eq!(serde_json::from_str::<PlanHash>(&json).unwrap(), PLAN);
    assert!(serde_json::from_str::<PlanHash>("\"12\"").is_err());
}
