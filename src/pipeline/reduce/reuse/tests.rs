//! Searches that reuse chunks make the archive that their last plan makes by itself.

use super::super::existing::Existing;
use super::super::job::{Basis, Job};
use super::super::plan_file::{Cut, PlanFile};
use super::super::series::{PlannedSource, SeriesPlan};
use super::super::{make, numbered};
use super::Round;
use crate::archive::manifest::Manifest;
use crate::density::Choice;
use crate::pipeline::plan::{Attachments, Layout};
use crate::pipeline::read::{OpenArchive, StepView};
use crate::pipeline::{
    Bound, CompleteSettings, InputFacts, Plan, ReduceReport, ReduceSettings, RunSettings, Shard, Shards,
    Target, reduce_series,
};
use isospan_io::exec::{Progress, Resources, Silent};
use isospan_io::formats::{OpenOptions, StepSource};
use isospan_mesh::points::{Levels, PointSpec, SetKind};
use isospan_mesh::sample::Values;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;

const DIMS: [usize; 3] = [130, 30, 28];

/// A ball with a soft edge in a field of long waves; in the second step it is elsewhere.
fn write_field(path: &Path, step: usize) {
    let mut bytes = format!(
        "NRRD0004\ntype: float\ndimension: 3\nsizes: {} {} {}\nencoding: raw\nendian: little\n\n",
        DIMS[0], DIMS[1], DIMS[2]
    )
    .into_bytes();
    let middle = [30.3 + 50.0 * step as f64, 15.2, 12.9];
    for i in 0..DIMS.iter().product() {
        let p = [i % DIMS[0], i / DIMS[0] % DIMS[1], i / DIMS[0] / DIMS[1]].map(|c| c as f64);
        let waves: f64 = p.iter().map(|c| 3.0 * libm::sin(c / 5.0)).sum();
        let d = p.iter().zip(middle).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        let value = waves + 10.0 / (1.0 + libm::exp(libm::sqrt(d) - 8.0));
        bytes.extend((value as f32).to_le_bytes());
    }
    fs::write(path, bytes).unwrap();
}

fn sources(folder: &Path, steps: usize) -> Vec<StepSource> {
    let of = |step| {
        let path = folder.join(format!("{step}.nrrd"));
        write_field(&path, step);
        StepSource::new(&path, &OpenOptions::default())
    };
    (0..steps).map(of).collect()
}

fn settings(values: Values) -> ReduceSettings {
    ReduceSettings {
        points: Some(SetKind::Halton),
        adapt: true,
        values: Some(values),
        chunk_points: 2_000,
        ..ReduceSettings::default()
    }
}

fn complete(values: Values) -> CompleteSettings {
    settings(values).complete(&InputFacts::default()).unwrap()
}

fn run(threads: usize) -> RunSettings {
    RunSettings { resources: Resources::default().with_threads(threads), ..RunSettings::default() }
}

/// A try of a search, with those around as they are there.
fn make_round(
    sources: &[StepSource],
    values: Values,
    round: Option<&Round>,
    out: &Path,
    threads: usize,
) -> ReduceReport {
    let (settings, run) = (&complete(values), &run(threads));
    let (sources, basis) = (&numbered(sources), round.map_or(Basis::New, Basis::Round));
    make(&Job { sources, settings, out, run, progress: &Silent, basis, keeps_sums: true }, &Existing::Nothing)
        .unwrap()
}

/// The levels of an archive with a cell at the low end of x raised by 2.
fn raised(archive: &StepView) -> Choice {
    let levels = archive.points.levels().unwrap();
    let PointSpec::Halton { n } = archive.manifest.plan.points else { panic!("no Halton set") };
    let (cells, mut all) = (*levels.cells(), levels.as_slice().to_vec());
    let cell = &mut all[cells.id([1, cells.dims()[1] / 2, cells.dims()[2] / 2]).0 as usize];
    // Above all others: what depends on the largest level must not show elsewhere.
    *cell = levels.top() + 1;
    Levels::grade(&cells, &mut all);
    Choice { n, levels: Levels::new(cells, all).unwrap() }
}

/// All files below a folder, with their bytes.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            found.extend(files(&path).into_iter().map(|(n, bytes)| (format!("{name}/{n}"), bytes)));
        } else if !name.contains("-sums-") {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

/// Carries out the plan of an archive from the beginning.
fn made_again(archive: &Path, sources: &[StepSource], values: Values, out: &Path, shards: u64) {
    let manifest = Manifest::read(archive).unwrap();
    let steps = manifest.steps.iter().map(|s| s.plan.clone()).collect();
    let plan = Plan { mesh: manifest.plan.clone(), steps };
    let attachments = Attachments::read(archive, &plan.mesh).unwrap();
    let settings = complete(values);
    let planned = |source: &StepSource| PlannedSource::in_place(source.clone());
    let series = SeriesPlan {
        plan,
        sources: sources.iter().map(planned).collect(),
        skipped: vec![],
        order: Default::default(),
        is_there: false,
        keyframes: settings.keyframes,
        attachments: Attachments::default(),
        watch: Default::default(),
    };
    let chunks = manifest.counts.chunks;
    let file = PlanFile::new(
        &settings,
        &series,
        Cut { chunks, shards, memory_least: 0, replaces: false, search: None, isovalues: vec![] },
    )
    .unwrap();
    file.write(out, false).unwrap();
    Layout::new(out, chunks, 0).make_folders().unwrap();
    attachments.write(out, file.mesh_hash).unwrap();
    let work = Shards::at(out).resources(run(2).resources);
    for shard in 0..shards {
        work.work(Shard::new(shard, shards).unwrap()).unwrap();
    }
    work.commit().unwrap();
}

#[test]
fn a_round_makes_what_its_plan_makes_and_meshes_where_levels_are_others() {
    let dir = tempfile::tempdir().unwrap();
    for (steps, values) in [(1, Values::Sample), (2, Values::Fit)] {
        let sources = sources(dir.path(), steps);
        let [first, two, one, plain] =
            ["first", "two", "one", "plain"].map(|n| dir.path().join(format!("{steps}{n}.isospan")));
        make_round(&sources, values, None, &first, 2);
        let open = || OpenArchive::open(&first).unwrap().step_at(0);
        let round = Round::new(raised(&open()), open()).unwrap();
        let made = make_round(&sources, values, Some(&round), &two, 2);
        assert!(made.reused_chunks > 0 && made.reused_chunks < made.chunks, "{made:?}");
        let [before, after] = [&first, &two].map(|a| Manifest::read(a).unwrap());
        assert!(before.plan.frame.is_none() && after.plan.frame.is_some());
        assert!(after.plan.levels.unwrap().top > before.plan.levels.unwrap().top);
        make_round(&sources, values, Some(&round), &one, 1);
        let expected = files(&two);
        assert!(expected == files(&one), "threads");
        made_again(&two, &sources, values, &plain, 3);
        assert!(expected == files(&plain), "as planned");
        crate::Archive::open(&two).unwrap().check().unwrap();
        // And with no change there is nothing to mesh.
        let same = Choice { levels: (**open().points.levels().unwrap()).clone(), ..raised(&open()) };
        let round = Round::new(same, open()).unwrap();
        fs::remove_dir_all(&one).unwrap();
        let made = make_round(&sources, values, Some(&round), &one, 2);
        assert_eq!(made.reused_chunks, made.chunks);
    }
}

#[test]
fn chunks_are_cut_afresh_where_bricks_would_be_too_large() {
    let dir = tempfile::tempdir().unwrap();
    let (sources, out) = (sources(dir.path(), 1), dir.path().join("a.isospan"));
    make_round(&sources, Values::Sample, None, &out, 2);
    let open = || OpenArchive::open(&out).unwrap().step_at(0);
    let Choice { n, levels } = raised(&open());
    let denser = |by: u8| {
        let all = levels.as_slice().iter().map(|l| l + by).collect();
        Round::new(Choice { n, levels: Levels::new(*levels.cells(), all).unwrap() }, open()).unwrap()
    };
    assert!(denser(0).frame.is_some());
    assert!(denser(4).frame.is_none());
    let other = Choice { n: n + 1, levels: levels.clone() };
    assert!(Round::new(other, open()).unwrap().frame.is_none());
}

/// Stops a run in one of its tries.
struct StopsIn {
    round: usize,
    run: RunSettings,
    seen: Mutex<(usize, bool)>,
}

impl Progress for StopsIn {
    fn begin(&self, stage: &str, _: u64, _: &str) {
        let mut seen = self.seen.lock().unwrap();
        seen.1 = stage.starts_with("reduce");
        seen.0 += usize::from(seen.1);
    }

    fn advance(&self, _: u64) {
        let seen = self.seen.lock().unwrap();
        if seen.1 && seen.0 == self.round {
            self.run.resources.cancel.cancel();
        }
    }

    fn end(&self) {}
}

#[test]
fn a_search_that_was_stopped_ends_alike() {
    let dir = tempfile::tempdir().unwrap();
    let sources = sources(dir.path(), 1);
    let [whole, stopped] = ["whole", "stopped"].map(|n| dir.path().join(format!("{n}.isospan")));
    let target = Some(Target::Max(Bound::Value(1.0)));
    let settings = ReduceSettings { target, ..settings(Values::Sample) };
    let search = |out: &Path| reduce_series(&sources, &settings, out, &run(2), &Silent).unwrap();
    let target = search(&whole).target.unwrap();
    assert!(
        target.met && target.tries > 2 && target.meshed_chunks[0] <= target.meshed_chunks[1],
        "{target:?}"
    );
    for round in 1..=3 {
        let progress = StopsIn { round, run: run(2), seen: Mutex::default() };
        let error = reduce_series(&sources, &settings, &stopped, &progress.run, &progress).unwrap_err();
        assert!(matches!(error, crate::Error::Cancelled), "{error}");
    }
    assert_eq!(search(&stopped).target, Some(target));
    assert!(files(&whole) == files(&stopped));
    assert!(!dir.path().join("stopped.isospan.work").exists(), "tries are gone");
}
