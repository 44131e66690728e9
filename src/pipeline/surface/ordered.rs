//! An ordered pipeline: pieces are made in parallel and consumed in order, without needless
//! waiting.
//!
//! ```text
//!  pieces ──▶ made, on any thread ──▶ held until those before are done ──▶ consumed, by one thread at a time, in order
//! ```
//!
//! A thread that has made a piece checks whether the next piece in order is ready. If so, and if no
//! other thread is consuming, it consumes that piece. Then it begins a new one. So no thread waits
//! while there is work: the last pieces are consumed while others are made, and a single thread
//! consumes each piece at once, while it is in cache. Pieces are begun in order, as memory allows.
//!
//! A piece that fails ends the pipeline at its turn, so the first error in order is reported.

use crate::error::{Error, Result};
use crate::exec::Reorder;
use rayon::{Scope, ThreadPool};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Takes pieces, in order.
pub(super) trait Last: Send {
    type Piece: Send;
    /// Takes a piece, told its number.
    fn take(&mut self, number: usize, piece: Self::Piece) -> Result<()>;
}

/// The pieces, on their way.
pub(super) struct Line<M, L: Last> {
    make: M,
    /// Bytes that each piece takes from its beginning until it has been taken.
    bytes: Vec<u64>,
    most_bytes: u64,
    /// Pieces that are made at one time, and those that are not yet taken.
    making: usize,
    held: usize,
    state: Mutex<State<L>>,
}

struct State<L: Last> {
    /// Pieces that were begun, that are being made, that were taken.
    begun: usize,
    making: usize,
    taken: usize,
    /// Bytes of those that were begun and not yet taken.
    bytes: u64,
    made: Reorder<Result<L::Piece>>,
    /// Gone while it takes a piece.
    last: Option<L>,
    failed: Option<Error>,
}

impl<M, L> Line<M, L>
where
    M: Fn(usize) -> Result<L::Piece> + Sync,
    L: Last,
{
    /// A line of as many pieces as there are `bytes`, on the threads of a pool.
    pub(super) fn new(bytes: Vec<u64>, most_bytes: u64, pool: &ThreadPool, make: M, last: L) -> Self {
        let (begun, making, taken) = (0, 0, 0);
        let made = Reorder::new(0);
        let state = State { begun, making, taken, bytes: 0, made, last: Some(last), failed: None };
        let making = pool.current_num_threads();
        Self { make, bytes, most_bytes, making, held: 4 * making, state: Mutex::new(state) }
    }

    /// Makes and takes all pieces.
    ///
    /// # Errors
    /// The first one, in the order of the pieces.
    pub(super) fn run(self, pool: &ThreadPool) -> Result<L> {
        pool.scope(|scope| self.begin(scope));
        let State { last, failed, .. } = self.state.into_inner().unwrap_or_else(PoisonError::into_inner);
        match failed {
            Some(error) => Err(error),
            None => Ok(last.expect("it is there when nobody takes a piece")),
        }
    }

    fn state(&self) -> MutexGuard<'_, State<L>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins the next pieces, as far as threads and memory allow. One alone is always begun.
    fn begin<'s>(&'s self, scope: &Scope<'s>) {
        let mut state = self.state();
        while let Some(&bytes) = self.bytes.get(state.begun) {
            let fits = state.bytes == 0 || state.bytes.saturating_add(bytes) <= self.most_bytes;
            let has_thread = state.making < self.making && state.begun - state.taken < self.held;
            if state.failed.is_some() || !fits || !has_thread {
                return;
            }
            let number = state.begun;
            (state.begun, state.making) = (state.begun + 1, state.making + 1);
            state.bytes = state.bytes.saturating_add(bytes);
            scope.spawn(move |scope| self.work(number, scope));
        }
    }

    /// Makes a piece, and takes those whose turn it is.
    fn work<'s>(&'s self, number: usize, scope: &Scope<'s>) {
        let piece = (self.make)(number);
        let mut state = self.state();
        state.making -= 1;
        state.made.push(number as u64, piece);
        drop(state);
        self.begin(scope);
        while self.take_next() {
            self.begin(scope);
        }
    }

    /// Takes the next piece, if it is there and nobody else is about that.
    fn take_next(&self) -> bool {
        let mut state = self.state();
        let Some(mut last) = state.last.take() else { return false };
        let (number, next) = (state.taken, state.made.pop());
        let Some(piece) = next else {
            state.last = Some(last);
            return false;
        };
        let has_failed = state.failed.is_some();
        drop(state);
        let taken = if has_failed { Ok(()) } else { piece.and_then(|piece| last.take(number, piece)) };
        let mut state = self.state();
        state.last = Some(last);
        state.taken += 1;
        state.bytes = state.bytes.saturating_sub(self.bytes[number]);
        state.failed = state.failed.take().or(taken.err());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exec::pool;
    use std::sync::atomic::{AtomicU64, Ordering};

    #[derive(Default)]
    struct Numbers(Vec<usize>);

    impl Last for Numbers {
        type Piece = usize;
        fn take(&mut self, number: usize, piece: usize) -> Result<()> {
            assert_eq!(piece, number * number);
            self.0.push(number);
            Ok(())
        }
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
    fn pieces_are_taken_in_order_in_bounded_memory() {
        for threads in [1, 2, 5] {
            let (pool, now, most) = (pool(threads).unwrap(), AtomicU64::new(0), AtomicU64::new(0));
            let make = |n: usize| {
                most.fetch_max(now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                spin(n);
                now.fetch_sub(1, Ordering::SeqCst);
                Ok(n * n)
            };
            let taken = Line::new(vec![10; 200], 30, &pool, make, Numbers::default()).run(&pool).unwrap();
            assert!(taken.0.into_iter().eq(0..200), "{threads} threads");
            assert!(Line::new(vec![], 0, &pool, make, Numbers::default()).run(&pool).unwrap().0.is_empty());
            assert!(most.into_inner() <= 3.min(threads as u64), "at most three pieces fit");
            // What does not fit is made alone.
            let alone = Line::new(vec![10; 20], 9, &pool, |n| Ok(n * n), Numbers::default()).run(&pool);
            assert_eq!(alone.unwrap().0.len(), 20);
        }
    }

    #[test]
    fn the_first_error_in_order_is_told() {
        let pool = pool(3).unwrap();
        let make = |n: usize| {
            spin(n);
            if n == 13 || n == 14 { Err(Error::usage(format!("piece {n}"))) } else { Ok(n * n) }
        };
        for _ in 0..20 {
            let error =
                Line::new(vec![1; 100], 1000, &pool, make, Numbers::default()).run(&pool).err().unwrap();
            assert!(error.to_string().contains("piece 13"), "{error}");
        }
    }
}
