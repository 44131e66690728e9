//! Reductions on a real Slurm of two nodes, started by `tools/slurm/cluster`: the bytes are those
//! of `reduce`, regardless of what happens to the nodes.
//!
//! Takes about two minutes and wants root and Debian's slurmctld, slurmd, slurm-client and munge,
//! so it is ignored unless asked for: `cargo test --test it slurm:: -- --ignored`, which CI does.
#![cfg(target_os = "linux")]

use crate::common::*;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

/// 22 segments: a chunk is a brick.
const CHOICES: [&str; 6] = ["--points", "hammersley", "--fraction", "1/2", "--chunk-points", "120"];
const DIMS: [usize; 3] = [80, 80, 80];

struct Cluster {
    dir: tempfile::TempDir,
    port: u16,
    expected: BTreeMap<PathBuf, Vec<u8>>,
}

impl Cluster {
    fn start() -> Self {
        let dir = tempfile::tempdir().unwrap();
        // Several clusters may run on this machine; the nodes use the next two ports.
        let port = 20_000 + (std::process::id() % 10_000) as u16 * 3;
        let mut cluster = Self { dir, port, expected: BTreeMap::new() };
        cluster.control(&["start"]);
        write_npy(&cluster.path().join("v.npy"), DIMS, waves);
        cluster.ok(&[&["reduce", "v.npy", "-o", "whole.isospan"], &CHOICES[..]].concat());
        cluster.expected = folder(&cluster.path().join("whole.isospan"));
        assert!(cluster.expected.len() > 16, "as many segments as shards");
        cluster
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn command(&self, program: &str, args: &[&str]) -> Command {
        let mut command = Command::new(program);
        command
            .current_dir(self.path())
            .args(args)
            .env("SLURM_CONF", self.path().join("slurm/slurm.conf"))
            .env("ISOSPAN_SLURM_DIR", self.path().join("slurm"))
            .env("ISOSPAN_SLURM_PORT", self.port.to_string());
        command
    }

    /// What a command prints; it must succeed.
    fn run(&self, program: &str, args: &[&str]) -> String {
        let Output { status, stdout, stderr } = self.command(program, args).output().unwrap();
        let text = |b: &[u8]| String::from_utf8_lossy(b).into_owned();
        assert!(status.success(), "{program} {args:?}: {status}: {}{}", text(&stdout), text(&stderr));
        text(&stdout)
    }

    fn control(&self, args: &[&str]) {
        // Nodes outlive the script, and would hold its pipes.
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/slurm/cluster");
        let log = fs::File::create(self.path().join("cluster.log")).unwrap();
        let mut command = self.command(script, args);
        let status = command.stdout(log.try_clone().unwrap()).stderr(log).status().unwrap();
        let log = fs::read_to_string(self.path().join("cluster.log")).unwrap();
        assert!(status.success(), "cluster {args:?}: {log}");
    }

    fn ok(&self, args: &[&str]) -> String {
        self.run(env!("CARGO_BIN_EXE_isospan"), &[args, &["-q"]].concat())
    }

    fn plan(&self, out: &str, shards: u64) {
        let shards = shards.to_string();
        self.ok(&[&["plan", "v.npy", "-o", out, "--shards", &shards], &CHOICES[..]].concat());
    }

    /// Submits shards and commit; gives the number of the array.
    fn submit(&self, out: &str, more: &[&str]) -> String {
        let args = ["slurm", out, "--submit", "--json", "--memory", "200MiB"];
        let report: serde_json::Value = serde_json::from_str(&self.ok(&[&args[..], more].concat())).unwrap();
        report["work_job"].as_str().unwrap().to_owned()
    }

    /// Waits until no job of an archive is left; requeued ones start without the usual delay.
    fn finish(&self, what: &str) {
        wait(what, || {
            self.control(&["hurry"]);
            self.run("squeue", &["-h", "-o", "%i %T %r"]).is_empty()
        });
    }

    /// Waits until a worker on a node is within a segment: gives its temporary file.
    fn at_work(&self, out: &str, node: &str) -> PathBuf {
        let mut found = None;
        wait("a worker within a segment", || {
            let mark = format!(".tmp-{node}");
            let files = folder_names(&self.path().join(out).join("steps"));
            let is_of_values = |f: &String| f.contains("-values-") && !f.contains(".chunks");
            found = files.into_iter().find(|f| f.contains(&mark) && is_of_values(f));
            found.is_some()
        });
        self.path().join(out).join("steps").join(found.unwrap())
    }

    /// Stops the workers of an archive when the one on a node is within a segment, which it then
    /// cannot finish.
    fn held_at_work(&self, out: &str, node: &str) -> PathBuf {
        loop {
            let file = self.at_work(out, node);
            self.signal(Signal::STOP, out);
            if file.exists() {
                return file;
            }
            self.signal(Signal::CONT, out);
        }
    }

    /// The workers of an archive that run now.
    fn workers(&self, out: &str) -> Vec<String> {
        let pattern = format!("work {}", self.path().join(out).display());
        let is_worker = |entry: &fs::DirEntry| {
            let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
            let line = String::from_utf8_lossy(&line).replace('\0', " ");
            line.contains(&pattern) && line.starts_with(env!("CARGO_BIN_EXE_isospan"))
        };
        let found = fs::read_dir("/proc").unwrap().flatten().filter(is_worker);
        found.map(|entry| entry.file_name().into_string().unwrap()).collect()
    }

    /// A signal to the workers of an archive that run now.
    fn signal(&self, signal: Signal, out: &str) -> usize {
        let send = |pid: &String| send_signal(pid.parse().unwrap(), signal);
        self.workers(out).iter().filter(|pid| send(pid)).count()
    }

    /// Whether a worker has been told to end, and sleeps too deeply to hear it.
    fn is_told_to_end(&self, out: &str) -> bool {
        const TERM: u64 = 1 << (15 - 1);
        self.workers(out).iter().any(|pid| {
            let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
            let pending = status.lines().find_map(|l| l.strip_prefix("ShdPnd:"));
            pending.is_some_and(|set| u64::from_str_radix(set.trim(), 16).unwrap() & TERM != 0)
        })
    }

    /// Waits for the end of a job; returns what Slurm reports of it.
    fn ended(&self, job: &str) -> String {
        let mut about = String::new();
        wait("a job", || {
            about = self.run("scontrol", &["show", "job", job]);
            !["PENDING", "RUNNING", "COMPLETING"].iter().any(|s| about.contains(&format!("JobState={s}")))
        });
        about
    }

    fn same(&self, out: &str) {
        self.ok(&["gc", out, "--older-than", "0s"]);
        let got = folder(&self.path().join(out));
        let logs = || self.logs(out);
        assert!(got == self.expected, "{out}: {:?}\n{}", got.keys(), logs());
    }

    fn logs(&self, out: &str) -> String {
        let logs = folder(&self.path().join(format!("{out}.work/slurm")));
        logs.iter()
            .map(|(f, text)| format!("{}:\n{}\n", f.display(), String::from_utf8_lossy(text)))
            .collect()
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            return self.control(&["stop"]);
        }
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/slurm/cluster");
        let _ = self.command(script, &["stop"]).output();
    }
}

fn folder_names(path: &Path) -> Vec<String> {
    let entries = fs::read_dir(path).into_iter().flatten().flatten();
    entries.map(|e| e.file_name().to_string_lossy().into_owned()).collect()
}

fn wait(what: &str, mut done: impl FnMut() -> bool) {
    let started = Instant::now();
    while !done() {
        assert!(started.elapsed() < Duration::from_secs(180), "waited three minutes for {what}");
        std::thread::sleep(Duration::from_millis(60));
    }
}

/// What is printed of it, and what happens.
type Scene = (&'static str, fn(&Cluster));

#[test]
#[ignore = "starts a Slurm; tools/check runs it with ISOSPAN_SLURM_TESTS=1"]
fn a_real_slurm_gives_the_bytes_of_reduce() {
    let cluster = Cluster::start();
    let scenes: [Scene; 9] = [
        ("1, 3 and 16 shards", numbers_of_shards),
        ("a node without power", a_node_loses_power),
        ("a node without network", a_node_loses_the_network),
        ("a task stopped before its limit", a_task_is_told_to_stop),
        ("damage before the commit", commit_mends),
        ("nodes of different age", old_and_new_nodes),
        ("srun in an allocation", srun_in_an_allocation),
        ("tries for a target", tries_for_a_target),
        ("nightly jobs", nightly_jobs),
    ];
    for (name, scene) in scenes {
        let started = Instant::now();
        scene(&cluster);
        eprintln!("{name}: {:.1} s", started.elapsed().as_secs_f64());
    }
}

fn numbers_of_shards(c: &Cluster) {
    for shards in [1, 3, 16] {
        let out = format!("s{shards}.isospan");
        c.plan(&out, shards);
        c.submit(&out, &["--threads", "1"]);
    }
    c.finish("shards");
    [1, 3, 16].iter().for_each(|n| c.same(&format!("s{n}.isospan")));
}

/// More tries than a commit submits missing shards: each try begins to count anew.
fn tries_for_a_target(c: &Cluster) {
    let target = ["--target-rms", "0.6%", "--chunk-points", "120", "--points", "hammersley"];
    c.ok(&[&["reduce", "v.npy", "-o", "target-whole.isospan"], &target[..]].concat());
    c.ok(&[&["plan", "v.npy", "-o", "target.isospan", "--shards", "3"], &target[..]].concat());
    c.submit("target.isospan", &["--threads", "1", "--tries", "1"]);
    c.finish("tries");
    c.ok(&["gc", "target.isospan", "--older-than", "0s"]);
    let [whole, made] = ["target-whole.isospan", "target.isospan"].map(|name| folder(&c.path().join(name)));
    assert!(whole == made, "{:?}\n{}", made.keys(), c.logs("target.isospan"));
    assert!(c.logs("target.isospan").contains("try 2"));
}

/// All that runs on the node ends at once; Slurm notices, and the tasks start again elsewhere.
fn a_node_loses_power(c: &Cluster) {
    c.plan("power.isospan", 2);
    c.submit("power.isospan", &["--threads", "2"]);
    let left = c.held_at_work("power.isospan", "n1");
    c.control(&["kill-node", "n1"]);
    c.signal(Signal::CONT, "power.isospan");
    c.finish("what the other node does");
    let manifest = c.path().join("power.isospan/manifest.zst");
    assert!(manifest.exists(), "{}", c.logs("power.isospan"));
    assert!(left.exists(), "what the dead node left is not touched by others");
    c.control(&["start-node", "n1"]);
    c.same("power.isospan");
}

/// The controller gives the node up and starts its task elsewhere, while the first one wakes up and
/// goes on writing.
fn a_node_loses_the_network(c: &Cluster) {
    c.plan("cut.isospan", 2);
    c.submit("cut.isospan", &["--threads", "2"]);
    // Asleep until the other node has taken over, so that both write at the same time.
    c.held_at_work("cut.isospan", "n1");
    c.control(&["cut-node", "n1"]);
    let array = || c.run("squeue", &["-h", "-r", "-n", "isospan-cut", "-o", "%T %r %N"]);
    wait("the task to be requeued", || {
        c.control(&["hurry"]);
        // The task on the living node sleeps too: only the other one is given up.
        array().lines().any(|l| l.starts_with("PENDING"))
    });
    assert!(c.signal(Signal::CONT, "cut.isospan") > 0, "the given-up task is still there");
    c.finish("both tasks");
    c.control(&["heal-node", "n1"]);
    c.same("cut.isospan");
    wait("the node to come back", || c.run("sinfo", &["-h", "-N", "-o", "%t"]).lines().all(|s| s == "idle"));
}

fn a_task_is_told_to_stop(c: &Cluster) {
    c.plan("term.isospan", 2);
    let job = c.submit("term.isospan", &["--threads", "2"]);
    c.held_at_work("term.isospan", "n1");
    // What --signal does before the time limit.
    c.run("scancel", &["--batch", "--signal=TERM", &job]);
    // The signal waits for the worker to wake up.
    wait("the signal", || c.is_told_to_end("term.isospan"));
    c.signal(Signal::CONT, "term.isospan");
    c.finish("a second try");
    c.same("term.isospan");
    let logs = c.logs("term.isospan");
    assert!(logs.contains("same command continues") && logs.contains("try 1 of 3: shards"), "{logs}");
}

/// Missing, cut short, and of another plan; more shards than an array may have.
fn commit_mends(c: &Cluster) {
    let out = "mend.isospan";
    c.plan(out, 16);
    c.ok(&["slurm", out, "--threads", "1", "--max-array", "5", "--tries", "2"]);
    c.ok(&["work", out]);
    c.ok(&[
        "plan",
        "v.npy",
        "-o",
        "other.isospan",
        "--points",
        "hammersley",
        "--fraction",
        "1/2",
        "--chunk-points",
        "121",
    ]);
    c.ok(&["work", "other.isospan", "--shard", "0/16"]);
    let values =
        |archive: &str, n: u32| c.path().join(archive).join(format!("steps/000000-values-{n:06}.seg"));
    fs::remove_file(values(out, 5)).unwrap();
    let cut = values(out, 10);
    fs::write(&cut, &fs::read(&cut).unwrap()[..999]).unwrap();
    fs::copy(values("other.isospan", 0), values(out, 0)).unwrap();
    let script = |n: &str| c.path().join(format!("{out}.work/slurm/{n}")).display().to_string();
    let refused = c.run("sbatch", &["--parsable", "--export=ALL,ISOSPAN_TRY=2", &script("commit.sh")]);
    c.finish("the last try");
    let about = c.run("scontrol", &["show", "job", refused.trim()]);
    assert!(about.contains("ExitCode=3:0"), "{about}");
    let logs = c.logs(out);
    for part in [
        "values-000000.seg (of another plan)",
        "values-000005.seg (not there)",
        "values-000010.seg (damaged)",
    ] {
        assert!(logs.contains(part), "{part}: {logs}");
    }
    assert!(!c.path().join(out).join("manifest.zst").exists());
    c.run("sbatch", &["--parsable", &script("commit.sh")]);
    c.finish("what is missing");
    c.same(out);
    assert!(c.logs(out).contains("try 1 of 2: shards 0-2 are missing"), "{}", c.logs(out));
}

/// Half of the shards without vector instructions.
fn old_and_new_nodes(c: &Cluster) {
    c.plan("old.isospan", 4);
    c.ok(&["slurm", "old.isospan", "--threads", "1"]);
    let script = c.path().join("old.isospan.work/slurm/work.sh").display().to_string();
    // A comma would end a value of --export.
    for (array, tunables) in [("0,2", "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-FMA4"), ("1,3", "")] {
        let args = ["--parsable", "--export=ALL", &format!("--array={array}"), &script];
        let out = c.command("sbatch", &args).env("GLIBC_TUNABLES", tunables).output().unwrap();
        assert!(out.status.success(), "{out:?}");
    }
    c.finish("old and new nodes");
    c.ok(&["commit", "old.isospan"]);
    c.same("old.isospan");
}

fn srun_in_an_allocation(c: &Cluster) {
    c.plan("srun.isospan", 1);
    let program = env!("CARGO_BIN_EXE_isospan");
    let task = format!("{program} work -q srun.isospan --threads 1 --shard $SLURM_PROCID/$SLURM_NTASKS");
    let printed = c.run("srun", &["--ntasks=3", "--nodes=2", "sh", "-c", &task]);
    assert_eq!(printed.lines().filter(|l| l.contains("/3")).count(), 3, "{printed}");
    c.ok(&["commit", "srun.isospan"]);
    c.same("srun.isospan");
}

/// A night's work as a job, which submits itself for the next one.
fn nightly_jobs(c: &Cluster) {
    fs::create_dir(c.path().join("scope")).unwrap();
    let new_file = |name: &str, dims, drift: f64| {
        write_npy(&c.path().join("scope").join(name), dims, |x, y, z| waves(x + drift, y, z));
    };
    // The exit code of a night, and its summary.
    let night = |more: &[&str]| -> (String, serde_json::Value) {
        let args = ["nightly", "scope", "t*.npy", "scope.isospan", "--settle=0s", "--submit=now"];
        let args = [&args[..], &CHOICES[..], more].concat();
        let job = c.run(env!("CARGO_BIN_EXE_isospan"), &args);
        let about = c.ended(job.trim());
        let code = about.split_whitespace().find_map(|w| w.strip_prefix("ExitCode=")).unwrap().to_owned();
        let folder = c.path().join("scope.isospan.work/nightly");
        let ends = format!("-{}.json", job.trim());
        let name = folder_names(&folder).into_iter().find(|f| f.ends_with(&ends)).expect(&about);
        assert!(folder.join(&name).with_extension("txt").exists());
        (code, serde_json::from_slice(&fs::read(folder.join(name)).unwrap()).unwrap())
    };
    let count = |summary: &serde_json::Value, what: &str| summary[what].as_array().unwrap().len();
    new_file("t1.npy", [40, 38, 36], 0.0);
    new_file("t2.npy", [40, 38, 36], 0.02);
    let (code, summary) = night(&["--option=--comment=night"]);
    assert!(code == "0:0" && count(&summary, "added") == 2, "{code} {summary}");
    // One more, and one that does not fit.
    new_file("t3.npy", [40, 38, 36], 0.04);
    new_file("t4.npy", [40, 38, 20], 0.06);
    let (code, summary) = night(&["--again"]);
    assert!(code == "1:0" && count(&summary, "added") == 1, "{code} {summary}");
    let next = c.run("squeue", &["-h", "-t", "PENDING", "-n", "isospan-nightly", "-o", "%i %V %S"]);
    assert_eq!(next.lines().count(), 1, "{next}");
    c.run("scancel", &[next.split_whitespace().next().unwrap()]);
    fs::remove_file(c.path().join("scope/t4.npy")).unwrap();
    let all = ["t1.npy", "t2.npy", "t3.npy"].map(|f| format!("scope/{f}"));
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    c.ok(&[&["reduce", "-o", "at-once.isospan"], &all[..], &CHOICES[..]].concat());
    assert!(folder(&c.path().join("scope.isospan")) == folder(&c.path().join("at-once.isospan")));
}
