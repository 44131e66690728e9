//! Releases pieces in the order of their sequence numbers, however they arrive, so that output
//! depends on input alone.

use std::collections::BTreeMap;

/// Holds back pieces that come before their turn.
#[derive(Debug)]
pub struct Reorder<T> {
    next: u64,
    waiting: BTreeMap<u64, T>,
}

impl<T> Reorder<T> {
    /// Nothing waiting; the first piece to be released is number `first`.
    pub fn new(first: u64) -> Self {
        Self { next: first, waiting: BTreeMap::new() }
    }

    /// Takes in piece number `sequence`.
    pub fn push(&mut self, sequence: u64, piece: T) {
        self.waiting.insert(sequence, piece);
    }

    /// The next piece in order, if it has arrived.
    pub fn pop(&mut self) -> Option<T> {
        let piece = self.waiting.remove(&self.next)?;
        self.next += 1;
        Some(piece)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_leave_in_order() {
        let (mut r, mut out) = (Reorder::new(3), vec![]);
        for n in [5, 4, 7, 3, 6] {
            r.push(n, n);
            while let Some(p) = r.pop() {
                out.push(p);
            }
        }
        assert_eq!(out, [3, 4, 5, 6, 7]);
    }
}
