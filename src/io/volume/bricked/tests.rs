//! Tests of the bricked copy.

use super::*;
use crate::volume::ScalarType;

/// A volume whose sample (x, y, z) is x + 100 y + 10 000 z, delivered in given boxes.
struct Boxes {
    info: VolumeInfo,
    boxes: std::vec::IntoIter<IndexBox>,
}

fn value(x: u64, y: u64, z: u64) -> u32 {
    (x + 100 * y + 10_000 * z) as u32
}

fn boxes(dims: [u64; 3], boxes: Vec<IndexBox>) -> Box<dyn SlabStream> {
    let field = FieldInfo { name: "data".into(), scalar: ScalarType::U32, components: 1 };
    let geometry =
        Geometry { origin: [0.1, -2.0, 3.0], spacing: [0.1, 0.7, 1.0 / 3.0], ..Geometry::default() };
    let info = VolumeInfo {
        path: "somewhere/test.nrrd".into(),
        format: "test".into(),
        dims,
        fields: vec![field.clone()],
        field,
        geometry,
        slope: 0.3,
        intercept: -1.1,
        missing: Some(203.0),
        units: Units::default(),
        notes: vec![],
        data_files: vec![],
        assumed: crate::volume::Assumed::default(),
        is_labels: false,
    };
    Box::new(Boxes { info, boxes: boxes.into_iter() })
}

impl SlabStream for Boxes {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        let Some(b) = self.boxes.next() else { return Ok(None) };
        for z in b.lo[2]..b.hi[2] {
            for (y, x) in (b.lo[1]..b.hi[1]).flat_map(|y| (b.lo[0]..b.hi[0]).map(move |x| (y, x))) {
                out.extend(value(x, y, z).to_le_bytes());
            }
        }
        Ok(Some(b))
    }
}

/// Cuts a volume into boxes of at most `edge`, x fastest.
fn tiles(dims: [u64; 3], edge: [u64; 3]) -> Vec<IndexBox> {
    let starts = |a: usize| (0..dims[a]).step_by(edge[a] as usize);
    let at = |lo: [u64; 3]| IndexBox { lo, hi: std::array::from_fn(|a| dims[a].min(lo[a] + edge[a])) };
    starts(2).flat_map(|z| starts(1).flat_map(move |y| starts(0).map(move |x| at([x, y, z])))).collect()
}

fn check(volume: &BrickedVolume, voxels: IndexBox) {
    let mut values = vec![0.0; voxels.len()];
    let mut stored = vec![0; 4 * voxels.len()];
    volume.read_box(voxels, &mut values).unwrap();
    volume.read_stored(voxels, &mut stored).unwrap();
    volume.will_need(voxels);
    for z in voxels.lo[2]..voxels.hi[2] {
        for (y, x) in
            (voxels.lo[1]..voxels.hi[1]).flat_map(|y| (voxels.lo[0]..voxels.hi[0]).map(move |x| (y, x)))
        {
            let at = voxels.offset([x, y, z]);
            assert_eq!(le32(&stored[4 * at..]), value(x, y, z));
            match value(x, y, z) {
                203 => assert!(values[at].is_nan()),
                v => assert_eq!(values[at], (0.3 * f64::from(v) - 1.1) as f32),
            }
        }
    }
}

const DIMS: [u64; 3] = [70, 33, 67];

#[test]
fn any_tiling_and_any_buffer_give_the_same_file() {
    let dir = tempfile::tempdir().unwrap();
    let (out, mut first) = (dir.path().join("a.bricks"), None::<Vec<u8>>);
    let (row, slice) = (280, 280 * 33);
    for edge in [[70, 33, 1], [70, 33, 5], [70, 33, 67], [70, 7, 1], [70, 32, 1], [9, 33, 1], [11, 13, 40]] {
        for buffer in [1, 10 * row, 33 * row, 7 * slice, 33 * slice, usize::MAX / 2] {
            let mut last = 0;
            BrickedVolume::build(boxes(DIMS, tiles(DIMS, edge)), &out, buffer, &mut |n| last = n).unwrap();
            assert_eq!(last, DIMS.iter().product::<u64>());
            let bytes = std::fs::read(&out).unwrap();
            match &first {
                Some(first) => assert!(*first == bytes, "tiles of {edge:?}, buffer of {buffer}"),
                None => first = Some(bytes),
            }
        }
    }
    // Slabs in another order, and a mixture of orders.
    let mut mixed = tiles(DIMS, [70, 7, 1]);
    mixed.reverse();
    BrickedVolume::build(boxes(DIMS, mixed.clone()), &out, 3 * slice, &mut |_| ()).unwrap();
    assert!(first.as_ref() == Some(&std::fs::read(&out).unwrap()));
    mixed[20..200].reverse();
    BrickedVolume::build(boxes(DIMS, mixed), &out, 3 * slice, &mut |_| ()).unwrap();
    assert!(first == Some(std::fs::read(&out).unwrap()));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary files are left");
}

#[test]
fn boxes_come_back() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.bricks");
    BrickedVolume::build(boxes(DIMS, tiles(DIMS, [70, 33, 3])), &out, 1 << 16, &mut |_| ()).unwrap();
    let volume = BrickedVolume::open(&out).unwrap();
    volume.verify().unwrap();
    assert_eq!(volume.brick_count(), 3 * 2 * 3);
    let (info, original) = (volume.info(), boxes(DIMS, vec![]).info().clone());
    assert_eq!(
        (info.geometry, info.slope, info.missing),
        (original.geometry, original.slope, original.missing)
    );
    assert_eq!(info.format, "isospan bricks of test.nrrd (test)");
    for voxels in [
        IndexBox::whole(DIMS),
        IndexBox { lo: [31, 31, 31], hi: [33, 33, 33] },
        IndexBox { lo: [64, 0, 64], hi: [70, 33, 67] },
        IndexBox { lo: [5, 6, 7], hi: [5, 6, 7] },
        IndexBox { lo: [0, 32, 0], hi: [70, 33, 1] },
    ] {
        check(&volume, voxels);
    }
}

#[test]
fn a_copy_of_a_copy_is_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (dir.path().join("test.nrrd"), dir.path().join("b.bricks"));
    BrickedVolume::build(boxes(DIMS, tiles(DIMS, [70, 33, 3])), &a, 1 << 16, &mut |_| ()).unwrap();
    let source = crate::volume::VolumeSource::Random(Box::new(BrickedVolume::open(&a).unwrap()));
    BrickedVolume::build(source.into_stream(), &b, 1 << 20, &mut |_| ()).unwrap();
    let (a, b) = (BrickedVolume::open(&a).unwrap(), BrickedVolume::open(&b).unwrap());
    b.verify().unwrap();
    let data = |v: &BrickedVolume| v.layout.data_at..v.layout.file_bytes() - FOOTER;
    assert!(a.source.slice(data(&a)).unwrap() == b.source.slice(data(&b)).unwrap());
}

#[test]
fn a_stream_that_fails_or_ends_early_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.bricks");
    let mut short = tiles(DIMS, [70, 33, 3]);
    short.pop();
    let error = BrickedVolume::build(boxes(DIMS, short), &out, 1 << 16, &mut |_| ()).unwrap_err();
    assert_eq!(error.exit_code(), 5);
    assert!(BrickedVolume::build(boxes([0, 4, 4], vec![]), &out, 1 << 16, &mut |_| ()).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    let nowhere = dir.path().join("no/folder.bricks");
    let error = BrickedVolume::build(boxes(DIMS, vec![]), &nowhere, 1, &mut |_| ()).unwrap_err();
    assert_eq!(error.exit_code(), 1);
}

#[test]
fn damage_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.bricks");
    let dims = [5, 4, 3];
    BrickedVolume::build(boxes(dims, tiles(dims, [5, 4, 1])), &out, 1 << 16, &mut |_| ()).unwrap();
    let good = std::fs::read(&out).unwrap();
    let data = ALIGN as usize..ALIGN as usize + 240;
    for cut in [0, 1, 8, 23, 24, 100, 4095, 4096, good.len() - 40, good.len() - 1] {
        std::fs::write(&out, &good[..cut]).unwrap();
        assert_eq!(BrickedVolume::open(&out).unwrap_err().exit_code(), 5, "cut to {cut}");
    }
    for at in (0..700).chain(4000..good.len()) {
        let mut bad = good.clone();
        bad[at] ^= 0x40;
        std::fs::write(&out, &bad).unwrap();
        match BrickedVolume::open(&out) {
            Err(e) => assert!(e.exit_code() == 5 && !data.contains(&at), "{e}"),
            Ok(v) if data.contains(&at) => assert!(v.verify().unwrap_err().to_string().contains("brick 0")),
            // Bytes that no one reads: the reserved field and the zeros before the bricks.
            Ok(_) => assert!((20..24).contains(&at) || bad[at] == 0x40, "byte {at} is not checked"),
        }
    }
}
