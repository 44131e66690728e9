//! All methods find what a scan of all cells finds.

use super::*;
use isospan::grid::Geometry;
use isospan::surface::check::check;
use proptest::prelude::*;

/// SplitMix64 of a number, as a number from 0 to 1.
fn noise(n: u64) -> f32 {
    let mut z = n.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
}

/// Fields of all sorts: noise, noise of few levels (plateaus), a wave, a constant.
fn field(kind: u8, dims: [usize; 3], seed: u64) -> Vec<f32> {
    let of = |n: usize| {
        let random = noise(seed * 1_000_003 + n as u64);
        let [x, y, z] = coordinates(dims, n).map(|i| i as f32);
        match kind {
            0 => random - 0.5,
            1 => (4.0 * random).floor(),
            2 => (0.7 * x).sin() + (0.9 * y).cos() * (0.6 * z + seed as f32).sin(),
            3 => ((0.4 * x).sin() + (0.5 * y).cos() + (0.3 * z).sin()).round(),
            _ => 7.0,
        }
    };
    (0..dims.iter().product()).map(of).collect()
}

fn brute_force(cells: &Cells<'_>, isovalue: f32) -> Vec<u32> {
    let corner = |id: usize| -> Vec<f32> {
        match *cells {
            Cells::Cubes { dims, samples } => {
                let at = coordinates(dims.map(|d| d - 1), id);
                let of = |c: [usize; 3]| samples[sample_of(dims, std::array::from_fn(|a| at[a] + c[a]))];
                CORNERS.map(of).to_vec()
            }
            Cells::Tets { values, corners } => corners[id].map(|v| values[v as usize]).to_vec(),
        }
    };
    let inside = |id: usize| corner(id).iter().filter(|v| **v >= isovalue).count();
    let all = (0..cells.len()).filter(|&id| (1..corner(id).len()).contains(&inside(id)));
    all.map(|id| id as u32).collect()
}

/// Asks all methods for isovalues one after another, as some remember the one before.
fn agree(cells: &Cells<'_>, isovalues: &[f32]) {
    let mut made = 0;
    for kind in &KINDS {
        let Some(mut method) = (kind.make)(cells).unwrap() else { continue };
        made += 1;
        for &isovalue in isovalues {
            let mut found = vec![];
            method.active(cells, isovalue, &mut found).unwrap();
            found.sort_unstable();
            assert_eq!(found, brute_force(cells, isovalue), "{} at {isovalue}", kind.name);
        }
    }
    assert_eq!(made, if matches!(cells, Cells::Cubes { .. }) { 8 } else { 6 });
}

/// Isovalues in and between samples, up and down, in large and small steps.
fn isovalues(values: &[f32], seed: u64) -> Vec<f32> {
    let pick = |n: u64| values[(noise(seed + n) * (values.len() - 1) as f32) as usize];
    let mut out: Vec<f32> = (0..6).map(pick).collect();
    out.extend([out[0] + 0.01, out[0] - 0.01, out[1] + 0.3, f32::MIN, f32::MAX, out[2]]);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn cubes(kind in 0u8..5, x in 2usize..20, y in 2usize..12, z in 2usize..20, seed in 0u64..1000) {
        let dims = [x, y, z];
        let samples = field(kind, dims, seed);
        agree(&Cells::Cubes { dims, samples: &samples }, &isovalues(&samples, seed));
    }

    #[test]
    fn tetrahedra(kind in 0u8..5, count in 1usize..3000, seed in 0u64..1000) {
        let values = field(kind, [20, 5, 4], seed);
        let corner = |n: u64| (noise(seed + n) * 399.0) as u32;
        let corners: Vec<Tet> = (0..count as u64).map(|t| [0, 1, 2, 3].map(|c| corner(4 * t + c))).collect();
        agree(&Cells::Tets { values: &values, corners: &corners }, &isovalues(&values, seed));
    }
}

#[test]
fn a_real_volume() {
    let Some(shared) = std::env::var_os("ISOSPAN_SHARED_DATA") else {
        eprintln!("ISOSPAN_SHARED_DATA is not set: skipped");
        return;
    };
    let file = std::path::Path::new(&shared).join("volumes/ironprot_u8.vtk");
    let volume::Volume { dims, samples, .. } = volume::Volume::read(&file).unwrap();
    assert_eq!(dims, [68; 3]);
    let cells = Cells::Cubes { dims, samples: &samples };
    agree(&cells, &[60.0, 61.5, 200.0, 1.0, 255.0, 30.0]);
    let both = few_and_many(&cells);
    both.iter().for_each(|&(v, n)| assert_eq!(brute_force(&cells, v).len(), n));
    assert_eq!(compare(&cells, &both, 1).unwrap().len(), KINDS.len());
}

#[test]
fn marching_cubes_makes_closed_surfaces() {
    // All cases, the ambiguous ones too: noise within a frame of low values.
    let dims = [12, 14, 10];
    let mut samples = field(0, dims, 3);
    for (n, v) in samples.iter_mut().enumerate() {
        let at = coordinates(dims, n);
        if (0..3).any(|a| at[a] == 0 || at[a] + 1 == dims[a]) {
            *v = -1.0;
        }
    }
    let report = check(&marching::surface(dims, &samples, &Geometry::default(), 0.1));
    assert!(report.is_closed() && report.misoriented_edges == 0 && report.triangles > 1000, "{report:?}");
    // A ball of larger values: its volume is positive, whichever way the axes go.
    let dims = [24; 3];
    let ball: Vec<f32> = (0..24usize.pow(3))
        .map(|n| 8.0 - coordinates(dims, n).map(|i| (i as f32 - 11.5).powi(2)).iter().sum::<f32>().sqrt())
        .collect();
    for z in [1.0, -1.0] {
        let geometry =
            Geometry { direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, z]], ..Geometry::default() };
        let report = check(&marching::surface(dims, &ball, &geometry, 0.0));
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 512.0;
        assert!(report.is_closed() && (report.volume.unwrap() / exact - 1.0).abs() < 0.01, "{report:?}");
    }
}

#[test]
fn the_median_is_in_the_middle() {
    assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
    assert!(median(vec![]).is_nan());
}
