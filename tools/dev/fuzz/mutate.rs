//! Damage of all kinds, chosen by a generator that gives the same choices everywhere.

/// SplitMix64 (Steele, Lea, Flood 2014).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64, case: u64) -> Self {
        let mut random = Self(seed ^ case.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        random.next();
        random
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// A number below `n`, which is not 0.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    pub(crate) fn pick<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[self.below(list.len())]
    }
}

/// Numbers at which arithmetic breaks.
const NUMBERS: [u64; 20] = [
    0,
    1,
    2,
    7,
    0x7f,
    0x80,
    0xff,
    0x7fff,
    0xffff,
    0x0100_0001,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    1 << 40,
    1 << 62,
    i64::MAX as u64,
    1 << 63,
    u64::MAX - 1,
    u64::MAX,
];

/// Texts in the place of a number.
const WORDS: [&str; 24] = [
    "0",
    "1",
    "-1",
    "2",
    "3",
    "65536",
    "16777217",
    "2147483648",
    "4294967295",
    "4294967296",
    "1000000000000000000",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "99999999999999999999999999999999999999999",
    "-9223372036854775808",
    "1e308",
    "-1e309",
    "1e-320",
    "nan",
    "inf",
    "0x10",
    "",
    "7.5",
];

/// The largest input that damage may grow to.
const LARGEST: usize = 1 << 20;

/// One to four kinds of damage; `other` is another good input of the same kind.
pub(crate) fn mutate(input: &[u8], other: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = input.to_vec();
    for _ in 0..=random.below(4) {
        damage(&mut bytes, other, random);
    }
    bytes.truncate(LARGEST);
    bytes
}

/// A place to damage: headers are at the start, so half of all places are there; directories at the
/// end.
fn place(len: usize, random: &mut Random) -> usize {
    match random.below(8) {
        0..=3 => random.below(len.min(400)),
        4 => len - 1 - random.below(len.min(200)),
        _ => random.below(len),
    }
}

fn damage(bytes: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    if bytes.is_empty() {
        bytes.push(random.next() as u8);
        return;
    }
    let at = place(bytes.len(), random);
    let longest = *random.pick(&[40, 40, 40, 4096]);
    let run = 1 + random.below(longest);
    let end = bytes.len().min(at + run);
    match random.below(14) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = random.next() as u8,
        2 => bytes.truncate(at),
        3 => drop(bytes.drain(at..end)),
        4 => {
            let copy = bytes[at..end].to_vec();
            bytes.splice(at..at, copy);
        }
        5 => {
            let noise: Vec<u8> = (0..run.min(64)).map(|_| random.next() as u8).collect();
            bytes.splice(at..at, noise);
        }
        6 | 7 => put_number(bytes, at, random),
        8..=10 => put_word(bytes, at, random),
        11 => lines(bytes, other, random),
        12 if !other.is_empty() => {
            let from = random.below(other.len());
            let part = other[from..other.len().min(from + run)].to_vec();
            bytes.splice(at..end, part);
        }
        _ => {
            let byte = *random.pick(b"\0 \n\"<>/=.-9\xff");
            bytes[at..end].fill(byte);
        }
    }
}

/// A binary number at a place aligned to its size, in either byte order.
fn put_number(bytes: &mut [u8], at: usize, random: &mut Random) {
    let size = *random.pick(&[1usize, 2, 4, 8]);
    let (at, number) = (at / size * size, *random.pick(&NUMBERS));
    let mut word = number.to_le_bytes()[..size].to_vec();
    if random.below(3) == 0 {
        word.reverse();
    }
    for (to, from) in bytes[at..].iter_mut().zip(word) {
        *to = from;
    }
}

/// Another text in the place of the next number at or after `at`.
fn put_word(bytes: &mut Vec<u8>, at: usize, random: &mut Random) {
    let digit = |b: &u8| b.is_ascii_digit();
    let Some(start) = bytes[at..].iter().position(digit).map(|i| at + i) else { return };
    let end = bytes[start..].iter().position(|b| !digit(b)).map_or(bytes.len(), |i| start + i);
    bytes.splice(start..end, random.pick(&WORDS).bytes());
}

/// A line is doubled, lost, exchanged for another or for one of another input.
fn lines(bytes: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    let split = |b: &[u8]| b.split_inclusive(|&b| b == b'\n').map(<[u8]>::to_vec).collect::<Vec<_>>();
    let (mut all, others) = (split(bytes), split(other));
    let at = random.below(all.len().min(40));
    match random.below(4) {
        0 => drop(all.remove(at)),
        1 => all.insert(at, all[at].clone()),
        2 => {
            let to = random.below(all.len());
            all.swap(at, to);
        }
        _ if !others.is_empty() => all[at] = others[random.below(others.len().min(40))].clone(),
        _ => {}
    }
    *bytes = all.concat();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_follows_from_the_seed_and_differs_from_case_to_case() {
        let input: Vec<u8> = (0..200).map(|i| b"sizes: 10 20\nok "[i % 16]).collect();
        let make = |case| mutate(&input, b"other\nlines\n", &mut Random::new(1, case));
        let all: Vec<Vec<u8>> = (0..500).map(make).collect();
        assert!((0..500).all(|case| make(case) == all[case as usize]));
        let changed = all.iter().filter(|b| **b != input).count();
        let mut distinct = all.clone();
        distinct.sort();
        distinct.dedup();
        assert!(changed > 480 && distinct.len() > 450, "{changed} changed, {} distinct", distinct.len());
        // What is empty stays an input.
        mutate(&[], &[], &mut Random::new(2, 2));
    }
}
