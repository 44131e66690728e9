//! Volumes on a web server are reduced as those on disk are: the same values, chunks fetched many
//! at a time. What is not there is the fill value; what fails is an error that names it.

use crate::common::folder;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// What a server does, and what it was asked.
#[derive(Default)]
struct Conduct {
    delay: Duration,
    /// Statuses given once in place of a file, by parts of names.
    once: HashMap<String, u16>,
    /// Statuses always given, by parts of names.
    always: HashMap<String, u16>,
    /// Requests that are answered; later ones find nobody.
    most: Option<usize>,
    requests: BTreeMap<String, usize>,
    under_way: usize,
    most_at_once: usize,
}

/// A folder, served over HTTP with ranges.
struct Server {
    address: String,
    conduct: Arc<Mutex<Conduct>>,
}

impl Server {
    fn of(root: &Path) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let (conduct, root) = (Arc::new(Mutex::new(Conduct::default())), root.to_path_buf());
        let served = Arc::clone(&conduct);
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let (root, conduct) = (root.clone(), Arc::clone(&served));
                std::thread::spawn(move || answer(stream.unwrap(), &root, &conduct));
            }
        });
        Self { address, conduct }
    }

    fn url(&self, name: &str) -> String {
        format!("{}/{name}", self.address)
    }

    fn set(&self, change: impl FnOnce(&mut Conduct)) {
        change(&mut self.conduct.lock().unwrap());
    }

    fn requests(&self) -> usize {
        self.conduct.lock().unwrap().requests.values().sum()
    }
}

fn answer(stream: TcpStream, root: &Path, conduct: &Mutex<Conduct>) {
    let mut reader = BufReader::new(stream.try_clone().unwrap());
    let (mut line, mut range) = (String::new(), None);
    if reader.read_line(&mut line).unwrap_or(0) == 0 {
        return;
    }
    let mut words = line.split_whitespace().map(str::to_owned);
    let (method, name) = (words.next().unwrap(), words.next().unwrap());
    let name = name.trim_start_matches('/');
    loop {
        let mut header = String::new();
        reader.read_line(&mut header).unwrap();
        if header.trim().is_empty() {
            break;
        }
        if let Some(value) = header.to_ascii_lowercase().strip_prefix("range: bytes=") {
            range = Some(value.trim().to_owned());
        }
    }
    let (delay, status) = {
        let mut conduct = conduct.lock().unwrap();
        *conduct.requests.entry(name.to_owned()).or_default() += 1;
        let all: usize = conduct.requests.values().sum();
        if conduct.most.is_some_and(|most| all > most) {
            return;
        }
        conduct.under_way += 1;
        conduct.most_at_once = conduct.most_at_once.max(conduct.under_way);
        let part = conduct.once.keys().find(|part| name.contains(*part)).cloned();
        let once = part.and_then(|part| conduct.once.remove(&part));
        let always = conduct.always.iter().find(|(part, _)| name.contains(*part)).map(|(_, s)| *s);
        (conduct.delay, once.or(always))
    };
    std::thread::sleep(delay);
    let bytes = fs::read(root.join(name)).ok().filter(|_| status.is_none());
    let tag = bytes.as_ref().map(|bytes| xxhash_rust::xxh3::xxh3_64(bytes)).unwrap_or_default();
    let (status, extra, body) = match (bytes, range) {
        (None, _) => (status.unwrap_or(404), String::new(), vec![]),
        (Some(bytes), None) => (200, String::new(), bytes),
        (Some(bytes), Some(range)) => {
            let (from, to) = range.split_once('-').unwrap();
            let len = bytes.len();
            let (start, end) = match (from.parse::<usize>(), to.parse::<usize>()) {
                (Ok(from), Ok(to)) => (from, (to + 1).min(len)),
                (Err(_), Ok(last)) => (len.saturating_sub(last), len),
                other => panic!("{range}: {other:?}"),
            };
            (206, format!("Content-Range: bytes {start}-{}/{len}\r\n", end - 1), bytes[start..end].to_vec())
        }
    };
    conduct.lock().unwrap().under_way -= 1;
    let mut out = format!(
        "HTTP/1.1 {status} Whatever\r\nContent-Length: {}\r\nETag: \"{tag:x}\"\r\n{extra}Connection: close\r\n\r\n",
        body.len()
    )
    .into_bytes();
    if method != "HEAD" {
        out.extend(body);
    }
    // The other side may have ended.
    let _ = (&stream).write_all(&out);
    let _ = stream.shutdown(std::net::Shutdown::Write);
    let _ = reader.read(&mut [0; 1]);
}

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let out = isospan(dir, args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// The exit code and the one line of a command that fails.
fn fails(dir: &Path, args: &[&str]) -> (i32, String) {
    let out = isospan(dir, args);
    let line = String::from_utf8(out.stderr).unwrap();
    assert!(!out.status.success() && line.trim_end().lines().count() == 1, "{args:?}: {line}");
    (out.status.code().unwrap(), line)
}

const REDUCE: [&str; 6] = ["--points", "regular", "--fraction", "1/8", "--chunk-points", "2000"];

fn reduce(dir: &Path, input: &str, out: &str, more: &[&str]) {
    ok(dir, &[&["reduce", "-q", input, "-o", out], &REDUCE[..], more].concat());
}

/// Two archives have the same bytes, but for the manifest and the hash of the plan, at both ends of
/// a segment: these name the input.
fn assert_same(one: &Path, other: &Path) {
    let (one, other) = (folder(one), folder(other));
    let names = |f: &BTreeMap<PathBuf, Vec<u8>>| f.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&one), names(&other));
    for (name, bytes) in one.iter().filter(|(name, _)| !name.ends_with("manifest.zst")) {
        let others = &other[name];
        let differ = bytes.iter().zip(others).filter(|(a, b)| a != b).count();
        assert!(bytes.len() == others.len() && differ <= 64, "{}: {differ} bytes", name.display());
        assert!(bytes.len() > 1000 || differ < bytes.len() / 4, "{}", name.display());
    }
}

const DIMS: [usize; 3] = [40, 36, 48];
const CHUNK: usize = 16;

fn value(x: usize, y: usize, z: usize) -> u16 {
    let [x, y, z] = [x, y, z].map(|v| v as f64 / 10.0);
    (1000.0 + 300.0 * (x + y).sin() * (2.0 * z).cos() + 40.0 * x) as u16
}

/// The samples of a box that begins at `lo`, zeros beyond the end.
fn samples(lo: [usize; 3], size: [usize; 3]) -> Vec<u8> {
    let mut out = vec![];
    for z in lo[2]..lo[2] + size[2] {
        for y in lo[1]..lo[1] + size[1] {
            for x in lo[0]..lo[0] + size[0] {
                let inside = x < DIMS[0] && y < DIMS[1] && z < DIMS[2];
                out.extend(if inside { value(x, y, z) } else { 0 }.to_le_bytes());
            }
        }
    }
    out
}

/// All places of a grid of boxes of an edge that cover the volume, as z, y, x.
fn places(edge: usize) -> Vec<[usize; 3]> {
    let count = DIMS.map(|d| d.div_ceil(edge));
    let rows = (0..count[2]).flat_map(|z| (0..count[1]).map(move |y| (z, y)));
    rows.flat_map(|(z, y)| (0..count[0]).map(move |x| [z, y, x])).collect()
}

fn put(file: PathBuf, bytes: impl AsRef<[u8]>) {
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, bytes).unwrap();
}

fn chunk(at: [usize; 3], edge: usize) -> Vec<u8> {
    samples([at[2] * edge, at[1] * edge, at[0] * edge], [edge; 3])
}

/// Version 2, all chunks in one folder.
fn write_v2(array: &Path) {
    let meta = "{\"zarr_format\": 2, \"shape\": [48, 36, 40], \"chunks\": [16, 16, 16], \"dtype\": \"<u2\", \
        \"compressor\": null, \"fill_value\": 900, \"order\": \"C\", \"filters\": null}";
    put(array.join(".zarray"), meta);
    for at in places(CHUNK) {
        put(array.join(at.map(|n| n.to_string()).join(".")), chunk(at, CHUNK));
    }
}

/// Version 3, shards of 2 x 2 x 2 chunks, their index at the end.
fn write_shards(array: &Path) {
    let meta = "{\"zarr_format\": 3, \"node_type\": \"array\", \"shape\": [48, 36, 40], \"data_type\": \"uint16\", \
        \"chunk_grid\": {\"name\": \"regular\", \"configuration\": {\"chunk_shape\": [32, 32, 32]}}, \
        \"chunk_key_encoding\": {\"name\": \"default\"}, \"fill_value\": 900, \"codecs\": [{\"name\": \
        \"sharding_indexed\", \"configuration\": {\"chunk_shape\": [16, 16, 16], \"codecs\": [{\"name\": \"bytes\", \
        \"configuration\": {\"endian\": \"little\"}}], \"index_codecs\": [{\"name\": \"bytes\", \"configuration\": \
        {\"endian\": \"little\"}}]}}], \"attributes\": {}}";
    put(array.join("zarr.json"), meta);
    for [sz, sy, sx] in places(2 * CHUNK) {
        let (mut shard, mut index) = (vec![], vec![]);
        for n in 0..8 {
            let part = chunk([2 * sz + n / 4, 2 * sy + n / 2 % 2, 2 * sx + n % 2], CHUNK);
            index.extend((shard.len() as u64).to_le_bytes());
            index.extend((part.len() as u64).to_le_bytes());
            shard.extend(part);
        }
        shard.extend(index);
        put(array.join(format!("c/{sz}/{sy}/{sx}")), shard);
    }
}

/// An image of two channels and one level, with a spacing; a series has several such fields.
fn write_image(group: &Path) {
    put(group.join(".zgroup"), "{\"zarr_format\": 2}");
    let about = "{\"multiscales\": [{\"version\": \"0.4\", \"axes\": [{\"name\": \"c\", \"type\": \"channel\"}, \
        {\"name\": \"z\"}, {\"name\": \"y\"}, {\"name\": \"x\"}], \"datasets\": [{\"path\": \"0\", \
        \"coordinateTransformations\": [{\"type\": \"scale\", \"scale\": [1, 2.5, 0.5, 0.5]}]}]}], \
        \"omero\": {\"channels\": [{\"label\": \"dark\"}, {\"label\": \"bright\"}]}}";
    put(group.join(".zattrs"), about);
    let meta = "{\"zarr_format\": 2, \"shape\": [2, 48, 36, 40], \"chunks\": [1, 16, 16, 16], \"dtype\": \"<u2\", \
        \"compressor\": null, \"fill_value\": 0, \"order\": \"C\", \"filters\": null, \"dimension_separator\": \"/\"}";
    put(group.join("0/.zarray"), meta);
    for [z, y, x] in places(CHUNK) {
        let bytes = chunk([z, y, x], CHUNK);
        put(group.join(format!("0/1/{z}/{y}/{x}")), &bytes);
        put(group.join(format!("0/0/{z}/{y}/{x}")), vec![1; bytes.len()]);
    }
}

/// Pages of one deflated strip each, the directory of each before its samples.
fn write_tiff(file: &Path) {
    let mut out = b"II*\0\x08\0\0\0".to_vec();
    for z in 0..DIMS[2] {
        let mut packed = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::fast());
        packed.write_all(&samples([0, 0, z], [DIMS[0], DIMS[1], 1])).unwrap();
        let strip = packed.finish().unwrap();
        let entries: [(u16, u32); 8] = [
            (256, DIMS[0] as u32),
            (257, DIMS[1] as u32),
            (258, 16),
            (259, 8),
            (262, 1),
            (273, out.len() as u32 + 2 + 8 * 12 + 4),
            (278, DIMS[1] as u32),
            (279, strip.len() as u32),
        ];
        out.extend((entries.len() as u16).to_le_bytes());
        for (tag, number) in entries {
            out.extend([&tag.to_le_bytes()[..], &4u16.to_le_bytes(), &1u32.to_le_bytes()].concat());
            out.extend(number.to_le_bytes());
        }
        let next = out.len() + 4 + strip.len();
        out.extend(if z + 1 < DIMS[2] { next as u32 } else { 0 }.to_le_bytes());
        out.extend(strip);
    }
    fs::write(file, out).unwrap();
}

fn nrrd(more: &str) -> Vec<u8> {
    let [x, y, z] = DIMS;
    let head = "NRRD0004\ntype: uint16\ndimension: 3\nendian: little\nencoding: raw";
    format!("{head}\nsizes: {x} {y} {z}\nspacings: 0.5 0.5 2\n{more}\n").into_bytes()
}

#[test]
fn the_archive_is_that_of_the_same_files_on_disk() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_v2(&d.join("v2.zarr"));
    write_shards(&d.join("shards.zarr"));
    write_image(&d.join("image.ome.zarr"));
    write_tiff(&d.join("pages.tif"));
    let all = samples([0; 3], DIMS);
    fs::write(d.join("one.nrrd"), [nrrd(""), all.clone()].concat()).unwrap();
    fs::write(d.join("two.nhdr"), nrrd("data file: two.raw\n")).unwrap();
    fs::write(d.join("two.raw"), &all).unwrap();
    let mut packed = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
    packed.write_all(&all).unwrap();
    fs::write(d.join("packed.raw.gz"), packed.finish().unwrap()).unwrap();
    let h5 = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("tests/data/chunks.h5");
    fs::copy(h5, d.join("chunks.h5")).unwrap();
    let server = Server::of(d);
    let layout = ["--dims", "40,36,48", "--type", "uint16"];
    for (name, more) in [
        ("v2.zarr", &[][..]),
        ("shards.zarr", &[]),
        ("image.ome.zarr", &["--channel", "bright"]),
        ("image.ome.zarr/0", &["--channel", "bright"]),
        ("pages.tif", &[]),
        ("one.nrrd", &[]),
        ("two.nhdr", &[]),
        ("two.raw", &layout),
        ("packed.raw.gz", &layout),
        ("chunks.h5", &[]),
    ] {
        let out = name.replace('/', "-");
        let (local, remote) = (format!("{out}.local.isospan"), format!("{out}.remote.isospan"));
        reduce(d, name, &local, more);
        reduce(d, &server.url(name), &remote, more);
        assert_same(&d.join(&local), &d.join(&remote));
        let about = |input: &str| {
            let text = ok(d, &[&["info", input], more].concat());
            text.lines().skip(1).filter(|l| !l.contains("I/O")).map(str::to_owned).collect::<Vec<_>>()
        };
        assert_eq!(about(name), about(&server.url(name)), "{name}");
        // No copy of the volume is left, nor one of another name.
        assert!(fs::read_dir(d).unwrap().all(|f| !f.unwrap().file_name().to_string_lossy().contains("copy")));
    }
}

#[test]
fn plan_and_work_take_addresses_and_see_another_input() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_v2(&d.join("v.zarr"));
    let server = Server::of(d);
    let input = server.url("v.zarr");
    reduce(d, &input, "whole.isospan", &[]);
    let plan = |out: &str, shards: &str| {
        ok(d, &[&["plan", "-q", &input, "-o", out, "--shards", shards], &REDUCE[..]].concat())
    };
    plan("parts.isospan", "2");
    for shard in ["0/2", "1/2"] {
        ok(d, &["work", "-q", "parts.isospan", "--shard", shard]);
    }
    ok(d, &["commit", "-q", "parts.isospan"]);
    assert!(folder(&d.join("whole.isospan")) == folder(&d.join("parts.isospan")));
    // The same command leaves a finished archive alone; another input makes another one.
    let before = fs::read(d.join("whole.isospan/manifest.zst")).unwrap();
    reduce(d, &input, "whole.isospan", &[]);
    assert_eq!(before, fs::read(d.join("whole.isospan/manifest.zst")).unwrap());
    plan("late.isospan", "1");
    fs::write(d.join("v.zarr/1.1.1"), vec![7; 2 * CHUNK.pow(3)]).unwrap();
    let (code, line) = fails(d, &["work", "-q", "late.isospan", "--shard", "0/1"]);
    assert!(code == 5 && line.contains("fingerprint"), "{line}");
    reduce(d, &input, "whole.isospan", &["--force"]);
    assert_ne!(before, fs::read(d.join("whole.isospan/manifest.zst")).unwrap());
}

#[test]
fn a_missing_chunk_is_the_fill_value_and_a_failure_is_none() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_v2(&d.join("v.zarr"));
    write_shards(&d.join("s.zarr"));
    fs::remove_file(d.join("v.zarr/1.1.1")).unwrap();
    fs::remove_file(d.join("s.zarr/c/1/0/1")).unwrap();
    let server = Server::of(d);
    // A failure that passes is tried again.
    server.set(|c| c.once.extend([("v.zarr/0.0.1".into(), 500), ("c/0/0/0".into(), 503)]));
    for name in ["v.zarr", "s.zarr"] {
        reduce(d, name, "local.isospan", &["--force"]);
        reduce(d, &server.url(name), "remote.isospan", &["--force"]);
        assert_same(&d.join("local.isospan"), &d.join("remote.isospan"));
    }
    assert!(server.conduct.lock().unwrap().once.is_empty());
    // What may not be read is not missing.
    for status in [403, 401, 410] {
        server.set(|c| c.always = [("2.0.1".to_owned(), status)].into());
        let input = server.url("v.zarr");
        let (code, line) = fails(d, &[&["reduce", "-q", &input, "-o", "none.isospan"], &REDUCE[..]].concat());
        assert!(code == 1 && line.contains("v.zarr/2.0.1"), "{status}: {line}");
        assert!(status == 410 || line.contains("denies it"), "{line}");
        assert!(!d.join("none.isospan/manifest.zst").exists());
    }
}

#[test]
fn a_server_that_goes_away_is_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_v2(&d.join("v.zarr"));
    let server = Server::of(d);
    reduce(d, &server.url("v.zarr"), "v.isospan", &[]);
    let half = server.requests() * 2 / 3;
    server.set(|c| (c.requests, c.most) = (BTreeMap::new(), Some(half)));
    let input = server.url("v.zarr");
    let (code, line) = fails(d, &[&["reduce", "-q", &input, "-o", "none.isospan"], &REDUCE[..]].concat());
    assert!(code == 1 && line.contains("v.zarr/"), "{line}");
    assert!(!d.join("none.isospan/manifest.zst").exists());
    // When it is back, the same command makes the same archive.
    server.set(|c| c.most = None);
    reduce(d, &input, "none.isospan", &[]);
    assert!(folder(&d.join("v.isospan")) == folder(&d.join("none.isospan")));
}

#[test]
fn many_chunks_are_asked_for_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_v2(&d.join("v.zarr"));
    let server = Server::of(d);
    server.set(|c| c.delay = Duration::from_millis(30));
    reduce(d, &server.url("v.zarr"), "v.isospan", &["--threads", "1"]);
    let most = server.conduct.lock().unwrap().most_at_once;
    assert!((9..=32).contains(&most), "{most} requests at once");
}

#[test]
fn metadata_are_asked_for_once() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_v2(&d.join("v2.zarr"));
    write_shards(&d.join("shards.zarr"));
    write_image(&d.join("image.ome.zarr"));
    let server = Server::of(d);
    for (name, more) in [
        ("v2.zarr", &[][..]),
        ("shards.zarr", &[]),
        ("image.ome.zarr", &["--channel", "bright"]),
        ("image.ome.zarr/0", &["--channel", "bright"]),
    ] {
        let (url, out) = (server.url(name), format!("{}.isospan", name.replace('/', "-")));
        let commands = [["info"].as_slice(), &["reduce", "-q", "-o", &out]];
        for command in commands {
            server.set(|c| c.requests.clear());
            ok(d, &[command, &[&url], more].concat());
            let requests = std::mem::take(&mut server.conduct.lock().unwrap().requests);
            let is_metadata = |file: &str| file.ends_with(".json") || file.contains("/.z");
            let again = requests.iter().find(|(file, n)| is_metadata(file) && **n > 1);
            assert!(again.is_none(), "{name}, {command:?}: {requests:?}");
            assert!(requests.keys().any(|file| is_metadata(file)));
        }
    }
}

#[test]
fn groups_are_found_by_their_consolidated_metadata() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_v2(&d.join("g.zarr/density"));
    put(d.join("g.zarr/.zgroup"), "{\"zarr_format\": 2}");
    let server = Server::of(d);
    let input = server.url("g.zarr");
    let (code, line) = fails(d, &["info", &input]);
    assert!(code == 5 && line.contains("g.zarr") && line.contains("name the array"), "{line}");
    assert!(ok(d, &["info", &server.url("g.zarr/density")]).contains("40 x 36 x 48"));
    put(d.join("g.zarr/.zmetadata"), "{\"metadata\": {\".zgroup\": {}, \"density/.zarray\": {}}}");
    assert!(ok(d, &["info", &input]).contains("density"));
    // Version 3 has them in the group's own metadata.
    fs::remove_file(d.join("g.zarr/.zmetadata")).unwrap();
    fs::remove_file(d.join("g.zarr/.zgroup")).unwrap();
    let about = "{\"zarr_format\": 3, \"node_type\": \"group\", \"consolidated_metadata\": {\"metadata\": {\"density\": {}}}}";
    put(d.join("g.zarr/zarr.json"), about);
    assert!(ok(d, &["info", &input]).contains("density"));
}

#[test]
fn what_is_not_read_from_servers_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::write(d.join("a.vti"), "<VTKFile type=\"ImageData\"/>").unwrap();
    fs::write(d.join("a.html"), "<html>nothing here</html>").unwrap();
    fs::write(d.join("a.nhdr"), nrrd("data file: /etc/hostname\n")).unwrap();
    let server = Server::of(d);
    for (name, code, expected) in [
        ("a.vti", 5, "copy it to a disk"),
        ("a.html", 5, "kind of file"),
        ("none.nrrd", 1, "none.nrrd"),
        ("none.zarr", 1, "none.zarr"),
        ("slice_*.tif", 5, "patterns are for folders"),
        ("a.nhdr", 5, "on this machine"),
    ] {
        for command in ["info", "reduce"] {
            let url = server.url(name);
            let args = [command, &url, "-o", "none.isospan"];
            let found = fails(d, if command == "info" { &args[..2] } else { &args });
            assert!(found.0 == code && found.1.contains(expected), "{name}: {found:?}");
        }
    }
    let secret = server.url("a.nrrd").replace("http://", "http://me:word@");
    let (code, line) = fails(d, &["info", &secret]);
    assert!(code == 2 && !line.contains("word@") && line.contains("leave them out"), "{line}");
    assert!(!d.join("none.isospan").exists());
}
