//! Arrays are what they were, up to the step, however they are cut, decoded and damaged.

use isospan_wavelet::{
    Accuracy, Box3, Compressed, Error, HALO, Pyramid, Scratch, Settings, Window, compress,
};
use proptest::prelude::*;

fn noise(i: usize, seed: u32) -> f32 {
    let mut x = (i as u32 ^ seed.wrapping_mul(0x9e37_79b9)).wrapping_mul(0x85eb_ca6b);
    x = (x ^ x >> 13).wrapping_mul(0xc2b2_ae35);
    (x >> 8) as f32 / (1 << 24) as f32 - 0.5
}

/// A smooth field with an edge and some noise.
fn field(dims: [usize; 3], seed: u32) -> Vec<f32> {
    let [nx, ny, nz] = dims;
    let at = |i: usize| [i % nx, i / nx % ny, i / nx / ny].map(|n| n as f32);
    let value = |i: usize| {
        let [x, y, z] = at(i);
        let ball = if x * x + y * y + z * z < 400.0 { 3.0 } else { 0.0 };
        (x * 0.21).sin() + (y * 0.13 + z * 0.17).cos() + ball + 0.1 * noise(i, seed)
    };
    (0..nx * ny * nz).map(value).collect()
}

fn worst(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Compresses, and decodes level 0.
fn there_and_back(samples: &[f32], dims: [usize; 3], step: f64) -> Vec<f32> {
    let bytes = compress(samples, dims, &Settings { accuracy: Accuracy::Step(step), delay: None }).unwrap();
    Compressed::new(&bytes, samples.len()).unwrap().level(0).unwrap()
}

#[test]
fn all_sizes_come_back() {
    for n in 1..=70 {
        for dims in [[n, 9, 5], [3, n, 17], [12, 2, n], [n, n, 1], [1, 1, n]] {
            let samples = field(dims, n as u32);
            let back = there_and_back(&samples, dims, 0.01);
            assert!(worst(&samples, &back) < 0.06, "{dims:?}: {}", worst(&samples, &back));
        }
    }
}

#[test]
fn extreme_samples_come_back() {
    let dims = [20, 17, 11];
    let shape = field(dims, 3);
    for (scale, offset) in
        [(1e-38, 0.0), (1e-42, 0.0), (6e37, 0.0), (1.0, 1e6), (1e-3, -7.0), (f32::MAX / 6.0, 0.0)]
    {
        let samples: Vec<f32> = shape.iter().map(|s| s * scale + offset).collect();
        let back = there_and_back(&samples, dims, f64::from(scale) * 0.01);
        // Near the largest and the least numbers the samples themselves are rounded.
        let bound = scale * 0.06 + offset.abs() * f32::EPSILON + 3e-45;
        assert!(worst(&samples, &back) <= bound, "{scale} {offset}: {}", worst(&samples, &back));
    }
    let constant = vec![-0.3_f32; 20 * 17 * 11];
    assert_eq!(there_and_back(&constant, dims, 0.5), constant);
    let bytes =
        compress(&constant, dims, &Settings { accuracy: Accuracy::Step(0.5), delay: Some([0; 3]) }).unwrap();
    assert!(bytes.len() < 64, "{}", bytes.len());
    let noisy: Vec<f32> = (0..constant.len()).map(|i| noise(i, 9)).collect();
    assert!(worst(&noisy, &there_and_back(&noisy, dims, 1e-4)) < 6e-4);
}

#[test]
fn the_largest_error_falls_with_the_step() {
    let dims = [40, 33, 50];
    let samples = field(dims, 5);
    let errors = [0.2, 0.02, 0.002].map(|step| worst(&samples, &there_and_back(&samples, dims, step)));
    assert!(errors[0] > 3.0 * errors[1] && errors[1] > 3.0 * errors[2], "{errors:?}");
}

fn rms(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    (sum / a.len() as f64).sqrt()
}

#[test]
fn an_error_that_is_asked_for_is_met() {
    let dims = [50, 40, 45];
    let n = dims.iter().product();
    let smooth = field(dims, 7);
    let noisy: Vec<f32> = (0..n).map(|i| noise(i, 4) * 2e20).collect();
    let spike: Vec<f32> = (0..n).map(|i| if i == 12_345 { 1e-9 } else { 0.0 }).collect();
    for (samples, extent) in [(smooth, 7.0), (noisy, 2e20), (spike, 1e-9)] {
        for part in [0.5, 0.02, 0.001] {
            let settings = Settings { accuracy: Accuracy::Rms(part * extent), delay: None };
            let bytes = compress(&samples, dims, &settings).unwrap();
            let error = rms(&samples, &Compressed::new(&bytes, n).unwrap().level(0).unwrap());
            assert!(error <= part * extent, "{part} of {extent}: {error}");
        }
    }
    let settings = Settings { accuracy: Accuracy::Rms(0.02), delay: None };
    let bytes = compress(&field(dims, 7), dims, &settings).unwrap();
    let error = rms(&field(dims, 7), &Compressed::new(&bytes, n).unwrap().level(0).unwrap());
    assert!((0.95 * 0.02..=0.02).contains(&error), "{error}");
}

#[test]
fn no_sample_is_off_by_more_than_a_bound() {
    let dims = [50, 33, 45];
    let n = dims.iter().product();
    let rough: Vec<f32> = (0..n).map(|i| noise(i, 4) * 2e20 + 7e20).collect();
    for (samples, extent) in [(field(dims, 7), 7.0), (rough, 2e20)] {
        for part in [0.3, 0.01, 1e-4, 1e-6] {
            let bound = part * extent;
            let settings = Settings { accuracy: Accuracy::Max(bound), delay: None };
            let bytes = compress(&samples, dims, &settings).unwrap();
            let array = Compressed::new(&bytes, n).unwrap();
            let back = array.level(0).unwrap();
            let off = |a: f32, b: f32| (f64::from(a) - f64::from(b)).abs();
            assert!(samples.iter().zip(&back).all(|(a, b)| off(*a, *b) <= bound), "{part} of {extent}");
            let part = Box3 { start: [20, 7, 30], size: [20, 26, 5] };
            let of_part = array.nodes(0, &part).unwrap();
            assert_eq!(of_part[21], back[(30 * 33 + 8) * 50 + 21]);
        }
    }
    let bound =
        |bound| compress(&field(dims, 7), dims, &Settings { accuracy: Accuracy::Max(bound), delay: None });
    for none in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9] {
        let Err(Error::Bound { least, .. }) = bound(none) else { panic!("{none}") };
        assert!(bound(least).is_ok());
    }
}

#[test]
fn whole_numbers_come_back() {
    let dims = [41, 33, 37];
    let n: usize = dims.iter().product();
    let whole = |scale: f32| field(dims, 3).iter().map(|s| (s * scale).round()).collect::<Vec<f32>>();
    let labels = (0..n).map(|i| (noise(i / 7, 3) * 5.0).round()).collect();
    let huge = (0..n).map(|i| (noise(i, 3) * 3.3e7).round()).collect();
    for samples in [whole(20.0), whole(3000.0), labels, huge, vec![-3.0; n]] {
        let settings = Settings { accuracy: Accuracy::Lossless, delay: None };
        let bytes = compress(&samples, dims, &settings).unwrap();
        assert_eq!(Compressed::new(&bytes, n).unwrap().level(0).unwrap(), samples);
    }
    let lossless = |sample: f32| {
        compress(&[1.0, sample], [2, 1, 1], &Settings { accuracy: Accuracy::Lossless, delay: None })
    };
    assert_eq!(lossless(0.5), Err(Error::NotWhole { index: 1 }));
    assert_eq!(lossless(3e7), Err(Error::NotWhole { index: 1 }));
}

#[test]
fn what_cannot_be_compressed_is_told() {
    let settings = Settings { accuracy: Accuracy::Step(0.1), delay: Some([0; 3]) };
    assert_eq!(compress(&[], [0, 1, 1], &settings), Err(Error::Size { dims: [0, 1, 1], samples: 0 }));
    assert_eq!(compress(&[1.0], [2, 1, 1], &settings), Err(Error::Size { dims: [2, 1, 1], samples: 1 }));
    let dims = [usize::MAX, 2, 1];
    assert_eq!(compress(&[1.0], dims, &settings), Err(Error::Size { dims, samples: 1 }));
    assert_eq!(compress(&[1.0, f32::NAN], [2, 1, 1], &settings), Err(Error::NotFinite { index: 1 }));
    for error in [1e-12, 0.0, -1.0, f64::NAN, f64::INFINITY] {
        let settings = Settings { accuracy: Accuracy::Rms(error), delay: None };
        assert!(matches!(compress(&[1.0, 3.0], [2, 1, 1], &settings), Err(Error::Step { .. })), "{error}");
    }
    for step in [1e-9, 0.0, -1.0, f64::NAN, f64::INFINITY] {
        let settings = Settings { accuracy: Accuracy::Step(step), delay: Some([0; 3]) };
        let Err(Error::Step { least, .. }) = compress(&[1.0, 3.0], [2, 1, 1], &settings) else {
            panic!("{step}")
        };
        assert!(
            compress(&[1.0, 3.0], [2, 1, 1], &Settings { accuracy: Accuracy::Step(least), ..settings })
                .is_ok()
        );
    }
}

#[test]
fn a_step_that_is_too_small_for_coarse_coefficients_is_told() {
    // Sums of many samples outgrow numbers of steps before samples do.
    let samples: Vec<f32> = (0..1 << 18).map(|i| if i < 1 << 17 { -1.0 } else { 1.0 }).collect();
    let dims = [1 << 18, 1, 1];
    let settings = |step| Settings { accuracy: Accuracy::Step(step), delay: None };
    let Err(Error::Step { least, .. }) = compress(&samples, dims, &settings(5e-7)) else { panic!() };
    let bytes = compress(&samples, dims, &settings(least)).unwrap();
    assert!(worst(&samples, &Compressed::new(&bytes, 1 << 18).unwrap().level(0).unwrap()) < 1e-4);
    let settings = Settings { accuracy: Accuracy::Max(3e-7), delay: None };
    let bytes = compress(&samples, dims, &settings).unwrap();
    assert!(worst(&samples, &Compressed::new(&bytes, 1 << 18).unwrap().level(0).unwrap()) <= 3e-7);
}

#[test]
fn coarse_levels_are_near_the_samples() {
    let dims = [65, 66, 49];
    let smooth = |i: usize| {
        let [x, y, z] = [i % 65, i / 65 % 66, i / 65 / 66].map(|n| n as f32);
        (x * 0.11).sin() + (y * 0.09).cos() * (z * 0.1).sin()
    };
    let samples: Vec<f32> = (0..dims.iter().product()).map(smooth).collect();
    let bytes =
        compress(&samples, dims, &Settings { accuracy: Accuracy::Step(1e-4), delay: Some([0, 0, 1]) })
            .unwrap();
    let array = Compressed::new(&bytes, samples.len()).unwrap();
    for level in 0..3 {
        let nodes = array.pyramid().nodes(level);
        let stride = array.pyramid().stride(level);
        assert_eq!(stride, [1 << level, 1 << level, if level == 0 { 1 } else { 1 << (level - 1) }]);
        let values = array.level(level).unwrap();
        let mut most = 0.0_f32;
        for (i, value) in values.iter().enumerate() {
            let [x, y, z] = [i % nodes[0], i / nodes[0] % nodes[1], i / nodes[0] / nodes[1]];
            let sample = samples[(z * stride[2] * 66 + y * stride[1]) * 65 + x * stride[0]];
            most = most.max((value - sample).abs());
        }
        assert!(most < [0.001, 0.02, 0.08][level], "level {level}: {most}");
    }
    assert_eq!(array.level(9), Err(Error::Level { level: 9, coarsest: array.pyramid().coarsest() }));
}

/// Flips bits of each byte, and cuts. The answer is an error or samples; nothing panics, and no
/// more samples are made than are accepted.
#[test]
fn damaged_arrays_end_in_an_error_or_in_samples() {
    let dims = [34, 20, 40];
    let bytes =
        compress(&field(dims, 1), dims, &Settings { accuracy: Accuracy::Step(0.3), delay: Some([0, 1, 0]) })
            .unwrap();
    let most = dims.iter().product();
    let refused = damage(&bytes, most);
    assert!(refused > bytes.len(), "{refused} of {}", 4 * bytes.len());
    assert!(matches!(Compressed::new(&bytes, most - 1), Err(Error::Size { .. })));
    // An exponent that has no negative.
    let mut other = bytes.clone();
    other[40..44].copy_from_slice(&i32::MIN.to_le_bytes());
    assert!(matches!(Compressed::new(&other, most), Err(Error::Damaged(_))));
    // With corrections, and their quantum or none.
    for accuracy in [Accuracy::Max(0.1), Accuracy::Lossless] {
        let samples: Vec<f32> = field([20, 9, 34], 1).iter().map(|s| (s * 3.0).round()).collect();
        let bytes = compress(&samples, [20, 9, 34], &Settings { accuracy, delay: None }).unwrap();
        assert!(damage(&bytes, samples.len()) > bytes.len());
    }
}

/// How many flips, cuts and longer ones are refused; the others give samples.
fn damage(bytes: &[u8], most: usize) -> usize {
    let mut refused = 0;
    let mut ask = |bytes: &[u8]| match Compressed::new(bytes, most).and_then(|a| a.level(0)) {
        Ok(samples) => assert!(samples.iter().all(|s| s.is_finite()) && samples.len() <= most),
        Err(error) => {
            assert!(!error.to_string().is_empty());
            refused += 1;
        }
    };
    for at in 0..bytes.len() {
        for bit in [0, 3, 7] {
            let mut other = bytes.to_vec();
            other[at] ^= 1 << bit;
            ask(&other);
        }
        ask(&bytes[..at]);
    }
    ask(&[bytes, &[7]].concat());
    refused
}

#[test]
fn the_bytes_are_those_they_have_always_been() {
    // As the field above without libm, which is not the same everywhere.
    let dims = [70, 45, 33];
    let samples: Vec<f32> = (0..dims.iter().product::<usize>())
        .map(|i| {
            let [x, y, z] = [i % 70, i / 70 % 45, i / 70 / 45].map(|n| n as f32);
            let bump = |t: f32, width: f32| 1.0 / (1.0 + t * t * width);
            bump(x - 30.0, 0.01) * bump(y - 20.0, 0.02) + bump(z - 9.0, 0.1) + 0.05 * noise(i, 2)
        })
        .collect();
    let hash = |values: &[u8]| {
        values
            .iter()
            .fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3))
    };
    let bytes = compress(&samples, dims, &Settings { accuracy: Accuracy::Step(0.1), delay: Some([0, 0, 1]) })
        .unwrap();
    let back = Compressed::new(&bytes, samples.len()).unwrap().level(0).unwrap();
    let decoded: Vec<u8> = back.iter().flat_map(|s| s.to_le_bytes()).collect();
    assert_eq!(
        (bytes.len(), hash(&bytes), hash(&decoded)),
        (889, 11039519667136476649, 16586936384212254416)
    );
}

fn dims() -> impl Strategy<Value = [usize; 3]> {
    prop::array::uniform3(1_usize..71)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// A box of a level has the bits that the whole level has there.
    #[test]
    fn boxes_are_parts_of_their_levels(
        dims in dims(), delay in prop::array::uniform3(0_u8..3), seed: u32, part in prop::array::uniform6(0.0..1.0_f64), at: usize,
    ) {
        let samples = field(dims, seed);
        let bytes = compress(&samples, dims, &Settings { accuracy: Accuracy::Step(0.05), delay: Some(delay) }).unwrap();
        let array = Compressed::new(&bytes, samples.len()).unwrap();
        let level = at % (array.pyramid().coarsest() + 1);
        let nodes = array.pyramid().nodes(level);
        let start: [usize; 3] = std::array::from_fn(|a| (part[a] * nodes[a] as f64) as usize);
        let size = std::array::from_fn(|a| 1 + (part[3 + a] * (nodes[a] - start[a]) as f64) as usize);
        let wanted = Box3 { start, size }.cut(&Box3::all(nodes));
        let (whole, found) = (array.level(level).unwrap(), array.nodes(level, &wanted).unwrap());
        let inside = |i: usize| {
            let at = [i % nodes[0], i / nodes[0] % nodes[1], i / nodes[0] / nodes[1]];
            (0..3).all(|a| (wanted.start[a]..wanted.end()[a]).contains(&at[a]))
        };
        let there: Vec<u32> = (0..whole.len()).filter(|i| inside(*i)).map(|i| whole[i].to_bits()).collect();
        prop_assert_eq!(there, found.iter().map(|v| v.to_bits()).collect::<Vec<_>>());
    }

    /// The coefficients of a window with a halo are those of the array.
    #[test]
    fn windows_have_the_coefficients_of_the_array(
        dims in prop::array::uniform3(1_usize..120), delay in prop::array::uniform3(0_u8..3), seed: u32, part in prop::array::uniform3(0.0..1.0_f64),
    ) {
        let samples = field(dims, seed);
        let pyramid = Pyramid::new(dims, delay);
        let levels = pyramid.coarsest().min(3);
        let splits = &pyramid.splits()[..levels];
        let mut whole = Window { place: Box3::all(dims), samples: samples.clone() };
        whole.forward(splits, &mut Scratch::default());
        // A tile of the third level, and its halo, which begins at a multiple of 8.
        let core: [usize; 3] = std::array::from_fn(|a| (part[a] * dims[a] as f64) as usize / 32 * 32);
        let place = Box3 { start: core, size: [32; 3] }.widened(HALO);
        let start = place.start.map(|s| s / 8 * 8);
        let place = Box3 { start, size: std::array::from_fn(|a| place.end()[a] - start[a]) }.cut(&Box3::all(dims));
        let mut window = Window { place, samples: vec![] };
        for z in place.start[2]..place.end()[2] {
            for y in place.start[1]..place.end()[1] {
                let at = (z * dims[1] + y) * dims[0] + place.start[0];
                window.samples.extend_from_slice(&samples[at..at + place.size[0]]);
            }
        }
        window.forward(splits, &mut Scratch::default());
        for level in 1..=levels {
            let stride = pyramid.stride(level);
            for band in pyramid.bands(level) {
                let first: [usize; 3] = std::array::from_fn(|a| core[a] / stride[a]);
                let size = std::array::from_fn(|a| 32 / stride[a]);
                let here = Box3 { start: first, size }.cut(&Box3::all(band.size));
                let bits = |w: &Window| w.band(&splits[..level], band.high, &here).iter().map(|c| c.to_bits()).collect::<Vec<_>>();
                prop_assert_eq!(bits(&whole), bits(&window), "level {} {:?}", level, band);
            }
        }
    }
}
