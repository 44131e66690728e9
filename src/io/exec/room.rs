//! Reusable scratch memory, borrowed piece by piece.
//!
//! The system provides large vectors and takes them back, and clearing their pages costs more than
//! much of the work done in them. So work on a chunk borrows the unused part of the memory in which
//! the chunk was meshed. What does not fit is
//! allocated.

use bytemuck::Pod;
use std::ops::{Deref, DerefMut};

/// Memory that is empty and not lent yet: some pieces.
#[derive(Debug, Default)]
pub struct Room<'a>(Vec<&'a mut [u64]>);

/// A piece of a room, or where that was too small a vector.
#[derive(Debug)]
pub enum Lent<'a, T> {
    /// Memory of a room.
    Piece(&'a mut [T]),
    /// Memory of its own.
    Own(Vec<T>),
}

impl<'a> Room<'a> {
    /// Lends memory whose contents are not needed.
    pub fn new(empty: &'a mut [u64]) -> Self {
        Self(vec![empty])
    }

    /// The same with more memory, used for what does not fit in the first.
    #[must_use]
    pub fn and(mut self, more: &'a mut [u64]) -> Self {
        self.0.push(more);
        self
    }

    /// Without any memory: all that is lent is allocated.
    pub fn none() -> Self {
        Self::default()
    }

    /// Lends room for `count` items, each with this value.
    pub fn lend<T: Pod>(&mut self, count: usize, value: T) -> Lent<'a, T> {
        const WORD: usize = size_of::<u64>();
        let bytes = count.checked_mul(size_of::<T>()).filter(|_| align_of::<T>() <= WORD);
        let found =
            bytes.and_then(|n| self.0.iter_mut().find(|empty| n.div_ceil(WORD) <= empty.len()).zip(bytes));
        let Some((empty, bytes)) = found else { return Lent::Own(vec![value; count]) };
        let (piece, rest) = std::mem::take(empty).split_at_mut(bytes.div_ceil(WORD));
        *empty = rest;
        let items = bytemuck::cast_slice_mut(&mut bytemuck::cast_slice_mut::<u64, u8>(piece)[..bytes]);
        items.fill(value);
        Lent::Piece(items)
    }
}

impl<T> Deref for Lent<'_, T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match self {
            Self::Piece(items) => items,
            Self::Own(items) => items,
        }
    }
}

impl<T> DerefMut for Lent<'_, T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T] {
        match self {
            Self::Piece(items) => items,
            Self::Own(items) => items,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lent_lies_apart_and_has_its_value() {
        for words in [0, 3, 8, 40] {
            let mut memory = vec![u64::MAX; words];
            let mut room = Room::new(&mut memory);
            let mut small = room.lend(5, 7u8);
            let mut rows = room.lend(2, [1u32, 2, 3, 4]);
            let none = room.lend(0, 0.0f64);
            let mut wide = room.lend(20, 9.0f64);
            assert_eq!(
                (&*small, &*rows, &*none, &*wide),
                (&[7u8; 5][..], &[[1, 2, 3, 4]; 2][..], &[][..], &[9.0; 20][..])
            );
            small.fill(1);
            rows.fill([5; 4]);
            wide.fill(3.0);
            assert_eq!((&*small, &*rows, &*wide), (&[1u8; 5][..], &[[5; 4]; 2][..], &[3.0; 20][..]));
            let is_piece = [
                matches!(small, Lent::Piece(_)),
                matches!(rows, Lent::Piece(_)),
                matches!(wide, Lent::Piece(_)),
            ];
            assert_eq!(is_piece, [words >= 1, words >= 5, words >= 25], "{words}");
            let mut more = [u64::MAX; 20];
            let mut room = Room::new(&mut memory).and(&mut more);
            let (large, small) = (room.lend(20, 2u64), room.lend(1, 3u64));
            assert!(matches!(large, Lent::Piece(_)) && large.iter().all(|&n| n == 2) && *small == [3]);
        }
    }
}
