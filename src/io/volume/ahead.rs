//! Chunks that are decoded before they are asked for, because each has to wait for a server.
//!
//! The question: a request to a server takes some 20 ms, so a thread that waits for one after the
//! other is idle most of the time. The chunks that will be needed are announced, in their order,
//! and some threads of their own fetch and decode them. These threads wait nearly always.
//!
//! ```text
//!  will_need(chunks) ─▶ wanted, in order ─▶ threads: decode ─▶ ready ─▶ take(chunk)
//! ```
//!
//! Memory: as many chunks as [`most_ahead`] says are ready or being decoded at a time. Chunks that
//! nobody takes give way to those that are asked for. Which chunks are ready changes no sample.

use crate::error::Result;
use std::collections::{HashMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Requests that wait at the same time, at most.
const AT_ONCE: u64 = 32;
/// Bytes that chunks decoded ahead may take, unless one has more.
const BYTES: u64 = 64 << 20;
/// Chunks that are announced and not begun; more are forgotten.
const WANTED: usize = 4096;

/// How many chunks are decoded ahead, where one takes so many bytes.
pub(super) fn most_ahead(bytes_of_one: u64) -> u64 {
    (BYTES / bytes_of_one.max(1)).clamp(1, AT_ONCE)
}

/// The chunks of a source that are decoded ahead.
pub(super) struct Ahead(Arc<AheadWork>);

type Decode = dyn Fn([u64; 3]) -> Decoded + Send + Sync;

struct AheadWork {
    decode: Box<Decode>,
    most: usize,
    state: Mutex<State>,
    changed: Condvar,
}

type Decoded = Result<Vec<u8>>;

#[derive(Default)]
struct State {
    wanted: VecDeque<[u64; 3]>,
    /// Those begun; `None` while one is decoded.
    begun: HashMap<[u64; 3], Option<Decoded>>,
    /// Those that are ready, in the order in which they became so, and how many had been asked for
    /// in vain by then.
    ready: VecDeque<([u64; 3], usize)>,
    /// Chunks that were asked for and not begun.
    in_vain: usize,
    threads: usize,
    idle: usize,
    is_over: bool,
}

impl Ahead {
    /// Up to `most` chunks are decoded ahead by `decode`.
    pub(super) fn new(most: u64, decode: impl Fn([u64; 3]) -> Decoded + Send + Sync + 'static) -> Self {
        let (state, changed) = (Mutex::default(), Condvar::new());
        Self(Arc::new(AheadWork { decode: Box::new(decode), most: most as usize, state, changed }))
    }

    /// The most chunks that are ready or being decoded.
    pub(super) fn most(&self) -> usize {
        self.0.most
    }

    /// Announces chunks, in the order in which they will be asked for; `soon` puts them before
    /// others.
    pub(super) fn will_need(&self, chunks: impl DoubleEndedIterator<Item = [u64; 3]>, soon: bool) {
        let mut state = self.0.lock();
        let new = |state: &State, at: &[u64; 3]| !state.begun.contains_key(at);
        if soon {
            for at in chunks.rev() {
                if new(&state, &at) {
                    state.wanted.retain(|other| *other != at);
                    state.wanted.push_front(at);
                }
            }
        } else {
            for at in chunks {
                if new(&state, &at) && !state.wanted.contains(&at) {
                    state.wanted.push_back(at);
                }
            }
        }
        state.wanted.truncate(WANTED);
        let missing = state.wanted.len().min(self.0.most.saturating_sub(state.begun.len()));
        for _ in state.idle..missing {
            if state.threads >= self.0.most {
                break;
            }
            let shared = Arc::clone(&self.0);
            let thread = std::thread::Builder::new().name("isospan-ahead".into());
            // Without threads, chunks are decoded when they are asked for.
            if thread.spawn(move || shared.work()).is_err() {
                break;
            }
            state.threads += 1;
        }
        drop(state);
        self.0.changed.notify_all();
    }

    /// A chunk that was decoded ahead, or is being decoded now; `None` of others, which are decoded
    /// by whoever asks.
    pub(super) fn take(&self, at: [u64; 3]) -> Option<Decoded> {
        let mut state = self.0.lock();
        loop {
            match state.begun.get(&at) {
                Some(Some(_)) => {
                    let found = state.begun.remove(&at).flatten();
                    state.ready.retain(|(other, _)| *other != at);
                    drop(state);
                    self.0.changed.notify_all();
                    return found;
                }
                Some(None) => state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                None => break,
            }
        }
        state.wanted.retain(|other| *other != at);
        state.in_vain += 1;
        // What nobody took for long stands in the way of what is needed.
        if state.begun.len() >= self.0.most
            && let Some(&(oldest, since)) = state.ready.front()
            && state.in_vain - since > self.0.most
        {
            state.ready.pop_front();
            state.begun.remove(&oldest);
            drop(state);
            self.0.changed.notify_all();
        }
        None
    }

    /// Forgets chunks that will not be asked for.
    pub(super) fn forget(&self, gone: impl Fn([u64; 3]) -> bool) {
        let mut state = self.0.lock();
        state.wanted.retain(|at| !gone(*at));
        let State { begun, ready, .. } = &mut *state;
        ready.retain(|(at, _)| !gone(*at));
        begun.retain(|at, decoded| decoded.is_none() || !gone(*at));
        drop(state);
        self.0.changed.notify_all();
    }
}

impl Drop for Ahead {
    fn drop(&mut self) {
        let mut state = self.0.lock();
        state.is_over = true;
        state.wanted.clear();
        drop(state);
        // Nobody waits for what they still decode.
        self.0.changed.notify_all();
    }
}

impl AheadWork {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What a thread does until all is over.
    fn work(&self) {
        let mut state = self.lock();
        while !state.is_over {
            let next = if state.begun.len() < self.most { state.wanted.pop_front() } else { None };
            let Some(at) = next else {
                state.idle += 1;
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                state.idle -= 1;
                continue;
            };
            state.begun.insert(at, None);
            drop(state);
            let decoded = catch_unwind(AssertUnwindSafe(|| (self.decode)(at)));
            state = self.lock();
            match decoded {
                Ok(decoded) => {
                    state.begun.insert(at, Some(decoded));
                    let in_vain = state.in_vain;
                    state.ready.push_back((at, in_vain));
                }
                // Whoever asks for it decodes it again, and sees the panic.
                Err(_) => {
                    state.begun.remove(&at);
                }
            }
            self.changed.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn places(n: u64) -> impl DoubleEndedIterator<Item = [u64; 3]> {
        (0..n).map(|x| [x, 0, 0])
    }

    /// Chunk 3 cannot be decoded, chunk 4 is a bug.
    fn decode(at: [u64; 3]) -> Decoded {
        assert_ne!(at[0], 4, "a bug, as this test wants it");
        if at[0] == 3 { Err(Error::usage("bad")) } else { Ok(vec![at[0] as u8]) }
    }

    #[test]
    fn what_is_taken_is_what_decoding_gives() {
        for most in [1, 2, 20] {
            let ahead = Ahead::new(most, decode);
            ahead.will_need(places(10), false);
            ahead.will_need((7..10).map(|x| [x, 0, 0]), true);
            for at in places(10).chain(places(10)) {
                let found =
                    ahead.take(at).unwrap_or_else(|| if at[0] == 4 { Ok(vec![4]) } else { decode(at) });
                match at[0] {
                    3 => assert!(found.is_err()),
                    x => assert_eq!(found.unwrap(), [x as u8]),
                }
            }
        }
    }

    #[test]
    fn no_more_are_begun_than_may_be_ready() {
        let count = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&count);
        let ahead = Ahead::new(3, move |at| {
            counted.fetch_add(1, Ordering::SeqCst);
            Ok(vec![at[0] as u8])
        });
        let all_are_ready = || {
            while ahead.0.lock().ready.len() < 3 {
                std::thread::yield_now();
            }
        };
        ahead.will_need(places(10), false);
        for at in places(3) {
            all_are_ready();
            assert_eq!(count.load(Ordering::SeqCst), 3 + at[0] as usize);
            assert_eq!(ahead.take(at).unwrap().unwrap(), [at[0] as u8]);
        }
        // What nobody takes gives way, and what will not be asked for is forgotten.
        all_are_ready();
        assert!((20..60).all(|x| ahead.take([x, 0, 0]).is_none()));
        assert!(ahead.take([3, 0, 0]).is_none());
        ahead.forget(|_| true);
        let state = ahead.0.lock();
        assert!(state.wanted.is_empty() && state.ready.is_empty());
        assert!(count.load(Ordering::SeqCst) <= 10);
    }

    #[test]
    fn one_is_decoded_ahead_even_if_it_is_large() {
        assert_eq!([1, 2 << 20, 30 << 20, 1 << 40].map(most_ahead), [AT_ONCE, AT_ONCE, 2, 1]);
    }
}
