//! Errors of a chunk's field at some samples, at all steps.
//!
//! Which tetrahedron holds a sample, and with which weights, is the same at all steps. So the
//! values of a vertex at several steps are interleaved.

use super::step_lanes::{Lanes, StepLanes};
use super::step_samples::{Rows, WindowSamples};
use crate::measure::{Compared, ComparedAt, TOGETHER};
use isospan_io::grid::IndexBox;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::raster::{MEMBERS, Members, interpolate};
use isospan_mesh::simd::{Avx2, F64xN, Plain, four, on_avx2_or_plain, on_widest, sorted, with_vectors};

const _: () = assert!(MEMBERS <= TOGETHER);

/// Some samples that are measured, at a step.
pub(in crate::pipeline) struct Measured<'a> {
    /// Which of the steps.
    pub(super) step: usize,
    /// Reduced values are NaN in a tetrahedron with a void corner.
    pub(in crate::pipeline) compared: ComparedAt<'a>,
    pub(super) window: &'a IndexBox,
    /// The place of each in the window.
    pub(super) places: &'a [u32],
}

impl Measured<'_> {
    /// The place of one among the samples of the volume.
    #[inline]
    pub(in crate::pipeline) fn place(&self, n: usize) -> [u64; 3] {
        let (at, [x, y, _]) = (u64::from(self.places[n]), self.window.dims());
        [self.window.lo[0] + at % x, self.window.lo[1] + at / x % y, self.window.lo[2] + at / x / y]
    }

    /// The number of one in a volume of `dims` samples along the axes.
    #[inline]
    pub(super) fn number(&self, n: usize, dims: [u64; 3]) -> u64 {
        let [x, y, z] = self.place(n);
        (z * dims[1] + y) * dims[0] + x
    }
}

/// Some samples at the steps that are interleaved.
pub(super) struct CompareBuffers {
    one: Box<Compared<1>>,
    four: Box<Compared<4>>,
    eight: Box<Compared<8>>,
}

impl Default for CompareBuffers {
    fn default() -> Self {
        Self { one: Compared::new(), four: Compared::new(), eight: Compared::new() }
    }
}

impl CompareBuffers {
    /// Hands on some samples of a window at each step; `originals` are all samples of the window.
    #[inline(always)]
    pub(super) fn compare(
        &mut self,
        members: &Members,
        window: &IndexBox,
        tets: &[Tet],
        steps: &StepLanes<'_>,
        originals: &WindowSamples,
        each: &mut impl FnMut(Measured<'_>),
    ) {
        let places = members.places();
        let count = places.len().min(MEMBERS);
        if count == 0 {
            return;
        }
        for ((steps, lanes), originals) in steps.iter().zip(originals.rows_of_steps()) {
            match (lanes, originals) {
                (Lanes::One(values), Rows::One(originals)) => {
                    compare_one(members, tets, values, originals, &mut self.one);
                }
                (Lanes::Four(values), Rows::Four(originals)) => {
                    compare_four(members, tets, values, originals, &mut self.four);
                }
                (Lanes::Eight(values), Rows::Eight(originals)) => {
                    compare_eight(members, tets, values, originals, &mut self.eight);
                }
                _ => unreachable!("samples lie as the values do"),
            }
            for (lane, step) in steps.enumerate() {
                let compared = match lanes {
                    Lanes::One(_) => self.one.at(lane, count),
                    Lanes::Four(_) => self.four.at(lane, count),
                    Lanes::Eight(_) => self.eight.at(lane, count),
                };
                each(Measured { step, compared, window, places });
            }
        }
    }
}

/// Values and errors of some samples at one step.
#[inline(never)]
fn compare_one(members: &Members, tets: &[Tet], values: &[f32], originals: &[f32], out: &mut Compared<1>) {
    with_vectors(
        #[inline(always)]
        || {
            let mut corners = [[0.0; MEMBERS]; 4];
            let count = members.tets().len().min(MEMBERS);
            for (i, &tet) in members.tets().iter().enumerate().take(count) {
                let tet = tets[tet as usize];
                (0..4).for_each(|k| corners[k][i] = values[tet[k] as usize]);
            }
            let ([wa, wb, wc, wd], [a, b, c, d]) = (members.weights().map(|w| &w[..count]), &corners);
            for i in 0..count {
                let value = interpolate([wa[i], wb[i], wc[i], wd[i]], [a[i], b[i], c[i], d[i]]);
                let void = a[i].is_nan() | b[i].is_nan() | c[i].is_nan() | d[i].is_nan();
                out.reduced[i] = [if void { f32::NAN } else { value }];
            }
            find_errors(members, originals.as_chunks().0, out);
        },
    );
}

/// The same at four steps.
#[inline(never)]
fn compare_four(
    members: &Members,
    tets: &[Tet],
    values: &[[f32; 4]],
    originals: &[[f32; 4]],
    out: &mut Compared<4>,
) {
    on_avx2_or_plain!(Avx2::found(), F64x4, Plain<f64, 4>, |W, token| compare_wide::<W, 4>(
        token, members, tets, values, originals, out
    ));
}

/// The same at eight steps.
#[inline(never)]
fn compare_eight(
    members: &Members,
    tets: &[Tet],
    values: &[[f32; 8]],
    originals: &[[f32; 8]],
    out: &mut Compared<8>,
) {
    on_widest!(F64x8, F64x4, Plain<f64, 8>, |W, token| compare_wide::<W, 8>(
        token, members, tets, values, originals, out
    ));
}

/// As [`interpolate`], and NaN where a corner is, sample by sample, at all steps at a time: the
/// same bits.
#[inline(always)]
fn compare_wide<W: F64xN<N>, const N: usize>(
    token: W::Token,
    members: &Members,
    tets: &[Tet],
    values: &[[f32; N]],
    originals: &[[f32; N]],
    out: &mut Compared<N>,
) {
    let (weights, void) = (members.weights(), W::splat(token, f64::NAN));
    for ((i, &tet), reduced) in members.tets().iter().enumerate().zip(&mut out.reduced) {
        let tet = tets[tet as usize];
        let corners = four(
            #[inline(always)]
            |k| W::from_f32(token, &values[tet[k] as usize]),
        );
        let [a, b, c, d] = sorted(four(
            #[inline(always)]
            |k| corners[k] * W::splat(token, weights[k][i]),
        ));
        let value = a + b + c + d;
        let all = corners[0] + corners[1] + (corners[2] + corners[3]);
        *reduced = W::select(all.is_number(), value, void).to_f32();
    }
    find_errors(members, originals, out);
}

/// Looks up the original values among those of the window, and computes the errors.
#[inline(always)]
fn find_errors<const N: usize>(members: &Members, originals: &[[f32; N]], out: &mut Compared<N>) {
    for (row, &place) in out.originals.iter_mut().zip(members.places()) {
        *row = originals[place as usize];
    }
    out.find_errors(members.places().len());
}
