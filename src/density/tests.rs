use super::*;
use isospan_io::geom::Lattice;
use isospan_io::grid::IndexBox;

/// The curves of a function of the sample, measured block by block.
fn curves(dims: [u64; 3], f: impl Fn([u64; 3]) -> f32) -> ErrorCurves {
    let mut curves = ErrorCurves::new(Lattice::new(dims).unwrap());
    let blocks = BlockErrors::blocks(curves.cells());
    for block in (0..blocks.len()).map(isospan_io::grid::BrickId) {
        let samples = BlockErrors::samples_of(&blocks, block);
        let values = values(&samples, &f);
        curves.add(&BlockErrors::measure(curves.cells(), &samples, &values));
    }
    curves
}

fn values(b: &IndexBox, f: &impl Fn([u64; 3]) -> f32) -> Vec<f32> {
    let (lo, hi) = (b.lo, b.hi);
    let zy = (lo[2]..hi[2]).flat_map(|z| (lo[1]..hi[1]).map(move |y| [y, z]));
    zy.flat_map(|[y, z]| (lo[0]..hi[0]).map(move |x| [x, y, z])).map(f).collect()
}

fn noise([x, y, z]: [u64; 3]) -> f32 {
    let h = ((x * 73_856_093) ^ (y * 19_349_663) ^ (z * 83_492_791)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (h >> 40) as f32 / (1 << 24) as f32
}

/// Points a voxel at a sample, by the level of its cell.
fn density(choice: &Choice, at: [u64; 3]) -> f64 {
    let lattice = choice.levels.cells().lattice;
    let voxels: f64 = lattice.dims.iter().map(|&d| (d - 1) as f64).product();
    let level = choice.levels.at(lattice.of_voxel(at));
    choice.n as f64 / voxels * 2f64.powi(i32::from(level))
}

#[test]
fn the_error_of_a_square_is_that_of_its_chords() {
    // x² between two samples s apart is off by at most s²/4.
    let curves = curves([70, 40, 34], |[x, _, _]| (x * x) as f32);
    let cell = curves.cells().id([8, 8, 8]).0 as usize;
    let samples = 8.0f64;
    for (i, &log) in curves.logs[cell].iter().enumerate() {
        let s = f64::from(2 << i);
        // Samples 16 and 17 of a block: the first is kept up to s = 16.
        let off = |x: f64| {
            let before = (x / s).floor() * s;
            (x - before) * (before + s - x)
        };
        let expected = samples / 2.0 * (off(16.0).powi(2) + off(17.0).powi(2));
        let found = from_log(log);
        assert!((found / expected - 1.0).abs() < 0.1, "s = {s}: {found} {expected}");
    }
}

#[test]
fn linear_fields_have_no_error_and_levels_of_their_own() {
    let curves = curves([40, 37, 35], |[x, y, z]| x as f32 * 2.0 - y as f32 + 0.5 * z as f32);
    assert!(curves.logs.iter().flatten().all(|&l| from_log(l) < 1e-6));
    let choice = Choice::of_count(&curves, 5000).unwrap();
    let total: f64 = (0..40).map(|x| density(&choice, [x, 3, 3])).sum();
    assert!(total > 0.0);
}

#[test]
fn points_go_where_the_field_bends_and_not_where_it_is_noise() {
    // Flat, a smooth bump, noise: side by side along x.
    let field = |p: [u64; 3]| match p[0] {
        0..32 => 0.0,
        32..64 => {
            let d: f32 =
                [48.0, 16.0, 16.0].iter().zip(p).map(|(c, x): (&f32, _)| (c - x as f32).powi(2)).sum();
            10.0 * (-d / 60.0).exp()
        }
        _ => 0.01 * noise(p),
    };
    let curves = curves([96, 33, 33], field);
    for count in [800, 3000, 10_000] {
        let choice = Choice::of_count(&curves, count).unwrap();
        let [flat, bump, noisy] = [[8, 16, 16], [46, 12, 14], [88, 16, 16]].map(|p| density(&choice, p));
        assert!(bump > 7.0 * noisy && bump > 30.0 * flat, "{count}: {flat} {bump} {noisy}");
        let voxels: f64 = 95.0 * 32.0 * 32.0;
        let by_level = choice.levels.voxels_by_level();
        let points: f64 =
            by_level.iter().zip(0..).map(|(&v, l)| v as f64 * choice.n as f64 / voxels * 2f64.powi(l)).sum();
        assert!((points / count as f64 - 1.0).abs() < 0.05, "{points} for {count}");
    }
}

#[test]
fn a_cell_at_the_edge_of_the_data_is_not_coarser_than_the_mean() {
    let hole = |p: [u64; 3]| if p[0] < 17 { f32::NAN } else { noise(p) * p[0] as f32 };
    let curves = curves([48, 33, 33], hole);
    let choice = Choice::of_count(&curves, 4000).unwrap();
    let mean = 4000.0 / (47.0 * 32.0 * 32.0);
    assert!(density(&choice, [16, 10, 10]) > mean / 2.1);
    assert!(density(&choice, [2, 10, 10]) < mean);
}

#[test]
fn blocks_may_come_in_any_number_of_pieces() {
    // The last block of an axis may be a single layer of cells; a far face belongs to the last
    // cell.
    for dims in [[33, 33, 33], [34, 2, 65], [5, 3, 2]] {
        let curves = curves(dims, noise);
        let choice = Choice::of_count(&curves, 20).unwrap();
        assert_eq!(choice.levels.as_slice().len() as u64, curves.cells().len());
    }
}

#[test]
fn equal_errors_are_asked_for_everywhere() {
    // A steep edge in a field that is nearly flat.
    let field = |[x, ..]: [u64; 3]| 1.0 / (1.0 + (-(x as f32 - 40.0)).exp()) + 1e-4 * x as f32;
    let curves = curves([81, 33, 33], field);
    let [coarse, fine] = [0.1, 0.001].map(|bound| Choice::of_bound(&curves, bound, 1 << 20).unwrap());
    for choice in [&coarse, &fine] {
        assert!(density(choice, [39, 16, 16]) > 8.0 * density(choice, [70, 16, 16]));
    }
    assert!(density(&fine, [39, 16, 16]) > 8.0 * density(&coarse, [39, 16, 16]));
    let few = Choice::of_bound(&curves, 1e-6, 500).unwrap();
    assert!(few.points(few.levels.as_slice()) < 520.0, "no more than there may be");
}

#[test]
fn levels_rise_around_errors_alone() {
    let flat = curves([65, 65, 65], |_| 0.0);
    let even = Choice::of_bound(&flat, 1.0, 1 << 20).unwrap();
    let cells = *even.levels.cells();
    let mut worst = vec![0.0f32; even.levels.as_slice().len()];
    assert_eq!(even.raised(&worst, 1.0, 1 << 20).unwrap(), None);
    let [off, far] = [[10, 10, 10], [25, 25, 25]].map(|c| cells.id(c).0 as usize);
    (worst[off], worst[far]) = (16.0, 1.1);
    let raised = even.raised(&worst, 1.0, 1 << 20).unwrap().unwrap();
    let of = |c: &Choice, cell: usize| c.levels.as_slice()[cell];
    assert_eq!([of(&raised, off), of(&raised, far)], [of(&even, off) + 3, of(&even, far) + 1]);
    assert_eq!(of(&raised, cells.id([0, 0, 31]).0 as usize), of(&even, 0));
    // Where points do not suffice for both, the larger error has them; where not for that either,
    // nothing rises.
    let points = |c: &Choice| c.points(c.levels.as_slice());
    let most = (points(&raised) - 1e-3) as u64;
    if let Some(one) = even.raised(&worst, 1.0, most).unwrap() {
        assert!(of(&one, off) > of(&even, off) && points(&one) <= most as f64);
    }
    assert_eq!(even.raised(&worst, 1.0, 1).unwrap(), None);
    // Up to the densest that a place may be.
    let (mut choice, mut rounds) = (raised, 0);
    while let Some(next) = choice.raised(&worst, 1.0, 1 << 30).unwrap() {
        (choice, rounds) = (next, rounds + 1);
    }
    assert!(rounds < 40 && density(&choice, [21, 21, 21]) <= 4096.0);
}
