//! A reduction that is killed, stopped or out of room loses no chunk that was done; the same
//! command continues to the same bytes. Nothing is left that looks like a result, and in the end no
//! temporary file.
#![cfg(unix)]

use crate::common::*;
use rustix::process::Signal;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

fn command(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    command.current_dir(dir).args(args).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn spawn(dir: &Path, args: &[&str]) -> Child {
    command(dir, args).spawn().unwrap()
}

/// How a run ended, and its one line on standard error, if any.
fn end(child: Child) -> (ExitStatus, String) {
    let out = child.wait_with_output().unwrap();
    (out.status, String::from_utf8(out.stderr).unwrap())
}

fn ok(dir: &Path, args: &[&str]) {
    let (status, text) = end(spawn(dir, args));
    assert!(status.success() && text.is_empty(), "{args:?}: {status}: {text}");
}

fn signal(child: &Child, signal: Signal) {
    assert!(send_signal(child.id(), signal), "the process {} is still there", child.id());
}

/// Numbers below `n`, the same in every run of the test.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }
}

fn temporaries(dir: &Path) -> Vec<PathBuf> {
    folder(dir).into_keys().filter(|f| f.to_string_lossy().contains(".tmp")).collect()
}

const REDUCE: [&str; 10] =
    ["reduce", "-q", "v.npy", "--points", "hammersley", "--fraction", "1/3", "--chunk-points", "1000", "-o"];

fn reduce_to(out: &str) -> Vec<&str> {
    reduce_with(out, "2", "1GiB")
}

fn reduce_with<'a>(out: &'a str, threads: &'a str, memory: &'a str) -> Vec<&'a str> {
    [&REDUCE[..], &[out, "--threads", threads, "--memory", memory]].concat()
}

/// A small volume of many chunks, and what an uninterrupted run makes of it.
struct Case {
    dir: tempfile::TempDir,
    expected: std::collections::BTreeMap<PathBuf, Vec<u8>>,
    took: Duration,
}

impl Case {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        write_npy(&dir.path().join("v.npy"), [50, 44, 40], waves);
        let start = Instant::now();
        ok(dir.path(), &reduce_to("whole.isospan"));
        let took = start.elapsed();
        let expected = folder(&dir.path().join("whole.isospan"));
        Self { dir, expected, took }
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn same(&self, out: &str) {
        let got = folder(&self.path().join(out));
        assert!(got == self.expected, "{out}: {:?}", got.keys());
    }
}

/// Each run goes on with another number of threads, and another budget, than the one before.
#[test]
fn twenty_kills_at_random_moments_cost_nothing() {
    let case = Case::new();
    let (mut dice, mut kills, mut kept) = (Dice(7), 0, 0);
    let mut out = String::new();
    for run in 0u32.. {
        assert!(run < 400, "{kills} kills, {kept} left something to continue");
        if out.is_empty() {
            out = format!("k{run}.isospan");
        }
        let at = run as usize;
        let (threads, memory) = (["1", "2"][at % 2], ["48MiB", "64MiB", "1GiB"][at / 2 % 3]);
        let mut child = spawn(case.path(), &reduce_with(&out, threads, memory));
        // Within a third of a whole run, so that most archives are killed several times; later, if
        // that turns out to be too early.
        let within = case.took * (1 + run / 40) / 3;
        std::thread::sleep(Duration::from_micros(dice.roll(within.as_micros() as u64)));
        let enough = kills >= 20 && kept >= 5;
        if !enough && child.try_wait().unwrap().is_none() {
            child.kill().unwrap();
            let (status, _) = end(child);
            kills += u64::from(status.signal() == Some(9));
            let folder = case.path().join(&out);
            kept += u64::from(folder.exists() && !temporaries(&folder).is_empty());
            if folder.join("manifest.zst").exists() {
                // Killed when all was done, maybe before the sums of chunks were removed.
                let got = crate::common::folder(&folder);
                assert!(case.expected.iter().all(|(file, bytes)| got.get(file) == Some(bytes)), "{out}");
                ok(case.path(), &reduce_to(&out));
                case.same(&out);
                out.clear();
            }
            continue;
        }
        let (status, text) = end(child);
        assert!(status.success(), "{text}");
        case.same(&out);
        out.clear();
        if enough {
            break;
        }
    }
}

/// What was done before a kill is not done again: the chunks of the open segment are there too.
#[test]
fn a_killed_run_is_continued_chunk_by_chunk() {
    let case = Case::new();
    let journal = |f: &PathBuf| f.to_string_lossy().contains(".chunks.tmp");
    for tries in 0u32.. {
        assert!(tries < 100, "no run was killed within a segment");
        let mut child = spawn(case.path(), &reduce_to("c.isospan"));
        std::thread::sleep(case.took * (6 + tries % 10) / 16);
        child.kill().unwrap();
        child.wait().unwrap();
        let left = folder(&case.path().join("c.isospan"));
        let noted = left.iter().filter(|(f, bytes)| journal(f) && !bytes.is_empty()).count();
        if noted == 0 || left.contains_key(Path::new("manifest.zst")) {
            let _ = fs::remove_dir_all(case.path().join("c.isospan"));
            continue;
        }
        // The inode of the temporary is that of the finished segment: it was gone on with.
        let inode = |f: &Path| {
            use std::os::unix::fs::MetadataExt;
            fs::metadata(case.path().join("c.isospan").join(f)).map(|m| m.ino())
        };
        let (open, _) = left.iter().find(|(f, b)| journal(f) && !b.is_empty()).unwrap();
        let data = PathBuf::from(open.to_string_lossy().replace(".chunks.tmp", ".tmp"));
        let name = data.file_name().unwrap().to_string_lossy().into_owned();
        let segment = data.with_file_name(name[1..].split(".tmp-").next().unwrap());
        let before = inode(&data).unwrap();
        ok(case.path(), &reduce_to("c.isospan"));
        assert_eq!(inode(&segment).unwrap(), before, "{}", segment.display());
        case.same("c.isospan");
        return;
    }
}

/// Whether whoever started the tests ignores a signal, as `nohup` does with hangups: programs that
/// they start ignore it then.
fn is_ignored(signal: Signal) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|bits| u64::from_str_radix(bits.trim(), 16).ok()).unwrap_or(0);
    ignored >> (signal.as_raw() - 1) & 1 == 1
}

#[test]
fn signals_stop_a_run_in_a_state_that_continues() {
    let case = Case::new();
    let signals = [
        ("TERM", Signal::TERM),
        ("INT", Signal::INT),
        ("HUP", Signal::HUP),
        ("USR1", Signal::USR1),
        ("XCPU", Signal::XCPU),
    ];
    for (n, (name, number)) in (3u32..).zip(signals) {
        if is_ignored(number) {
            eprintln!("{name} is ignored here: not tried");
            continue;
        }
        let out = format!("{name}.isospan");
        let stopped = (0..60u32).find_map(|tries| {
            let child = spawn(case.path(), &reduce_to(&out));
            std::thread::sleep(case.took * (1 + (n + 2 * tries) % 11) / 12);
            signal(&child, number);
            let (status, text) = end(child);
            if status.code() == Some(75) {
                return Some((status, text));
            }
            // Done before the signal came, or ended by it before the program was set up.
            assert!(status.success() || status.signal().is_some(), "{name}: {status}: {text}");
            let _ = fs::remove_dir_all(case.path().join(&out));
            None
        });
        let (status, text) = stopped.expect("no run was stopped");
        assert_eq!(status.code(), Some(75), "{name}: {status}: {text}");
        assert!(text.trim_end().lines().count() == 1 && text.contains("same command continues"), "{text}");
        assert!(!case.path().join(&out).join("manifest.zst").exists());
        ok(case.path(), &reduce_to(&out));
        case.same(&out);
    }
}

/// What nohup started goes on when the terminal closes.
#[test]
#[cfg(target_os = "linux")]
fn an_ignored_hangup_stays_ignored() {
    let case = Case::new();
    for tries in 1..5u32 {
        let out = format!("n{tries}.isospan");
        let child = Command::new("bash")
            .current_dir(case.path())
            .args(["-c", "trap '' HUP; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_isospan")])
            .args(reduce_to(&out))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(case.took * tries / 5);
        send_signal(child.id(), Signal::HUP);
        let (status, text) = end(child);
        assert!(status.success() || status.signal() == Some(1) && tries == 1, "{status}: {text}");
        if status.success() {
            case.same(&out);
        }
    }
}

/// Whoever does not want to wait for the chunk presses twice.
#[test]
fn a_second_interrupt_ends_a_run_at_once() {
    let case = Case::new();
    for tries in 0u32.. {
        assert!(tries < 120, "no second signal came before the end");
        let child = spawn(case.path(), &reduce_to("i.isospan"));
        std::thread::sleep(case.took * (2 + tries % 7) / 10);
        // Time between the two to be seen as two, and too little for the run to end by itself, most
        // often.
        for pause in [u64::from(tries % 5 + 1), 0] {
            send_signal(child.id(), Signal::INT);
            std::thread::sleep(Duration::from_millis(pause));
        }
        let (status, text) = end(child);
        if status.signal() == Some(2) {
            assert_eq!(text, "", "ended by the signal, and by nothing else");
            break;
        }
        assert!(matches!(status.code(), Some(0 | 75)), "{status}: {text}");
        let _ = fs::remove_dir_all(case.path().join("i.isospan"));
    }
    ok(case.path(), &reduce_to("i.isospan"));
    case.same("i.isospan");
}

/// Under the name of a surface there is what was there before, or all of the new one.
#[test]
fn a_stopped_or_killed_surface_is_never_half_written() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [70, 60, 50], waves);
    ok(
        d,
        &[
            "reduce",
            "-q",
            "v.npy",
            "-o",
            "a.isospan",
            "--points",
            "regular",
            "--fraction",
            "1",
            "--chunk-points",
            "4000",
        ],
    );
    for format in ["ply", "stl"] {
        let out = format!("s.{format}");
        let args = ["surface", "-q", "a.isospan", "-i", "0.1", "-o", &out, "--memory", "32MiB", "--force"];
        let started = Instant::now();
        ok(d, &args);
        let (took, whole) = (started.elapsed(), fs::read(d.join(&out)).unwrap());
        assert!(whole.len() > 100_000);
        let (mut stopped, mut killed) = (0, 0);
        for n in 0..240u32 {
            if n >= 12 && stopped > 0 && killed > 0 {
                break;
            }
            fs::write(d.join(&out), "old").unwrap();
            let mut child = spawn(d, &args);
            std::thread::sleep(took * (1 + n % 12) / 13);
            let kill = n % 2 == 0;
            if kill {
                let _ = child.kill();
            } else if child.try_wait().unwrap().is_none() {
                send_signal(child.id(), Signal::TERM);
            }
            let (status, text) = end(child);
            stopped += u32::from(status.code() == Some(75));
            killed += u32::from(status.signal() == Some(9));
            let now = fs::read(d.join(&out)).unwrap();
            assert!(now == b"old" || now == whole, "{out}: {status}: {} bytes: {text}", now.len());
            assert!(now == whole || !status.success(), "{out}: done, and not there");
            assert!(kill || temporaries(d).is_empty() || killed > 0, "{:?}", temporaries(d));
        }
        assert!(stopped > 0 && killed > 0, "{stopped} stopped, {killed} killed");
        ok(d, &args);
        assert!(fs::read(d.join(&out)).unwrap() == whole && temporaries(d).is_empty(), "the next run sweeps");
    }
}

/// A limit on the size of files stands for a full disk: the program sees the same refusal of a
/// write.
#[test]
fn no_room_is_one_line_and_resumable() {
    let case = Case::new();
    for kib in [0u64, 8, 40] {
        let out = format!("{kib}.isospan");
        let limited = format!("ulimit -f {kib}; exec \"$0\" \"$@\"");
        let child = Command::new("bash")
            .current_dir(case.path())
            .args(["-c", &limited, env!("CARGO_BIN_EXE_isospan")])
            .args(reduce_to(&out))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (status, text) = end(child);
        assert_eq!(status.code(), Some(4), "{kib} KiB: {status}: {text}");
        assert!(text.trim_end().lines().count() == 1 && text.contains("make room"), "{text}");
        assert!(!case.path().join(&out).join("manifest.zst").exists());
        ok(case.path(), &reduce_to(&out));
        case.same(&out);
    }
    // The other writers leave nothing at all.
    for args in [
        vec!["brick", "v.npy", "-o", "v.bricks"],
        vec!["surface", "-q", "whole.isospan", "--isovalue", "0.1", "-o", "s.ply"],
        vec!["surface", "-q", "whole.isospan", "--isovalue", "0.1", "-o", "s.stl"],
    ] {
        let before = folder(case.path()).len();
        let child = Command::new("bash")
            .current_dir(case.path())
            .args(["-c", "ulimit -f 20; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_isospan")])
            .args(&args)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (status, text) = end(child);
        assert_eq!(status.code(), Some(4), "{args:?}: {status}: {text}");
        assert_eq!(text.trim_end().lines().count(), 1, "{text}");
        assert_eq!(folder(case.path()).len(), before, "{args:?}");
    }
}

/// The same with a real full file system.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "mounts a file system, which wants root; tools/check runs it"]
fn a_full_file_system_is_one_line_and_resumable() {
    let case = Case::new();
    // A small file system that only the shell and its children see; it fills up while the run,
    // asleep, has a segment open.
    let script =
        "mkdir small && mount -t tmpfs -o size=64m tmpfs small && cp v.npy small/ && cd small || exit 99
        for try in {1..60}; do
            \"$@\" 2>../full.err & run=$!
            until [ -n \"$(ls -A x.isospan/mesh 2>/dev/null)\" ] || ! kill -0 $run; do :; done 2>/dev/null
            kill -STOP $run; cat /dev/zero 2>/dev/null > fill; kill -CONT $run; wait $run; code=$?
            [ $code = 0 ] || break
            rm -r x.isospan fill
        done
        echo $code > ../full.code; ls x.isospan/manifest.zst 2>/dev/null > ../full.ls; rm fill
        \"$@\" 2>>../full.err; echo $? >> ../full.code; cp -r x.isospan ../full.isospan";
    let out = Command::new("unshare")
        .args(["--mount", "bash", "-c", script, "bash"])
        .arg(env!("CARGO_BIN_EXE_isospan"))
        .args(reduce_to("x.isospan"))
        .current_dir(case.path())
        .output();
    let code = fs::read_to_string(case.path().join("full.code")).unwrap_or_default();
    assert!(!code.is_empty(), "no right to mount a file system? {out:?}");
    let text = fs::read_to_string(case.path().join("full.err")).unwrap();
    assert_eq!(code, "4\n0\n", "{text}");
    assert!(text.trim_end().lines().count() == 1 && text.contains("No space left"), "{text}");
    assert_eq!(fs::read_to_string(case.path().join("full.ls")).unwrap(), "");
    case.same("full.isospan");
}

/// Folders that cannot be written to: a file in the place of one, and a read-only one.
#[test]
fn targets_that_cannot_be_written_are_one_line() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    write_npy(&dir.path().join("v.npy"), [12, 12, 12], ball);
    ok(dir.path(), &["reduce", "-q", "v.npy", "-o", "a.isospan"]);
    fs::write(dir.path().join("file"), "x").unwrap();
    let locked = dir.path().join("locked");
    fs::create_dir(&locked).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
    // Root is bound by permissions once its capabilities are gone, which setpriv of util-linux
    // takes.
    let bound = fs::write(locked.join("probe"), "x").is_err();
    let run = |args: &[&str]| match bound {
        true => spawn(dir.path(), args),
        false => Command::new("setpriv")
            .current_dir(dir.path())
            .args(["--inh-caps=-all", "--bounding-set=-all", env!("CARGO_BIN_EXE_isospan")])
            .args(args)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap(),
    };
    for folder in ["file", "locked"] {
        for args in [
            ["reduce", "-q", "v.npy", "-o", &format!("{folder}/x.isospan")].map(str::to_owned).to_vec(),
            ["brick", "v.npy", "-o", &format!("{folder}/x.bricks")].map(str::to_owned).to_vec(),
            ["surface", "-q", "a.isospan", "-i", "0", "-o", &format!("{folder}/x.ply")]
                .map(str::to_owned)
                .to_vec(),
        ] {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            let (status, text) = end(run(&args));
            assert!(matches!(status.code(), Some(1 | 2)), "{args:?}: {status}: {text}");
            assert!(text.trim_end().lines().count() == 1 && text.contains(folder), "{text}");
        }
    }
    assert!(fs::read(dir.path().join("file")).unwrap() == b"x" && temporaries(dir.path()).is_empty());
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o755)).unwrap();
}

/// A copy and a surface are stopped by a signal without a trace; what a kill leaves is removed by
/// the next run.
#[test]
fn brick_and_surface_leave_nothing() {
    let dir = tempfile::tempdir().unwrap();
    write_npy(&dir.path().join("v.npy"), [250, 250, 250], |x, y, z| x + y * z);
    let args = ["brick", "v.npy", "-o", "v.bricks", "--memory", "1MiB"];
    let files = || folder(dir.path()).into_keys().collect::<Vec<_>>();
    // The moments follow the machine's speed: they are spread over the time of a whole run.
    let started = std::time::Instant::now();
    ok(dir.path(), &args);
    let whole = started.elapsed();
    fs::remove_file(dir.path().join("v.bricks")).unwrap();
    let (mut stopped, mut left) = (0, 0);
    for n in 0..200u32 {
        if n >= 12 && stopped > 0 && left > 0 {
            break;
        }
        let mut child = spawn(dir.path(), &args);
        std::thread::sleep(whole * (1 + n % 16) / 18);
        if child.try_wait().unwrap().is_some() {
            let _ = fs::remove_file(dir.path().join("v.bricks"));
            continue;
        }
        if n % 2 == 0 {
            child.kill().unwrap();
            child.wait().unwrap();
            left += temporaries(dir.path()).len();
            continue;
        }
        signal(&child, Signal::TERM);
        let (status, text) = end(child);
        // Stopped, done before the signal came, or ended by it before the program was set up.
        if status.code() == Some(75) {
            stopped += 1;
            assert!(text.contains("nothing was written"), "{text}");
            assert_eq!(files(), [PathBuf::from("v.npy")]);
        }
        let _ = fs::remove_file(dir.path().join("v.bricks"));
    }
    ok(dir.path(), &args);
    assert_eq!(files(), [PathBuf::from("v.bricks"), PathBuf::from("v.npy")]);
    assert!(stopped > 0 && left > 0, "{stopped} stopped, {left} left something");
}

/// Steps that are added while the run is killed again and again: the archive is the old one until
/// it is the new one.
#[test]
fn kills_while_steps_are_added_leave_the_archive_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for t in 0..6 {
        let (name, t) = (format!("s{t}.npy"), f64::from(t));
        write_npy(&d.join(name), [40, 36, 32], |x, y, z| waves(x + 0.03 * t, y, z));
    }
    let base = ["--points", "regular", "--fraction", "1/2", "--chunk-points", "1000", "--no-measure"];
    let first = [&["reduce", "-q", "s0.npy", "s1.npy", "-o", "a.isospan"], &base[..]].concat();
    let all: Vec<&str> = ["s0.npy", "s1.npy", "s2.npy", "s3.npy", "s4.npy", "s5.npy"].to_vec();
    ok(d, &[&["reduce", "-q", "-o", "whole.isospan"], &all[..], &base[..]].concat());
    ok(d, &first);
    let append = [&["append", "-q", "--no-measure", "a.isospan"], &all[2..]].concat();
    let archive = d.join("a.isospan");
    let old = folder(&archive);
    let answer = || isospan::Archive::open(&archive).unwrap().count(0.1).unwrap().active_cells;
    let again = || {
        fs::remove_dir_all(&archive).unwrap();
        for (file, bytes) in &old {
            fs::create_dir_all(archive.join(file).parent().unwrap()).unwrap();
            fs::write(archive.join(file), bytes).unwrap();
        }
    };
    let (expected, mut dice, mut kills, mut kept) = (answer(), Dice(3), 0, 0);
    let start = Instant::now();
    ok(d, &append);
    let took = start.elapsed();
    again();
    // Until there were kills enough, a run that is done before its moment is for nothing.
    for run in 0u32.. {
        assert!(run < 400, "{kills} kills, {kept} left something to continue");
        let child = spawn(d, &append);
        std::thread::sleep(Duration::from_micros(dice.roll(took.as_micros() as u64)));
        signal(&child, Signal::KILL);
        let (status, text) = end(child);
        let manifest = Path::new("manifest.zst");
        if fs::read(archive.join(manifest)).unwrap() != old[manifest] {
            assert!(status.success() || status.signal() == Some(9), "{text}");
            again();
            continue;
        }
        kills += 1;
        let begun = archive.join("steps/000002-values-000000.seg").exists();
        kept += u64::from(!temporaries(&archive).is_empty() || begun);
        assert_eq!(answer(), expected);
        ok(d, &["check", "a.isospan"]);
        if kills >= 8 && kept > 0 {
            break;
        }
    }
    ok(d, &append);
    assert!(folder(&archive) == folder(&d.join("whole.isospan")));
    assert!(temporaries(d).is_empty());
}

/// The same where a step is put between others, or in the place of one to which others refer: until
/// the manifest names the new one, the archive is the old one.
#[test]
fn kills_while_steps_are_inserted_or_replaced_lose_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for t in 0..5 {
        let (name, t) = (format!("s{t}.npy"), f64::from(t));
        write_npy(&d.join(name), [40, 36, 32], |x, y, z| waves(x + 0.03 * t, y, z));
    }
    let base = ["--points", "regular", "--fraction", "1/2", "--chunk-points", "1000", "--no-measure"];
    let files = ["s0.npy", "s1.npy", "s2.npy", "s3.npy", "-o", "old.isospan", "--times", "0,1,2,3"];
    ok(d, &[&["reduce", "-q"], &files[..], &base[..]].concat());
    let (old, archive) = (folder(&d.join("old.isospan")), d.join("a.isospan"));
    let begin = || {
        let _ = fs::remove_dir_all(&archive);
        for (file, bytes) in &old {
            fs::create_dir_all(archive.join(file).parent().unwrap()).unwrap();
            fs::write(archive.join(file), bytes).unwrap();
        }
    };
    let manifest = Path::new("manifest.zst");
    for how in [&["--times", "1.5"][..], &["--times", "1", "--replace"]] {
        let append = [&["append", "-q", "--no-measure", "a.isospan", "s4.npy"], how].concat();
        begin();
        let start = Instant::now();
        ok(d, &append);
        let (took, whole) = (start.elapsed(), folder(&archive));
        begin();
        let (mut dice, mut kills) = (Dice(11), 0);
        for run in 0u32.. {
            assert!(run < 200, "{kills} kills within an append");
            let child = spawn(d, &append);
            std::thread::sleep(Duration::from_micros(dice.roll(took.as_micros() as u64)));
            signal(&child, Signal::KILL);
            let (status, text) = end(child);
            assert!(status.success() || status.signal() == Some(9), "{text}");
            let now = folder(&archive);
            let kept = |(file, bytes): (&PathBuf, &Vec<u8>)| file == manifest || now.get(file) == Some(bytes);
            assert!(old.iter().all(kept), "a file of the old archive is gone");
            ok(d, &["check", "a.isospan"]);
            if now[manifest] != old[manifest] {
                assert!(now[manifest] == whole[manifest]);
                begin();
                continue;
            }
            kills += 1;
            if kills >= 5 {
                break;
            }
        }
        ok(d, &append);
        assert!(folder(&archive) == whole && temporaries(d).is_empty());
    }
}

/// The same of a mesh. The kills come when a new step is under way: when its first segment is
/// there, then that of the next.
#[test]
fn a_kill_while_a_step_is_added_to_a_mesh_leaves_the_archive_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let names: Vec<String> = (0..3).map(|t| format!("m{t}.vtk")).collect();
    for (t, name) in names.iter().enumerate() {
        write_hexahedra(&d.join(name), |x, y, z| waves(x + 0.05 * t as f64, y, z));
    }
    let files: Vec<&str> = names.iter().map(String::as_str).collect();
    let choices = ["--points", "regular", "--fraction", "1", "--chunk-points", "200"];
    ok(d, &[&["reduce", "-q", "-o", "whole.isospan"], &files[..], &choices].concat());
    let archive = d.join("a.isospan");
    let append = ["append", "-q", "--threads", "1", "a.isospan", files[1], files[2]];
    let states = ["steps/000001-values-000000.seg", "steps/000002-values-000000.seg"];
    let mut kills = 0;
    for tries in 0.. {
        assert!(tries < 200, "{kills} kills within an append");
        if !archive.exists() {
            ok(d, &[&["reduce", "-q", files[0], "-o", "a.isospan"], &choices[..]].concat());
        }
        let old = fs::read(archive.join("manifest.zst")).unwrap();
        let mut child = spawn(d, &append);
        let started = Instant::now();
        while !archive.join(states[kills]).exists() && child.try_wait().unwrap().is_none() {
            assert!(started.elapsed() < Duration::from_secs(300), "the step is not begun");
            std::thread::sleep(Duration::from_millis(1));
        }
        let _ = child.kill();
        end(child);
        if fs::read(archive.join("manifest.zst")).unwrap() != old {
            // Killed when all was done: begin again.
            fs::remove_dir_all(&archive).unwrap();
            continue;
        }
        ok(d, &["check", "a.isospan"]);
        kills += 1;
        if kills == states.len() {
            break;
        }
    }
    ok(d, &append);
    assert!(folder(&archive) == folder(&d.join("whole.isospan")) && temporaries(d).is_empty());
}

/// A file above 16 MiB of which a byte changes, far from both ends: it is another file.
#[test]
fn a_changed_byte_in_a_large_input_is_noticed() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let side = 272usize;
    let bytes: Vec<u8> =
        (0..side.pow(3)).map(|i| ((i / side / side) as u8) ^ ((i % side) as u8 >> 4)).collect();
    assert!(bytes.len() > 19 << 20);
    let path = d.join("v.raw");
    let layout = ["--dims", "272,272,272", "--type", "uint8"];
    let reduce = [
        &[
            "reduce",
            "-q",
            "v.raw",
            "-o",
            "a.isospan",
            "--points",
            "regular",
            "--count",
            "3000",
            "--no-measure",
        ],
        &layout[..],
    ]
    .concat();
    let reduce = [&reduce[..], &["--values", "sample"]].concat();
    let plan = [&["plan", "-q"], &reduce[2..3], &["-o", "p.isospan"], &reduce[5..]].concat();
    let append = ["append", "-q", "a.isospan", "v.raw", "--dims", "272,272,272", "--type", "uint8"];
    fs::write(&path, &bytes).unwrap();
    ok(d, &reduce);
    let first = folder(&d.join("a.isospan"));
    let planned = command(d, &plan).status().unwrap();
    assert!(planned.success());
    // The archive ends with this very step already.
    ok(d, &append);
    assert_eq!(steps_of(&d.join("a.isospan")), 1);
    let mut changed = bytes.clone();
    // Between two of 64 evenly spaced pieces of 64 KiB.
    changed[(10 << 20) + 230_000] ^= 1;
    fs::write(&path, &changed).unwrap();
    let (status, text) = end(spawn(d, &["work", "-q", "p.isospan"]));
    assert!(status.code() == Some(5) && text.contains("not what it was when the plan was made"), "{text}");
    ok(d, &append);
    assert_eq!(steps_of(&d.join("a.isospan")), 2, "another step");
    fs::remove_dir_all(d.join("a.isospan")).unwrap();
    fs::write(&path, &bytes).unwrap();
    ok(d, &reduce);
    assert!(folder(&d.join("a.isospan")) == first);
    fs::write(&path, &changed).unwrap();
    let (status, text) = end(spawn(d, &reduce));
    assert!(status.code() == Some(2) && text.contains("exists"), "{status}: {text}");
    // What is as it was when it was planned, but for its times, is the same file.
    fs::write(&path, &bytes).unwrap();
    ok(d, &["work", "-q", "p.isospan"]);
    assert!(command(d, &["commit", "-q", "p.isospan"]).status().unwrap().success());
    assert!(folder(&d.join("p.isospan")) == first);
}

fn steps_of(archive: &Path) -> usize {
    isospan::archive::manifest::Manifest::read(archive).unwrap().steps.len()
}

/// An input that is written while it is read: nothing is published, and what is stored was read
/// before.
#[test]
fn an_input_that_changes_during_a_run_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [36, 34, 72], waves);
    let original = fs::read(d.join("v.npy")).unwrap();
    // As slices: more files than are looked at before each chunk.
    let slice = 36 * 34 * 4;
    for (z, bytes) in original[original.len() - 72 * slice..].chunks(slice).enumerate() {
        fs::write(d.join(format!("s{z:03}.raw")), bytes).unwrap();
    }
    let header = "NRRD0004\ntype: float\ndimension: 3\nsizes: 36 34 72\nencoding: raw\nendian: little\ndata file: s%03d.raw 0 71 1 2\n";
    fs::write(d.join("v.nhdr"), header).unwrap();
    for (input, file) in [("v.npy", "v.npy"), ("v.nhdr", "s071.raw")] {
        let args =
            reduce_with("x.isospan", "1", "1GiB").into_iter().map(|a| if a == "v.npy" { input } else { a });
        let args: Vec<&str> = args.collect();
        ok(d, &args);
        let expected = folder(&d.join("x.isospan"));
        fs::remove_dir_all(d.join("x.isospan")).unwrap();
        let before = fs::read(d.join(file)).unwrap();
        for tries in 0.. {
            assert!(tries < 60, "{input}: every run was done before the change");
            let mut child = spawn(d, &args);
            let begun =
                || fs::read_dir(d.join("x.isospan/mesh")).is_ok_and(|mut files| files.next().is_some());
            while !begun() && child.try_wait().unwrap().is_none() {}
            send_signal(child.id(), Signal::STOP);
            let mut changed = before.clone();
            *changed.last_mut().unwrap() ^= 1;
            fs::write(d.join(file), changed).unwrap();
            send_signal(child.id(), Signal::CONT);
            let (status, text) = end(child);
            fs::write(d.join(file), &before).unwrap();
            if status.code() == Some(5) {
                assert!(text.trim_end().lines().count() == 1 && text.contains(file), "{text}");
                assert!(text.contains("run the same command again"), "{text}");
                assert!(!d.join("x.isospan/manifest.zst").exists());
                break;
            }
            assert!(status.success(), "{status}: {text}");
            fs::remove_dir_all(d.join("x.isospan")).unwrap();
        }
        // With the bytes that it had, the run continues.
        ok(d, &args);
        assert!(folder(&d.join("x.isospan")) == expected, "{input}");
        fs::remove_dir_all(d.join("x.isospan")).unwrap();
    }
}

/// All that a killed commit has left is gone after the next one.
#[test]
fn a_commit_sweeps_what_killed_processes_have_left() {
    let case = Case::new();
    let d = case.path();
    let plan = [&["plan"], &REDUCE[1..], &["w.isospan"]].concat();
    for tries in 0.. {
        assert!(tries < 100, "no worker was killed with a segment open");
        assert!(command(d, &plan).status().unwrap().success());
        let mut child = spawn(d, &["work", "-q", "w.isospan", "--threads", "1"]);
        std::thread::sleep(case.took * (2 + tries % 9) / 12);
        child.kill().unwrap();
        child.wait().unwrap();
        let left = temporaries(&d.join("w.isospan"));
        let Some(one) = left.first() else {
            let _ = fs::remove_dir_all(d.join("w.isospan"));
            continue;
        };
        // The same writer might have left a file that will never be written again.
        let name = one.file_name().unwrap().to_string_lossy().into_owned();
        let (_, writer) = name.split_once(".tmp-").unwrap();
        fs::write(d.join("w.isospan/steps").join(format!(".000009-index.seg.tmp-{writer}")), "left").unwrap();
        break;
    }
    ok(d, &["work", "-q", "w.isospan"]);
    assert!(command(d, &["commit", "-q", "w.isospan"]).status().unwrap().success());
    case.same("w.isospan");
}

/// A search that had finished is asked for again: it says so. Of another input, or with another
/// target, it is refused.
#[test]
fn a_target_that_was_met_is_not_looked_for_again() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [24, 22, 20], waves);
    for target in [["--target-rms", "3%"], ["--target-max", "30%"]] {
        let args = [&["reduce", "-q", "v.npy", "-o", "t.isospan"], &target[..]].concat();
        ok(d, &args);
        let made = folder(&d.join("t.isospan"));
        let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(&args).output().unwrap();
        let text = String::from_utf8(out.stdout).unwrap();
        assert!(out.status.success() && text.contains("nothing left to make"), "{text}");
        let other = [&args[..6], &[if target[0] == "--target-rms" { "2%" } else { "29%" }]].concat();
        assert_eq!(end(spawn(d, &other)).0.code(), Some(2));
        write_npy(&d.join("v.npy"), [24, 22, 20], |x, y, z| waves(x, y, z) * 1.5);
        assert_eq!(end(spawn(d, &args)).0.code(), Some(2));
        write_npy(&d.join("v.npy"), [24, 22, 20], waves);
        assert!(folder(&d.join("t.isospan")) == made);
        fs::remove_dir_all(d.join("t.isospan")).unwrap();
    }
}
