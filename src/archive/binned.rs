//! A writer of pcodec's format for blocks of values: its classic mode, without differences of neighbours.
//!
//! The bytes are those of a chunk that [pcodec](https://docs.rs/pco) reads. Each number is in a **bin**: which one is told by asymmetric numeral
//! systems (four states in turn), the offset from the bin's lowest number in plain bits.
//!
//! pcodec finds bins by sorting all numbers halfway, which takes most of its time. Here an eighth of a block is sorted, and its quantiles are the
//! borders of up to [`MOST`] bins; those of neighbours are joined where that takes fewer bits, by dynamic programming as in pcodec. Which
//! bin a number is in is counted: the borders below it, in vectors. All is done in integers.

use super::values::BLOCK_VALUES;
use crate::exec::with_vectors;

/// Bins before neighbours are joined, at most.
const MOST: usize = 32;
/// Numbers that are sorted, at most.
const SORTED: usize = 128;
/// Numbers of a page that are written together: first their states' bits, then their offsets.
const BATCH: usize = 256;
/// States of the numeral system: 2 to this power, at most.
const MOST_STATES_LOG2: u32 = 8;
const MOST_STATES: usize = 1 << MOST_STATES_LOG2;

/// `log2(n)` in 1/1024, rounded, for n up to [`BLOCK_VALUES`]; of 0, 0.
static LOG2: [u32; BLOCK_VALUES + 1] = log2_table();

const fn log2_table() -> [u32; BLOCK_VALUES + 1] {
    let mut table = [0; BLOCK_VALUES + 1];
    let mut n = 1u64;
    while n <= BLOCK_VALUES as u64 {
        let whole = n.ilog2();
        // The fraction bit by bit: squared, it doubles its logarithm. One bit more than is kept, to round.
        let (mut x, mut bits, mut left) = ((n << 31) >> whole, 0u32, 11);
        while left > 0 {
            x = (x * x) >> 31;
            bits <<= 1;
            if x >> 32 != 0 {
                x >>= 1;
                bits |= 1;
            }
            left -= 1;
        }
        table[n as usize] = (whole << 10) + bits.div_ceil(2);
        n += 1;
    }
    table
}

/// What a number is, as pcodec tells types apart.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    I32 = 3,
    F32 = 5,
}

/// Some numbers that follow each other.
#[derive(Clone, Copy, Default)]
struct Bin {
    lower: u32,
    offset_bits: u32,
    count: u32,
    weight: u32,
}

/// How a symbol is written in a state: see [`Packer::states`].
#[derive(Clone, Copy, Default)]
struct Symbol {
    lower: u32,
    offset_bits: u32,
    add: u32,
    first: i32,
}

/// Packs blocks; its memory is kept from one to the next.
pub(super) struct Packer {
    /// Numbers in their order, as unsigned integers.
    numbers: [u32; BLOCK_VALUES],
    /// Of each number: the bin.
    bins: [u32; BLOCK_VALUES],
    next: [u16; MOST_STATES],
    state_bits: [u32; BLOCK_VALUES],
    state_lengths: [u8; BLOCK_VALUES],
}

impl Packer {
    pub(super) fn new() -> Box<Self> {
        Box::new(Self {
            numbers: [0; BLOCK_VALUES],
            bins: [0; BLOCK_VALUES],
            next: [0; MOST_STATES],
            state_bits: [0; BLOCK_VALUES],
            state_lengths: [0; BLOCK_VALUES],
        })
    }

    /// Appends a chunk with some numbers, told by what makes unsigned integers in their order of them.
    ///
    /// # Panics
    /// When there are none, or more than [`BLOCK_VALUES`].
    pub(super) fn pack(
        &mut self,
        kind: Kind,
        numbers: impl ExactSizeIterator<Item = u32>,
        out: &mut Vec<u8>,
    ) {
        let n = numbers.len();
        assert!((1..=BLOCK_VALUES).contains(&n), "as many numbers as a block has");
        self.numbers.iter_mut().zip(numbers).for_each(|(to, number)| *to = number);
        with_vectors(
            #[inline(always)]
            || self.pack_all(kind, n, out),
        );
    }

    #[inline(always)]
    fn pack_all(&mut self, kind: Kind, n: usize, out: &mut Vec<u8>) {
        let (borders, count) = self.borders(n);
        let (counts, uppers) = self.find_bins(n, &borders[..count]);
        let (mut joined, place) = join(n, &borders[..count], &counts, &uppers);
        let states_log2 = weigh(n, &mut joined);
        let symbols = self.spread(&joined, states_log2);
        // Of each number: the symbol in place of the bin.
        let symbol_of: [Symbol; MOST] = std::array::from_fn(|i| symbols[usize::from(place[i])]);
        let last_states = self.states(n, &symbol_of, states_log2);
        let mut bits = Bits::new(out, 64 + 6 * MOST + n * 5 + n / 4);
        bits.head(kind, n);
        bits.put(u64::from(states_log2), 4);
        bits.put(joined.len() as u64, 15);
        for bin in &joined {
            bits.put(u64::from(bin.weight - 1), states_log2);
            bits.put(u64::from(bin.lower), 32);
            bits.put(u64::from(bin.offset_bits), 6);
        }
        bits.end_byte();
        for state in last_states {
            bits.put(u64::from(state), states_log2);
        }
        bits.end_byte();
        for start in (0..n).step_by(BATCH) {
            let batch = start..n.min(start + BATCH);
            if states_log2 > 0 {
                for (some, lengths) in
                    self.state_bits[batch.clone()].chunks(4).zip(self.state_lengths[batch.clone()].chunks(4))
                {
                    let (mut all, mut length) = (0u64, 0);
                    for (&value, &len) in some.iter().zip(lengths) {
                        all |= u64::from(value) << length;
                        length += u32::from(len);
                    }
                    bits.put(all, length);
                }
            }
            for (&number, &bin) in self.numbers[batch.clone()].iter().zip(&self.bins[batch]) {
                let symbol = &symbol_of[bin as usize % MOST];
                bits.put(u64::from(number - symbol.lower), symbol.offset_bits);
            }
        }
        bits.end_byte();
        bits.put(0, 8);
        bits.finish();
    }

    /// The lowest number of each bin, and how many bins.
    #[inline(always)]
    fn borders(&self, n: usize) -> ([u32; MOST], usize) {
        let numbers = &self.numbers[..n];
        let (least, most) = numbers.iter().fold((u32::MAX, 0), |(a, b), &v| (a.min(v), b.max(v)));
        let (mut some, step) = ([0; SORTED], n.div_ceil(SORTED));
        some.iter_mut().zip(numbers.iter().step_by(step)).for_each(|(to, &v)| *to = v);
        let taken = n.div_ceil(step);
        let some = &mut some[..taken];
        some.sort_unstable();
        let (mut borders, mut count) = ([0; MOST], 1);
        borders[0] = least;
        let bins = MOST.min(n.div_ceil(16)).max(1);
        let mut add = |border: u32| {
            if count < MOST && border > borders[count - 1] {
                borders[count] = border;
                count += 1;
            }
        };
        for i in 1..bins {
            let (before, at) = (some[(i - 1) * taken / bins], some[i * taken / bins]);
            if before == at {
                // A number that is there often has a bin of its own.
                add(at);
                if at < most {
                    add(at + 1);
                }
            } else {
                add(at);
            }
        }
        (borders, count)
    }

    /// Finds the bin of each number; tells how many each has, and its highest; 0 of one that has none.
    #[inline(always)]
    fn find_bins(&mut self, n: usize, borders: &[u32]) -> ([u32; MOST], [u32; MOST]) {
        let (numbers, bins) = (&self.numbers[..n], &mut self.bins[..n]);
        bins.fill(0);
        for (numbers, bins) in numbers.chunks(64).zip(bins.chunks_mut(64)) {
            for &border in &borders[1..] {
                numbers.iter().zip(&mut *bins).for_each(|(&v, bin)| *bin += u32::from(v >= border));
            }
        }
        // Neighbours are often in one bin: four counters, so that none waits for the one before.
        let (mut counts, mut most) = ([[0u32; MOST]; 4], [[0u32; MOST]; 4]);
        for (some, numbers) in bins.chunks(4).zip(numbers.chunks(4)) {
            for (k, (&bin, &v)) in some.iter().zip(numbers).enumerate() {
                let bin = bin as usize % MOST;
                counts[k][bin] += 1;
                most[k][bin] = most[k][bin].max(v);
            }
        }
        (
            std::array::from_fn(|i| (0..4).map(|k| counts[k][i]).sum()),
            std::array::from_fn(|i| (0..4).fold(0, |all, k| all.max(most[k][i]))),
        )
    }

    /// Makes the tables of the numeral system: of the states of a symbol, which follow each other in [`Packer::next`], the `x`-th is in place
    /// `first + x`, and `(state + add) >> 16` bits of a state are written.
    #[inline(always)]
    fn spread(&mut self, bins: &[Bin], states_log2: u32) -> [Symbol; MOST] {
        let (mut symbols, mut place) = ([Symbol::default(); MOST], [0usize; MOST]);
        let mut at = 0;
        for ((symbol, place), bin) in symbols.iter_mut().zip(&mut place).zip(bins) {
            let least = states_log2 - (2 * bin.weight - 1).ilog2();
            let cutoff = (2 * bin.weight) << least;
            *symbol = Symbol {
                lower: bin.lower,
                offset_bits: bin.offset_bits,
                add: ((least + 1) << 16) - cutoff,
                first: at - bin.weight as i32,
            };
            *place = at as usize;
            at += bin.weight as i32;
        }
        // Which symbol a state is of, as pcodec spreads them; the states of each in ascending order.
        let states = 1usize << states_log2;
        let stride = (3 * states / 5) | 1;
        let (mut of_state, mut step) = ([0u8; MOST_STATES], 0);
        for (symbol, bin) in bins.iter().enumerate() {
            for _ in 0..bin.weight {
                of_state[(stride * step) & (states - 1)] = symbol as u8;
                step += 1;
            }
        }
        for (state, &symbol) in of_state[..states].iter().enumerate() {
            let place = &mut place[usize::from(symbol)];
            self.next[*place % MOST_STATES] = (states + state) as u16;
            *place += 1;
        }
        symbols
    }

    /// Goes through the numbers, the last one first, in four states in turn; tells the last ones, from 0 on.
    #[inline(always)]
    fn states(&mut self, n: usize, symbols: &[Symbol; MOST], states_log2: u32) -> [u32; 4] {
        let mut states = [1u32 << states_log2; 4];
        let mut step = |i: usize, state: &mut u32| {
            let symbol = &symbols[self.bins[i] as usize % MOST];
            let length = (*state + symbol.add) >> 16;
            self.state_bits[i] = *state & ((1 << length) - 1);
            self.state_lengths[i] = length as u8;
            let place = (*state >> length) as i32 + symbol.first;
            *state = u32::from(self.next[place as usize % MOST_STATES]);
        };
        let whole = n / 4 * 4;
        for i in (whole..n).rev() {
            step(i, &mut states[i % 4]);
        }
        for base in (0..whole).step_by(4).rev() {
            for (k, state) in states.iter_mut().enumerate().rev() {
                step(base + k, state);
            }
        }
        states.map(|state| state - (1 << states_log2))
    }
}

/// Joins neighbours where that takes fewer bits; also tells where each has gone.
#[inline(always)]
fn join(n: usize, borders: &[u32], counts: &[u32; MOST], uppers: &[u32; MOST]) -> (Vec<Bin>, [u8; MOST]) {
    // What a bin takes in the head, in 1/1024 bits.
    const META: u32 = (MOST_STATES_LOG2 + 38) << 10;
    let bins = borders.len();
    // Numbers in the bins before; the least bits for those, and the first of the last joined.
    let (mut before, mut best, mut from) = ([0u32; MOST + 1], [0u32; MOST + 1], [0usize; MOST + 1]);
    for i in 0..bins {
        before[i + 1] = before[i] + counts[i];
        let upper = uppers[i].max(borders[i]);
        let (mut least, mut first) = (u32::MAX, 0);
        for j in (0..=i).rev() {
            let count = before[i + 1] - before[j];
            let bits =
                ((u32::BITS - (upper - borders[j]).leading_zeros()) << 10) + LOG2[n] - LOG2[count as usize];
            let cost = best[j] + META + bits * count;
            if cost < least {
                (least, first) = (cost, j);
            }
        }
        (best[i + 1], from[i + 1]) = (least, first);
    }
    let (mut joined, mut end) = (vec![], bins);
    while end > 0 {
        joined.push((from[end], end));
        end = from[end];
    }
    joined.reverse();
    let mut place = [0u8; MOST];
    let bin = |(k, &(first, end)): (usize, &(usize, usize))| {
        place[first..end].fill(k as u8);
        let upper = uppers[end - 1].max(borders[end - 1]);
        let offset_bits = u32::BITS - (upper - borders[first]).leading_zeros();
        Bin { lower: borders[first], offset_bits, count: before[end] - before[first], weight: 0 }
    };
    (joined.iter().enumerate().map(bin).collect(), place)
}

/// Gives each bin its part of the states, at least one; tells how many states there are.
#[inline(always)]
fn weigh(n: usize, bins: &mut [Bin]) -> u32 {
    if let [bin] = bins {
        bin.weight = 1;
        return 0;
    }
    let states = MOST_STATES as u32;
    let n = n as u32;
    let mut sum = 0;
    for bin in &mut *bins {
        bin.weight = ((bin.count * states + n / 2) / n).max(1);
        sum += bin.weight;
    }
    // What rounding has left over or taken too much goes to the largest.
    while sum != states {
        let largest = bins.iter_mut().max_by_key(|bin| bin.weight).expect("there are bins");
        let change = if sum < states { states - sum } else { (sum - states).min(largest.weight / 8).max(1) };
        if sum < states {
            largest.weight += change;
            sum += change;
        } else {
            largest.weight -= change;
            sum -= change;
        }
    }
    MOST_STATES_LOG2
}

/// Writes bits, the lowest first.
struct Bits<'a> {
    out: &'a mut Vec<u8>,
    at: usize,
    waiting: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    #[inline(always)]
    fn new(out: &'a mut Vec<u8>, room: usize) -> Self {
        let at = out.len();
        out.resize(at + room, 0);
        Self { out, at, waiting: 0, count: 0 }
    }

    /// Up to 56 bits; those above are 0.
    #[inline(always)]
    fn put(&mut self, value: u64, length: u32) {
        self.waiting |= value << self.count;
        self.count += length;
        self.out[self.at..self.at + 8].copy_from_slice(&self.waiting.to_le_bytes());
        self.at += (self.count / 8) as usize;
        self.waiting >>= self.count & !7;
        self.count %= 8;
    }

    /// Zeros up to the next byte.
    #[inline(always)]
    fn end_byte(&mut self) {
        if self.count > 0 {
            self.put(0, 8 - self.count);
        }
    }

    /// All before the metadata of the chunk, and its mode.
    #[inline(always)]
    fn head(&mut self, kind: Kind, n: usize) {
        // "pco!", the version, and numbers of any type.
        self.put(u64::from(u32::from_le_bytes(*b"pco!")), 32);
        self.put(3, 16);
        // How many numbers, in as few bits as they take.
        let length = n.ilog2() + 1;
        self.put(u64::from(length - 1), 6);
        self.put(n as u64, length);
        self.end_byte();
        // The version of what follows: 4.1.
        self.put(4 | 1 << 8, 16);
        self.put(kind as u64, 8);
        self.put(n as u64 - 1, 24);
        // The classic mode, and no differences of neighbours.
        self.put(0, 8);
    }

    fn finish(self) {
        self.out.truncate(self.at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pco::standalone::simple_decompress;

    fn noise(n: usize) -> impl Iterator<Item = u32> {
        let next = |state: &u64| Some(state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
        std::iter::successors(Some(7u64), next).map(|state| (state >> 32) as u32).skip(3).take(n)
    }

    /// Packs numbers, with vectors and without, and reads them with pcodec.
    fn round_trip(numbers: &[u32]) -> usize {
        let (mut packer, mut out, mut plain) = (Packer::new(), vec![99], vec![]);
        packer.pack(Kind::I32, numbers.iter().copied(), &mut out);
        packer.pack_all(Kind::I32, numbers.len(), &mut plain);
        assert_eq!(out[1..], plain, "the same bytes without vectors");
        let back: Vec<i32> = simple_decompress(&plain).unwrap();
        assert!(back.iter().map(|&v| v as u32 ^ 1 << 31).eq(numbers.iter().copied()));
        packer.pack(Kind::F32, numbers.iter().copied(), &mut out);
        let back: Vec<f32> = simple_decompress(&out[1 + plain.len()..]).unwrap();
        let place = |v: f32| if v.is_sign_negative() { !v.to_bits() } else { v.to_bits() | 1 << 31 };
        assert!(back.iter().map(|&v| place(v)).eq(numbers.iter().copied()));
        plain.len()
    }

    #[test]
    fn pcodec_reads_what_is_packed() {
        for n in [1, 2, 3, 4, 5, 15, 16, 17, 127, 128, 129, 255, 256, 257, 1000, 1023, BLOCK_VALUES] {
            assert!(round_trip(&vec![5; n]) < 40);
            round_trip(&vec![u32::MAX; n]);
            round_trip(&(0..n as u32).collect::<Vec<_>>());
            assert!(round_trip(&noise(n).collect::<Vec<_>>()) <= 5 * n + 40);
            let few: Vec<u32> =
                noise(n).map(|v| [0, 3, 4, 1 << 31, u32::MAX][(v % 7 % 5) as usize]).collect();
            assert!(round_trip(&few) <= if n < 1000 { 4 * n + 60 } else { n / 3 + 90 });
            // Numbers of all lengths, and most of them the same.
            round_trip(&noise(n).map(|v| v >> (v % 32)).collect::<Vec<_>>());
            round_trip(&noise(n).map(|v| if v % 16 == 0 { v } else { 77 }).collect::<Vec<_>>());
        }
    }

    #[test]
    fn bins_follow_the_numbers() {
        // Cubes are dense near 0: less than the 4130 bytes that one bin for all would take.
        let all: Vec<u32> = noise(BLOCK_VALUES).collect();
        let cubes: Vec<u32> = all.iter().map(|&v| (u64::from(v >> 11).pow(3) >> 31) as u32).collect();
        let bytes = round_trip(&cubes);
        assert!(bytes < 4060, "{bytes}");
        // Of two heaps far apart, each number says which, and where in it: 11 bits and not 31, but for a few that are not among the sorted.
        let heaps: Vec<u32> = all.iter().map(|v| (v >> 31 << 30) + (v & 1023)).collect();
        let bytes = round_trip(&heaps);
        assert!(bytes < 1650, "{bytes}");
    }

    #[test]
    fn logarithms_are_rounded() {
        for (n, &log) in LOG2.iter().enumerate().skip(1) {
            assert!((f64::from(log) / 1024.0 - (n as f64).log2()).abs() < 0.6 / 1024.0, "{n}");
        }
    }
}
