//! The crossed edges of a chunk that several blocks may have, found by their corners.
//!
//! Each corner that is the lower one of crossed edges has a *bucket* of their higher ones, a cache
//! line that is compared as a whole: which of them is wanted cannot be predicted, and a list that
//! is searched one by one pays for a branch at each step. Neighbouring tetrahedra have neighbouring
//! corners, so buckets are in cache, which the slots of a hash table are not. A corner with more
//! edges has a chain of buckets; one of enormous degree would make it slow, so what exceeds
//! `LONGEST_CHAIN` goes to a hash table. What belongs to an edge is kept elsewhere, by its number.

use isospan_io::exec::will_read;
use isospan_mesh::simd::places_among_eight;
use rustc_hash::FxHashMap;

/// No corner.
const NONE: u32 = u32::MAX;

/// Numbers edges in the order in which they are first looked for.
#[derive(Debug)]
pub(super) struct EdgeTable {
    /// The lower corner of each edge.
    pub(super) lows: Vec<u32>,
    /// First bucket of each corner; `NO_BUCKET` without.
    pub(super) heads: Vec<u32>,
    /// The first is empty, for corners that have none.
    pub(super) buckets: Vec<Bucket>,
    /// The edges that did not fit their chains; looked up, never iterated.
    pub(super) overflow: FxHashMap<(u32, u32), u32>,
}

/// Edges of one lower corner: a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Bucket {
    /// The higher corners, from the front; `NONE` behind, and in the last place always.
    high: [u32; 8],
    /// The numbers of the crossings; in the last place the next bucket of the chain.
    number: [u32; LANES],
}

const LANES: usize = 8;
/// The place of the next bucket.
const NEXT: usize = LANES - 1;
pub(super) const NO_BUCKET: u32 = 0;

impl Bucket {
    const EMPTY: Self = Self { high: [NONE; LANES], number: [NO_BUCKET; LANES] };
}

/// An edge that was looked for.
pub(super) enum EdgeLookup {
    Known(u32),
    New(u32),
}

impl Default for EdgeTable {
    fn default() -> Self {
        Self { lows: vec![], heads: vec![], buckets: vec![Bucket::EMPTY], overflow: FxHashMap::default() }
    }
}

impl EdgeTable {
    const LONGEST_CHAIN: usize = 8;

    /// Forgets all edges, in time proportional to their number, and makes room for the edges of
    /// this many corners.
    pub(super) fn clear(&mut self, corners: usize) {
        for low in self.lows.drain(..) {
            self.heads[low as usize] = NO_BUCKET;
        }
        self.buckets.truncate(1);
        self.overflow.clear();
        if self.heads.len() < corners {
            self.heads.resize(corners, NO_BUCKET);
        }
    }

    pub(super) fn bytes(&self) -> usize {
        (self.heads.capacity() + self.lows.capacity()) * 4
            + self.buckets.capacity() * size_of::<Bucket>()
            + self.overflow.capacity() * 16
    }

    /// Asks the processor to load what is needed to find an edge.
    #[inline(always)]
    pub(super) fn will_be_looked_for(&self, edge: [u32; 2]) {
        will_read(&self.buckets[self.heads[edge[0] as usize] as usize..][..1]);
    }

    /// The number of an edge. The caller adds what belongs to a new one.
    #[inline(always)]
    pub(super) fn find_or_add(&mut self, edge: [u32; 2]) -> EdgeLookup {
        let bucket = &self.buckets[self.heads[edge[0] as usize] as usize];
        let places = places_among_eight(&bucket.high, edge[1]);
        if places != 0 {
            return EdgeLookup::Known(bucket.number[places.trailing_zeros() as usize % LANES]);
        }
        self.find_or_add_behind(edge)
    }

    /// The number of an edge that is not in the first bucket of its lower corner.
    #[inline(never)]
    fn find_or_add_behind(&mut self, [low, high]: [u32; 2]) -> EdgeLookup {
        let mut at = self.heads[low as usize];
        let mut length = usize::from(at != NO_BUCKET);
        loop {
            let bucket = &self.buckets[at as usize];
            let places = places_among_eight(&bucket.high, high);
            if places != 0 {
                return EdgeLookup::Known(bucket.number[places.trailing_zeros() as usize % LANES]);
            }
            let next = bucket.number[NEXT];
            if next == NO_BUCKET {
                break;
            }
            (at, length) = (next, length + 1);
        }
        let number = self.lows.len() as u32;
        assert!(number < NONE, "a chunk has fewer than 2^32 - 1 crossed edges");
        let free = places_among_eight(&self.buckets[at as usize].high, NONE).trailing_zeros() as usize;
        if at != NO_BUCKET && free < NEXT {
            let bucket = &mut self.buckets[at as usize];
            (bucket.high[free], bucket.number[free]) = (high, number);
        } else if length < Self::LONGEST_CHAIN {
            self.chain(low, at, high, number);
        } else if let Some(known) = self.find_or_add_overflow((low, high), number) {
            return EdgeLookup::Known(known);
        }
        self.lows.push(low);
        EdgeLookup::New(number)
    }

    /// Adds a bucket behind the last one of a corner's chain.
    fn chain(&mut self, low: u32, last: u32, high: u32, number: u32) {
        let new = self.buckets.len() as u32;
        let mut bucket = Bucket::EMPTY;
        (bucket.high[0], bucket.number[0]) = (high, number);
        self.buckets.push(bucket);
        match last {
            NO_BUCKET => self.heads[low as usize] = new,
            last => self.buckets[last as usize].number[NEXT] = new,
        }
    }

    #[cold]
    fn find_or_add_overflow(&mut self, key: (u32, u32), number: u32) -> Option<u32> {
        let known = *self.overflow.entry(key).or_insert(number);
        (known != number).then_some(known)
    }
}
