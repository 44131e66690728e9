use super::*;
use proptest::prelude::*;

/// The bits of a number. Which NaN does not matter: Rust promises neither sign nor payload. The
/// choice is between integers, since a compiler may take any NaN for `f64::NAN`.
fn bits_of_f64(x: f64) -> u64 {
    if x.is_nan() { 0x7ff8 << 48 } else { x.to_bits() }
}

/// [`bits_of_f64`] of fewer bits.
fn bits_of_f32(x: f32) -> u32 {
    if x.is_nan() { 0x7fc0 << 16 } else { x.to_bits() }
}

/// Results of all operations on lanes of `f64`, as bits.
fn of_f64<const N: usize, V: F64xN<N>>(token: V::Token, a: &[f64; N], b: &[f64; N]) -> Vec<Vec<u64>> {
    let (a, b) = (V::load(token, a), V::load(token, b));
    let bits = |v: V| v.to_array().map(bits_of_f64).to_vec();
    let narrow = |v: V| V::from_f32(token, &v.to_f32());
    let mask = a.lt(b);
    vec![
        bits(a + b),
        bits(a - b),
        bits(a * b),
        bits(a / b),
        bits(a.mul_add(b, V::splat(token, 0.1))),
        bits(a.min(b)),
        bits(b.max(a)),
        bits(a.sqrt()),
        bits(a.floor()),
        bits(V::select(mask, a, b)),
        bits(narrow(a)),
        bits(V::from_f32(token, &V::min_f32(token, &a.to_f32(), &b.to_f32()))),
        bits(V::from_f32(token, &V::max_f32(token, &b.to_f32(), &a.to_f32()))),
        vec![V::bitmask(mask).into(), V::bitmask(a.eq(b)).into(), V::bitmask(a.sqrt().is_number()).into()],
    ]
}

/// Results of all operations on lanes of `f32` and as many `u32`.
fn of_f32<V: F32s>(token: V::Token, a: &[f32], b: &[f32], ids: &[u32], some: u32) -> Vec<Vec<u32>> {
    let (a, b, ids) = (V::load(token, a), V::load(token, b), V::U32s::load(token, ids));
    let bits = |v: V| v.to_array().as_ref().iter().map(|&x| bits_of_f32(x)).collect::<Vec<_>>();
    let few = |all: &[u32]| all[..some.count_ones() as usize].to_vec();
    let packed = a.compress(some);
    let same = ids.eq(V::U32s::splat(token, 7));
    vec![
        bits(a + b),
        bits(a - b),
        bits(a * b),
        bits(a / b),
        bits(a.mul_add(b, V::splat(token, 0.1))),
        bits(a.neg_mul_add(b, V::splat(token, 0.1))),
        bits(a.min(b)),
        bits(a.max(b)),
        bits(a.reduce_min()),
        bits(V::select(a.lt(b), a, b)),
        few(&packed.as_ref().iter().map(|&x| bits_of_f32(x)).collect::<Vec<_>>()),
        few(ids.compress(some).as_ref()),
        vec![V::bitmask(a.lt(b)), V::bitmask(a.eq(b)), V::U32s::bitmask(same)],
    ]
}

/// Results of all operations on sixteen lanes.
fn of_sixteen<F: F32x16s>(token: F::Token, rows: &[[u32; 3]; 16], some: u32) -> Vec<Vec<u32>> {
    let [x, y, z] = F::U32s::from_rows(token, |n| rows[n]);
    let (f, g) = (F::from_i32(x >> 7), F::from_i32(y >> 9));
    let one = F::splat(token, 1.0);
    let bits = |f: F| f.to_array().map(bits_of_f32).to_vec();
    let h = (f - g) / (g + one);
    let mask = f.lt(g);
    let packed = x.compress(some)[..some.count_ones() as usize].to_vec();
    vec![
        (x + y).to_array().to_vec(),
        (x - y).to_array().to_vec(),
        (y * z).to_array().to_vec(),
        x.min(y).max(z).to_array().to_vec(),
        ((z << 3) + F::U32s::splat(token, 5)).to_array().to_vec(),
        (x.permute(y) & z).to_array().to_vec(),
        F::U32s::load(token, &x.to_array()).to_array().to_vec(),
        packed,
        bits(f.permute(z)),
        vec![x.reduce_max(), F::U32s::bitmask(x.lt(z)), F::U32s::bitmask(x.eq(z)), F::bitmask(mask)],
        bits(h),
        bits(F::select(mask, f, h) * g),
        bits(f.min_where(mask, h)),
        bits(f.max_where(mask, h)),
        (f * F::splat(token, 0.37)).to_i32().to_array().to_vec(),
    ]
}

#[test]
fn each_place_is_a_bit() {
    let eight = [5, u32::MAX, 0, 5, 7, 1 << 31, u32::MAX, 5];
    for wanted in [0, 1, 5, 7, 1 << 31, u32::MAX] {
        let expected = (0..8).filter(|&i| eight[i] == wanted).map(|i| 1 << i).sum::<u32>();
        assert_eq!(places_among_eight(&eight, wanted), expected, "{wanted}");
    }
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -4.0f64..4.0,
        2 => (-2i8..3).prop_map(f64::from),
        1 => any::<f32>().prop_map(f64::from),
    ]
}

proptest! {
    #[test]
    fn vectors_and_plain_code_have_the_same_bits_in_f64(a in [(); 8].map(|()| number()), b in [(); 8].map(|()| number())) {
        let halves = |x: &[f64; 8]| -> [[f64; 4]; 2] { bytemuck::cast(*x) };
        let plain = of_f64::<8, Plain<f64, 8>>((), &a, &b);
        for (half, (a, b)) in halves(&a).iter().zip(&halves(&b)).enumerate() {
            let four = of_f64::<4, Plain<f64, 4>>((), a, b);
            for (all, four) in plain.iter().zip(&four).take(13) {
                prop_assert_eq!(&all[4 * half..][..4], &four[..]);
            }
            #[cfg(target_arch = "x86_64")]
            if let Some(token) = Avx2::found() {
                prop_assert_eq!(of_f64::<4, F64x4>(token, a, b), four);
            }
        }
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(token) = Avx2::found() {
                prop_assert_eq!(&of_f64::<8, Pair<F64x4>>(token, &a, &b), &plain);
            }
            if let Some(token) = Avx512::found() {
                prop_assert_eq!(&of_f64::<8, F64x8>(token, &a, &b), &plain);
            }
        }
    }

    #[test]
    fn vectors_have_the_same_bits_in_f32(
        a in prop::array::uniform16(-4.0f32..4.0),
        b in prop::array::uniform16(-4.0f32..4.0),
        ids in prop::array::uniform16(5u32..9),
        some: u8,
    ) {
        let every = of_f32::<Vec4x2>((), &a, &b, &ids, some.into());
        let least = a[..8].iter().fold(f32::INFINITY, |a, &b| a.min(b));
        prop_assert_eq!(every[8][0], least.to_bits());
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(token) = Avx2::found() {
                prop_assert_eq!(&of_f32::<F32x8>(token, &a, &b, &ids, some.into()), &every);
            }
            if let Some(token) = Avx512::found() {
                // Twice the same eight.
                let twice = |x: &[f32; 16]| std::array::from_fn::<f32, 16, _>(|n| x[n % 8]);
                let wide = of_f32::<F32x16>(token, &twice(&a), &twice(&b), &ids, some.into());
                for (wide, every) in wide.iter().zip(&every).take(12) {
                    prop_assert_eq!(&wide[..every.len()], &every[..]);
                }
            }
        }
    }

    #[test]
    fn vectors_and_plain_code_have_the_same_bits_in_sixteen_lanes(rows: [[u32; 3]; 16], some: u16) {
        let plain = of_sixteen::<Plain<f32, 16>>((), &rows, some.into());
        let first = rows.map(|[x, y, _]| x.wrapping_add(y));
        prop_assert_eq!(&plain[0][..], &first);
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(token) = Avx512::found() {
                prop_assert_eq!(&of_sixteen::<F32x16>(token, &rows, some.into()), &plain);
            }
            if let Some(token) = Avx2::found() {
                prop_assert_eq!(&of_sixteen::<Pair<F32x8>>(token, &rows, some.into()), &plain);
            }
        }
    }
}
