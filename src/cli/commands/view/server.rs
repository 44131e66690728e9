//! The server: who may ask, how much at one time, and how answers travel.
//!
//! It listens on 127.0.0.1. Every address begins with a random token, so other users of the machine
//! and pages of other sites cannot ask. The `Host` header must name this server, so no name of
//! another site leads here. The numbers of open connections and of working requests are limited;
//! others wait. A request's head must come within seconds, and a connection without a request is
//! closed when another one waits (`connections`): who only connects keeps nobody out.

use super::connections::{Busy, Limited, Seat};
use super::page;
use crate::answers::{self, Archives, Sink};
use axum::body::{Body, Bytes};
use axum::extract::{ConnectInfo, Path, Query, Request, State};
use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{AppendHeaders, IntoResponse, Response};
use axum::routing::{MethodRouter, get};
use axum::{Extension, Router};
use isospan::exec::CancelToken;
use isospan::{Error, Resources, Result};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::runtime::Builder;
use tokio::sync::{Semaphore, mpsc};
use tokio_stream::StreamExt as _;
use tokio_stream::wrappers::ReceiverStream;

/// Requests that work at one time.
const SLOTS: usize = 2;
/// Each of them has a quarter of the memory. Another quarter is for decoded blocks.
pub(super) const SHARE: u64 = 4;
/// Pieces of an answer that wait for a slow reader.
const PIECES: usize = 4;
/// Bytes of a piece of an answer.
const PIECE: usize = 256 << 10;
/// How often the token of the signals is checked.
const LOOK: Duration = Duration::from_millis(100);

struct Server {
    archives: Archives,
    /// The resources of one slot.
    means: Resources,
    /// `127.0.0.1:PORT` and `localhost:PORT`.
    hosts: [String; 2],
    /// What addresses begin with: the token between slashes.
    prefix: String,
    slots: Arc<Semaphore>,
    jobs: Arc<Jobs>,
}

/// The jobs that run now, so that all can be stopped.
#[derive(Default)]
struct Jobs {
    next: AtomicU64,
    tokens: Mutex<BTreeMap<u64, CancelToken>>,
}

impl Jobs {
    fn begin(self: &Arc<Self>) -> Job {
        let (number, token) = (self.next.fetch_add(1, Ordering::Relaxed), CancelToken::new());
        self.tokens().insert(number, token.clone());
        Job { jobs: self.clone(), number, token }
    }

    fn tokens(&self) -> std::sync::MutexGuard<'_, BTreeMap<u64, CancelToken>> {
        self.tokens.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn stop(&self) {
        self.tokens().values().for_each(CancelToken::cancel);
    }
}

/// A job; without it the job is stopped.
struct Job {
    jobs: Arc<Jobs>,
    number: u64,
    token: CancelToken,
}

impl Drop for Job {
    fn drop(&mut self) {
        self.token.cancel();
        self.jobs.tokens().remove(&self.number);
    }
}

/// Serves until it is stopped; `started` has the address as soon as requests are taken.
pub(super) fn serve(
    archives: Archives,
    means: Resources,
    address: SocketAddr,
    token: &str,
    stop: &CancelToken,
    started: impl FnOnce(SocketAddr) -> Result<()>,
) -> Result<()> {
    let failed = |e| Error::io("serve at", address.to_string(), e);
    let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build().map_err(failed)?;
    let served = runtime.block_on(async {
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let port = address.port();
        let server = Arc::new(Server {
            archives,
            means: means.clone().with_memory(means.memory / SHARE),
            hosts: [format!("127.0.0.1:{port}"), format!("localhost:{port}")],
            prefix: format!("/{token}/"),
            slots: Arc::new(Semaphore::new(SLOTS)),
            jobs: Arc::default(),
        });
        started(address)?;
        let app = router(server.clone(), token).into_make_service_with_connect_info::<Seat>();
        let stopped = async {
            while !stop.is_cancelled() {
                tokio::time::sleep(LOOK).await;
            }
        };
        tokio::select! {
            served = axum::serve(Limited::new(listener), app) => served.map_err(failed),
            () = stopped => {
                server.jobs.stop();
                Ok(())
            }
        }
    });
    // Jobs that were stopped remove their temporary files.
    runtime.shutdown_timeout(Duration::from_secs(5));
    served
}

fn router(server: Arc<Server>, token: &str) -> Router {
    let mut router = Router::new();
    for (n, file) in page::FILES.iter().enumerate() {
        let name = if n == 0 { "" } else { file.name };
        let answer = move || async move {
            let encoding = file.is_gzip.then_some([(header::CONTENT_ENCODING, "gzip")]);
            (encoding.map(AppendHeaders), [(header::CONTENT_TYPE, file.kind)], file.content).into_response()
        };
        router = router.route(&format!("/{token}/{name}"), get(answer));
    }
    router
        .route(&format!("/{token}/archives"), get(archives))
        .route(&format!("/{token}/colours"), get(colours))
        .route(&format!("/{token}/{{archive}}/spectrum"), ask(JSON, answers::spectrum))
        .route(&format!("/{token}/{{archive}}/bounds"), ask(JSON, answers::bounds))
        .route(&format!("/{token}/{{archive}}/surface"), ask(PARTS, answers::surface))
        .route(&format!("/{token}/{{archive}}/slice"), ask(NUMBERS, answers::slice))
        .route(&format!("/{token}/{{archive}}/export"), ask(NUMBERS, answers::export))
        .layer(middleware::from_fn_with_state(server.clone(), guard))
        .with_state(server)
}

/// Refuses what does not come from our own page, and forbids pages of others to use what we answer.
async fn guard(
    State(server): State<Arc<Server>>,
    ConnectInfo(seat): ConnectInfo<Seat>,
    mut request: Request,
    next: Next,
) -> Response {
    let host = request.headers().get(header::HOST).and_then(|h| h.to_str().ok());
    let is_our_name = host.is_some_and(|h| server.hosts.iter().any(|own| own == h));
    let is_known = is_our_name && request.uri().path().starts_with(&server.prefix);
    // The connection is in use until the answer is made; the answer goes on with it.
    request.extensions_mut().insert(seat.begin(is_known));
    let mut response = if !is_our_name {
        refusal(StatusCode::MISDIRECTED_REQUEST, "this server has another name")
    } else if request.method() != Method::GET && request.method() != Method::HEAD {
        refusal(StatusCode::METHOD_NOT_ALLOWED, "only GET is answered")
    } else {
        next.run(request).await
    };
    const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                          connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
    let headers = [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in headers {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

fn refusal(status: StatusCode, text: &str) -> Response {
    (status, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], format!("{text}\n")).into_response()
}

fn refused(error: &Error) -> Response {
    let status = match error {
        Error::Usage(_) | Error::NoSuch(_) => StatusCode::BAD_REQUEST,
        Error::Budget { .. } => StatusCode::PAYLOAD_TOO_LARGE,
        Error::Cancelled => StatusCode::SERVICE_UNAVAILABLE,
        _ => StatusCode::INTERNAL_SERVER_ERROR,
    };
    refusal(status, &words(error))
}

fn words(error: &Error) -> String {
    isospan::error::printable(&error.to_string()).into_owned()
}

/// What an answer is.
#[derive(Clone, Copy)]
struct AnswerKind {
    content: &'static str,
    /// Whether the last part can say what went wrong.
    in_parts: bool,
}

const JSON: AnswerKind = AnswerKind { content: "application/json", in_parts: false };
const NUMBERS: AnswerKind = AnswerKind { content: "application/octet-stream", in_parts: false };
const PARTS: AnswerKind = AnswerKind { in_parts: true, ..NUMBERS };

async fn archives(State(server): State<Arc<Server>>, Extension(busy): Extension<Busy>) -> Response {
    answer(server, busy, JSON, |server, _, sink| answers::archives(&server.archives, sink)).await
}

async fn colours(State(server): State<Arc<Server>>, Extension(busy): Extension<Busy>) -> Response {
    answer(server, busy, JSON, |_, _, sink| answers::colours(sink)).await
}

/// A question about an archive: the archives, which of them, the parameters, what may be used.
type Question<Q> = fn(&Archives, usize, &Q, &Resources, &mut dyn Sink) -> Result<()>;

fn ask<Q: DeserializeOwned + Send + 'static>(
    kind: AnswerKind,
    question: Question<Q>,
) -> MethodRouter<Arc<Server>> {
    get(
        move |State(server): State<Arc<Server>>,
              Extension(busy): Extension<Busy>,
              Path(archive): Path<usize>,
              Query(query): Query<Q>| {
            answer(server, busy, kind, move |server, resources, sink| {
                question(&server.archives, archive, &query, resources, sink)
            })
        },
    )
}

/// Does blocking work in a slot, and streams what comes of it. The work stops when its reader is
/// gone.
async fn answer(
    server: Arc<Server>,
    busy: Busy,
    kind: AnswerKind,
    work: impl FnOnce(&Server, &Resources, &mut dyn Sink) -> Result<()> + Send + 'static,
) -> Response {
    // As many wait as there are connections.
    let Ok(slot) = server.slots.clone().acquire_owned().await else {
        return refused(&Error::Cancelled);
    };
    let (to, mut pieces) = mpsc::channel(PIECES);
    let job = server.jobs.begin();
    let resources = server.means.clone().with_cancel(job.token.clone());
    tokio::task::spawn_blocking(move || {
        let _slot = slot;
        let mut sink = Stream::new(to);
        let result = work(&server, &resources, &mut sink);
        sink.end(result.map_err(|e| e.of_share(resources.memory, resources.memory * SHARE)), kind);
    });
    let first: Option<Result<Bytes>> = pieces.recv().await;
    let content = [(header::CONTENT_TYPE, kind.content)];
    match first {
        Some(Err(e)) => refused(&e),
        Some(Ok(first)) => {
            let all = tokio_stream::once(Ok(first)).chain(ReceiverStream::new(pieces));
            // The job ends with the stream that holds it, and the connection is in use until then.
            let all = all.map(move |piece| {
                let _ = (&job, &busy);
                piece
            });
            (content, Body::from_stream(all)).into_response()
        }
        None => (content, Body::empty()).into_response(),
    }
}

/// Takes the bytes of an answer, and hands them on in pieces. Waits for a slow reader, holding
/// little.
struct Stream {
    to: mpsc::Sender<Result<Bytes>>,
    piece: Vec<u8>,
    has_begun: bool,
}

impl Sink for Stream {
    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        bytes.chunks(PIECE).try_for_each(|part| {
            self.piece.extend_from_slice(part);
            if self.piece.len() >= PIECE { self.flush() } else { Ok(()) }
        })
    }

    /// # Errors
    /// [`Error::Cancelled`] when the reader is gone.
    fn flush(&mut self) -> Result<()> {
        let piece = std::mem::replace(&mut self.piece, Vec::with_capacity(PIECE));
        self.has_begun = true;
        self.to.blocking_send(Ok(piece.into())).map_err(|_| Error::Cancelled)
    }
}

impl Stream {
    fn new(to: mpsc::Sender<Result<Bytes>>) -> Self {
        Self { to, piece: Vec::with_capacity(PIECE), has_begun: false }
    }

    /// Ends the answer with an error, or with what is left of its bytes.
    fn end(mut self, mut result: Result<()>, kind: AnswerKind) {
        if self.has_begun && kind.in_parts {
            result = result.or_else(|e| answers::failed_part(&words(&e), &mut self));
        }
        let result = result.and_then(|()| if self.piece.is_empty() { Ok(()) } else { self.flush() });
        if let Err(e) = result {
            // A reader that is gone needs no error.
            let _ = self.to.blocking_send(Err(e));
        }
    }
}
