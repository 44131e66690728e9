use super::*;
use isospan_io::grid::IndexBox;

/// Numbers that look random and are the same everywhere (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: u32) -> u32 {
        (self.next() % u64::from(n)) as u32
    }

    fn position(&mut self, lattice: &Lattice) -> LatticePos {
        lattice.max().map(|m| self.below(m + 1))
    }
}

/// A volume in memory.
struct Volume {
    lattice: Lattice,
    values: Vec<f32>,
}

impl Volume {
    fn new(dims: [u64; 3], f: impl Fn([f64; 3]) -> f64) -> Self {
        let mut values = vec![];
        for z in 0..dims[2] {
            for y in 0..dims[1] {
                for x in 0..dims[0] {
                    values.push(f([x as f64, y as f64, z as f64]) as f32);
                }
            }
        }
        Self { lattice: Lattice::new(dims).unwrap(), values }
    }

    fn noise(dims: [u64; 3]) -> Self {
        let mut v = Self::new(dims, |_| 0.0);
        let mut random = Random(dims[0]);
        v.values.iter_mut().for_each(|x| *x = random.below(2000) as f32 - 1000.0);
        v
    }

    fn block(&self) -> VoxelBlock<'_> {
        VoxelBlock { voxels: IndexBox::whole(self.lattice.dims), values: &self.values }
    }

    fn at(&self, ijk: [u64; 3]) -> f32 {
        self.values[self.block().voxels.offset(ijk)]
    }

    fn set(&mut self, ijk: [u64; 3], value: f32) {
        let at = self.block().voxels.offset(ijk);
        self.values[at] = value;
    }

    fn sample(&self, how: Interpolation, positions: &[LatticePos]) -> Vec<f32> {
        let mut out = vec![];
        sample(how, &self.lattice, &self.block(), positions, &mut out);
        out
    }

    fn cut(&self, voxels: IndexBox) -> Vec<f32> {
        let mut values = vec![];
        for z in voxels.lo[2]..voxels.hi[2] {
            for y in voxels.lo[1]..voxels.hi[1] {
                for x in voxels.lo[0]..voxels.hi[0] {
                    values.push(self.at([x, y, z]));
                }
            }
        }
        values
    }
}

const SMOOTH: [Interpolation; 3] = [Interpolation::Linear, Interpolation::Cubic, Interpolation::CubicThesis];

fn of_volumes() -> impl Iterator<Item = Interpolation> {
    Interpolation::ALL.into_iter().filter(|how| how.is_of_volumes())
}

#[test]
fn names_are_the_same_in_text_and_json() {
    for how in of_volumes() {
        assert_eq!(how.to_string().parse::<Interpolation>().unwrap(), how);
        assert_eq!(serde_json::to_string(&how).unwrap(), format!("\"{how}\""));
    }
    let message = "quintic".parse::<Interpolation>().unwrap_err().to_string();
    assert!(
        message.contains("quintic") && message.contains("linear, cubic, cubic-thesis, nearest"),
        "{message}"
    );
}

#[test]
fn a_linear_field_is_exact_up_to_the_faces() {
    // Coefficients and positions on a grid of 2^-10 have exact values of 24 bits: the f32 must be
    // equal, not near.
    let f = |p: [f64; 3]| 2.0 * p[0] - 3.0 * p[1] + 0.5 * p[2] + 7.0;
    for dims in [[9, 6, 13], [2, 3, 4], [5, 2, 2]] {
        let v = Volume::new(dims, f);
        let mut random = Random(1);
        let coarse = v.lattice.log2_steps[0] - 10;
        let max = v.lattice.max();
        let positions: Vec<_> =
            (0..4000).map(|_| max.map(|m| random.below((m >> coarse) + 1) << coarse)).collect();
        for how in SMOOTH {
            for (value, p) in v.sample(how, &positions).iter().zip(&positions) {
                assert_eq!(f64::from(*value), f(v.lattice.to_index_space(*p)), "{how} {dims:?} {p:?}");
            }
        }
    }
}

#[test]
fn a_cubic_polynomial_is_exact_to_rounding_by_cubic_at_the_border_too() {
    // Of degree three in each variable, as a tensor product allows.
    let g = |x: f64| 1.0 + x * (0.5 - x * (0.75 - 0.125 * x));
    let f = |p: [f64; 3]| g(p[0] - 4.0) * g(p[1] - 3.0) * g(2.0 - p[2]);
    let v = Volume::new([8, 7, 4], f);
    let mut random = Random(2);
    let positions: Vec<_> = (0..20_000).map(|_| random.position(&v.lattice)).collect();
    let largest = v.values.iter().fold(0.0f32, |m, x| m.max(x.abs()));
    let error = |how| {
        let values = v.sample(how, &positions);
        let pairs = values.iter().zip(&positions);
        pairs.map(|(&s, &p)| (f64::from(s) - f(v.lattice.to_index_space(p))).abs()).fold(0.0, f64::max)
    };
    let rounding = f64::from(largest) * 8.0 * f64::from(f32::EPSILON);
    assert!(error(Interpolation::Cubic) < rounding, "{} {rounding}", error(Interpolation::Cubic));
    assert!(error(Interpolation::Linear) > 1e3 * rounding);
}

#[test]
fn with_three_voxels_cubic_is_exact_for_quadratics() {
    let f = |p: [f64; 3]| p[0] * p[0] - 3.0 * p[1] * p[1] + p[0] * p[2] * p[2] + 1.0;
    let v = Volume::new([3, 3, 3], f);
    let mut random = Random(3);
    let positions: Vec<_> = (0..2000).map(|_| random.position(&v.lattice)).collect();
    for (&value, &p) in v.sample(Interpolation::Cubic, &positions).iter().zip(&positions) {
        assert!((f64::from(value) - f(v.lattice.to_index_space(p))).abs() < 1e-5, "{p:?}");
    }
}

/// Largest error on the waves sin(x)·cos(y)·sin(z + 1) over a box of n cells an axis, as fine as
/// the waves are long.
fn error_at(n: u64, how: Interpolation) -> f64 {
    let scale = 3.0 / n as f64;
    let f = |p: [f64; 3]| (scale * p[0]).sin() * (scale * p[1]).cos() * (scale * p[2] + 1.0).sin();
    let v = Volume::new([n + 1; 3], f);
    let mut random = Random(4);
    let positions: Vec<_> = (0..4000).map(|_| random.position(&v.lattice)).collect();
    let values = v.sample(how, &positions);
    let pairs = values.iter().zip(&positions);
    pairs.map(|(&s, &p)| (f64::from(s) - f(v.lattice.to_index_space(p))).abs()).fold(0.0, f64::max)
}

#[test]
fn convergence_is_second_order_for_linear_and_fourth_for_cubic() {
    let order = |how, n| (error_at(n, how) / error_at(2 * n, how)).log2();
    for (how, expected, n) in [
        (Interpolation::Nearest, 1.0, 16),
        (Interpolation::Linear, 2.0, 16),
        (Interpolation::Cubic, 4.0, 8),
        // What is printed as a second derivative is none: no better than linear.
        (Interpolation::CubicThesis, 2.0, 16),
    ] {
        let measured = order(how, n);
        assert!((measured - expected).abs() < 0.35, "{how}: order {measured}");
    }
    let (linear, thesis) = (error_at(16, Interpolation::Linear), error_at(16, Interpolation::CubicThesis));
    assert!((thesis / linear - 1.0).abs() < 0.02, "{thesis} {linear}");
}

#[test]
fn cubic_is_the_printed_formula_with_a_true_second_derivative() {
    // One dimension, written out as in the thesis, against the gathered weights.
    let y = [3.0, -1.0, 4.0, 1.0, -5.0, 9.0, 2.0, -6.0];
    let v = Volume::new([8, 2, 2], |p| y[p[0] as usize]);
    let second = |i: usize| y[i + 1] - 2.0 * y[i] + y[i - 1];
    let fourth = |i: usize| (y[i + 2] - 4.0 * y[i + 1] + 6.0 * y[i] - 4.0 * y[i - 1] + y[i - 2]) / 4.0;
    let spline = |i: usize, b: f64, yy: [f64; 2]| {
        let a = 1.0 - b;
        let (c, d) = ((a * a * a - a) / 6.0, (b * b * b - b) / 6.0);
        a * y[i] + b * y[i + 1] + c * yy[0] + d * yy[1]
    };
    let mut random = Random(5);
    for _ in 0..500 {
        let p = random.position(&v.lattice);
        let x = v.lattice.to_index_space(p)[0];
        let (i, b) = ((x as usize).min(6), x - (x as usize).min(6) as f64);
        let yy = match i {
            0 => [2.0 * second(1) - second(2), second(1)],
            6 => [second(6), 2.0 * second(6) - second(5)],
            _ => [second(i), second(i + 1)],
        };
        let y4 = [fourth(i.clamp(2, 5)), fourth((i + 1).clamp(2, 5))];
        let close = |how, expected: f64| {
            let got = f64::from(v.sample(how, &[p])[0]);
            assert!((got - expected).abs() < 2e-6, "{how} at {x}: {got} {expected}");
        };
        close(Interpolation::Cubic, spline(i, b, yy));
        close(Interpolation::CubicThesis, spline(i, b, y4));
    }
}

#[test]
fn a_voxel_is_returned_exactly_whatever_surrounds_it() {
    for dims in [[7, 6, 5], [2, 2, 2], [3, 4, 5]] {
        let clean = Volume::noise(dims);
        let mut poisoned = Volume::noise(dims);
        poisoned.values.fill(f32::NAN);
        for z in 0..dims[2] {
            for y in 0..dims[1] {
                for x in 0..dims[0] {
                    let p = clean.lattice.of_voxel([x, y, z]);
                    poisoned.set([x, y, z], clean.at([x, y, z]));
                    for how in of_volumes() {
                        assert_eq!(clean.sample(how, &[p]), [clean.at([x, y, z])], "{how} {x} {y} {z}");
                        assert_eq!(poisoned.sample(how, &[p]), [clean.at([x, y, z])], "{how} {x} {y} {z}");
                    }
                    poisoned.set([x, y, z], f32::NAN);
                    for how in of_volumes() {
                        assert!(poisoned.sample(how, &[p])[0].is_nan());
                    }
                }
            }
        }
    }
}

#[test]
fn a_missing_voxel_voids_the_points_it_has_a_weight_in_and_no_others() {
    let clean = Volume::noise([9, 8, 7]);
    let mut holed = Volume::noise([9, 8, 7]);
    let hole = [4, 3, 3];
    holed.set(hole, f32::NAN);
    let s = clean.lattice.log2_steps[0];
    let mut random = Random(6);
    for round in 0..6000 {
        let mut p = random.position(&clean.lattice);
        // Every other point on a voxel plane, axis by axis, where weights are zero.
        if round % 2 == 0 {
            let a = round / 2 % 3;
            p[a] = p[a] >> s << s;
        }
        let near = |reach: f64| {
            let x = clean.lattice.to_index_space(p);
            (0..3).all(|a| {
                let d = (x[a] - hole[a] as f64).abs();
                // On a voxel plane only that plane's voxels count.
                if x[a].fract() == 0.0 { d == 0.0 } else { d < reach }
            })
        };
        let void = |how| holed.sample(how, &[p])[0].is_nan();
        assert_eq!(void(Interpolation::Linear), near(1.0), "{p:?}");
        // Cells 1 to n-3 of an axis use two voxels each way; at the border the stencil is moved, so
        // test inside only.
        let inside = (0..3).all(|a| (1..clean.lattice.dims[a] as u32 - 2).contains(&(p[a] >> s)));
        if inside {
            assert_eq!(void(Interpolation::Cubic), near(2.0), "{p:?}");
        }
        for how in of_volumes() {
            if !void(how) {
                assert_eq!(holed.sample(how, &[p]), clean.sample(how, &[p]), "{how} {p:?}");
            }
        }
    }
}

#[test]
fn linear_stays_within_its_corners_and_cubic_stays_finite() {
    let mut v = Volume::noise([6, 6, 6]);
    for (i, x) in v.values.iter_mut().enumerate() {
        *x = [f32::MAX, f32::MIN, 1e-45, 1.0e30, 3.3333, -1e-20, 16_777_215.0][i * 5 % 7];
    }
    let mut random = Random(7);
    for _ in 0..20_000 {
        let p = random.position(&v.lattice);
        let cell = p.map(|x| u64::from(x >> v.lattice.log2_steps[0]).min(4));
        let corners = v.cut(IndexBox { lo: cell, hi: cell.map(|c| c + 2) });
        let (lo, hi) = corners.iter().fold((f32::MAX, f32::MIN), |(l, h), &c| (l.min(c), h.max(c)));
        let s = v.sample(Interpolation::Linear, &[p])[0];
        assert!(lo <= s && s <= hi, "{s} not in {lo}..{hi}");
        assert!(v.sample(Interpolation::Cubic, &[p])[0].is_finite());
    }
}

#[test]
fn the_smallest_block_gives_the_same_bits_as_the_whole_volume() {
    for dims in [[9, 8, 11], [2, 3, 4], [5, 6, 2]] {
        let v = Volume::noise(dims);
        let mut random = Random(8);
        let mut positions: Vec<_> = (0..600).map(|_| random.position(&v.lattice)).collect();
        positions.extend([[0; 3], v.lattice.max(), [0, v.lattice.max()[1], 0]]);
        positions.sort_by_key(|p| (p[2], p[1], p[0]));
        for how in of_volumes() {
            let whole = v.sample(how, &positions);
            assert_eq!(how.voxels_for(&v.lattice, &positions), {
                let all = how.voxels_for(&v.lattice, &[[0; 3], v.lattice.max()]);
                assert_eq!(all, IndexBox::whole(dims));
                all
            });
            for size in [1, 7, 100] {
                let mut parts = vec![];
                for some in positions.chunks(size) {
                    let voxels = how.voxels_for(&v.lattice, some);
                    let values = v.cut(voxels);
                    sample(how, &v.lattice, &VoxelBlock { voxels, values: &values }, some, &mut parts);
                }
                assert!(whole.iter().zip(&parts).all(|(a, b)| a.to_bits() == b.to_bits()), "{how} {dims:?}");
            }
        }
    }
}

#[test]
fn nearest_takes_the_higher_voxel_half_way() {
    let v = Volume::noise([5, 4, 3]);
    let (s, half) = (v.lattice.log2_steps[0], 1 << (v.lattice.log2_steps[0] - 1));
    let at = |p| v.sample(Interpolation::Nearest, &[p])[0];
    assert_eq!(at([(1 << s) + half, 0, 0]), v.at([2, 0, 0]));
    assert_eq!(at([(1 << s) + half - 1, half, 0]), v.at([1, 1, 0]));
    assert_eq!(at(v.lattice.max()), v.at([4, 3, 2]));
}

#[test]
fn the_longest_axis_has_one_step_a_voxel() {
    let lattice = Lattice::new([(1 << 24) + 1, 2, 2]).unwrap();
    assert_eq!(lattice.log2_steps, [0; 3]);
    let end = lattice.max();
    for how in of_volumes() {
        let voxels = how.voxels_for(&lattice, &[end]);
        let values: Vec<f32> = (0..voxels.len()).map(|i| i as f32).collect();
        let mut out = vec![];
        sample(how, &lattice, &VoxelBlock { voxels, values: &values }, &[end], &mut out);
        assert_eq!(out, values[values.len() - 1..], "{how}");
    }
}

#[test]
fn no_positions_need_no_voxels() {
    let v = Volume::noise([3, 3, 3]);
    for how in of_volumes() {
        assert!(how.voxels_for(&v.lattice, &[]).is_empty());
        assert_eq!(v.sample(how, &[]), [0.0; 0]);
    }
}

#[test]
#[should_panic(expected = "lacks voxels")]
fn a_block_without_the_voxels_is_refused() {
    let v = Volume::noise([5, 5, 5]);
    let voxels = IndexBox { lo: [0; 3], hi: [3; 3] };
    let values = v.cut(voxels);
    sample(
        Interpolation::Linear,
        &v.lattice,
        &VoxelBlock { voxels, values: &values },
        &[v.lattice.max()],
        &mut vec![],
    );
}
