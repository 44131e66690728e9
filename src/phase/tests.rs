use super::*;
use isospan_io::exec::{CancelToken, Threads};
use proptest::prelude::*;

/// A map of values, of which those at or above 0.5 are above.
fn map_of(values: &[f32], [nx, ny, nz]: [usize; 3], memory: usize) -> PhaseMap {
    let scratch = std::env::temp_dir();
    let mut map = PhaseMap::new([nx, ny, nz], values.iter().any(|v| v.is_nan()), memory, &scratch);
    for z in 0..nz {
        let mut slab = map.slab(1);
        for y in 0..ny {
            let row = &values[(z * ny + y) * nx..][..nx];
            for x in (0..nx).step_by(64) {
                slab.note([x, y, 0], &row[x..nx.min(x + 64)], 0.5);
            }
        }
        map.push(&slab).unwrap();
    }
    map
}

/// The same by a flood from each node.
fn flooded(values: &[f32], dims: [usize; 3], phase: Phase) -> Connected {
    let is_in = |n: usize| match phase {
        Phase::Above => values[n] >= 0.5,
        Phase::Below => values[n] < 0.5,
    };
    let [nx, ny, nz] = dims;
    let steps: i32 = if phase == Phase::Above { 1 } else { 2 };
    let mut seen = vec![false; values.len()];
    let mut out = Connected::default();
    for start in 0..values.len() {
        if seen[start] || !is_in(start) {
            continue;
        }
        let (mut faces, mut stack) = (0u8, vec![start]);
        seen[start] = true;
        while let Some(n) = stack.pop() {
            out.nodes += 1;
            let at = [n % nx, n / nx % ny, n / nx / ny];
            for a in 0..3 {
                faces |= u8::from(at[a] == 0) << (2 * a) | u8::from(at[a] + 1 == dims[a]) << (2 * a + 1);
            }
            for d in 0..27i32 {
                let d = [d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1];
                let to: [i32; 3] = std::array::from_fn(|a| at[a] as i32 + d[a]);
                let is_near = (1..=steps).contains(&d.iter().map(|d| d.abs()).sum());
                if !is_near || (0..3).any(|a| to[a] < 0 || to[a] >= dims[a] as i32) {
                    continue;
                }
                let [x, y, z] = to.map(|t| t as usize);
                let m = (z * ny + y) * nx + x;
                if is_in(m) && !seen[m] {
                    seen[m] = true;
                    stack.push(m);
                }
            }
        }
        out.pieces += 1;
        (0..3).for_each(|a| out.percolates[a] |= faces >> (2 * a) & 3 == 3);
    }
    let _ = nz;
    out
}

/// The largest ball by looking at all pairs of nodes.
fn by_all_pairs(values: &[f32], dims: [usize; 3], phase: Phase, axes: &[Vec<f64>; 3]) -> Option<Ball> {
    let [nx, ny, _] = dims;
    let node = |n: usize| [n % nx, n / nx % ny, n / nx / ny];
    let place = |n: usize| [0, 1, 2].map(|a| axes[a][node(n)[a]]);
    let is_in = |n: usize| if phase == Phase::Above { values[n] >= 0.5 } else { values[n] < 0.5 };
    let mut best: Option<(f64, usize)> = None;
    for n in (0..values.len()).filter(|&n| is_in(n)) {
        let (p, mut least) = (place(n), f64::INFINITY);
        for m in (0..values.len()).filter(|&m| !is_in(m)) {
            let q = place(m);
            least = least.min((0..3).map(|a| (p[a] - q[a]).powi(2)).sum());
        }
        for a in 0..3 {
            let last = axes[a][dims[a] - 1];
            least = least.min(p[a].min(last - p[a]).powi(2));
        }
        if least > best.map_or(0.0, |b| b.0) {
            best = Some((least, n));
        }
    }
    best.map(|(squared, n)| Ball { node: node(n), distance: squared.sqrt() })
}

fn odd_grid() -> impl Strategy<Value = (Vec<f32>, [usize; 3])> {
    let dims = [1..80usize, 1..7, 1..7];
    dims.prop_flat_map(|dims| {
        let values = prop::sample::select(vec![0.0f32, 1.0, 1.0, f32::NAN]);
        (prop::collection::vec(values, dims.iter().product::<usize>()), Just(dims))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn pieces_are_those_of_a_flood((values, dims) in odd_grid()) {
        for memory in [0, 1 << 20] {
            let map = map_of(&values, dims, memory);
            for phase in [Phase::Above, Phase::Below] {
                let found = connected(&map, phase, &CancelToken::new()).unwrap();
                prop_assert_eq!(found, flooded(&values, dims, phase), "{:?}", phase);
            }
        }
    }

    #[test]
    fn the_largest_ball_is_that_of_all_pairs((mut values, dims) in odd_grid(), seed in 0u64..1000) {
        // Few nodes in the other phase, so that balls are large.
        for (n, v) in values.iter_mut().enumerate() {
            if (n as u64).wrapping_mul(0x9e37_79b9).wrapping_add(seed) % 23 != 0 {
                *v = 1.0;
            }
        }
        let axes = [0, 1, 2].map(|a| {
            let step = [0.5, 1.25, 2.0][a];
            (0..dims[a]).map(|n| n as f64 * step + (n * n) as f64 * 0.125).collect::<Vec<f64>>()
        });
        let scratch = std::env::temp_dir();
        for (memory, threads) in [(0, 1), (1 << 20, 3)] {
            let threads = Threads::new(threads).unwrap();
            let cancel = CancelToken::new();
            let means = BallMeans { memory, scratch: &scratch, threads: &threads, cancel: &cancel };
            let map = map_of(&values, dims, memory);
            for phase in [Phase::Above, Phase::Below] {
                let found = largest_ball(&map, phase, &axes, &means).unwrap();
                let expected = by_all_pairs(&values, dims, phase, &axes);
                prop_assert_eq!(found.map(|b| b.node), expected.map(|b| b.node), "{:?}", phase);
                let [found, expected] = [found, expected].map(|b| b.map_or(0.0, |b| b.distance));
                prop_assert!((found - expected).abs() <= 1e-12 * expected);
            }
        }
    }
}
