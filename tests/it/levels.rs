//! Levels of a pyramid: each question takes one by its number, by triangles or by error, and the
//! errors that are told are those of the samples.

use crate::common::*;
use isospan::exec::{Resources, Silent};
use isospan::formats::StepSource;
use isospan::measure::FieldError;
use isospan::pipeline::{
    self, Bound, LevelChoice, ProbeSettings, ReduceSettings, Roi, RunSettings, SurfaceQuery, Target,
};
use isospan::points::SetKind;
use isospan::surface::TriMesh;
use isospan::surface::check::check;
use isospan::{Archive, Error};
use std::path::Path;
use std::process::Command;

fn pyramid(part: f64) -> ReduceSettings {
    ReduceSettings {
        points: Some(SetKind::Pyramid),
        target: Some(Target::Rms(Bound::OfRange(part))),
        ..ReduceSettings::default()
    }
}

/// A wave with noise and an edge.
fn rough(x: f64, y: f64, z: f64) -> f64 {
    let noise = (1e4 * (x + 3.7 * y + 9.1 * z).sin()).rem_euclid(1.0);
    waves(x, y, z) + 0.05 * noise + if ball(x, y, z) > 0.3 { 0.5 } else { 0.0 }
}

/// An archive of a field, in a folder, with the file that it was made from.
fn made(dir: &Path, dims: [usize; 3], field: fn(f64, f64, f64) -> f64) -> [std::path::PathBuf; 2] {
    let paths = [dir.join("a.npy"), dir.join("a.isospan")];
    write_npy(&paths[0], dims, field);
    reduce(&paths[0], &pyramid(0.005), &paths[1], 2);
    paths
}

fn measured(archive: &Path, input: &Path, level: usize) -> FieldError {
    let level = LevelChoice::Level(level as u32);
    measurement(archive, input).level(level).resources(run(2).resources).run().unwrap().error
}

fn at_level(level: usize) -> ProbeSettings {
    ProbeSettings { level: Some(LevelChoice::Level(level as u32)), ..ProbeSettings::default() }
}

fn at(level: u32) -> LevelChoice {
    LevelChoice::Level(level)
}

/// Surfaces, and the level that they are of.
fn surfaces(query: &SurfaceQuery<'_>) -> (u32, Vec<TriMesh>) {
    (query.chosen_level().unwrap(), query.meshes().unwrap())
}

fn triangles(query: &SurfaceQuery<'_>) -> u64 {
    query.meshes().unwrap().iter().map(|mesh| mesh.triangles.len() as u64).sum()
}

#[test]
fn errors_of_levels_are_those_at_all_samples() {
    let dir = tempfile::tempdir().unwrap();
    // Several chunks, a thin volume, even and odd numbers of samples.
    for (n, dims) in [[300, 41, 34], [20, 2, 600], [64, 57, 65]].into_iter().enumerate() {
        let (input, out) = (dir.path().join(format!("{n}.npy")), dir.path().join(format!("{n}.isospan")));
        write_npy(&input, dims, rough);
        reduce(&input, &pyramid(0.005), &out, 2);
        let archive = Archive::open(&out).unwrap();
        let info = archive.info().unwrap();
        assert!(info.pyramid.len() > 2, "{dims:?}");
        for level in &info.pyramid {
            let again = measured(&out, &input, level.level);
            let (told, found) = (level.rms.unwrap(), again.rms);
            assert!(told >= found && told <= 1.002 * found, "{dims:?} {level:?}: {found}");
            // The samples up to the last node, against the field as `probe` has it.
            let values = archive.sample_with(archive.dims(), &at_level(level.level)).unwrap();
            let inside: u64 = (0..3).map(|a| (level.nodes[a] - 1) * level.stride[a] + 1).product();
            assert_eq!(again.measured, inside);
            assert_eq!(again.outside, archive.dims().iter().product::<u64>() - inside);
            let (mut sum, mut count) = (0.0, 0);
            for (i, v) in values.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
                sum += (v - source_value(&input, i)).powi(2);
                count += 1;
            }
            assert_eq!(count, inside, "{dims:?} {level:?}");
            let plain = (sum / count as f64).sqrt();
            assert!((found / plain - 1.0).abs() < 1e-4, "{dims:?} {level:?}: {found} {plain}");
        }
        let rms: Vec<f64> = info.pyramid.iter().filter_map(|level| level.rms).collect();
        assert!(rms.is_sorted(), "coarser levels are farther off: {rms:?}");
        let bytes: Vec<u64> = info.pyramid.iter().filter_map(|level| level.bytes).collect();
        assert!(bytes.is_sorted_by(|a, b| a >= b) && bytes[0] < info.bytes, "{bytes:?} {}", info.bytes);
        assert!(bytes[1] < bytes[0] && bytes[2] < bytes[1]);
    }
}

/// A sample of a file of NPY with f32, x fastest.
fn source_value(input: &Path, n: usize) -> f64 {
    use std::cell::RefCell;
    thread_local!(static READ: RefCell<(std::path::PathBuf, Vec<u8>)> = RefCell::default());
    READ.with_borrow_mut(|(path, bytes)| {
        if path != input {
            (*path, *bytes) = (input.to_path_buf(), std::fs::read(input).unwrap());
        }
        let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        f64::from(f32::from_le_bytes(bytes[header + 4 * n..][..4].try_into().unwrap()))
    })
}

/// A ball of 20 samples where nothing else is, in 1100 x 70 x 66.
fn far_ball(x: f64, y: f64, z: f64) -> f64 {
    let r = ((16.0 * (x + 0.94)).powi(2) + y * y + z * z).sqrt();
    (0.6 - r).max(-0.1) + 1e-3 * (40.0 * (x + y)).sin()
}

#[test]
fn a_surface_of_a_coarse_level_is_read_where_it_lies() {
    let dir = tempfile::tempdir().unwrap();
    let [input, out] = ["a.npy", "a.isospan"].map(|name| dir.path().join(name));
    write_npy(&input, [1100, 70, 66], far_ball);
    let settings = ReduceSettings { target: Some(Target::Rms(Bound::Value(2e-3))), ..pyramid(0.01) };
    reduce(&input, &settings, &out, 2);
    let archive = Archive::open(&out).unwrap();
    for (level, bricks) in [(0, 8), (1, 1), (2, 1), (3, 1)] {
        for cap in [false, true] {
            let query = archive.query(0.0).level(at(level)).cap(cap);
            let report = query.write(dir.path().join(format!("{level} {cap}.ply"))).unwrap();
            assert!(report.triangles > 20, "level {level}: {}", report.triangles);
            assert_eq!(report.active_blocks, bricks, "level {level}, cap {cap}");
            // Beside a surface that is nearly everywhere it is no other.
            let both = archive.query([0.0, -0.1]).level(at(level)).cap(cap).meshes().unwrap();
            assert_eq!(query.mesh().unwrap(), both[0]);
            assert!(both[1].triangles.len() > both[0].triangles.len());
        }
    }
}

#[test]
fn levels_of_a_larger_volume_are_measured_in_some_rows() {
    let dir = tempfile::tempdir().unwrap();
    let [input, out] = made(dir.path(), [150, 110, 90], rough);
    for level in Archive::open(&out).unwrap().info().unwrap().pyramid {
        let (told, found) = (level.rms.unwrap(), measured(&out, &input, level.level).rms);
        assert!((told / found - 1.0).abs() < 0.03, "{level:?}: {found}");
    }
}

#[test]
fn errors_of_levels_do_not_depend_on_how_they_were_measured() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    // More chunks than a segment has.
    write_npy(&input, [4400, 12, 9], rough);
    let levels = |out: &Path| Archive::open(out).unwrap().info().unwrap().pyramid;
    let whole = dir.path().join("whole.isospan");
    reduce(&input, &pyramid(0.01), &whole, 2);
    for (threads, memory) in [(1, 1 << 30), (2, 110 << 20)] {
        let out = dir.path().join(format!("{threads}-{memory}.isospan"));
        let run = RunSettings { resources: run(threads).resources.with_memory(memory), ..run(threads) };
        pipeline::reduce_series(&[StepSource::from(&*input)], &pyramid(0.01), &out, &run, &Silent).unwrap();
        assert_eq!(levels(&out), levels(&whole));
        assert!(folder(&out) == folder(&whole));
    }
    let shards = dir.path().join("shards.isospan");
    let settings = ReduceSettings { target: Some(Target::Max(Bound::OfRange(0.02))), ..pyramid(0.01) };
    reduce_in_shards(&input, &settings, &shards);
    assert!(levels(&shards).iter().all(|level| level.rms.is_some()));
}

#[test]
fn an_error_chooses_the_coarsest_level_that_has_it() {
    let dir = tempfile::tempdir().unwrap();
    let [_, out] = made(dir.path(), [64, 60, 70], rough);
    let archive = Archive::open(&out).unwrap();
    let levels = archive.info().unwrap().pyramid;
    let of_error = |bound| archive.query(0.1).level(LevelChoice::Error(bound)).chosen_level();
    for level in &levels {
        assert_eq!(of_error(Bound::Value(level.rms.unwrap())).unwrap() as usize, level.level);
        let [lo, hi] = archive.info().unwrap().error.unwrap().source_range.unwrap();
        let part = level.rms.unwrap() / (hi - lo) * (1.0 + 1e-12);
        assert_eq!(of_error(Bound::OfRange(part)).unwrap() as usize, level.level);
    }
    let less = 0.99 * levels[0].rms.unwrap();
    let error = of_error(Bound::Value(less)).unwrap_err().to_string();
    assert!(error.contains("no level has an RMS error of at most") && error.contains("level 0"), "{error}");
    // Without errors there is nothing to choose by.
    let further = dir.path().join("b.npy");
    write_npy(&further, [64, 60, 70], waves);
    addition(&[StepSource::from(&*further)], &run(2)).measure(false).append_to(&out).unwrap();
    let archive = Archive::open(&out).unwrap();
    let archive = archive.at(pipeline::StepChoice::Number(1)).unwrap();
    assert!(archive.info().unwrap().pyramid.iter().all(|level| level.rms.is_none()));
    let error = archive.query(0.1).level(LevelChoice::Error(Bound::Value(1.0))).chosen_level().unwrap_err();
    assert!(error.to_string().contains("`measure=false`"), "{error}");
    assert!(archive.query(0.1).level(at(1)).mesh().is_ok());
}

#[test]
fn triangles_choose_the_finest_level_that_stays_below() {
    let dir = tempfile::tempdir().unwrap();
    let [_, out] = made(dir.path(), [140, 60, 70], rough);
    let archive = Archive::open(&out).unwrap();
    let levels = archive.info().unwrap().pyramid.len();
    let isovalues = [0.1, 0.4];
    let counts: Vec<u64> =
        (0..levels as u32).map(|level| triangles(&archive.query(isovalues).level(at(level)))).collect();
    assert!(counts.is_sorted_by(|a, b| a > b) && counts[levels - 1] > 0, "{counts:?}");
    for (level, &count) in (0u32..).zip(&counts) {
        let (chosen, meshes) = surfaces(&archive.query(isovalues).level(LevelChoice::Triangles(count)));
        assert_eq!(chosen, level);
        assert_eq!(meshes, archive.query(isovalues).level(at(level)).meshes().unwrap());
        let next = archive.query(isovalues).level(LevelChoice::Triangles(count - 1)).chosen_level();
        match next {
            Ok(chosen) => assert_eq!(chosen, level + 1),
            Err(error) => {
                assert_eq!(level as usize + 1, levels);
                let told = format!("level {level} has {count}");
                assert!(error.to_string().contains(&told), "{error}");
            }
        }
    }
    // Nothing crosses the values: no triangle is at most any number.
    assert_eq!(archive.query(1e6).level(LevelChoice::Triangles(1)).chosen_level().unwrap(), 0);
}

#[test]
fn caps_and_cuts_count_as_triangles() {
    let dir = tempfile::tempdir().unwrap();
    let [_, out] = made(dir.path(), [70, 60, 66], rough);
    let archive = Archive::open(&out).unwrap();
    let roi: Roi = "9.3:50.1,:,5.7:40".parse().unwrap();
    for most in [700, 2000, 6000, 15_000] {
        let query = archive.query(0.1).level(LevelChoice::Triangles(most));
        let capped = query.clone().cap(true);
        let (level, meshes) = surfaces(&capped);
        assert!(meshes[0].triangles.len() as u64 <= most && check(&meshes[0]).is_closed());
        if level > 0 {
            assert!(triangles(&capped.level(at(level - 1))) > most);
        }
        let cut = query.region(roi);
        let (level, meshes) = surfaces(&cut);
        assert!(meshes[0].triangles.len() as u64 <= most && !meshes[0].triangles.is_empty());
        if level > 0 {
            // Cutting was reckoned with; it makes few triangles more.
            assert!(triangles(&cut.level(at(level - 1))) as f64 > 0.7 * most as f64);
        }
    }
}

#[test]
fn points_and_grids_have_the_field_of_a_level() {
    let dir = tempfile::tempdir().unwrap();
    let [_, out] = made(dir.path(), [140, 40, 34], rough);
    let archive = Archive::open(&out).unwrap();
    for level in archive.info().unwrap().pyramid {
        let settings = at_level(level.level);
        let [nx, ny, nz] = level.nodes;
        let node = |x: u64, y: u64, z: u64| {
            [x * level.stride[0], y * level.stride[1], z * level.stride[2]].map(|n| n as f64)
        };
        let all: Vec<[f64; 3]> = (0..nx * ny * nz).map(|i| node(i % nx, i / nx % ny, i / nx / ny)).collect();
        let values = archive.probe_with(&all, &settings).unwrap();
        assert!(values.iter().all(|v| v.is_finite()), "{level:?}");
        let at = |p: [u64; 3]| values[((p[2] * ny + p[1]) * nx + p[0]) as usize];
        // Between nodes, and beyond the last one.
        let places: Vec<[f64; 3]> = (0..300)
            .map(|i| [f64::from(i) * 0.463, f64::from(i * 7 % 39) + 0.25, f64::from(i * 11 % 33) + 0.75])
            .collect();
        let found = archive.probe_with(&places, &settings).unwrap();
        let mut beyond = 0;
        for (place, found) in places.iter().zip(found) {
            let scaled: [f64; 3] = std::array::from_fn(|a| place[a] / level.stride[a] as f64);
            if (0..3).any(|a| scaled[a] > (level.nodes[a] - 1) as f64) {
                assert!(found.is_nan(), "{place:?}");
                beyond += 1;
                continue;
            }
            let (lo, t) = (scaled.map(|x| x as u64), scaled.map(f64::fract));
            let corner = |c: u64| {
                let high = [0, 1, 2].map(|a| c >> a & 1);
                let weight: f64 = (0..3).map(|a| if high[a] == 1 { t[a] } else { 1.0 - t[a] }).product();
                weight * at(std::array::from_fn(|a| (lo[a] + high[a]).min(level.nodes[a] - 1)))
            };
            let expected: f64 = (0..8).map(corner).sum();
            assert!((found - expected).abs() < 1e-5, "{level:?} {place:?}: {found} {expected}");
        }
        assert!(beyond > 0 || level.level == 0);
        // The same on grids of any size.
        for dims in [[140, 40, 34], [33, 70, 11], [1, 5, 1]] {
            let grid = archive.sample_with(dims, &settings).unwrap();
            let step =
                |i: u64, a: usize| i as f64 * (archive.dims()[a] - 1) as f64 / (dims[a].max(2) - 1) as f64;
            let place = |i: u64| {
                [step(i % dims[0], 0), step(i / dims[0] % dims[1], 1), step(i / dims[0] / dims[1], 2)]
            };
            let places: Vec<[f64; 3]> = (0..dims.iter().product()).map(place).collect();
            let points = archive.probe_with(&places, &settings).unwrap();
            for (i, (a, b)) in grid.iter().zip(&points).enumerate() {
                assert!(a.is_nan() && b.is_nan() || (a - b).abs() <= 1e-5, "{level:?} {dims:?} {i}: {a} {b}");
            }
        }
    }
}

#[test]
fn cells_of_a_level_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let [_, out] = made(dir.path(), [140, 40, 34], rough);
    let archive = Archive::open(&out).unwrap();
    assert_eq!(
        archive.count(0.1).unwrap().active_cells,
        archive.query(0.1).level(at(0)).count().unwrap().active_cells
    );
    for level in 1..4 {
        let query = archive.query(0.1).level(at(level));
        let (report, step) = (query.count().unwrap(), archive.info().unwrap());
        assert_eq!(report.level, Some(level as usize));
        let (cells, found) = (report.active_cells, triangles(&query));
        // A crossed cell has one to five triangles.
        assert!(
            cells > 0 && cells <= found && found <= 5 * cells && cells < step.pyramid[level as usize].cells
        );
    }
    let few = archive.query(0.1).level(LevelChoice::Triangles(2000));
    let chosen = few.count().unwrap().level;
    assert_eq!(chosen.unwrap(), few.chosen_level().unwrap() as usize);
}

#[test]
fn each_step_of_a_series_has_a_level_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let inputs: Vec<_> = (0..2).map(|t| dir.path().join(format!("{t}.npy"))).collect();
    write_npy(&inputs[0], [60, 50, 40], rough);
    write_npy(&inputs[1], [60, 50, 40], |x, y, z| 0.3 * x + 0.01 * y * z);
    let sources: Vec<StepSource> = inputs.iter().map(|path| StepSource::from(&**path)).collect();
    let out = dir.path().join("a.isospan");
    pipeline::reduce_series(&sources, &pyramid(0.005), &out, &run(2), &Silent).unwrap();
    let archive = Archive::open(&out).unwrap();
    let few = LevelChoice::Triangles(3000);
    let report = archive.steps(..).unwrap().query(0.1).level(few).write(dir.path().join("s_%d.ply")).unwrap();
    let levels: Vec<usize> = report.steps.iter().map(|step| step.report.level.unwrap()).collect();
    assert!(report.steps.iter().all(|step| step.report.triangles <= 3000));
    assert!(levels[0] > 0 && levels[1] < levels[0], "{levels:?}");
    // A moment between two steps has levels, and no errors.
    let between = archive.at(pipeline::StepChoice::Time(0.5)).unwrap();
    assert!(between.query(0.1).level(at(1)).mesh().is_ok());
    assert!(between.query(0.1).level(few).mesh().is_ok());
    let error = between.query(0.1).level(LevelChoice::Error(Bound::Value(1.0))).mesh().unwrap_err();
    assert!(error.to_string().contains("between two"), "{error}");
}

#[test]
fn threads_and_memory_do_not_choose_another_level() {
    let dir = tempfile::tempdir().unwrap();
    let [_, out] = made(dir.path(), [300, 60, 70], rough);
    let archive = Archive::open(&out).unwrap();
    let query = archive.query(0.1).level(LevelChoice::Triangles(5000));
    let whole = surfaces(&query);
    let resources = Resources::default().with_threads(1).with_memory(100 << 20);
    assert!(surfaces(&query.resources(resources)) == whole);
}

fn isospan(dir: &Path, command: &str) -> (bool, String, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_isospan"))
        .current_dir(dir)
        .args(command.split(' '))
        .arg("-q")
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (out.status.success(), text(out.stdout), text(out.stderr))
}

fn json(dir: &Path, command: &str) -> serde_json::Value {
    let (good, out, error) = isospan(dir, &format!("{command} --json"));
    assert!(good, "{command}: {error}");
    serde_json::from_str(&out).unwrap()
}

#[test]
fn the_program_takes_one_of_the_three() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    made(d, [64, 50, 40], rough);
    std::fs::write(d.join("points.csv"), "x,y,z\n1,2,3\n63,49,39\n70,0,0\n").unwrap();
    let levels = json(d, "info a.isospan")["pyramid"].as_array().unwrap().clone();
    let rms = levels[2]["rms"].as_f64().unwrap();
    let most = json(d, "surface a.isospan -i 0.1 --level 2 -o a.ply")["triangles"].clone();
    let [of_triangles, of_error] = [format!("--triangles {most}"), format!("--error {rms}")];
    for flags in ["--level 2", &*of_triangles, &*of_error] {
        let level = 2;
        let report = json(d, &format!("surface a.isospan -i 0.1 {flags} -o a.ply --force"));
        assert_eq!(report["level"], level, "{flags}: {report}");
        assert_eq!(json(d, &format!("count a.isospan -i 0.1 {flags}"))["level"], level);
        let picture = format!("render a.isospan -i 0.1 --slice z=50% --size 60,60 {flags} -o a.png --force");
        assert_eq!(json(d, &picture)["panels"][0]["level"], level);
        let text = isospan(d, &format!("surface a.isospan -i 0.1 {flags} -o a.ply --force")).1;
        assert!(text.contains("level         2"), "{text}");
        if flags.starts_with("--triangles") {
            continue;
        }
        // The domain of a level ends at its last node, and so do its surfaces.
        assert!(isospan(d, &format!("check a.ply --within a.isospan {flags}")).0, "{flags}");
        assert!(!isospan(d, "check a.ply --within a.isospan").0);
        let grid = json(d, &format!("probe a.isospan --grid 64,50,40 {flags} -o a.npz.npy --force"));
        assert_eq!((&grid["level"], &grid["void"]), (&2.into(), &0.into()));
        assert!(grid["outside"].as_u64().unwrap() > 0);
        let points = json(d, &format!("probe a.isospan --at points.csv {flags} -o v.csv --force"));
        assert_eq!((&points["level"], &points["outside"]), (&2.into(), &2.into()));
        let error = json(d, &format!("measure a.isospan --against a.npy {flags}"));
        assert!(error["rms"].as_f64().unwrap() <= rms && error["level"] == 2);
    }
    let refused = |command: &str, words: &[&str]| {
        let (good, _, error) = isospan(d, command);
        assert!(!good && error.lines().count() == 1, "{command}: {error}");
        words.iter().for_each(|word| assert!(error.contains(word), "{command}: {error}"));
    };
    refused("surface a.isospan -i 0.1 --level 1 --error 1% -o b.ply", &["--level", "--error"]);
    refused("surface a.isospan -i 0.1 --triangles 10 --error 1% -o b.ply", &["--triangles", "--error"]);
    refused("surface a.isospan -i 0.1 --triangles 1 -o b.ply", &["at most 1 triangle", "level"]);
    refused("surface a.isospan -i 0.1 --level 40 -o b.ply", &["no level 40", "0 (the finest) to"]);
    refused("probe a.isospan --grid 5,5,5 --triangles 100 -o b.npy", &["--triangles", "--level"]);
    refused("probe a.isospan --at points.csv --triangles 100 -o b.csv", &["--triangles", "--level"]);
    refused("measure a.isospan --against a.npy --triangles 100", &["--triangles", "--level"]);
    refused("render a.isospan --slice z=50% --triangles 100 -o b.png", &["--triangles", "--level"]);
    refused("check a.ply --level 1", &["--level", "--within"]);
    refused("check a.isospan --level 1", &["--level is for surfaces"]);
    assert!(!d.join("b.ply").exists() && !d.join("b.npy").exists() && !d.join("b.png").exists());
    // Archives of tetrahedra have no levels, not even the finest.
    assert!(isospan(d, "reduce a.npy -o t.isospan --points halton --fraction 1/16").0);
    for flags in ["--level 0", "--triangles 100", "--error 50%"] {
        let flag = flags.split(' ').next().unwrap();
        let words = ["is no pyramid", flag];
        refused(&format!("surface t.isospan -i 0.1 {flags} -o b.ply"), &words);
        refused(&format!("count t.isospan -i 0.1 {flags}"), &words);
        refused(&format!("render t.isospan -i 0.1 {flags} -o b.png"), &words);
        refused(&format!("render t.isospan --slice z=50% {flags} -o b.png"), &words);
        refused(&format!("probe t.isospan --grid 5,5,5 {flags} -o b.npy"), &words);
        refused(&format!("probe t.isospan --at points.csv {flags} -o b.csv"), &words);
        refused(&format!("measure t.isospan --against a.npy {flags}"), &words);
        refused(&format!("check a.ply --within t.isospan {flags}"), &words);
    }
    refused("render a.ply --level 1 -o b.png", &["--level is for archives"]);
}

#[test]
fn damaged_levels_are_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let [_, out] = made(dir.path(), [64, 50, 40], rough);
    let name = folder(&out).into_keys().find(|name| name.to_string_lossy().ends_with("coarse.seg")).unwrap();
    std::fs::write(out.join(name), b"no").unwrap();
    let archive = Archive::open(&out).unwrap();
    let found = archive.query(0.1).level(LevelChoice::Triangles(100)).chosen_level();
    assert!(matches!(found, Err(Error::BadInput { .. } | Error::Incomplete { .. })), "{found:?}");
}
