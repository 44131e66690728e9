//! The two I/O modes give the same; a file that shrinks while it is read is an error and not the
//! end of the process; progress comes in the form that was asked for.

use crate::common::*;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

fn ok(dir: &Path, args: &[&str]) -> (String, String) {
    let out = isospan(dir, args);
    let (stdout, stderr) = (String::from_utf8(out.stdout).unwrap(), String::from_utf8(out.stderr).unwrap());
    assert!(out.status.success(), "{args:?}: {stderr}");
    (stdout, stderr)
}

/// Others of a machine do not read what one user's data is copied to; what the user asks for has
/// the usual permissions.
#[test]
#[cfg(target_os = "linux")]
fn copies_in_the_scratch_folder_are_private() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::create_dir(d.join("scratch")).unwrap();
    write_npy(&d.join("w.npy"), [128, 128, 100], waves);
    let plain = fs::read(d.join("w.npy")).unwrap();
    let mut packed = flate2::write::GzEncoder::new(
        fs::File::create(d.join("w.raw.gz")).unwrap(),
        flate2::Compression::fast(),
    );
    std::io::Write::write_all(&mut packed, &plain[plain.len() - 4 * 128 * 128 * 100..]).unwrap();
    packed.finish().unwrap();
    // While it is copied the copy has a name; it is looked at from outside, again and again.
    let mut seen = vec![];
    for _ in 0..20 {
        let mut child = Command::new(env!("CARGO_BIN_EXE_isospan"))
            .current_dir(d)
            .args([
                "reduce",
                "-q",
                "w.raw.gz",
                "--dims",
                "128,128,100",
                "--type",
                "float32",
                "--points",
                "regular",
                "--fraction",
                "1/64",
                "--no-measure",
            ])
            .args(["--memory", "160MiB", "--scratch", "scratch", "--force", "-o", "w.isospan"])
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        while child.try_wait().unwrap().is_none() {
            for entry in fs::read_dir(d.join("scratch")).unwrap().flatten() {
                seen.extend(entry.metadata().map(|about| about.permissions().mode() & 0o777));
            }
        }
        assert!(child.wait().unwrap().success());
        if !seen.is_empty() {
            break;
        }
    }
    assert!(!seen.is_empty() && seen.iter().all(|&mode| mode == 0o600), "{seen:?}");
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    fs::write(d.join("usual"), "").unwrap();
    assert_eq!(mode(&d.join("w.isospan/manifest.zst")), mode(&d.join("usual")));
}

#[test]
fn mapped_and_read_files_give_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("w.npy"), [45, 37, 41], waves);
    // A text, which is searched and not only copied: values of a legacy VTK file.
    let text: String = (0..40 * 30 * 20).map(|i| format!("{}\n", (i * 37 % 101) as f32 / 7.0)).collect();
    let head = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 40 30 20\nORIGIN 0 0 0\nSPACING 1 1 1\nPOINT_DATA 24000\nSCALARS s float\nLOOKUP_TABLE default\n";
    fs::write(d.join("t.vtk"), format!("{head}{text}")).unwrap();
    ok(d, &["brick", "w.npy", "-o", "w.bricks", "--io", "map"]);
    for input in ["w.npy", "t.vtk", "w.bricks"] {
        let mut results = vec![];
        for io in ["map", "read", "auto"] {
            let info = ok(d, &["info", input, "--json", "--io", io]).0;
            let (archive, bricks) = (format!("{input}.{io}.isospan"), format!("{input}.{io}.bricks"));
            ok(
                d,
                &[
                    "reduce",
                    input,
                    "-o",
                    &archive,
                    "--io",
                    io,
                    "--points",
                    "regular",
                    "--fraction",
                    "1/2",
                    "--chunk-points",
                    "5000",
                ],
            );
            ok(d, &["brick", input, "-o", &bricks, "--io", io]);
            results.push((info, folder(&d.join(&archive)), fs::read(d.join(&bricks)).unwrap()));
        }
        assert!(results.iter().all(|r| *r == results[0]), "{input}");
    }
    let refused = isospan(d, &["info", "w.npy", "--io", "guess"]);
    assert_eq!(refused.status.code(), Some(2));
}

/// Cuts the input at several moments of a run; each run ends by itself, with a result or with one
/// line that names the file.
#[test]
#[cfg(unix)]
fn an_input_that_shrinks_is_an_error_that_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("good.npy"), [120, 110, 100], waves);
    let whole = fs::metadata(d.join("good.npy")).unwrap().len();
    let mut failed = 0;
    for (n, io) in (0..100).zip(["map", "read"].into_iter().cycle()) {
        if n >= 10 && failed >= 3 {
            break;
        }
        fs::copy(d.join("good.npy"), d.join("v.npy")).unwrap();
        let (out, n) = (format!("{n}.isospan"), n % 10);
        let args = [
            "reduce",
            "v.npy",
            "-o",
            &out,
            "--io",
            io,
            "--points",
            "regular",
            "--chunk-points",
            "20000",
            "--threads",
            "2",
            "-q",
        ];
        let child = Command::new(env!("CARGO_BIN_EXE_isospan"))
            .current_dir(d)
            .args(args)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(std::time::Duration::from_millis(5 + 30 * n));
        let file = fs::File::options().write(true).open(d.join("v.npy")).unwrap();
        file.set_len(whole / 20 * n + 1000).unwrap();
        let out = child.wait_with_output().unwrap();
        let line = String::from_utf8(out.stderr).unwrap();
        match out.status.code() {
            Some(0) => assert_eq!(line, ""),
            Some(1 | 5) => {
                failed += 1;
                assert!(line.trim_end().lines().count() == 1 && line.contains("v.npy"), "{line}");
            }
            other => panic!("{other:?} ({}): {line}", out.status),
        }
    }
    assert!(failed >= 3, "{failed} runs met the cut");
}

#[test]
fn progress_comes_in_the_form_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("w.npy"), [40, 30, 20], waves);
    let reduce = |extra: &[&str]| {
        ok(
            d,
            &[
                &[
                    "reduce",
                    "w.npy",
                    "-o",
                    "w.isospan",
                    "--points",
                    "regular",
                    "--force",
                    "--spacing",
                    "1,1,1",
                ],
                extra,
            ]
            .concat(),
        )
    };
    // JSON alone on standard error, the counts of each stage complete.
    let (_, err) = reduce(&["--progress", "json", "-v"]);
    let lines: Vec<serde_json::Value> = err.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let events = |name: &str| lines.iter().filter(|l| l["event"] == name).collect::<Vec<_>>();
    let stages: Vec<_> = events("begin").iter().map(|e| e["stage"].clone()).collect();
    assert_eq!((stages, events("end").len()), (vec!["reduce".into()], 1), "{err}");
    assert!(
        events("end").iter().all(|e| e["done"] == e["total"] && e["done"].as_u64().unwrap() > 0),
        "{err}"
    );
    assert!(events("note").iter().any(|n| n["text"].as_str().unwrap().contains("I/O: mapped")), "{err}");
    // A short run has no lines of progress; -v reports memory, I/O and stages, -q nothing.
    let (_, err) = reduce(&["--progress", "plain", "-v", "--io", "read", "--threads", "2"]);
    for word in ["memory", "2 threads", "I/O: read", "mesh:", "commit:", "halos"] {
        assert!(err.contains(word), "{word}: {err}");
    }
    assert!(err.lines().all(|l| l.starts_with("isospan: ")), "{err}");
    for form in ["auto", "bar", "plain", "json", "none"] {
        assert_eq!(reduce(&["--progress", form, "-q"]).1, "", "{form}");
    }
    assert_eq!(reduce(&["--progress", "none", "--memory", "1GiB"]).1, "");
    let (_, err) = ok(d, &["surface", "w.isospan", "-i", "0.1", "-o", "s.ply", "-v"]);
    assert!(err.contains("extract:"), "{err}");
    let (_, err) = ok(d, &["brick", "w.npy", "-o", "w.bricks", "--progress", "json"]);
    assert!(err.lines().last().unwrap().contains("\"end\""), "{err}");
    assert_eq!(isospan(d, &["info", "w.npy", "-q", "-v"]).status.code(), Some(2));
}
