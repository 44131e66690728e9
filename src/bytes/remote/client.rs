//! The client of object stores and web servers.
//!
//! Keys and region come from the environment, as for Amazon's own tools (`AWS_ACCESS_KEY_ID`,
//! `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT_URL`; `AWS_SKIP_SIGNATURE=true` for public
//! buckets). Failed requests are tried again by the client; a server that does not exist, or does
//! not answer, is given up within about half a minute. A server must answer range requests; one
//! that sends the whole file instead is an error.

use super::{Fetched, Ranges, Wanted};
use crate::error::{Error, Result};
use object_store::aws::AmazonS3Builder;
use object_store::http::HttpBuilder;
use object_store::path::Path as Key;
use object_store::{BackoffConfig, GetOptions, GetRange, ObjectStore, ObjectStoreScheme, RetryConfig};
use std::future::Future;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use url::{Position, Url};

/// The address of an object, in its parts.
pub(super) struct Address {
    path: PathBuf,
    url: Url,
    scheme: ObjectStoreScheme,
    key: Key,
    origin: String,
}

impl Address {
    pub(super) fn of(path: &Path) -> Result<Self> {
        let bad = |got: String| bad_address(path, got);
        let text = path.to_str().ok_or_else(|| bad("no UTF-8".into()))?;
        let url = Url::parse(text).map_err(|e| bad(e.to_string()))?;
        if url.query().is_some() || url.fragment().is_some() {
            return Err(bad("an address with ? or #".into()));
        }
        let (scheme, key) = ObjectStoreScheme::parse(&url).map_err(|e| bad(one_line(&e)))?;
        // The rest of the address without the key: the first part of the path may name a bucket.
        let mut origin = url.as_str().trim_end_matches('/');
        for _ in key.parts() {
            origin = origin.rsplit_once('/').map_or(origin, |(parent, _)| parent);
        }
        let origin = origin.to_owned();
        Ok(Self { path: path.to_path_buf(), url, scheme, key, origin })
    }

    /// What the addresses of all objects of the server, or of the bucket, begin with.
    pub(super) fn origin(&self) -> &str {
        &self.origin
    }

    /// The name of the object there.
    pub(super) fn into_name(self) -> String {
        self.key.into()
    }

    /// A client of the server.
    pub(super) fn client(&self) -> Result<Client> {
        // Another library of the process may have chosen the cipher suites before.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let store = client(&self.scheme, &self.url).map_err(|e| bad_address(&self.path, one_line(&e)))?;
        Ok(Client { store })
    }
}

fn bad_address(path: &Path, got: String) -> Error {
    Error::bad_input(path, "address", "s3://BUCKET/NAME.isospan or https://HOST/NAME.isospan", got)
}

/// A client of a server or bucket.
pub(super) struct Client {
    store: Box<dyn ObjectStore>,
}

impl Ranges for Client {
    fn get(&self, name: &str, wanted: &Wanted) -> io::Result<Fetched> {
        let key = Key::parse(name).map_err(io::Error::other)?;
        let range = match wanted {
            Wanted::Last(count) => GetRange::Suffix(*count),
            Wanted::At(range) => GetRange::Bounded(range.clone()),
        };
        let options = GetOptions { range: Some(range), ..GetOptions::default() };
        let (len, range, bytes) = wait(async {
            let got = self.store.get_opts(&key, options).await?;
            let (len, range) = (got.meta.size, got.range.clone());
            Ok::<_, object_store::Error>((len, range, got.bytes().await?))
        })?
        .map_err(as_io)?;
        Ok(Fetched { len, range, bytes: bytes.to_vec() })
    }
}

fn as_io(error: object_store::Error) -> io::Error {
    let kind = match error {
        object_store::Error::NotFound { .. } => io::ErrorKind::NotFound,
        object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
            io::ErrorKind::PermissionDenied
        }
        _ => io::ErrorKind::Other,
    };
    io::Error::new(kind, one_line(&error))
}

/// A message in one line (those of servers have line ends), with its first cause where the
/// message does not include it.
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
    static RUNTIME: LazyLock<io::Result<Runtime>> = LazyLock::new(|| {
        Builder::new_multi_thread().worker_threads(2).thread_name("isospan-net").enable_all().build()
    });
    match &*RUNTIME {
        Ok(runtime) => Ok(runtime.block_on(request)),
        Err(e) => Err(io::Error::new(e.kind(), e.to_string())),
    }
}

/// Failed requests are tried again, but none is begun later than this. A request without an
/// answer takes half a minute itself, one whose server cannot be reached five seconds: the
/// defaults of the client.
const TRIES_END: Duration = Duration::from_secs(15);
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// A client of the server of an address.
fn client(scheme: &ObjectStoreScheme, url: &Url) -> object_store::Result<Box<dyn ObjectStore>> {
    let backoff = BackoffConfig { max_backoff: LONGEST_PAUSE, ..BackoffConfig::default() };
    let retry = RetryConfig { backoff, retry_timeout: TRIES_END, ..RetryConfig::default() };
    let options = options(url).into_iter();
    if matches!(scheme, ObjectStoreScheme::AmazonS3) {
        let builder = AmazonS3Builder::new().with_url(url.as_str()).with_retry(retry);
        let builder = options.fold(builder, |builder, (key, value)| match key.parse() {
            Ok(key) => builder.with_config(key, value),
            Err(_) => builder,
        });
        return Ok(Box::new(builder.build()?));
    }
    let builder = HttpBuilder::new().with_url(&url[..Position::BeforePath]).with_retry(retry);
    let builder = options.fold(builder, |builder, (key, value)| match key.parse() {
        Ok(key) => builder.with_config(key, value),
        Err(_) => builder,
    });
    Ok(Box::new(builder.build()?))
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
