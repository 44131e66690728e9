//! A memory budget is kept, decides no byte, and is refused, naming the least that works, before
//! anything is made.

use crate::common::*;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

fn reduce_with(dir: &Path, out: &str, memory: &str, more: &[&str]) -> Output {
    isospan(dir, &[&["-q", "reduce", "w.npy", "-o", out, "--memory", memory][..], more].concat())
}

/// A set that is meshed vertex by vertex, and one that is meshed by insertion.
const SETS: [&str; 2] = ["hammersley", "regular"];

/// A volume, and settings by which it becomes many chunks of points of each set.
fn waves_in(dir: &Path) -> [[&'static str; 6]; 2] {
    write_npy(&dir.join("w.npy"), [60, 52, 47], waves);
    SETS.map(|set| ["--points", set, "--fraction", "1/2", "--chunk-points", "4000"])
}

#[test]
fn the_budget_decides_no_byte() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for settings in waves_in(d) {
        let mut first = None;
        for (i, memory) in ["48MiB", "70MiB", "4GiB"].into_iter().enumerate() {
            let name = format!("{}{i}.isospan", settings[1]);
            let out = reduce_with(d, &name, memory, &settings);
            assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
            let files = folder(&d.join(&name));
            assert!(files.len() >= 4, "{:?}", files.keys());
            assert!(*first.get_or_insert_with(|| files.clone()) == files, "{memory} gives other bytes");
        }
    }
}

/// A limit of the address space that leaves the program no room is one line, not an abort. Below
/// the size of the program the system's loader ends it without a word.
#[test]
#[cfg(unix)]
fn a_small_address_space_is_refused_in_a_line() {
    use std::os::unix::process::ExitStatusExt;
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("w.npy"), [20, 20, 20], waves);
    assert!(
        isospan(d, &["reduce", "-q", "w.npy", "-o", "w.isospan", "--points", "regular"]).status.success()
    );
    let (mut refused, mut done) = (0, 0);
    for kib in (20_000u64..160_000).step_by(4_000) {
        for args in [
            &["surface", "w.isospan", "-q", "--isovalue", "0.1", "-o", "w.ply", "--force"][..],
            &["render", "w.isospan", "-q", "--isovalue", "0.1", "--size", "40,40", "-o", "w.png", "--force"],
        ] {
            let limited = format!("ulimit -v {kib}; exec \"$0\" \"$@\"");
            let limited = ["-c", &limited, env!("CARGO_BIN_EXE_isospan"), "--progress", "none"];
            let out = Command::new("bash").current_dir(d).args(limited).args(args).output().unwrap();
            let text = String::from_utf8_lossy(&out.stderr);
            assert_ne!(out.status.signal(), Some(6), "{kib} {args:?}: {text}");
            let is_line = text.trim_end().lines().count() == 1;
            match out.status.code() {
                Some(4) => refused += u32::from(is_line && text.contains("not enough memory")),
                Some(0) => done += 1,
                _ => assert!(text.is_empty() || is_line, "{kib} {args:?}: {text}"),
            }
        }
    }
    assert!(refused > 0 && done > 0, "{refused} refused, {done} done");
}

/// The number of "213MiB".
fn mebibytes(text: &str) -> u64 {
    text.strip_suffix("MiB").unwrap().parse().unwrap()
}

#[test]
fn the_least_that_works_is_named_and_works() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for settings in waves_in(d) {
        let name = format!("{}.isospan", settings[1]);
        let out = reduce_with(d, &name, "5MiB", &settings);
        let stderr = String::from_utf8(out.stderr).unwrap();
        assert_eq!((out.status.code(), stderr.lines().count()), (Some(4), 1), "{stderr}");
        assert!(!d.join(&name).exists(), "refused before anything is made");
        let least = stderr.trim_end().rsplit(' ').next().unwrap().to_owned();
        let less = format!("{}MiB", mebibytes(&least) - 1);
        assert_eq!(reduce_with(d, &name, &less, &settings).status.code(), Some(4));
        assert!(reduce_with(d, &name, &least, &settings).status.success());
    }
}

#[test]
fn what_is_named_for_a_mesh_is_of_all_memory() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_mesh(&d.join("ball.vtk"), 24, |_| true, |p| p, |p| p[0] + p[1] * p[2]);
    let reduce = |memory: &str| {
        let settings = ["--count", "15000", "--memory", memory];
        isospan(d, &[&["-q", "reduce", "ball.vtk", "-o", "a.isospan"][..], &settings].concat())
    };
    // The samples of the boundary get a part of the memory; what is named is the whole of it. Then
    // chunks have a need of their own.
    let mut memory = "1MiB".to_owned();
    let mut said = vec![];
    loop {
        let out = reduce(&memory);
        if out.status.success() {
            break;
        }
        let stderr = String::from_utf8(out.stderr).unwrap();
        assert_eq!((out.status.code(), stderr.lines().count()), (Some(4), 1), "{stderr}");
        let what = stderr.split(": the run needs").next().unwrap().to_owned();
        assert!(!said.contains(&what), "told twice: {stderr}");
        said.push(what);
        memory = stderr.trim_end().rsplit(' ').next().unwrap().to_owned();
    }
    assert!(said[0].contains("samples of the boundary"), "{said:?}");
}

/// Of the questions that read all of an archive: what is named once is enough for what asked for
/// it.
#[test]
fn the_least_for_a_question_is_named_and_works() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let [settings, _] = waves_in(d);
    assert!(reduce_with(d, "a.isospan", "1GiB", &settings).status.success());
    // One point: of more, each may lie in a chunk that needs more.
    fs::write(d.join("points.csv"), "x,y,z\n1,2,3\n").unwrap();
    let questions: [&[&str]; 5] = [
        &["export", "a.isospan", "-o", "a.vtu"],
        &["probe", "a.isospan", "--grid", "9,9,9", "-o", "a.npy"],
        &["probe", "a.isospan", "--at", "points.csv", "-o", "a.csv"],
        &["measure", "a.isospan", "--against", "w.npy"],
        &["measure", "a.isospan", "--against", "w.npy", "--map", "a.vti"],
    ];
    for question in questions {
        let (mut memory, mut said) = ("1".to_owned(), vec![]);
        loop {
            let out = isospan(d, &[question, &["-q", "--memory", &memory]].concat());
            if out.status.success() {
                break;
            }
            let stderr = String::from_utf8(out.stderr).unwrap();
            assert_eq!((out.status.code(), stderr.lines().count()), (Some(4), 1), "{question:?}: {stderr}");
            let what = stderr.split(": the run needs").next().unwrap().to_owned();
            // How many points chunks share turns out as they come.
            let known = !what.contains("points that chunks share");
            assert!(!(known && said.contains(&what)), "{question:?} told twice: {stderr}");
            said.push(what);
            memory = stderr.trim_end().rsplit(' ').next().unwrap().to_owned();
        }
        assert!(!said.is_empty(), "{question:?}");
    }
}

#[test]
fn a_dry_run_tells_and_makes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let [settings, _] = waves_in(d);
    let dry =
        |memory| reduce_with(d, "a.isospan", memory, &[&settings[..], &["--dry-run", "--json"]].concat());
    let out = dry("1GiB");
    assert!(out.status.success());
    let told: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let number = |key: &str| told[key].as_u64().unwrap_or_else(|| panic!("{key}: {told}"));
    assert!(number("chunks") > 10 && number("memory_least") < number("memory_comfortable") + 1);
    assert!(number("archive_bytes") > 5 * number("points") && number("scratch_bytes") == 0);
    // The samples without the header of the file.
    assert_eq!(number("source_bytes"), 60 * 52 * 47 * 4);
    let words = reduce_with(d, "a.isospan", "1GiB", &[&settings[..], &["--dry-run"]].concat());
    let words = String::from_utf8(words.stdout).unwrap();
    assert!(
        words.contains(" of the source (572.8 KiB)") || words.contains(" THE SOURCE (572.8 KiB)"),
        "{words}"
    );
    let short = dry("5MiB");
    assert_eq!((short.status.code(), short.stdout.is_empty()), (Some(4), false), "told, and refused");
    assert_eq!(fs::read_dir(d).unwrap().count(), 1, "nothing but the input is there");
}

#[test]
fn a_surface_is_the_same_whatever_its_memory() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("w.npy"), [70, 60, 80], waves);
    let settings = ["--points", "hammersley", "--fraction", "1/2", "--chunk-points", "3000"];
    assert!(reduce_with(d, "w.isospan", "1GiB", &settings).status.success());
    let surface = |name: &str, memory: &str| {
        isospan(d, &["-q", "surface", "w.isospan", "-i", "0.1", "-o", name, "--memory", memory])
    };
    let refused = surface("no.ply", "5MiB");
    let stderr = String::from_utf8(refused.stderr).unwrap();
    assert_eq!((refused.status.code(), stderr.lines().count()), (Some(4), 1), "{stderr}");
    let least = stderr.trim_end().rsplit(' ').next().unwrap();
    // Chunks of 3000 points have some 20 000 tetrahedra, of 200 bytes at most.
    assert!(mebibytes(least) < 24, "{least}");
    assert!(surface("all.ply", "4GiB").status.success());
    // With this little, edges are closed many times on the way, and most of the surface waits on
    // disk.
    assert!(surface("least.ply", least).status.success());
    assert!(fs::read(d.join("all.ply")).unwrap() == fs::read(d.join("least.ply")).unwrap());
    assert!(isospan(d, &["check", "least.ply", "--within", "w.isospan"]).status.success());
}

#[test]
fn a_surface_is_checked_the_same_whatever_its_memory() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    // Short waves: much surface in few points, so that the least memory does not hold it.
    write_npy(&d.join("w.npy"), [54, 50, 46], |x, y, z| waves(4.0 * x, 4.0 * y, 4.0 * z));
    assert!(
        reduce_with(d, "w.isospan", "1GiB", &["--points", "regular", "--fraction", "1/2"]).status.success()
    );
    let mut reports = vec![];
    for format in ["ply", "stl", "obj", "vtp", "vtkhdf", "glb"] {
        let file = format!("s.{format}");
        assert!(isospan(d, &["-q", "surface", "w.isospan", "-i", "0.1", "-o", &file]).status.success());
        let check = |memory: &str| {
            let args =
                ["check", &file, "--within", "w.isospan", "--json", "--memory", memory, "--scratch", "."];
            isospan(d, &args)
        };
        let refused = check("5MiB");
        let stderr = String::from_utf8(refused.stderr).unwrap();
        assert_eq!((refused.status.code(), stderr.lines().count()), (Some(4), 1), "{stderr}");
        let least = stderr.trim_end().rsplit(' ').next().unwrap();
        let (all, little) = (check("4GiB"), check(least));
        assert!(
            all.status.success() && little.status.success(),
            "{}",
            String::from_utf8_lossy(&little.stderr)
        );
        assert_eq!(all.stdout, little.stdout, "{format}");
        reports.push(all.stdout);
    }
    assert!(reports.iter().all(|r| *r == reports[0]), "six formats of one surface");
    assert_eq!(fs::read_dir(d).unwrap().count(), 8, "nothing is left");
}

/// A stream's own chunks are counted: 96 MiB decoded do not fit in 64.
#[test]
fn what_a_decoder_needs_is_known_beforehand() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::create_dir(d.join("v.zarr")).unwrap();
    let array = "{\"zarr_format\": 2, \"shape\": [96, 1024, 1024], \"chunks\": [96, 1024, 1024], \"dtype\": \"|u1\", \
        \"compressor\": null, \"fill_value\": 0, \"order\": \"C\", \"filters\": null}";
    fs::write(d.join("v.zarr/.zarray"), array).unwrap();
    let dry = |memory: &str| {
        let args = [
            "reduce",
            "v.zarr",
            "-o",
            "v.isospan",
            "--points",
            "regular",
            "--count",
            "1000",
            "--dry-run",
            "--memory",
            memory,
        ];
        isospan(d, &args)
    };
    let refused = dry("64MiB");
    let stderr = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.status.code(), Some(4), "{stderr}");
    let least = stderr.trim_end().rsplit(' ').next().unwrap();
    assert!((97..400).contains(&mebibytes(least)), "{least}");
    assert!(dry(least).status.success());
}

/// Peak of anonymous resident memory of a run, sampled: pages of mapped files do not count.
#[cfg(target_os = "linux")]
fn peak_anonymous(command: &mut Command) -> u64 {
    let mut child = command.spawn().unwrap();
    let [status, program] = ["status", "exe"].map(|name| format!("/proc/{}/{name}", child.id()));
    let mut peak = 0;
    while child.try_wait().unwrap().is_none() {
        // For a moment the child still has the memory of this process.
        if fs::read_link(&program).is_ok_and(|path| !path.ends_with("isospan")) {
            continue;
        }
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|l| l.strip_prefix("RssAnon:"));
        let kib = line.and_then(|l| l.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
        peak = peak.max(kib.unwrap_or(0) * 1024);
        std::thread::sleep(std::time::Duration::from_millis(3));
    }
    assert!(child.wait().unwrap().success());
    peak
}

#[cfg(target_os = "linux")]
#[test]
fn the_budget_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("w.npy"), [130, 120, 110], waves);
    let budgets = [(72u64 << 20, "20000"), (240 << 20, "100000")];
    for (set, (budget, chunk)) in SETS.iter().flat_map(|set| budgets.map(|budget| (set, budget))) {
        let settings = ["--points", set, "--fraction", "1/8", "--chunk-points", chunk];
        let mut run = Command::new(env!("CARGO_BIN_EXE_isospan"));
        run.current_dir(d).args(["-q", "reduce", "w.npy", "-o", "a.isospan", "--force", "--threads", "2"]);
        run.args(["--memory", &budget.to_string()]).args(settings).stdout(std::process::Stdio::null());
        let peak = peak_anonymous(&mut run);
        assert!(peak > budget / 20, "{peak} bytes: nothing was measured");
        assert!(peak <= budget, "{set}: {peak} bytes of {budget}");
    }
}
