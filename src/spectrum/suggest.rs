//! Isovalues that are worth a look: those whose isosurface is sharp and large.
//!
//! Where the field passes from one material to another it is steep, so a boundary shows as a
//! maximum of the mean gradient of the isosurface, T(v) / A(v) (Pekar, Wiemker, Hempel 2001, "Fast
//! detection of meaningful isosurfaces for volume data visualization", look for the same with
//! histograms). By itself that finds the smallest, sharpest surfaces, and the total gradient T(v)
//! the largest, noise included; we take the geometric mean of the two, T(v) / √A(v). It is smoothed
//! over 4 % of the range, for noise has no width. Each local maximum that stands out of its
//! surroundings by 3 % of the largest one is reported, the most marked first.
//!
//! On scans with known surfaces: an engine (60, 150) gives 50 and 163; a tooth (600, 1000) 650, 940
//! and 300; a lung (-500, 200) -7, -525 and -1040. A suggestion is a place to begin at, not an
//! answer.

use super::grid::{Family, LevelStep};
use super::{Spectrum, SpectrumKnot};

/// The most suggestions.
const MOST: usize = 5;
/// Half the width of the smoothing kernel, as a share of the range.
const SMOOTHING: f64 = 0.04;
/// The least height over the surroundings, as a share of the highest maximum.
const LEAST_STRENGTH: f64 = 0.03;

/// An isovalue, and how much speaks for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SuggestedIsovalue {
    /// The isovalue: a round number next to a knot of the spectrum.
    pub isovalue: f32,
    /// How far it stands out: 1 is the highest possible.
    pub strength: f64,
}

/// Suggests isovalues, the most marked one first.
pub fn suggest(spectrum: &Spectrum) -> Vec<SuggestedIsovalue> {
    let score = scores(spectrum);
    let highest = score.iter().copied().fold(0.0, f64::max);
    let mut found: Vec<SuggestedIsovalue> = (0..score.len())
        .filter(|&i| is_peak(&score, i))
        .map(|i| SuggestedIsovalue {
            isovalue: round_near(spectrum, i),
            strength: prominence(&score, i) / highest,
        })
        .filter(|s| s.strength >= LEAST_STRENGTH)
        .collect();
    found.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    found.truncate(MOST);
    found
}

/// The roundest number not further from a knot than half the way to the next: a person would rather
/// read 0.05 than 0.0498046875.
fn round_near(spectrum: &Spectrum, i: usize) -> f32 {
    let at = |i: usize| f64::from(spectrum.knots[i].isovalue);
    let way = if i + 1 < spectrum.knots.len() { at(i + 1) - at(i) } else { at(i) - at(i.saturating_sub(1)) };
    // Finer than `f32` is no number round.
    let steps = LevelStep::descending(Family::Decimal).take_while(|s| s.size() > at(i).abs() * 1e-7);
    let mut candidates = steps.map(|s| s.multiple((at(i) / s.size()).round() as i64));
    let near = candidates.find(|&v| (f64::from(v) - at(i)).abs() <= way / 2.0);
    near.unwrap_or(spectrum.knots[i].isovalue)
}

/// T / √A at each knot, both smoothed; NaN-free.
fn scores(spectrum: &Spectrum) -> Vec<f64> {
    let knots = &spectrum.knots;
    let at = |k: &SpectrumKnot| f64::from(k.isovalue);
    let width = SMOOTHING * (f64::from(spectrum.range[1]) - f64::from(spectrum.range[0]));
    // Knots are not evenly spread: each stands for the half-way to its neighbours.
    let share = |i: usize| at(&knots[(i + 1).min(knots.len() - 1)]) - at(&knots[i.saturating_sub(1)]);
    let smoothed = |i: usize, of: fn(&SpectrumKnot) -> f64| {
        let first = knots.partition_point(|k| at(k) <= at(&knots[i]) - width);
        let near = (first..knots.len()).take_while(|&j| at(&knots[j]) < at(&knots[i]) + width);
        near.map(|j| {
            let x = (at(&knots[j]) - at(&knots[i])) / width;
            (1.0 - x * x) * (1.0 - x * x) * share(j) * of(&knots[j])
        })
        .sum::<f64>()
    };
    (0..knots.len())
        .map(|i| {
            let score = smoothed(i, |k| k.gradient) / smoothed(i, |k| k.area).sqrt();
            if score.is_finite() { score } else { 0.0 }
        })
        .collect()
}

/// Higher than the knot before, and than the next one that differs.
fn is_peak(score: &[f64], i: usize) -> bool {
    let next = score[i..].iter().find(|&&s| s != score[i]);
    i > 0 && score[i - 1] < score[i] && next.is_some_and(|&s| s < score[i])
}

/// How far one must go down at least to get higher.
fn prominence(score: &[f64], i: usize) -> f64 {
    let lowest = |way: &mut dyn Iterator<Item = &f64>| {
        way.take_while(|&&s| s <= score[i]).copied().fold(score[i], f64::min)
    };
    let (before, behind) = score.split_at(i);
    score[i] - lowest(&mut before.iter().rev()).max(lowest(&mut behind.iter()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spectrum::{Design, Limits};

    /// Two boundaries at 200 and 700, of which the second is the larger, on a floor of noise.
    fn two_materials() -> Spectrum {
        let design = Design::new([0.0, 1000.0], Limits::of_mesh(250_000));
        let bump = |v: f64, at: f64| 1.0 / (1.0 + ((v - at) / 60.0).powi(4));
        let knots = design.knots.values().into_iter().map(|isovalue| {
            let v = f64::from(isovalue);
            let area = 5.0 + 100.0 * bump(v, 200.0) + 200.0 * bump(v, 700.0);
            let mean = 1.0 + 10.0 * bump(v, 200.0) + 10.0 * bump(v, 700.0);
            SpectrumKnot { isovalue, active_cells: 1, area, volume: 0.0, gradient: mean * area }
        });
        Spectrum {
            range: design.range,
            tetrahedra: 9,
            volume: 1.0,
            knots: knots.collect(),
            levels: design.levels,
        }
    }

    #[test]
    fn boundaries_are_found_and_the_larger_comes_first() {
        let mut s = two_materials();
        let found = suggest(&s);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(
            (f64::from(found[0].isovalue) - 700.0).abs() < 15.0
                && (f64::from(found[1].isovalue) - 200.0).abs() < 15.0
        );
        assert_eq!([found[0].isovalue, found[1].isovalue], [700.0, 200.0], "round, though no knots");
        assert!(found[0].strength > found[1].strength && found[0].strength <= 1.0);
        s.knots.iter_mut().for_each(|k| (k.area, k.gradient) = (0.0, 0.0));
        assert_eq!(suggest(&s), vec![], "nothing to see");
        s.knots.clear();
        assert_eq!(suggest(&s), vec![]);
    }
}
