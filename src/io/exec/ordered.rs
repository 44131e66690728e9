//! An ordered pipeline: pieces are made in parallel and consumed in order, without needless
//! waiting.
//!
//! ```text
//!  pieces ──▶ made, on any thread ──▶ held until those before are done ──▶ consumed, by one thread at a time, in order
//! ```
//!
//! One thread makes and consumes piece after piece. Of several, a thread that has made a piece
//! checks whether the next piece in order is ready. If so, and if no other thread is consuming, it
//! consumes that piece. Then it begins a new one. So no thread waits while there is work: the last
//! pieces are consumed while others are made, and a single thread consumes each piece at once,
//! while it is in cache. Pieces are begun in order, as memory allows.
//!
//! A piece that fails ends the pipeline at its turn, so the first error in order is reported.

use super::{Reorder, Threads};
use crate::error::{Error, Result};
use rayon::Scope;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Makes as many pieces as there are `bytes`, on some threads, and consumes them in order.
///
/// Piece `n` takes `bytes[n]` from its beginning until it was consumed. All at work take
/// `most_bytes` together at most, but one alone is always begun.
///
/// # Errors
/// The first one, in the order of the pieces.
pub fn in_order<T: Send>(
    bytes: &[u64],
    most_bytes: u64,
    threads: &Threads,
    make: impl Fn(usize) -> Result<T> + Sync,
    mut consume: impl FnMut(usize, T) -> Result<()> + Send,
) -> Result<()> {
    let Threads::Pool(pool) = threads else {
        return (0..bytes.len()).try_for_each(|n| consume(n, make(n)?));
    };
    let (begun, making, consumed) = (0, 0, 0);
    let (made, consume) = (Reorder::new(0), Some(consume));
    let state = State { begun, making, consumed, bytes: 0, made, consume, failed: None };
    let making = threads.count();
    let pipeline = Pipeline { make, bytes, most_bytes, making, held: 4 * making, state: Mutex::new(state) };
    pool.scope(|scope| pipeline.begin(scope));
    let state = pipeline.state.into_inner().unwrap_or_else(PoisonError::into_inner);
    state.failed.map_or(Ok(()), Err)
}

/// The pieces, on their way.
struct Pipeline<'a, M, T, C> {
    make: M,
    bytes: &'a [u64],
    most_bytes: u64,
    /// Pieces that are made at one time, and those that are not yet consumed, at most.
    making: usize,
    held: usize,
    state: Mutex<State<T, C>>,
}

struct State<T, C> {
    /// Pieces that were begun, that are being made, that were consumed.
    begun: usize,
    making: usize,
    consumed: usize,
    /// Bytes of those that were begun and not yet consumed.
    bytes: u64,
    made: Reorder<Result<T>>,
    /// Gone while it consumes a piece.
    consume: Option<C>,
    failed: Option<Error>,
}

impl<M, T, C> Pipeline<'_, M, T, C>
where
    T: Send,
    M: Fn(usize) -> Result<T> + Sync,
    C: FnMut(usize, T) -> Result<()> + Send,
{
    fn state(&self) -> MutexGuard<'_, State<T, C>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins the next pieces, as far as threads and memory allow.
    fn begin<'s>(&'s self, scope: &Scope<'s>) {
        let mut state = self.state();
        while let Some(&bytes) = self.bytes.get(state.begun) {
            let fits = state.bytes == 0 || state.bytes.saturating_add(bytes) <= self.most_bytes;
            let has_thread = state.making < self.making && state.begun - state.consumed < self.held;
            if state.failed.is_some() || !fits || !has_thread {
                return;
            }
            let number = state.begun;
            (state.begun, state.making) = (state.begun + 1, state.making + 1);
            state.bytes = state.bytes.saturating_add(bytes);
            scope.spawn(move |scope| self.work(number, scope));
        }
    }

    /// Makes a piece, and consumes those whose turn it is.
    fn work<'s>(&'s self, number: usize, scope: &Scope<'s>) {
        let piece = (self.make)(number);
        let mut state = self.state();
        state.making -= 1;
        state.made.push(number as u64, piece);
        drop(state);
        self.begin(scope);
        while self.consume_next() {
            self.begin(scope);
        }
    }

    /// Consumes the next piece, if it is there and no other thread is about that.
    fn consume_next(&self) -> bool {
        let mut state = self.state();
        let Some(mut consume) = state.consume.take() else { return false };
        let (number, next) = (state.consumed, state.made.pop());
        let Some(piece) = next else {
            state.consume = Some(consume);
            return false;
        };
        let has_failed = state.failed.is_some();
        drop(state);
        let done = if has_failed { Ok(()) } else { piece.and_then(|piece| consume(number, piece)) };
        let mut state = self.state();
        state.consume = Some(consume);
        state.consumed += 1;
        state.bytes = state.bytes.saturating_sub(self.bytes[number]);
        state.failed = state.failed.take().or(done.err());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// The squares that were consumed, in order.
    fn squares(
        bytes: &[u64],
        most_bytes: u64,
        threads: &Threads,
        make: impl Fn(usize) -> Result<usize> + Sync,
    ) -> Result<Vec<usize>> {
        let mut consumed = vec![];
        in_order(bytes, most_bytes, threads, make, |number, piece| {
            assert_eq!(piece, number * number);
            consumed.push(number);
            Ok(())
        })?;
        Ok(consumed)
    }

    /// Work of a length that has nothing to do with the number.
    fn spin(n: usize) {
        let steps = n * 7919 % 64 * 500;
        assert!(
            (0..steps).fold(1u64, |x, i| std::hint::black_box(x.wrapping_mul(i as u64 | 1))) != 0
                || steps > 0
        );
    }

    #[test]
    fn pieces_are_consumed_in_order_in_bounded_memory() {
        for threads in [1, 2, 5] {
            let (pool, now, most) = (Threads::new(threads).unwrap(), AtomicU64::new(0), AtomicU64::new(0));
            let make = |n: usize| {
                most.fetch_max(now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                spin(n);
                now.fetch_sub(1, Ordering::SeqCst);
                Ok(n * n)
            };
            let consumed = squares(&[10; 200], 30, &pool, make).unwrap();
            assert!(consumed.into_iter().eq(0..200), "{threads} threads");
            assert!(squares(&[], 0, &pool, make).unwrap().is_empty());
            assert!(most.into_inner() <= 3.min(threads as u64), "at most three pieces fit");
            // An item that does not fit is made alone.
            assert_eq!(squares(&[10; 20], 9, &pool, |n| Ok(n * n)).unwrap().len(), 20);
        }
    }

    #[test]
    fn the_first_error_in_order_is_reported() {
        let make = |n: usize| {
            spin(n);
            if n == 13 || n == 14 { Err(Error::usage(format!("piece {n}"))) } else { Ok(n * n) }
        };
        for threads in [1, 3] {
            let threads = Threads::new(threads).unwrap();
            for _ in 0..20 {
                let error = squares(&[1; 100], 1000, &threads, make).unwrap_err();
                assert!(error.to_string().contains("piece 13"), "{error}");
            }
        }
    }
}
