//! Servers that lie: each way to answer wrongly, endlessly, slowly or not at all. A command ends
//! within its time with one line, or with what an honest server gives; its memory stays bounded.

use crate::common::*;
use isospan::pipeline::Amount;
use isospan::points::SetKind;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// What was asked for.
struct Request {
    bytes: Vec<u8>,
    from: usize,
    to: usize,
    is_range: bool,
    /// The number of the request.
    count: u64,
    /// The file's name, without the way to lie.
    name: String,
    address: String,
}

impl Request {
    fn part(&self) -> &[u8] {
        &self.bytes[self.from..self.to]
    }

    fn range(&self) -> String {
        format!("bytes {}-{}/{}", self.from, self.to.max(1) - 1, self.bytes.len())
    }

    /// The answer of an honest server, with other headers or another body.
    fn answer(&self, length: usize, range: &str, more: &str, body: &[u8]) -> Vec<u8> {
        let status = if self.is_range { "206 Partial Content" } else { "200 OK" };
        let range = if self.is_range && !range.is_empty() {
            format!("Content-Range: {range}\r\n")
        } else {
            String::new()
        };
        let head = format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\n{range}{more}\r\n");
        [head.as_bytes(), body].concat()
    }

    fn honest(&self) -> Vec<u8> {
        self.answer(self.part().len(), &self.range(), TAG, self.part())
    }

    /// As an honest server's, but for the range that it claims.
    fn with_range(&self, range: &str) -> Vec<u8> {
        self.answer(self.part().len(), range, TAG, self.part())
    }

    /// As an honest server's, with more headers.
    fn with(&self, headers: &str) -> Vec<u8> {
        self.answer(self.part().len(), &self.range(), &format!("{TAG}{headers}"), self.part())
    }

    /// As an honest server's, with another body and its length.
    fn body(&self, body: &[u8]) -> Vec<u8> {
        self.answer(body.len(), &self.range(), TAG, body)
    }
}

const TAG: &str = "ETag: \"one\"\r\n";

/// What a server sends, and what it does then.
enum Then {
    /// Closes the connection.
    Close,
    /// Says nothing more, as long as the other side waits.
    Silence,
    /// Sends these bytes again and again.
    Again(Vec<u8>),
    /// Sends one byte of these a second, from the first on when they end.
    Drip(Vec<u8>),
}

type Lie = fn(&Request) -> (Vec<u8>, Then);

fn status(line: &str) -> Vec<u8> {
    format!("HTTP/1.1 {line}\r\nContent-Length: 0\r\n\r\n").into_bytes()
}

/// A failure whose body has no end.
fn endless(line: &str) -> (Vec<u8>, Then) {
    (format!("HTTP/1.1 {line}\r\n\r\n").into_bytes(), Then::Again(vec![b'x'; 1 << 16]))
}

fn redirect(to: &str) -> Vec<u8> {
    format!("HTTP/1.1 302 Found\r\nLocation: {to}\r\nContent-Length: 0\r\n\r\n").into_bytes()
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// Whether a command must fail, or may as well answer as with an honest server.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Must {
    Fail,
    MayAnswer,
}
use Must::{Fail, MayAnswer};

/// Bodies that are shorter, longer or other than what is said of them.
const BODIES: &[(&str, Must, Lie)] = &[
    ("honest", MayAnswer, |r| (r.honest(), Then::Close)),
    ("half", Fail, |r| {
        (r.answer(r.part().len(), &r.range(), TAG, &r.part()[..r.part().len() / 2]), Then::Close)
    }),
    ("half-and-says-so", Fail, |r| (r.body(&r.part()[..r.part().len() / 2]), Then::Close)),
    ("empty", Fail, |r| (r.body(&[]), Then::Close)),
    ("one-less", Fail, |r| (r.body(&r.part()[1..]), Then::Close)),
    ("one-more", Fail, |r| (r.body(&[r.part(), &[0]].concat()), Then::Close)),
    ("zeros", Fail, |r| (r.body(&vec![0; r.part().len()]), Then::Close)),
    ("noise", Fail, |r| {
        let noise: Vec<u8> = (0..r.part().len()).map(|i| (i * i / 7 + i) as u8).collect();
        (r.body(&noise), Then::Close)
    }),
    ("half-noise", Fail, |r| {
        let mut bytes = r.part().to_vec();
        bytes.iter_mut().step_by(2).for_each(|b| *b ^= 0x55);
        (r.body(&bytes), Then::Close)
    }),
    ("endless-chunks", Fail, |r| {
        let head = r.answer(0, &r.range(), TAG, &[]);
        let head =
            String::from_utf8(head).unwrap().replace("Content-Length: 0", "Transfer-Encoding: chunked");
        let chunk = [&b"4000\r\n"[..], &[7; 0x4000], b"\r\n"].concat();
        (head.into_bytes(), Then::Again(chunk))
    }),
    ("endless-range", Fail, |r| {
        let head = String::from_utf8(r.answer(0, &r.range(), TAG, &[])).unwrap();
        (head.replace("Content-Length: 0\r\n", "").into_bytes(), Then::Again(vec![7; 1 << 16]))
    }),
    ("endless-whole", Fail, |_| endless("200 OK")),
    ("length-of-10^18", Fail, |r| {
        (r.answer(1_000_000_000_000_000_000, &r.range(), TAG, &[]), Then::Again(vec![7; 1 << 16]))
    }),
    ("length-below-0", Fail, |_| {
        (b"HTTP/1.1 206 P\r\nContent-Length: -5\r\n\r\nabcde".to_vec(), Then::Close)
    }),
    ("length-of-words", Fail, |_| {
        (b"HTTP/1.1 206 P\r\nContent-Length: many\r\n\r\nabc".to_vec(), Then::Close)
    }),
    ("two-lengths", Fail, |r| (r.with("Content-Length: 7\r\n"), Then::Close)),
    ("length-and-chunks", Fail, |r| (r.with("Transfer-Encoding: chunked\r\n"), Then::Close)),
    ("bad-chunks", Fail, |_| {
        let head = format!(
            "HTTP/1.1 206 P\r\n{TAG}Content-Range: bytes 0-9/10\r\nTransfer-Encoding: chunked\r\n\r\n"
        );
        ([head.as_bytes(), b"FFFFFFFFFFFFFFFFF\r\n"].concat(), Then::Again(vec![7; 1 << 10]))
    }),
    ("chunk-words", Fail, |_| {
        let head = format!(
            "HTTP/1.1 206 P\r\n{TAG}Content-Range: bytes 0-9/10\r\nTransfer-Encoding: chunked\r\n\r\n1;"
        );
        (head.into_bytes(), Then::Again(vec![b'a'; 1 << 10]))
    }),
    ("trailers", Fail, |_| {
        let head = format!(
            "HTTP/1.1 206 P\r\n{TAG}Content-Range: bytes 0-9/10\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n"
        );
        (head.into_bytes(), Then::Again(b"A: b\r\n".repeat(100)))
    }),
    ("packed", Fail, |r| {
        let body = packed(r.part());
        (r.answer(body.len(), &r.range(), &format!("{TAG}Content-Encoding: gzip\r\n"), &body), Then::Close)
    }),
    ("packed-without-a-word", Fail, |r| (r.body(&packed(r.part())), Then::Close)),
    ("called-packed", MayAnswer, |r| (r.with("Content-Encoding: gzip\r\n"), Then::Close)),
    ("called-anything", MayAnswer, |r| (r.with("Content-Encoding: br, zstd, none\r\n"), Then::Close)),
    ("a-page", Fail, |_| {
        let body = "<html>Please log in</html>";
        (format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n{body}", body.len()).into_bytes(), Then::Close)
    }),
];

/// Ranges, tags and lengths that are not those of the file.
const RANGES: &[(&str, Must, Lie)] = &[
    ("whole-for-a-range", Fail, |r| {
        let head = format!("HTTP/1.1 200 OK\r\n{TAG}Content-Length: {}\r\n\r\n", r.bytes.len());
        ([head.as_bytes(), &r.bytes].concat(), Then::Close)
    }),
    ("no-range", Fail, |r| (r.with_range(""), Then::Close)),
    ("shifted", Fail, |r| {
        (r.with_range(&format!("bytes {}-{}/{}", r.from + 1, r.to, r.bytes.len() + 1)), Then::Close)
    }),
    ("beyond-the-end", Fail, |r| (r.with_range(&format!("bytes {}-{}/5", r.from, r.to)), Then::Close)),
    ("largest-end", Fail, |r| {
        (r.with_range("bytes 0-18446744073709551615/18446744073709551615"), Then::Close)
    }),
    ("largest-length", Fail, |r| {
        let last = u64::MAX - 1;
        let first = last - r.part().len() as u64 + 1;
        (r.with_range(&format!("bytes {first}-{last}/{}", u64::MAX)), Then::Close)
    }),
    ("backwards", Fail, |r| (r.with_range("bytes 9-3/100"), Then::Close)),
    ("length-unknown", Fail, |r| {
        (r.with_range(&format!("bytes {}-{}/*", r.from, r.to.max(1) - 1)), Then::Close)
    }),
    ("length-0", Fail, |r| (r.with_range("bytes 0-0/0"), Then::Close)),
    ("below-0", Fail, |r| (r.with_range("bytes -5--1/100"), Then::Close)),
    ("no-numbers", Fail, |r| (r.with_range("bytes all"), Then::Close)),
    ("lines", Fail, |r| (r.with_range(&r.range().replace("bytes", "lines")), Then::Close)),
    ("parts", Fail, |_| {
        let body = "--b\r\nContent-Range: bytes 0-3/4\r\n\r\nabcd\r\n--b--\r\n";
        let kind = "Content-Type: multipart/byteranges; boundary=b";
        (
            format!("HTTP/1.1 206 P\r\n{kind}\r\nContent-Length: {}\r\n\r\n{body}", body.len()).into_bytes(),
            Then::Close,
        )
    }),
    ("another-tag-each-time", MayAnswer, |r| {
        let tag = format!("ETag: \"{}\"\r\n", r.count);
        (r.answer(r.part().len(), &r.range(), &tag, r.part()), Then::Close)
    }),
    ("longer-each-time", Fail, |r| {
        let range = format!("bytes {}-{}/{}", r.from, r.to.max(1) - 1, r.bytes.len() as u64 + r.count);
        (r.with_range(&range), Then::Close)
    }),
    ("no-tag", MayAnswer, |r| (r.answer(r.part().len(), &r.range(), "", r.part()), Then::Close)),
    ("long-tag", MayAnswer, |r| {
        let tag = format!("ETag: \"{}\"\r\n", "t".repeat(60_000));
        (r.answer(r.part().len(), &r.range(), &tag, r.part()), Then::Close)
    }),
    ("bad-date", MayAnswer, |r| (r.with("Last-Modified: yesterday\r\n"), Then::Close)),
];

/// Failures, and other places.
const STATUSES: &[(&str, Must, Lie)] = &[
    ("endless-404", Fail, |_| endless("404 Not Found")),
    ("endless-500", Fail, |_| endless("500 Oh")),
    ("endless-403", Fail, |_| endless("403 No")),
    ("endless-401", Fail, |_| endless("401 No")),
    ("endless-416", Fail, |_| endless("416 No")),
    ("endless-429", Fail, |_| endless("429 Wait")),
    ("endless-302", Fail, |_| endless("302 Found")),
    ("503", Fail, |_| (status("503 Later"), Then::Close)),
    ("599", Fail, |_| (status("599 Odd"), Then::Close)),
    ("204", Fail, |_| (status("204 Nothing"), Then::Close)),
    ("304", Fail, |_| (status("304 As before"), Then::Close)),
    ("999", Fail, |_| (status("999 Odd"), Then::Close)),
    ("to-itself", Fail, |r| (redirect(&format!("/to-itself/{}", r.name)), Then::Close)),
    ("to-longer-names", Fail, |r| (redirect(&format!("/to-longer-names/x{}", r.name)), Then::Close)),
    ("to-a-file", Fail, |_| (redirect("file:///etc/hostname"), Then::Close)),
    ("to-nobody", Fail, |_| (redirect("http://127.0.0.1:1/x"), Then::Close)),
    ("to-nowhere", Fail, |_| (b"HTTP/1.1 307 Away\r\nContent-Length: 0\r\n\r\n".to_vec(), Then::Close)),
    ("to-the-file", MayAnswer, |r| (redirect(&format!("{}/honest/{}", r.address, r.name)), Then::Close)),
    ("to-silence", Fail, |r| (redirect(&format!("{}/silent/{}", r.address, r.name)), Then::Close)),
];

/// Heads without end or sense, and waiting.
const HEADS: &[(&str, Must, Lie)] = &[
    ("headers", Fail, |_| (b"HTTP/1.1 206 P\r\n".to_vec(), Then::Again(b"X-A: bcd\r\n".repeat(100)))),
    ("a-long-header", Fail, |_| (b"HTTP/1.1 206 P\r\nX-A: ".to_vec(), Then::Again(vec![b'a'; 1 << 12]))),
    ("many-headers", MayAnswer, |r| (r.with(&"X-A: b\r\n".repeat(5000)), Then::Close)),
    ("bad-header", MayAnswer, |r| (r.with("X\0A: b\r\n"), Then::Close)),
    ("bytes", Fail, |_| (vec![], Then::Again(vec![0xff; 1 << 12]))),
    ("another-protocol", Fail, |_| (b"SSH-2.0-OpenSSH_9.2\r\n".to_vec(), Then::Silence)),
    ("another-version", Fail, |_| (b"HTTP/9.9 206 P\r\nContent-Length: 0\r\n\r\n".to_vec(), Then::Close)),
    ("go-on", Fail, |_| (vec![], Then::Again(b"HTTP/1.1 100 Continue\r\n\r\n".repeat(100)))),
    ("hints", Fail, |_| (vec![], Then::Again(b"HTTP/1.1 103 Early Hints\r\nA: b\r\n\r\n".repeat(100)))),
    ("closed", Fail, |_| (vec![], Then::Close)),
    ("closed-in-the-head", Fail, |_| (b"HTTP/1.1 206 P\r\nContent-Le".to_vec(), Then::Close)),
    ("silent", Fail, |_| (vec![], Then::Silence)),
    ("silent-in-the-head", Fail, |_| (b"HTTP/1.1 206 P\r\nContent-Le".to_vec(), Then::Silence)),
    ("silent-after-the-head", Fail, |r| (r.answer(r.part().len(), &r.range(), TAG, &[]), Then::Silence)),
    ("silent-in-the-body", Fail, |r| {
        (r.answer(r.part().len(), &r.range(), TAG, &r.part()[..r.part().len() / 2]), Then::Silence)
    }),
    ("silent-after-a-failure", Fail, |_| {
        (b"HTTP/1.1 404 No\r\nContent-Length: 99\r\n\r\nNo".to_vec(), Then::Silence)
    }),
    ("a-slow-head", Fail, |r| (vec![], Then::Drip(r.honest()))),
    ("a-slow-body", Fail, |r| {
        (r.answer(r.part().len(), &r.range(), TAG, &[]), Then::Drip(r.part().to_vec()))
    }),
    ("a-slow-failure", Fail, |_| (b"HTTP/1.1 500 Oh\r\n\r\n".to_vec(), Then::Drip(vec![b'x']))),
];

fn all_lies() -> Vec<(&'static str, Must, Lie)> {
    [BODIES, RANGES, STATUSES, HEADS].concat()
}

/// Serves a folder below each way to lie: `/WAY/NAME`.
fn serve(root: &Path) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let (root, own) = (root.to_path_buf(), address.clone());
    std::thread::spawn(move || {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        for stream in listener.incoming() {
            let (root, own) = (root.clone(), own.clone());
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            // The other side may end at any time.
            std::thread::spawn(move || drop(stream.and_then(|stream| lie(&stream, &root, own, count))));
        }
    });
    address
}

fn lie(stream: &TcpStream, root: &Path, address: String, count: u64) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream);
    let (mut line, mut range) = (String::new(), None);
    reader.read_line(&mut line)?;
    loop {
        let mut header = String::new();
        if reader.read_line(&mut header)? == 0 || header.trim().is_empty() {
            break;
        }
        if let Some(value) = header.to_ascii_lowercase().strip_prefix("range: bytes=") {
            range = Some(value.trim().to_owned());
        }
    }
    let path = line.split_whitespace().nth(1).unwrap_or_default().trim_start_matches('/').to_owned();
    let (way, name) = path.split_once('/').unwrap_or((&path, ""));
    let Some((_, _, lie)) = all_lies().into_iter().find(|(known, _, _)| *known == way) else { return Ok(()) };
    let is_there = fs::read(root.join(name));
    let bytes = is_there.unwrap_or_else(|_| vec![b'n'; 20_000]);
    let (from, to) = match range.as_deref().and_then(|range| range.split_once('-')) {
        None => (0, bytes.len()),
        Some((from, to)) => match (from.parse::<usize>(), to.parse::<usize>()) {
            (Ok(from), Ok(to)) => (from.min(bytes.len()), (to + 1).min(bytes.len())),
            (_, last) => (bytes.len().saturating_sub(last.unwrap_or(0)), bytes.len()),
        },
    };
    let name = name.to_owned();
    let (sent, then) = match way {
        "honest" if !root.join(&name).is_file() => (status("404 Not Found"), Then::Close),
        _ => lie(&Request { bytes, from, to, is_range: range.is_some(), count, name, address }),
    };
    let mut out = stream;
    out.write_all(&sent)?;
    let second = Duration::from_secs(1);
    match then {
        Then::Close => {
            stream.shutdown(Shutdown::Write)?;
            stream.set_read_timeout(Some(second))?;
            let _ = reader.read(&mut [0; 1]);
        }
        Then::Silence => drop(reader.read(&mut [0; 1])),
        Then::Again(bytes) => loop {
            out.write_all(&bytes)?;
        },
        Then::Drip(bytes) => {
            for byte in bytes.iter().cycle() {
                out.write_all(&[*byte])?;
                std::thread::sleep(second);
            }
        }
    }
    Ok(())
}

/// What a command did.
struct Outcome {
    code: Option<i32>,
    out: Vec<u8>,
    words: String,
    seconds: f64,
    /// The most memory that it had, in MiB; 0 where the system does not tell.
    memory: u64,
}

/// Runs a command for at most so long.
fn outcome(dir: &Path, args: &[String], most: Duration) -> Outcome {
    static NEXT: AtomicUsize = AtomicUsize::new(0);
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    let files = ["out", "err"].map(|kind| dir.join(format!("{kind}-{number}")));
    let [out, err] = files.each_ref().map(|file| Stdio::from(fs::File::create(file).unwrap()));
    let begun = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_isospan"))
        .current_dir(dir)
        .args(args)
        .stdin(Stdio::null())
        .stdout(out)
        .stderr(err)
        .spawn()
        .unwrap();
    let (mut memory, place) = (0, format!("/proc/{}/status", child.id()));
    let code = loop {
        let about = fs::read_to_string(&place).unwrap_or_default();
        // For a moment, a process that begins still has the memory and the name of this one.
        let has_begun = about.lines().next() == Some("Name:\tisospan");
        let peak = about.lines().filter(|_| has_begun).find_map(|line| line.strip_prefix("VmHWM:"));
        memory =
            memory.max(peak.and_then(|l| l.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0) >> 10);
        match child.try_wait().unwrap() {
            Some(status) => break status.code(),
            None if begun.elapsed() > most => {
                child.kill().unwrap();
                child.wait().unwrap();
                break None;
            }
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    };
    let seconds = begun.elapsed().as_secs_f64();
    let [out, err] = files.map(|file| fs::read(file).unwrap());
    Outcome { code, out, words: String::from_utf8_lossy(&err).into_owned(), seconds, memory }
}

/// A command is given up after this time: half a minute, and what a busy machine needs.
const MOST: Duration = Duration::from_secs(75);
/// MiB that a command may have that was told to take 256, in a program without optimisation.
const MEMORY: u64 = 420;

/// What is wrong with how a command took a lie.
fn wrong(must: Must, found: &Outcome, is_right: bool) -> Option<&'static str> {
    let is_one_line = found.words.trim_end().lines().count() == 1 && found.words.len() < 2000;
    match found.code {
        None => Some("it was stopped"),
        Some(101) => Some("it panicked"),
        _ if found.words.contains("panicked") => Some("it panicked"),
        _ if found.memory > MEMORY => Some("memory"),
        Some(0) if must == Fail => Some("it answered"),
        Some(0) => (!is_right).then_some("another answer"),
        _ if !is_one_line => Some("not one line"),
        _ => None,
    }
}

/// What a command that succeeded has found, without what names the server.
fn answer(dir: &Path, what: &str, way: &str, found: &Outcome) -> String {
    if what != "reduce" {
        return String::from_utf8_lossy(&found.out).replace(&format!("/{way}/"), "/");
    }
    let archive = isospan::Archive::open(dir.join(format!("{way}.isospan"))).unwrap();
    let surface = archive.surface(0.1).unwrap();
    format!("{:?}", (surface.vertices, surface.triangles))
}

/// An archive and a volume to serve.
fn files(dir: &Path) {
    let volume = dir.join("waves.npy");
    write_npy(&volume, [60, 50, 40], waves);
    let archive = dir.join("waves.isospan");
    crate::common::reduce(&volume, &settings(SetKind::Halton, Amount::Fraction(0.5), 20_000), &archive, 2);
}

/// A command that asks a server, with the names of what it writes.
fn command(what: &str, url: &str, way: &str) -> Vec<String> {
    let words = match what {
        "info" => format!("info {url}/{way}/waves.isospan --json"),
        "count" => format!("count {url}/{way}/waves.isospan -i 0.1"),
        _ => format!(
            "reduce {url}/{way}/waves.npy -o {way}.isospan --points regular --fraction 1/8 --memory 256MiB -q"
        ),
    };
    words.split(' ').map(str::to_owned).collect()
}

/// Runs commands against ways to lie, many at a time, since most of them wait.
fn against(lies: &[(&'static str, Must, Lie)], commands: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    files(d);
    let url = serve(d);
    let mut tries: Vec<_> = lies
        .iter()
        .filter(|(way, ..)| *way != "honest")
        .flat_map(|lie| commands.iter().map(move |what| (*what, lie)))
        .collect();
    let honest: Vec<String> = commands
        .iter()
        .map(|what| {
            let found = outcome(d, &command(what, &url, "honest"), MOST);
            assert_eq!(found.code, Some(0), "{what}: {}", found.words);
            answer(d, what, "honest", &found)
        })
        .collect();
    let honest = |what: &str| &honest[commands.iter().position(|c| *c == what).unwrap()];
    let failures = Mutex::new(vec![]);
    let next = Mutex::new(&mut tries);
    std::thread::scope(|scope| {
        for _ in 0..24 {
            scope.spawn(|| {
                loop {
                    let Some((what, (way, must, _))) = next.lock().unwrap().pop() else { return };
                    let found = outcome(d, &command(what, &url, way), MOST);
                    let Outcome { code, seconds, memory, .. } = found;
                    let left = d.join(format!("{way}.isospan/manifest.zst")).exists() && code != Some(0);
                    let half = left.then_some("half an archive");
                    let is_right = code == Some(0) && answer(d, what, way, &found) == *honest(what);
                    if let Some(why) = wrong(*must, &found, is_right).or(half) {
                        let words: String = found.words.chars().take(300).collect();
                        let text =
                            format!("{way}, {what}: {why} ({code:?}, {seconds:.0} s, {memory} MiB): {words}");
                        failures.lock().unwrap().push(text);
                    }
                }
            });
        }
    });
    let failures = failures.into_inner().unwrap();
    assert!(failures.is_empty(), "{} of them:\n{}", failures.len(), failures.join("\n"));
}

#[test]
fn answers_that_are_not_what_they_say_are_one_line() {
    against(&[BODIES, RANGES].concat(), &["info", "count", "reduce"]);
}

#[test]
fn failures_and_waits_have_an_end() {
    assert!(all_lies().len() >= 60, "{} ways to lie", all_lies().len());
    against(&[STATUSES, HEADS].concat(), &["info", "reduce"]);
}
