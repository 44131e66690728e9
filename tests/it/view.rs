//! `isospan view`: who only connects keeps nobody out, and the token is nowhere to be seen.

use crate::common::*;
use isospan::pipeline::Amount;
use isospan::points::SetKind;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A server of the archive `a.isospan`, its address, and the path of the page.
struct Viewer {
    child: Child,
    address: String,
    path: String,
}

impl Viewer {
    fn start(dir: &Path, change: impl FnOnce(&mut Command)) -> Self {
        let volume = dir.join("a.npy");
        write_npy(&volume, [20, 18, 16], waves);
        let few = settings(SetKind::Halton, Amount::Fraction(0.25), 3_000);
        crate::common::reduce(&volume, &few, &dir.join("a.isospan"), 1);
        let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
        command.current_dir(dir).args(["view", "a.isospan", "-q"]).stdout(Stdio::piped());
        change(&mut command);
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let (address, path) = line.trim().strip_prefix("http://").unwrap().split_once('/').unwrap();
        Self { child, address: address.to_owned(), path: format!("/{path}") }
    }

    /// The answer to a question, without its head.
    fn answer(&self, question: &str) -> Vec<u8> {
        let mut stream = self.connect();
        self.send(&mut stream, &format!("{}{question}", self.path));
        let mut answer = vec![];
        stream.read_to_end(&mut answer).unwrap();
        let end = |bytes: &[u8], mark: &[u8]| bytes.windows(mark.len()).position(|w| w == mark).unwrap();
        let head = end(&answer, b"\r\n\r\n") + 4;
        let mut body = &answer[head..];
        if !String::from_utf8_lossy(&answer[..head]).to_ascii_lowercase().contains("chunked") {
            return body.to_vec();
        }
        let mut whole = vec![];
        loop {
            let (length, rest) = body.split_at(end(body, b"\r\n"));
            let length = usize::from_str_radix(std::str::from_utf8(length).unwrap(), 16).unwrap();
            if length == 0 {
                return whole;
            }
            whole.extend_from_slice(&rest[2..2 + length]);
            body = &rest[2 + length + 2..];
        }
    }

    /// What is sent on a connection of its own, and how long the answer took.
    fn ask(&self) -> (String, Duration) {
        let begun = Instant::now();
        let mut stream = self.connect();
        self.send(&mut stream, &format!("{}archives", self.path));
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        (answer, begun.elapsed())
    }

    fn send(&self, stream: &mut TcpStream, path: &str) {
        let head = format!("GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.address);
        stream.write_all(head.as_bytes()).unwrap();
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        stream
    }

    /// As Ctrl-C does.
    fn end(mut self) {
        assert!(send_signal(self.child.id(), rustix::process::Signal::INT));
        self.child.wait().unwrap();
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn idle_connections_keep_nobody_out() {
    let dir = tempfile::tempdir().unwrap();
    let viewer = Viewer::start(dir.path(), |_| ());
    let many = |sent: &str| -> Vec<TcpStream> {
        let open = |_| {
            let mut stream = viewer.connect();
            stream.write_all(sent.as_bytes()).unwrap();
            stream
        };
        (0..70).map(open).collect()
    };
    let half = format!("GET {}archives HTTP/1.1\r\nHost: ", viewer.path);
    let foreign = "GET /wrong/ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".to_owned();
    for sent in [String::new(), half, foreign] {
        let others = many(&sent);
        for _ in 0..3 {
            let (answer, time) = viewer.ask();
            assert!(
                answer.starts_with("HTTP/1.1 200") && time < Duration::from_secs(5),
                "{sent}: {time:?}, {answer}"
            );
        }
        drop(others);
    }
    // One that has begun a head is closed after seconds, also where it goes on byte by byte.
    let (begun, mut slow) = (Instant::now(), viewer.connect());
    slow.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let is_closed = |slow: &mut TcpStream| {
        let is_sent = slow.write_all(b"G").is_ok();
        let read = slow.read(&mut [0; 100]);
        !is_sent || !matches!(&read, Err(e) if e.kind() == std::io::ErrorKind::WouldBlock)
    };
    while !is_closed(&mut slow) {
        assert!(begun.elapsed() < Duration::from_secs(30), "it is open yet");
    }
    assert!(begun.elapsed() > Duration::from_secs(5));
    viewer.end();
}

/// A step of a field is asked for by its number and the name: each answer is that of the program.
#[test]
fn each_field_of_a_step_is_answered_by_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let run = |args: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(args).output().unwrap();
        assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    };
    (0..2).for_each(|t| crate::fields::both(d, &format!("v{t}.vti"), f64::from(t)));
    run(&["reduce", "-q", "v0.vti", "v1.vti", "-o", "f.isospan", "--fields", "T,p"]);
    let viewer = Viewer::start(d, |command| {
        command.arg("f.isospan");
    });
    for (field, isovalue) in [("T", "310"), ("p", "110000")] {
        for step in ["0", "1"] {
            let what = ["-i", isovalue, "--step", step, "--field", field];
            run(&[&["surface", "-q", "f.isospan", "-o", "s.ply", "--force"][..], &what].concat());
            let question = format!("1/export?isovalues={isovalue}&step={step}&field={field}&format=ply");
            assert!(viewer.answer(&question) == fs::read(d.join("s.ply")).unwrap(), "{question}");
            let other = if field == "T" { "p" } else { "T" };
            run(&[
                &["surface", "-q", "f.isospan", "-o", "s.ply", "--force", "--colour-by", other][..],
                &what,
            ]
            .concat());
            let question = format!("{question}&colour={step}&colour_field={other}");
            assert!(viewer.answer(&question) == fs::read(d.join("s.ply")).unwrap(), "{question}");
        }
        let text = |question: &str| String::from_utf8_lossy(&viewer.answer(question)).into_owned();
        let spectrum = text(&format!("1/spectrum?step=1&field={field}"));
        assert!(spectrum.contains("\"suggestions\""), "{spectrum}");
        let refused = text("1/spectrum?step=1");
        assert!(refused.contains("each step has the fields T, p"), "{refused}");
    }
    viewer.end();
}

#[cfg(target_os = "linux")]
#[test]
fn a_browser_is_started_with_a_private_file() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::create_dir(d.join("bin")).unwrap();
    fs::create_dir(d.join("scratch")).unwrap();
    let browser = d.join("bin/xdg-open");
    // The name comes last: what it is a sign of is whole then.
    let script = format!("#!/bin/sh\nprintf %s \"$*\" > {0}/part && mv {0}/part {0}/started\n", d.display());
    fs::write(&browser, script).unwrap();
    fs::set_permissions(&browser, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", d.join("bin").display(), std::env::var("PATH").unwrap_or_default());
    let viewer = Viewer::start(d, |command| {
        command.args(["--open", "--scratch", "scratch"]).env("PATH", path);
    });
    let begun = Instant::now();
    while !d.join("started").exists() {
        assert!(begun.elapsed() < Duration::from_secs(30), "no browser was started");
        std::thread::sleep(Duration::from_millis(20));
    }
    let words = fs::read_to_string(d.join("started")).unwrap();
    let token = viewer.path.trim_matches('/');
    assert!(!words.contains(token) && words.ends_with(".html"), "{words}");
    let page = d.join(&words);
    assert_eq!(fs::metadata(&page).unwrap().permissions().mode() & 0o777, 0o600);
    let text = fs::read_to_string(&page).unwrap();
    assert!(text.contains(&format!("url=http://{}{}", viewer.address, viewer.path)), "{text}");
    viewer.end();
    assert_eq!(fs::read_dir(d.join("scratch")).unwrap().count(), 0, "the file goes with the server");
}
