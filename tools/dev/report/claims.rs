//! The thesis's claims (sections 3.5 and 4.7, chapter 5, and what the text says of its figures),
//! each with what our figures say.
//!
//! A claim holds, holds in part, or fails by a rule that is written next to it; the words are put
//! together from the figures.

use crate::curves::{Curves, Size, Way};
use crate::data::Dataset;
use crate::document::{Block, Cell, Document, Table, short};
use crate::figures::time_chart;
use crate::runs::{How, Lab, Outcome, Points, Times, is_grid};
use crate::tables::{PARTS, STRUCTURED, subsampled};
use isospan::Result;
use isospan::sample::Values;

/// What the figures say of a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Holds,
    Partly,
    Fails,
    /// No experiment of this run decides it.
    Open,
}

impl Verdict {
    fn name(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::Partly => "holds in part",
            Self::Fails => "does not hold",
            Self::Open => "is not decided by this run",
        }
    }

    /// By the share of cases in which a claim is right.
    fn of_share(right: usize, all: usize) -> Self {
        if all == 0 {
            return Self::Open;
        }
        match right as f64 / all as f64 {
            0.8.. => Self::Holds,
            0.4.. => Self::Partly,
            _ => Self::Fails,
        }
    }
}

/// A claim and its verdict.
struct Claim {
    section: &'static str,
    claim: &'static str,
    rule: String,
    verdict: Verdict,
    figures: String,
}

/// A case of which a claim is right or wrong, and its figures.
type Case = (String, bool, String);

fn by_cases(section: &'static str, claim: &'static str, rule: &str, cases: Vec<Case>) -> Claim {
    let right = cases.iter().filter(|c| c.1).count();
    let verdict = Verdict::of_share(right, cases.len());
    let words: Vec<String> = cases
        .iter()
        .map(|(name, right, figures)| format!("{name} {figures}{}", if *right { "" } else { " (no)" }))
        .collect();
    let figures = match cases.len() {
        0 => "no case was tried".to_owned(),
        all => format!("{right} of {all} cases: {}", words.join("; ")),
    };
    Claim { section, claim, rule: rule.into(), verdict, figures }
}

const QMC: [Points; 3] = [Points::Hammersley, Points::Halton, Points::Hyperbolic];

fn times(lab: &mut Lab, dataset: Dataset, part: u64, how: How) -> Result<Option<Times>> {
    lab.times_of_part(dataset, Points::Hammersley, part, how)
}

fn hammersley(lab: &mut Lab, dataset: Dataset, part: u64, how: How) -> Result<Option<Outcome>> {
    lab.part(dataset, Points::Hammersley, part, how)
}

/// The page of conclusions.
pub(crate) fn conclusions(lab: &mut Lab, curves: &Curves) -> Result<Document> {
    let all: [fn(&mut Lab) -> Result<Claim>; 14] = [
        higher_is_no_better,
        higher_pays_at_large_ratios,
        shape_is_kept,
        sets_differ_little,
        better_than_regular,
        smoother_than_the_original,
        advantage_grows_with_size,
        meshing_takes_most,
        extraction_is_fast,
        speedup_is_linear,
        boundaries_are_distorted,
        cross_subsampled_is_better,
        cubic_costs_a_little_more,
        searching_takes_longer_than_extracting,
    ];
    let mut table = Table {
        number: "C".into(),
        title: "The thesis's claims".into(),
        columns: ["Section", "Verdict"].map(String::from).to_vec(),
        note: "Holds: in 4 of 5 cases or more; in part: in 2 of 5 or more.".into(),
        ..Table::default()
    };
    let mut body = Document::default();
    let claims: Vec<Claim> = all.into_iter().map(|make| make(lab)).collect::<Result<_>>()?;
    for claim in claims.into_iter().chain(beyond(curves)) {
        let row = vec![Cell::Text(claim.section.into()), Cell::Text(claim.verdict.name().into())];
        table.rows.push((claim.claim.into(), row));
        body.heading(2, &format!("{} ({})", claim.claim, claim.section));
        body.text(format!("It {}. Rule: {}.", claim.verdict.name(), claim.rule));
        body.text(format!("{}.", claim.figures));
    }
    let mut document = Document { title: "Conclusions of the thesis, measured".into(), blocks: vec![] };
    document.text(
        "Each claim of the thesis's sections 3.5 and 4.7 and of its chapter 5, and what its text says of single figures, against the figures of \
         this run; at the end four that it does not make. All numbers are those of the tables beside this page; the verdicts follow from them by the rules given.",
    );
    document.push(Block::Table(table));
    document.blocks.extend(body.blocks);
    Ok(document)
}

/// Claims that the thesis does not make: of fitted values, of points where they are needed, and
/// against every k-th voxel.
fn beyond(curves: &Curves) -> [Claim; 4] {
    let set = |values| Way::Set(Points::Hammersley, values);
    let cases = |way, against, size| -> Vec<Case> {
        let ratios = curves.ratios(way, against, size).into_iter();
        ratios.map(|(name, ratio)| (name, ratio < 1.0, format!("{}×", short(ratio)))).collect()
    };
    let (sampled, fitted) = (set(Values::Sample), set(Values::Fit));
    let rule = "each of three errors (field, distance of the surface, normals) of Hammersley points is less than that of the other, at the latter's";
    [
        by_cases(
            "ours",
            "Fitted values bring field and surface closer to the original than sampled ones",
            "each of three errors (field, distance of the surface, normals) is less with fitted values at the same Hammersley points",
            cases(fitted, sampled, Size::Points),
        ),
        by_cases(
            "ours",
            "Halton points that are dense where the field needs them are closer to the original than even ones",
            "each of three errors (field, distance of the surface, normals) is less at the same number of points, values sampled",
            cases(Way::Adapted(Values::Sample), Way::Set(Points::Halton, Values::Sample), Size::Points),
        ),
        by_cases(
            "ours",
            "Fitted Hammersley points are closer to the original than every k-th voxel of a volume, point for point",
            &format!("{rule} number of points"),
            cases(fitted, Way::Voxels, Size::Points),
        ),
        by_cases(
            "ours",
            "The same, byte for byte",
            &format!("{rule} bytes"),
            cases(fitted, Way::Voxels, Size::Bytes),
        ),
    ]
}

/// How much less the error is with the higher interpolation: 0.1 is a tenth less.
fn gain(
    lab: &mut Lab,
    dataset: Dataset,
    part: u64,
    how: How,
    of: fn(&Outcome) -> f64,
) -> Result<Option<f64>> {
    let linear = hammersley(lab, dataset, part, How::Linear)?;
    let higher = hammersley(lab, dataset, part, how)?;
    Ok(linear.zip(higher).map(|(l, h)| 1.0 - of(&h) / of(&l)))
}

fn higher_is_no_better(lab: &mut Lab) -> Result<Claim> {
    let (mut cases, mut printed) = (vec![], 0f64);
    for dataset in lab.datasets().collect::<Vec<_>>() {
        for part in PARTS {
            for (name, of) in [
                ("field", (|o: &Outcome| o.field_error()) as fn(&Outcome) -> f64),
                ("surface", |o| o.distances.rms),
            ] {
                if let Some(gain) = gain(lab, dataset, part, How::Higher, of)? {
                    let words = format!("{:+.1} %", -100.0 * gain);
                    cases.push((format!("{} 1/{part} {name}", dataset.name()), gain.abs() < 0.1, words));
                }
                let gain = gain(lab, dataset, part, How::HigherThesis, of)?;
                printed = printed.max(gain.map_or(0.0, f64::abs));
            }
        }
    }
    let mut claim = by_cases(
        "3.5, 4.7, 5",
        "Linear interpolation is accurate enough; higher order does not yield much improvement",
        "the error with cubic or quadratic values differs by less than a tenth from that with linear ones: of the field (RMS; in meshes, near whose dipole \
         single cells outweigh all others, the 95th percentile) and of the surface (RMS distance)",
        cases,
    );
    claim.figures += &format!(
        ". With the formulas as the thesis prints them, which are not of higher order, the largest difference is {} %",
        short(100.0 * printed)
    );
    Ok(claim)
}

fn higher_pays_at_large_ratios(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        let few = gain(lab, dataset, 16, How::Higher, Outcome::field_error)?;
        let many = gain(lab, dataset, 2, How::Higher, Outcome::field_error)?;
        if let Some((few, many)) = few.zip(many) {
            let words = format!("{:+.1} % at 1/2, {:+.1} % at 1/16", -100.0 * many, -100.0 * few);
            cases.push((dataset.name().into(), few > many + 0.005, words));
        }
    }
    Ok(by_cases(
        "3.5, 4.7, 5",
        "Higher order might be better for large compression ratios",
        "the error of the field falls by more at 1/16 than at 1/2",
        cases,
    ))
}

fn shape_is_kept(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        for points in QMC {
            if let Some(o) = lab.part(dataset, points, 8, How::Linear)? {
                let words = format!("{} % of the diagonal", short(100.0 * o.distances.rms));
                cases.push((format!("{} {}", dataset.name(), points.name()), o.distances.rms < 0.01, words));
            }
        }
    }
    Ok(by_cases(
        "3.5, 4.7, 5",
        "The QMC points generate a surface that represents the global shape of the original",
        "at 1/8, the RMS distance of the surfaces is below 1 % of the diagonal",
        cases,
    ))
}

fn sets_differ_little(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        for part in PARTS {
            let mut errors = vec![];
            for points in QMC {
                errors.extend(lab.part(dataset, points, part, How::Linear)?.map(|o| o.distances.rms));
            }
            let (least, most) = errors.iter().fold((f64::INFINITY, 0f64), |(a, b), &e| (a.min(e), b.max(e)));
            if !errors.is_empty() {
                let words = format!("factor {}", short(most / least));
                cases.push((format!("{} 1/{part}", dataset.name()), most / least < 1.5, words));
            }
        }
    }
    Ok(by_cases(
        "3.5, 4.7, 5",
        "The differences among different QMC points are not prominent and depend on the data sets",
        "the RMS distances of the surfaces of Hammersley, Halton and hyperbolic cross points are within a factor of 1.5",
        cases,
    ))
}

fn better_than_regular(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        for part in [2, 4, 8, 16] {
            let regular = lab.part(dataset, Points::Regular, part, How::Linear)?;
            let Some(regular) = regular else { continue };
            for points in QMC {
                let Some(o) = lab.part(dataset, points, part, How::Linear)? else { continue };
                let wins = [
                    o.distances.rms < regular.distances.rms,
                    o.distances.normal < regular.distances.normal,
                    o.roughness < regular.roughness,
                ];
                let words = format!(
                    "distance {}/{}, normals {}/{}",
                    short(100.0 * o.distances.rms),
                    short(100.0 * regular.distances.rms),
                    short(o.distances.normal),
                    short(regular.distances.normal)
                );
                let better = wins.iter().filter(|w| **w).count() >= 2;
                cases.push((format!("{} 1/{part} {}", dataset.name(), points.name()), better, words));
            }
        }
    }
    Ok(by_cases(
        "3.5, 4.7, 5",
        "Generally the QMC points produce better images than sub-regular grid points",
        "two of three are less than with regular points: RMS distance, deviation of normals, roughness (figures: % of the diagonal, degrees)",
        cases,
    ))
}

fn smoother_than_the_original(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        let original = lab.original(dataset).map_or(0.0, |o| o.roughness);
        if let Some(o) = hammersley(lab, dataset, 1, How::Linear)? {
            let words = format!("{}° against {}°", short(o.roughness), short(original));
            cases.push((dataset.name().into(), o.roughness < original, words));
        }
    }
    Ok(by_cases(
        "3.4, 4.6",
        "For the same number of points the QMC points give a smoother isosurface than the original",
        "the RMS angle between neighbouring triangles is less with as many Hammersley points as samples",
        cases,
    ))
}

fn advantage_grows_with_size(lab: &mut Lab) -> Result<Claim> {
    let mut found = vec![];
    for dataset in lab.datasets().filter(|&d| !is_grid(d)).collect::<Vec<_>>() {
        let size = lab.original(dataset).map_or(0, |o| o.size());
        if let Some(o) = hammersley(lab, dataset, 8, How::Linear)? {
            found.push((dataset.name(), size, o.distances.rms));
        }
    }
    found.sort_by_key(|f| f.1);
    let pairs = found.windows(2).map(|w| {
        let words = format!("{} % → {} %", short(100.0 * w[0].2), short(100.0 * w[1].2));
        (format!("{} ({}) → {} ({})", w[0].0, w[0].1, w[1].0, w[1].1), w[1].2 < w[0].2, words)
    });
    Ok(by_cases(
        "3.5, 4.7, 5",
        "Large data sets can be reduced remarkably; the advantage grows with the data size",
        "at 1/8 the RMS distance of the surfaces, in % of the diagonal, is less for the larger of two unstructured sets",
        pairs.collect(),
    ))
}

fn meshing_takes_most(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        for part in PARTS {
            if let Some(o) = times(lab, dataset, part, How::Linear)? {
                let share = o.mesh / (o.mesh + o.sample);
                let words = format!("{} %", short(100.0 * share));
                cases.push((format!("{} 1/{part}", dataset.name()), share > 0.5, words));
            }
        }
    }
    Ok(by_cases(
        "3.5, 4.7, 5",
        "Most of the time spent in the preprocessing is used for mesh generation",
        "meshing takes more than half of the time of meshing and interpolation",
        cases,
    ))
}

fn extraction_is_fast(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        if let Some(o) = times(lab, dataset, 8, How::Linear)? {
            let share = o.extract / (o.mesh + o.sample);
            let words = format!(
                "{} ms, {} % of meshing and interpolation",
                short(1e3 * o.extract),
                short(100.0 * share)
            );
            cases.push((dataset.name().into(), share < 0.2, words));
        }
    }
    Ok(by_cases(
        "3.5, 4.7, 5",
        "The preprocessing might be time consuming, but after it the isosurface extraction is very fast",
        "at 1/8, extraction takes less than a fifth of meshing and interpolation",
        cases,
    ))
}

fn speedup_is_linear(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        for line in time_chart(lab, dataset)?.lines {
            if let Some(slope) = line.slope() {
                let words = format!("{slope:.2}");
                cases.push((
                    format!("{} {}", dataset.name(), line.name),
                    (0.8..=1.2).contains(&slope),
                    words,
                ));
            }
        }
    }
    Ok(by_cases(
        "3.4, 4.6, 5",
        "The QMC isosurface extraction has a linear speedup with decreasing number of points",
        "seconds grow like the number of points to a power of 0.8 to 1.2 (a surface crosses about n^(2/3) of n tetrahedra, so an index can do better than \
         linear)",
        cases,
    ))
}

fn boundaries_are_distorted(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().filter(|&d| !is_grid(d)).collect::<Vec<_>>() {
        let many = hammersley(lab, dataset, 1, How::Linear)?;
        let few = hammersley(lab, dataset, 16, How::Linear)?;
        if let Some((many, few)) = many.zip(few) {
            let words = format!(
                "{} % of the vertices outside of the reduced mesh at 1/1, {} % at 1/16",
                short(100.0 * many.field.outside),
                short(100.0 * few.field.outside)
            );
            cases.push((dataset.name().into(), few.field.outside > many.field.outside, words));
        }
    }
    Ok(by_cases(
        "5",
        "The technique may distort boundaries if there are not enough points along them",
        "more of the original's vertices are outside of the reduced mesh at 1/16 than at 1/1 (the boundary is sampled besides, which the thesis proposes \
         as future work)",
        cases,
    ))
}

fn cross_subsampled_is_better(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in STRUCTURED {
        let cross = lab.run(subsampled(dataset, Points::Hyperbolic))?;
        for points in [Points::Hammersley, Points::Halton] {
            if let Some((cross, other)) = cross.as_ref().zip(lab.run(subsampled(dataset, points))?) {
                let words = format!(
                    "{} % against {} %",
                    short(100.0 * cross.distances.rms),
                    short(100.0 * other.distances.rms)
                );
                let name = format!("{}, against {}", dataset.name(), points.name());
                cases.push((name, cross.distances.rms < other.distances.rms * 1.1, words));
            }
        }
    }
    Ok(by_cases(
        "3.3.2",
        "Subsampled hyperbolic cross points give the same quality for SPHERE and a better image for SEIS",
        "the RMS distance of the surface is at most a tenth larger than that of interpolated Hammersley and Halton points",
        cases,
    ))
}

fn cubic_costs_a_little_more(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().collect::<Vec<_>>() {
        let linear = times(lab, dataset, 2, How::Linear)?;
        let higher = times(lab, dataset, 2, How::Higher)?;
        if let Some((l, h)) = linear.zip(higher) {
            let ratio = h.sample / l.sample;
            cases.push((dataset.name().into(), ratio < 1.5, format!("{}×", short(ratio))));
        }
    }
    Ok(by_cases(
        "3.2.4, 4.4.3",
        "Cubic interpolation takes a little more time than linear, quadratic interpolation in meshes about the same",
        "at 1/2, less than 1.5 times the time of linear interpolation (in meshes, searching included)",
        cases,
    ))
}

fn searching_takes_longer_than_extracting(lab: &mut Lab) -> Result<Claim> {
    let mut cases = vec![];
    for dataset in lab.datasets().filter(|&d| !is_grid(d)).collect::<Vec<_>>() {
        for part in PARTS {
            if let Some(o) = times(lab, dataset, part, How::Linear)? {
                let ratio = o.sample / o.extract;
                cases.push((
                    format!("{} 1/{part}", dataset.name()),
                    ratio > 1.0,
                    format!("{}×", short(ratio)),
                ));
            }
        }
    }
    Ok(by_cases(
        "4.4.3, 4.6",
        "In unstructured data, interpolation takes more time than isosurface extraction, because of the search",
        "interpolation takes longer than extraction",
        cases,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_follow_from_cases() {
        let case = |right| ("a".to_owned(), right, "1 %".to_owned());
        let verdict =
            |rights: &[bool]| by_cases("5", "c", "r", rights.iter().map(|&r| case(r)).collect()).verdict;
        assert_eq!(verdict(&[]), Verdict::Open);
        assert_eq!(verdict(&[true; 5]), Verdict::Holds);
        assert_eq!(verdict(&[true, false]), Verdict::Partly);
        assert_eq!(verdict(&[true, false, false]), Verdict::Fails);
        let claim = by_cases("5", "c", "r", vec![case(true), case(false)]);
        assert_eq!(claim.figures, "1 of 2 cases: a 1 %; a 1 % (no)");
    }
}
