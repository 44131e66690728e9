//! Bytes that were fetched and are borrowed from then on.

use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// A list of ranges that only grows, so that what it holds can be borrowed.
#[derive(Debug, Default)]
pub(super) struct Borrowed {
    first: OnceLock<Box<KeptBytes>>,
    bytes: AtomicU64,
}

#[derive(Debug)]
struct KeptBytes {
    start: u64,
    bytes: Vec<u8>,
    next: OnceLock<Box<KeptBytes>>,
}

impl Borrowed {
    /// All bytes that are kept.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// A range that lies in a kept one.
    pub(super) fn get(&self, range: &Range<u64>) -> Option<&[u8]> {
        let mut next = &self.first;
        while let Some(piece) = next.get() {
            if let Some(skip) = range.start.checked_sub(piece.start)
                && let Some(found) = piece.bytes.get(skip as usize..(range.end - piece.start) as usize)
            {
                return Some(found);
            }
            next = &piece.next;
        }
        None
    }

    /// Keeps bytes that begin at an offset.
    pub(super) fn keep(&self, start: u64, bytes: Vec<u8>) -> &[u8] {
        self.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let mut piece = Box::new(KeptBytes { start, bytes, next: OnceLock::new() });
        let mut next = &self.first;
        loop {
            match next.set(piece) {
                Ok(()) => return &next.get().expect("it was just set").bytes,
                // Others are there: it comes after the last one.
                Err(back) => piece = back,
            }
            next = &next.get().expect("it could not be set").next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_found_by_parts_of_it() {
        let kept = Borrowed::default();
        assert_eq!(kept.keep(10, vec![1, 2, 3]), [1, 2, 3]);
        kept.keep(100, vec![4, 5]);
        assert_eq!(kept.get(&(11..13)), Some(&[2, 3][..]));
        assert_eq!(kept.get(&(101..102)), Some(&[5][..]));
        assert_eq!((kept.get(&(12..14)), kept.get(&(9..11)), kept.bytes()), (None, None, 5));
    }
}
