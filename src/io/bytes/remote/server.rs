//! The servers that this process has talked to: requests, and what they said.

use super::client::Bounded;
use super::pages::ServerCache;
use super::{Answer, Seen, Wanted};
use crate::error::{Error, Result};
use object_store::aws::AmazonS3Builder;
use object_store::http::HttpBuilder;
use object_store::path::Path as Key;
use object_store::{
    BackoffConfig, GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreScheme, RetryConfig,
};
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::future::Future;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::timeout_at;
use tokio_stream::{Stream, StreamExt};
use url::{Position, Url};
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

/// Requests that are under way to a server, at most.
const AT_ONCE: usize = 32;
/// Small files are not asked for again so soon: metadata are needed several times when a volume is
/// opened.
const SMALL_FOR: Duration = Duration::from_secs(5);
/// Files of which a listing costs less than a request for each.
const MANY: usize = 16;
/// Files in each answer of a listing.
const IN_ANSWER: usize = 1000;
/// Small files that are kept for that long, and the most bytes of one.
const SMALL: (usize, usize) = (256, 256 << 10);

/// A request is given up after so long, with all its tries, unless bytes of the file come.
const LIMIT: Duration = Duration::from_secs(30);
/// So many bytes of a file must come within that time, or all.
const STRIDE: usize = 1 << 20;
/// A server that was given up is not asked again for so long: many may wait for it.
const SILENT_FOR: Duration = Duration::from_secs(10);
/// Letters of a server's words that are shown.
const WORDS: usize = 400;

/// A server or bucket, and what was fetched from it.
pub(super) struct Server {
    store: Arc<dyn ObjectStore>,
    /// Whether it lists what it has: a store, not a web server.
    lists: bool,
    room: Semaphore,
    bounded: Bounded,
    /// When it was given up last, and why.
    given_up: Mutex<Option<(Instant, String)>>,
    pub(super) cache: ServerCache,
    /// By hashes of paths.
    seen: Mutex<HashMap<u128, Seen>>,
    small: Mutex<HashMap<PathBuf, Small>>,
}

/// When a small file was asked for, and its bytes; `None` where there was none.
type Small = (Instant, Option<Arc<[u8]>>);

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.store)
    }
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Server {
    /// Bytes of a file.
    pub(super) fn get(&self, path: &Path, key: &Key, wanted: &Wanted) -> io::Result<Answer> {
        let (range, most) = match wanted {
            Wanted::Last(count) => (GetRange::Suffix(*count), *count),
            Wanted::At(range) => (GetRange::Bounded(range.clone()), range.end - range.start),
        };
        self.get_at_most(path, key, Some(range), most)
    }

    /// A range of a file, or all of it: at most `most` bytes.
    fn get_at_most(&self, path: &Path, key: &Key, range: Option<GetRange>, most: u64) -> io::Result<Answer> {
        self.cache.asked();
        let answer = wait(async {
            let _room = self.room.acquire().await;
            let begun = self.begin()?;
            let got = self.store.get_opts(key, GetOptions { range, ..GetOptions::default() });
            let got = self.within(begun, path, got).await?;
            let (len, tag, range) = (got.meta.size, tag_of(&got.meta), got.range.clone());
            // A server's word about a length allocates nothing that was not expected.
            let said = range.end.saturating_sub(range.start);
            if said > most {
                return Err(io::Error::other(format!("{len} bytes, where at most {most} are expected")));
            }
            let bytes = self.bytes_of(begun, path, got.into_stream(), said).await?;
            self.note(path, Some(len), tag);
            Ok(Answer { len, tag, range, bytes })
        })??;
        self.cache.got(&answer.bytes);
        Ok(answer)
    }

    /// A request begins now.
    fn begin(&self) -> io::Result<Instant> {
        match &*lock(&self.given_up) {
            Some((at, why)) if at.elapsed() < SILENT_FOR => {
                Err(io::Error::new(io::ErrorKind::TimedOut, why.clone()))
            }
            _ => Ok(Instant::now()),
        }
    }

    /// The server is given up, of which nothing came in time but this.
    fn give_up(&self, came: &str) -> io::Error {
        let why = format!("the server is given up: {came} within {} seconds", LIMIT.as_secs());
        *lock(&self.given_up) = Some((Instant::now(), why.clone()));
        io::Error::new(io::ErrorKind::TimedOut, why)
    }

    /// An answer that must be there in time.
    async fn within<T>(
        &self,
        begun: Instant,
        path: &Path,
        answer: impl Future<Output = object_store::Result<T>>,
    ) -> io::Result<T> {
        let Ok(answer) = timeout_at((begun + LIMIT).into(), answer).await else {
            return Err(self.give_up("no answer"));
        };
        answer.map_err(|e| {
            let failed = self.failed(path, e);
            if begun.elapsed() > TRIES_END {
                *lock(&self.given_up) = Some((Instant::now(), failed.to_string()));
            }
            failed
        })
    }

    /// The bytes of an answer that is said to have so many.
    async fn bytes_of(
        &self,
        begun: Instant,
        path: &Path,
        mut stream: impl Stream<Item = object_store::Result<impl AsRef<[u8]>>> + Unpin,
        said: u64,
    ) -> io::Result<Vec<u8>> {
        let (mut bytes, mut due, mut next): (Vec<u8>, _, _) = (vec![], begun + LIMIT, STRIDE);
        let is_more = loop {
            let piece = timeout_at(due.into(), stream.next()).await;
            let piece = piece.map_err(|_| self.give_up(&format!("{} of {said} bytes", bytes.len())))?;
            let Some(piece) = piece else { break false };
            let piece = piece.map_err(|e| self.failed(path, e))?;
            if (bytes.len() + piece.as_ref().len()) as u64 > said {
                break true;
            }
            bytes.extend_from_slice(piece.as_ref());
            if bytes.len() >= next {
                (due, next) = (Instant::now() + LIMIT, bytes.len() + STRIDE);
            }
        };
        if is_more || bytes.len() as u64 != said {
            let got = if is_more { "more".to_owned() } else { bytes.len().to_string() };
            return Err(io::Error::other(format!("the server says {said} bytes and sends {got}")));
        }
        Ok(bytes)
    }

    /// Asks about a file, without its bytes.
    async fn head(&self, path: &Path, key: &Key) -> io::Result<()> {
        self.cache.asked();
        let _room = self.room.acquire().await;
        let begun = self.begin()?;
        let asked = self.store.get_opts(key, GetOptions { head: true, ..GetOptions::default() });
        match self.within(begun, path, asked).await {
            Ok(got) => self.note(path, Some(got.meta.size), tag_of(&got.meta)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            Err(e) => return Err(e),
        }
        Ok(())
    }

    /// Notes what a listing of their folder says about files, and takes those out of `files`. What
    /// it does not name stays, and all do where it is refused, or the folder has many more files.
    async fn look_in_listing(&self, files: &mut Listed<'_>) {
        let room = self.room.acquire().await;
        let Ok(begun) = self.begin() else { return };
        self.bounded.begin_listing();
        let (mut listing, mut count) = (self.store.list(folder_of(files.keys()).as_ref()), 0);
        let due = begun + LIMIT;
        while let Some(about) = timeout_at(due.into(), listing.next()).await.unwrap_or(None) {
            if count % IN_ANSWER == 0 {
                self.cache.asked();
            }
            count += 1;
            let Ok(about) = about else { return };
            if count > 4 * files.len() + IN_ANSWER {
                return;
            }
            if let Some((_, said)) = files.get_mut(&about.location).filter(|_| about.e_tag.is_some()) {
                *said = Some((about.size, tag_of(&about)));
            }
        }
        drop(room);
        // A server may write the state of a file in two ways: one file shows whether it does.
        let listed = files.iter().find_map(|(key, &(path, said))| Some((key, path, said?)));
        let Some((key, path, said)) = listed else { return };
        let asked = self.head(path, key).await.is_ok();
        let known = lock(&self.seen).get(&hash_of(path)).copied();
        if !asked || known.is_none_or(|known| (known.len, known.tag) != (Some(said.0), said.1)) {
            return;
        }
        files.retain(|_, &mut (path, said)| match said {
            Some((len, tag)) => {
                self.note(path, Some(len), tag);
                false
            }
            None => true,
        });
    }

    fn note(&self, path: &Path, len: Option<u64>, tag: u64) {
        let mut seen = lock(&self.seen);
        let now = seen.entry(hash_of(path)).or_insert(Seen { len, tag, changes: 0 });
        if (now.len, now.tag) != (len, tag) {
            *now = Seen { len, tag, changes: now.changes + 1 };
        }
    }

    /// The reason of a failure, in one line. A file that is not there is noted.
    fn failed(&self, path: &Path, error: object_store::Error) -> io::Error {
        let mut text = one_line(&error);
        if text.chars().count() > WORDS {
            text = text.chars().take(WORDS).chain(['.'; 3]).collect();
        }
        let kind = match error {
            // Nor a bucket that is missing, nor a request that is not answered, is a missing file.
            object_store::Error::NotFound { .. }
                if !text.contains("NoSuchBucket") && !text.contains("405 Method Not Allowed") =>
            {
                self.note(path, None, 0);
                io::ErrorKind::NotFound
            }
            object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
                let text = format!(
                    "the server denies it ({text}); S3 does so, too, for what is not there, unless the keys may \
                     list the bucket: allow s3:ListBucket, or check the address and the keys"
                );
                return io::Error::new(io::ErrorKind::PermissionDenied, text);
            }
            _ => io::ErrorKind::Other,
        };
        io::Error::new(kind, text)
    }
}

/// The folder that all files are in; `None` for all of a store.
fn folder_of<'a>(mut files: impl Iterator<Item = &'a Key>) -> Option<Key> {
    let mut folder = files.next()?.parent()?;
    for file in files {
        while !file.prefix_matches(&folder) {
            folder = folder.parent()?;
        }
    }
    Some(folder).filter(|folder| !folder.is_root())
}

/// Files by their keys, and the length and the tag that a listing says.
type Listed<'a> = HashMap<Key, (&'a Path, Option<(u64, u64)>)>;

/// The files that no listing tells of: all but those of one store with many.
fn not_listed(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if paths.len() < MANY {
        return Ok(paths.to_vec());
    }
    let (server, _) = server_of(&paths[0])?;
    let mut files = Listed::new();
    for path in paths {
        let (of, key) = server_of(path)?;
        if !of.lists || !Arc::ptr_eq(&of, &server) {
            return Ok(paths.to_vec());
        }
        files.insert(key, (path.as_path(), None));
    }
    wait(server.look_in_listing(&mut files)).map_err(|e| Error::io("ask a server", &paths[0], e))?;
    Ok(files.into_values().map(|(path, _)| path.to_path_buf()).collect())
}

fn hash_of(path: &Path) -> u128 {
    xxh3_128(path.as_os_str().as_encoded_bytes())
}

/// What differs between two states of a file.
fn tag_of(about: &ObjectMeta) -> u64 {
    match &about.e_tag {
        Some(tag) => xxh3_64(tag.as_bytes()),
        None => xxh3_64(about.last_modified.to_rfc3339().as_bytes()),
    }
}

/// A message in one line (those of servers have line ends), with its first cause where the message
/// does not include it.
fn one_line(error: &dyn std::error::Error) -> String {
    let line = |e: &dyn std::error::Error| e.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    let first = std::iter::successors(error.source(), |e| e.source()).last().map(line);
    let message = line(error);
    match first {
        Some(cause) if !message.contains(&cause) => format!("{message}: {cause}"),
        _ => message,
    }
}

/// Runs a request to its end.
fn wait<T>(request: impl Future<Output = T>) -> io::Result<T> {
    Ok(runtime()?.block_on(request))
}

/// The runtime of this process: the copy that a fork has of another one has no threads.
fn runtime() -> io::Result<&'static Runtime> {
    static KNOWN: Mutex<Option<(u32, &Runtime)>> = Mutex::new(None);
    let (mut known, process) = (lock(&KNOWN), std::process::id());
    if let Some((_, runtime)) = known.filter(|(of, _)| *of == process) {
        return Ok(runtime);
    }
    let new =
        Builder::new_multi_thread().worker_threads(2).thread_name("isospan-net").enable_all().build()?;
    let runtime = Box::leak(Box::new(new));
    *known = Some((process, runtime));
    Ok(runtime)
}

/// All bytes of a file, at most `most` of them, in one request; `None` where there is none.
pub fn whole_if_there(path: &Path, most: u64) -> Result<Option<Vec<u8>>> {
    let (server, key) = server_of(path)?;
    match server.get_at_most(path, &key, None, most) {
        Ok(answer) => Ok(Some(answer.bytes)),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(Error::io("read", path, e)),
    }
}

/// As [`whole_if_there`], of a file that is asked for several times within seconds.
pub fn small_if_there(path: &Path, most: u64) -> Result<Option<Vec<u8>>> {
    let (server, _) = server_of(path)?;
    if let Some((at, known)) = lock(&server.small).get(path)
        && at.elapsed() < SMALL_FOR
    {
        return Ok(known.as_ref().map(|bytes| bytes.to_vec()));
    }
    let found = whole_if_there(path, most)?;
    if found.as_ref().is_none_or(|bytes| bytes.len() <= SMALL.1) {
        let mut small = lock(&server.small);
        if small.len() >= SMALL.0 {
            small.retain(|_, (at, _)| at.elapsed() < SMALL_FOR);
        }
        if small.len() < SMALL.0 {
            small.insert(path.to_path_buf(), (Instant::now(), found.as_deref().map(Arc::from)));
        }
    }
    Ok(found)
}

/// The names of the folders in a folder of a store.
pub fn folders_in(path: &Path) -> Result<Vec<String>> {
    let (server, key) = server_of(path)?;
    if !server.lists {
        return Err(Error::bad_input(path, "folder", "a server that lists its folders", "a web server")
            .with_help("name the array in it that is meant, or write the group's consolidated metadata"));
    }
    server.cache.asked();
    let list = wait(async {
        let begun = server.begin()?;
        server.bounded.begin_listing();
        server.within(begun, path, server.store.list_with_delimiter(Some(&key))).await
    })
    .flatten();
    let folders = list.map_err(|e| Error::io("list", path, e))?.common_prefixes;
    Ok(folders.iter().filter_map(|folder| folder.filename().map(str::to_owned)).collect())
}

/// Asks about files, by a listing or many at a time.
pub fn look_at(paths: &[PathBuf]) -> Result<()> {
    if paths.is_empty() {
        return Ok(());
    }
    let paths = not_listed(paths)?;
    let asked = wait(async {
        let (mut tasks, mut left) = (JoinSet::new(), paths.into_iter());
        loop {
            while tasks.len() < AT_ONCE
                && let Some(path) = left.next()
            {
                let (server, key) = server_of(&path)?;
                tasks.spawn(async move {
                    let asked = server.head(&path, &key).await;
                    asked.map_err(|e| Error::io("look at", &path, e))
                });
            }
            match tasks.join_next().await {
                None => return Ok(()),
                Some(Ok(asked)) => asked?,
                Some(Err(e)) => {
                    return Err(Error::io("ask a server", "files", io::Error::other(e.to_string())));
                }
            }
        }
    });
    asked.map_err(|e| Error::io("ask a server", "files", e))?
}

/// What the server said last about a file, which is asked about where nothing was said.
pub fn seen(path: &Path) -> Result<Seen> {
    let (server, _) = server_of(path)?;
    let known = || lock(&server.seen).get(&hash_of(path)).copied();
    if known().is_none() {
        look_at(&[path.to_path_buf()])?;
    }
    known().ok_or_else(|| Error::io("look at", path, io::Error::other("no answer")))
}

/// The server of a path, known from before or new, and the name of the object there.
pub(super) fn server_of(path: &Path) -> Result<(Arc<Server>, Key)> {
    // Connections are those of a process: a fork opens its own.
    static SERVERS: Mutex<BTreeMap<(u32, String), Arc<Server>>> = Mutex::new(BTreeMap::new());
    let expected = "s3://BUCKET/NAME or https://HOST/NAME";
    let bad = |got: String| Error::bad_input(path, "address", expected, got);
    let text = path.to_str().ok_or_else(|| bad("no UTF-8".into()))?;
    // What may be secret is not shown.
    let parsed = Url::parse(text);
    let is_open = |url: &Url| url.username().is_empty() && url.password().is_none();
    if parsed.as_ref().map_or(text.contains('@'), |url| !is_open(url)) {
        return Err(Error::usage(
            "an address with a name and a password would be shown and stored: leave them out",
        ));
    }
    let plain = text.split(['?', '#']).next().unwrap_or_default();
    if plain != text {
        let got = "an address with ? or #";
        return Err(Error::bad_input(Path::new(plain), "address", expected, got));
    }
    let url = parsed.map_err(|e| bad(e.to_string()))?;
    let (scheme, key) = ObjectStoreScheme::parse(&url).map_err(|e| bad(one_line(&e)))?;
    // The rest of the address without the key: the first part of the path may name a bucket.
    let mut origin = url.as_str().trim_end_matches('/');
    for _ in key.parts() {
        origin = origin.rsplit_once('/').map_or(origin, |(parent, _)| parent);
    }
    let origin = (std::process::id(), origin.to_owned());
    let mut servers = lock(&SERVERS);
    if let Some(server) = servers.get(&origin) {
        return Ok((Arc::clone(server), key));
    }
    // Another library of the process may have chosen the cipher suites before.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let bounded = Bounded::default();
    let server = Arc::new(Server {
        store: client(&scheme, &url, &bounded).map_err(|e| bad(one_line(&e)))?,
        lists: matches!(scheme, ObjectStoreScheme::AmazonS3),
        room: Semaphore::new(AT_ONCE),
        bounded,
        given_up: Mutex::default(),
        cache: ServerCache::default(),
        seen: Mutex::default(),
        small: Mutex::default(),
    });
    servers.insert(origin, Arc::clone(&server));
    Ok((server, key))
}

/// Failed requests are tried again, but none is begun later than this. One whose server cannot be
/// reached takes five seconds, the default of the client.
const TRIES_END: Duration = Duration::from_secs(15);
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// A client of the server of an address.
fn client(
    scheme: &ObjectStoreScheme,
    url: &Url,
    bounded: &Bounded,
) -> object_store::Result<Arc<dyn ObjectStore>> {
    let backoff = BackoffConfig { max_backoff: LONGEST_PAUSE, ..BackoffConfig::default() };
    let retry = RetryConfig { backoff, retry_timeout: TRIES_END, ..RetryConfig::default() };
    let options = options(url).into_iter();
    if matches!(scheme, ObjectStoreScheme::AmazonS3) {
        let builder = AmazonS3Builder::new()
            .with_client_options(Bounded::options())
            .with_http_connector(bounded.clone())
            .with_url(url.as_str())
            .with_retry(retry);
        let builder = options.fold(builder, |builder, (key, value)| match key.parse() {
            Ok(key) => builder.with_config(key, value),
            Err(_) => builder,
        });
        return Ok(Arc::new(builder.build()?));
    }
    let builder = HttpBuilder::new()
        .with_client_options(Bounded::options())
        .with_http_connector(bounded.clone())
        .with_url(&url[..Position::BeforePath])
        .with_retry(retry);
    let builder = options.fold(builder, |builder, (key, value)| match key.parse() {
        Ok(key) => builder.with_config(key, value),
        Err(_) => builder,
    });
    Ok(Arc::new(builder.build()?))
}

/// Keys and region from the environment. Plain HTTP only where the address itself says so.
fn options(url: &Url) -> Vec<(String, String)> {
    let mut options: Vec<_> = std::env::vars()
        .filter(|(k, _)| k.starts_with("AWS_"))
        .map(|(k, v)| (k.to_ascii_lowercase(), v))
        .collect();
    let plain = |address: &str| address.starts_with("http://");
    if plain(url.as_str()) || options.iter().any(|(k, v)| k.starts_with("aws_endpoint") && plain(v)) {
        options.push(("allow_http".into(), "true".into()));
    }
    options
}

#[cfg(test)]
mod tests {
    use super::*;
    use object_store::ObjectStoreExt;
    use object_store::memory::InMemory;

    /// A store in memory with so many files `a/c/N`, and as many others beside them.
    fn store(count: usize, others: usize) -> Server {
        let store = InMemory::new();
        let put = |key: String| wait(store.put(&Key::from(key), "bytes".into())).unwrap().unwrap();
        (0..count).for_each(|n| drop(put(format!("a/c/{n}"))));
        (0..others).for_each(|n| drop(put(format!("a/other/{n}"))));
        Server {
            store: Arc::new(store),
            lists: true,
            room: Semaphore::new(AT_ONCE),
            bounded: Bounded::default(),
            given_up: Mutex::default(),
            cache: ServerCache::default(),
            seen: Mutex::default(),
            small: Mutex::default(),
        }
    }

    fn paths(count: usize) -> Vec<PathBuf> {
        (0..count).map(|n| PathBuf::from(format!("s3://b/a/c/{n}"))).collect()
    }

    fn files(paths: &[PathBuf]) -> Listed<'_> {
        let file = |(n, path)| (Key::from(format!("a/c/{n}")), (path, None));
        paths.iter().map(PathBuf::as_path).enumerate().map(file).collect()
    }

    #[test]
    fn a_listing_says_what_each_answer_would() {
        let server = store(40, 3);
        // Two files are missing: nothing is said of them.
        let paths = paths(42);
        let mut left = files(&paths);
        wait(server.look_in_listing(&mut left)).unwrap();
        assert_eq!(left.len(), 2);
        assert_eq!(server.cache.traffic().requests, 2);
        let listed = lock(&server.seen).clone();
        for (key, (path, _)) in files(&paths[..40]) {
            wait(server.head(path, &key)).unwrap().unwrap();
            assert_eq!(listed[&hash_of(path)].len, Some(5));
            assert_eq!(lock(&server.seen)[&hash_of(path)].changes, 0, "the same length and tag");
        }
    }

    #[test]
    fn a_folder_with_many_other_files_is_not_listed_to_its_end() {
        let server = store(20, 3 * IN_ANSWER);
        let paths = paths(20);
        let mut left = files(&paths);
        left.insert(Key::from("a/d"), (Path::new("s3://b/a/d"), None));
        wait(server.look_in_listing(&mut left)).unwrap();
        assert_eq!(left.len(), 21);
        assert!(server.cache.traffic().requests <= 3);
    }

    #[test]
    fn the_folder_of_files_is_the_nearest() {
        let of = |names: &[&str]| {
            let keys: Vec<Key> = names.iter().map(|&n| Key::from(n)).collect();
            folder_of(keys.iter()).map(|key| key.to_string())
        };
        assert_eq!(of(&["a/b/c/0", "a/b/c/1"]).as_deref(), Some("a/b/c"));
        assert_eq!(of(&["a/b/c/0", "a/bc/1"]).as_deref(), Some("a"));
        assert_eq!(of(&["a/0", "b/0"]), None);
        assert_eq!(of(&["0", "1"]), None);
    }
}
