//! What of a server's answers reaches the client library: bounded, whatever the server sends.
//!
//! The library collects the bodies of failures and of listings whole. Here they are read first, up
//! to a limit. Bodies of files pass: their reader counts their bytes and seconds.

use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody,
    HttpService, ReqwestConnector,
};
use object_store::{ClientOptions, Result};
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio_stream::StreamExt as _;

/// Bytes of the body of a failure that are read: a server's words about it.
const FAILURE: usize = 16 << 10;
/// Bytes of a page of a listing, at most: a thousand names of a thousand bytes, and as much again.
const PAGE: usize = 4 << 20;
/// Bytes of all pages of a listing, at most.
const LISTING: u64 = 64 << 20;
/// The library's own limit of a request. Ours are stricter: of half a minute, as long as no bytes
/// come.
const LONGEST: Duration = Duration::from_secs(3600);

/// Makes clients whose answers are bounded.
#[derive(Clone, Debug, Default)]
pub(super) struct Bounded {
    listed: Arc<AtomicU64>,
}

impl Bounded {
    /// A listing begins.
    pub(super) fn begin_listing(&self) {
        self.listed.store(0, Ordering::Relaxed);
    }

    /// What a client of this kind is made with.
    pub(super) fn options() -> ClientOptions {
        ClientOptions::new().with_timeout(LONGEST)
    }
}

impl HttpConnector for Bounded {
    fn connect(&self, options: &ClientOptions) -> Result<HttpClient> {
        let client = ReqwestConnector::default().connect(options)?;
        Ok(HttpClient::new(Service { client, listed: self.listed.clone() }))
    }
}

#[derive(Debug)]
struct Service {
    client: HttpClient,
    listed: Arc<AtomicU64>,
}

impl HttpService for Service {
    fn call<'a, 'b>(
        &'a self,
        request: HttpRequest,
    ) -> Pin<Box<dyn Future<Output = std::result::Result<HttpResponse, HttpError>> + Send + 'b>>
    where
        'a: 'b,
        Self: 'b,
    {
        Box::pin(self.answer(request))
    }
}

impl Service {
    async fn answer(&self, request: HttpRequest) -> std::result::Result<HttpResponse, HttpError> {
        // Files have addresses without a query.
        let is_listing = request.uri().query().is_some();
        let (head, body) = self.client.execute(request).await?.into_parts();
        let range = head.headers.get("content-range").and_then(|range| range.to_str().ok());
        if let Some(range) = range.filter(|range| has_large_number(range)) {
            return Err(refused(format!("a Content-Range of numbers that no file has: {range}")));
        }
        if !head.status.is_success() {
            let (words, _) = first_bytes(body, FAILURE).await?;
            let words = String::from_utf8_lossy(&words).into_owned();
            return Ok(HttpResponse::from_parts(head, words.into()));
        }
        if !is_listing {
            return Ok(HttpResponse::from_parts(head, body));
        }
        let (page, is_whole) = first_bytes(body, PAGE).await?;
        let all = self.listed.fetch_add(page.len() as u64, Ordering::Relaxed) + page.len() as u64;
        if !is_whole || all > LISTING {
            return Err(refused("a listing that has no end".into()));
        }
        Ok(HttpResponse::from_parts(head, page.into()))
    }
}

/// An error after which a request is not tried again.
fn refused(what: String) -> HttpError {
    HttpError::new(HttpErrorKind::Decode, io::Error::other(format!("the server sends {what}")))
}

/// Whether a number of a header is larger than any length of a file.
fn has_large_number(text: &str) -> bool {
    let numbers = text.split(|c: char| !c.is_ascii_digit()).filter(|number| !number.is_empty());
    numbers.into_iter().any(|number| number.parse::<i64>().is_err())
}

/// The first bytes of a body, and whether these are all.
async fn first_bytes(body: HttpResponseBody, most: usize) -> std::result::Result<(Vec<u8>, bool), HttpError> {
    let (mut stream, mut out) = (body.bytes_stream(), vec![]);
    while let Some(piece) = stream.next().await {
        let piece = piece?;
        let room = most - out.len();
        out.extend_from_slice(&piece[..piece.len().min(room)]);
        if piece.len() > room {
            return Ok((out, false));
        }
    }
    Ok((out, true))
}
