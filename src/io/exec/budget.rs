//! A budget of bytes shared by everything in flight.

use super::CancelToken;
use crate::error::{Error, Result};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

#[derive(Debug)]
struct BudgetState {
    total: u64,
    used: Mutex<Use>,
    released: Condvar,
}

#[derive(Debug, Default)]
struct Use {
    now: u64,
    peak: u64,
}

/// A number of bytes that may be in use at one time. Clones share the same budget.
#[derive(Clone, Debug)]
pub struct MemoryBudget(Arc<BudgetState>);

impl MemoryBudget {
    /// A budget of `total` bytes.
    pub fn new(total: u64) -> Self {
        Self(Arc::new(BudgetState { total, used: Mutex::default(), released: Condvar::new() }))
    }

    /// The budget's size.
    pub fn total(&self) -> u64 {
        self.0.total
    }

    /// The largest number of bytes that were taken at one time.
    pub fn peak(&self) -> u64 {
        self.0.used.lock().unwrap_or_else(PoisonError::into_inner).peak
    }

    /// Takes `bytes`, waiting until others give back enough.
    ///
    /// # Errors
    /// [`Error::Budget`] when `bytes` alone exceed the budget; [`Error::Cancelled`] when cancelled
    /// while waiting.
    pub fn acquire(&self, bytes: u64, cancel: &CancelToken) -> Result<Permit> {
        if bytes > self.0.total {
            return Err(Error::memory("", bytes, self.0.total));
        }
        let mut used = self.0.used.lock().unwrap_or_else(PoisonError::into_inner);
        while used.now + bytes > self.0.total {
            cancel.check()?;
            // The timeout only bounds how long a cancellation can go unnoticed.
            (used, _) = self
                .0
                .released
                .wait_timeout(used, Duration::from_millis(50))
                .unwrap_or_else(PoisonError::into_inner);
        }
        used.now += bytes;
        used.peak = used.peak.max(used.now);
        Ok(Permit { shared: Arc::clone(&self.0), bytes })
    }
}

/// Bytes taken from a [`MemoryBudget`]; dropping gives them back.
#[derive(Debug)]
pub struct Permit {
    shared: Arc<BudgetState>,
    bytes: u64,
}

impl Permit {
    /// The bytes that this permit stands for.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Gives back all but `bytes`: a stage turned its input into something smaller.
    pub fn shrink(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        self.bytes -= less;
        give_back(&self.shared, less);
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        give_back(&self.shared, self.bytes);
    }
}

fn give_back(shared: &BudgetState, bytes: u64) {
    shared.used.lock().unwrap_or_else(PoisonError::into_inner).now -= bytes;
    shared.released.notify_all();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_much_is_refused_naming_what_would_do() {
        let budget = MemoryBudget::new(100);
        let error = budget.acquire(101, &CancelToken::new()).unwrap_err();
        assert_eq!((error.exit_code(), error.to_string().contains("101")), (4, true));
    }

    #[test]
    fn the_sum_in_use_never_exceeds_the_total() {
        let (budget, cancel) = (MemoryBudget::new(100), CancelToken::new());
        std::thread::scope(|s| {
            for _ in 0..4 {
                s.spawn(|| {
                    for i in 0..200u64 {
                        let mut p = budget.acquire(1 + i % 60, &cancel).unwrap();
                        p.shrink(1);
                    }
                });
            }
        });
        assert!(budget.peak() <= 100 && budget.peak() >= 60);
        assert_eq!(budget.0.used.lock().unwrap().now, 0);
    }

    #[test]
    fn waiting_ends_when_cancelled() {
        let (budget, cancel) = (MemoryBudget::new(10), CancelToken::new());
        let _all = budget.acquire(10, &cancel).unwrap();
        cancel.cancel();
        assert!(matches!(budget.acquire(1, &cancel), Err(Error::Cancelled)));
    }
}
