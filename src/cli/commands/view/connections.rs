//! Connections: how many at one time, and which one goes when another waits.
//!
//! ```text
//!  accepted ──10 s──▶ a request's head ──▶ in use, until its answer is sent ──▶ idle, a minute
//! ```
//!
//! Whoever can reach the port can connect. So a connection counts only while a request is under
//! way: when all places are taken, the one that has been without a request for longest is closed,
//! first of those that never had the token, but none before two seconds.

use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use std::collections::BTreeMap;
use std::future::Future as _;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll, Waker};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep, timeout};

/// Connections at one time; a browser opens six.
const CONNECTIONS: usize = 64;
/// The head of a request must come within this time, from the connection or its first byte on.
const HEAD: Duration = Duration::from_secs(10);
/// A connection without a request is closed after so long.
const IDLE: Duration = Duration::from_secs(60);
/// A request of which nothing comes or goes for so long is ended.
const QUIET: Duration = Duration::from_secs(300);
/// A connection that has been idle for less stays: its request may be on the way.
const GRACE: Duration = Duration::from_secs(2);
/// How often is looked for a place, or for a listener that works again.
const LOOK: Duration = Duration::from_millis(50);

/// A connection's place among the others.
#[derive(Clone)]
pub(super) struct Seat(Arc<Mutex<Use>>);

/// Held while a request is under way.
#[derive(Clone)]
pub(super) struct Busy(#[allow(dead_code, reason = "its count says whether a request is under way")] Arc<()>);

struct Use {
    /// The requests that are under way hold it.
    busy: Weak<()>,
    /// When the head began that has not ended.
    head: Option<Instant>,
    /// When something came or went last.
    last: Instant,
    /// Whether a request had the token.
    is_known: bool,
    /// Whether its place is wanted.
    is_closed: bool,
    waker: Option<Waker>,
}

impl Seat {
    fn new() -> Self {
        let now = Instant::now();
        let (busy, is_known, is_closed, waker) = (Weak::new(), false, false, None);
        Self(Arc::new(Mutex::new(Use { busy, head: Some(now), last: now, is_known, is_closed, waker })))
    }

    fn lock(&self) -> MutexGuard<'_, Use> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The head of a request is there.
    pub(super) fn begin(&self, is_known: bool) -> Busy {
        let mut seat = self.lock();
        seat.head = None;
        seat.is_known |= is_known;
        let busy = seat.busy.upgrade().unwrap_or_default();
        seat.busy = Arc::downgrade(&busy);
        Busy(busy)
    }

    /// Whether it has been without a request since when, and whether it had one with the token.
    fn idle_since(&self) -> Option<(bool, Instant)> {
        let seat = self.lock();
        (seat.busy.strong_count() == 0 && !seat.is_closed)
            .then(|| (seat.is_known, seat.head.unwrap_or(seat.last)))
    }

    fn close(&self) {
        let mut seat = self.lock();
        seat.is_closed = true;
        if let Some(waker) = seat.waker.take() {
            waker.wake();
        }
    }
}

impl Use {
    /// When it is to be closed.
    fn end(&self) -> Instant {
        match self.head {
            _ if self.busy.strong_count() > 0 => self.last + QUIET,
            Some(head) => head + HEAD,
            None => self.last + IDLE,
        }
    }
}

impl Connected<IncomingStream<'_, Limited>> for Seat {
    fn connect_info(stream: IncomingStream<'_, Limited>) -> Self {
        stream.io().seat.clone()
    }
}

/// Takes so many connections at one time.
pub(super) struct Limited {
    listener: TcpListener,
    open: Arc<Semaphore>,
    next: u64,
    seats: BTreeMap<u64, Weak<Mutex<Use>>>,
}

impl Limited {
    pub(super) fn new(listener: TcpListener) -> Self {
        Self { listener, open: Arc::new(Semaphore::new(CONNECTIONS)), next: 0, seats: BTreeMap::new() }
    }

    /// A place, for which an idle connection is closed where there is none.
    async fn place(&mut self) -> OwnedSemaphorePermit {
        loop {
            if let Ok(place) = self.open.clone().try_acquire_owned() {
                return place;
            }
            self.seats.retain(|_, seat| seat.strong_count() > 0);
            let seats = self.seats.values().filter_map(|seat| seat.upgrade().map(Seat));
            let idle = seats.filter_map(|seat| seat.idle_since().map(|since| (since, seat)));
            let idle = idle.filter(|((_, since), _)| since.elapsed() >= GRACE);
            if let Some((_, seat)) = idle.min_by_key(|(since, _)| *since) {
                seat.close();
            }
            // Where all are in use, this one waits.
            if let Ok(Ok(place)) = timeout(LOOK, self.open.clone().acquire_owned()).await {
                return place;
            }
        }
    }
}

impl Listener for Limited {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok((stream, address)) => {
                    let place = self.place().await;
                    let (seat, end) = (Seat::new(), Box::pin(tokio::time::sleep(HEAD)));
                    self.seats.insert(self.next, Arc::downgrade(&seat.0));
                    self.next += 1;
                    return (Connection { stream, seat, end, _place: place }, address);
                }
                // Too many open files, or a connection that ended at once: others go on.
                Err(_) => tokio::time::sleep(LOOK).await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A connection, and its place. What goes out counts, too: an answer may take long.
pub(super) struct Connection {
    stream: TcpStream,
    seat: Seat,
    /// Ends when it is to be closed, as far as is known.
    end: Pin<Box<Sleep>>,
    _place: OwnedSemaphorePermit,
}

impl Connection {
    /// Looks at what was done: something, or nothing for how long.
    fn timed<T>(
        &mut self,
        context: &mut Context<'_>,
        done: Poll<io::Result<T>>,
        is_head: bool,
    ) -> Poll<io::Result<T>> {
        let mut seat = self.seat.lock();
        if seat.is_closed {
            return Poll::Ready(Err(io::ErrorKind::ConnectionAborted.into()));
        }
        if done.is_ready() {
            seat.last = Instant::now();
            if is_head && seat.busy.strong_count() == 0 {
                seat.head = seat.head.or(Some(seat.last));
            }
            return done;
        }
        seat.waker = Some(context.waker().clone());
        loop {
            let end = seat.end();
            if self.end.deadline() != end {
                self.end.as_mut().reset(end);
            }
            match self.end.as_mut().poll(context) {
                Poll::Pending => return Poll::Pending,
                // A request may have begun or ended meanwhile.
                Poll::Ready(()) if seat.end() > end => {}
                Poll::Ready(()) => return Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            }
        }
    }
}

impl tokio::io::AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut tokio::io::ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let done = Pin::new(&mut self.stream).poll_read(context, buffer);
        let is_head = buffer.filled().len() > before;
        self.timed(context, done, is_head)
    }
}

impl tokio::io::AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let done = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.timed(context, done, false)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
