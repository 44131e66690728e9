//! Decodes arrays of `EXT_meshopt_compression`: see `encode`. What is damaged is `None`.

use super::encode::{ATTRIBUTES, GROUP, OTHER, Recent, TOLD, TRIANGLES, block_elements, tail_bytes};

/// Bytes that are taken from the front.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take(1).map(|one| one[0])
    }
}

/// The elements of an array of attributes.
pub(super) fn attributes(bytes: &[u8], count: usize, stride: usize) -> Option<Vec<u8>> {
    let is_stride = (4..=256).contains(&stride) && stride.is_multiple_of(4);
    let [ATTRIBUTES, coded @ ..] = bytes else { return None };
    if !is_stride || coded.len() < tail_bytes(stride) {
        return None;
    }
    let (coded, tail) = coded.split_at(coded.len() - tail_bytes(stride));
    let mut last = tail[tail.len() - stride..].to_vec();
    let mut coded = Bytes(coded);
    let mut elements = vec![0; count.checked_mul(stride)?];
    for block in elements.chunks_mut(stride * block_elements(stride)) {
        let groups = (block.len() / stride).div_ceil(GROUP);
        for (k, last) in last.iter_mut().enumerate() {
            let head = coded.take(groups.div_ceil(4))?;
            let mut places = block.chunks_exact_mut(stride);
            for n in 0..groups {
                let group = group(head[n / 4] >> (n % 4 * 2) & 3, &mut coded)?;
                for (step, element) in group.iter().zip(places.by_ref().take(GROUP)) {
                    *last = last.wrapping_add((step >> 1) ^ (step & 1).wrapping_neg());
                    element[k] = *last;
                }
            }
        }
    }
    coded.0.is_empty().then_some(elements)
}

/// The steps of a group.
fn group(kind: u8, coded: &mut Bytes<'_>) -> Option<[u8; GROUP]> {
    let bits = match kind {
        0 => return Some([0; GROUP]),
        3 => return coded.take(GROUP)?.try_into().ok(),
        kind => 2 * usize::from(kind),
    };
    let packed = coded.take(GROUP * bits / 8)?;
    let most = (1 << bits) - 1;
    let mut steps = [0; GROUP];
    for (n, step) in steps.iter_mut().enumerate() {
        let (byte, place) = (n * bits / 8, n * bits % 8);
        *step = packed[byte] >> (8 - bits - place) & most;
        if *step == most {
            *step = coded.byte()?;
        }
    }
    Some(steps)
}

/// The triangles of an array of indices.
pub(super) fn triangles(bytes: &[u8], count: usize) -> Option<Vec<[u32; 3]>> {
    let [TRIANGLES, coded @ ..] = bytes else { return None };
    let (coded, pairs) = coded.split_at_checked(coded.len().checked_sub(16)?)?;
    let (codes, data) = coded.split_at_checked(count)?;
    let mut decoder = TriangleDecoder { recent: Recent::new(), data: Bytes(data), pairs };
    let triangles: Vec<_> = codes.iter().map(|&code| decoder.triangle(code)).collect::<Option<_>>()?;
    decoder.data.0.is_empty().then_some(triangles)
}

struct TriangleDecoder<'a> {
    recent: Recent,
    data: Bytes<'a>,
    pairs: &'a [u8],
}

impl TriangleDecoder<'_> {
    fn triangle(&mut self, code: u8) -> Option<[u32; 3]> {
        let [high, low] = [code >> 4, code & 15].map(usize::from);
        match (high, low) {
            (OTHER, 14 | 15) => {
                let pair = self.data.byte()?;
                if pair == 0 {
                    self.recent.next = 0;
                }
                self.other(if low == 14 { 0 } else { OTHER }, pair)
            }
            (OTHER, _) => self.other(0, self.pairs[low]),
            _ => self.neighbour(high, low),
        }
    }

    fn neighbour(&mut self, ago: usize, third: usize) -> Option<[u32; 3]> {
        let [a, b] = self.recent.edge(ago);
        let c = match third {
            0 => self.next(),
            13 => self.recent.last.wrapping_sub(1),
            14 => self.recent.last.wrapping_add(1),
            15 => self.written_out()?,
            ago => self.recent.vertex(ago),
        };
        if third >= TOLD {
            self.recent.last = c;
        }
        if third == 0 || third >= TOLD {
            self.recent.add_vertex(c);
        }
        self.recent.add_edge(c, b);
        self.recent.add_edge(a, c);
        Some([a, b, c])
    }

    fn other(&mut self, first: usize, pair: u8) -> Option<[u32; 3]> {
        let codes = [first, usize::from(pair >> 4), usize::from(pair & 15)];
        let mut triangle = [0; 3];
        for (vertex, code) in triangle.iter_mut().zip(codes) {
            *vertex = match code {
                0 => self.next(),
                OTHER => 0,
                ago => self.recent.vertex(ago - 1),
            };
        }
        for (vertex, _) in triangle.iter_mut().zip(codes).filter(|(_, code)| *code == OTHER) {
            *vertex = self.written_out()?;
        }
        let is_new = |code: &usize| matches!(*code, 0 | OTHER);
        triangle
            .iter()
            .zip(codes)
            .filter(|(_, code)| is_new(code))
            .for_each(|(v, _)| self.recent.add_vertex(*v));
        self.recent.add_edges_of(triangle);
        Some(triangle)
    }

    fn next(&mut self) -> u32 {
        let next = self.recent.next;
        self.recent.next = next.wrapping_add(1);
        next
    }

    fn written_out(&mut self) -> Option<u32> {
        let mut number = 0u32;
        for place in (0..35).step_by(7) {
            let byte = self.data.byte()?;
            number |= u32::from(byte & 127).checked_shl(place)?;
            if byte < 128 {
                let step = (number >> 1) ^ (number & 1).wrapping_neg();
                self.recent.last = self.recent.last.wrapping_add(step);
                return Some(self.recent.last);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::encode::{AttributeCoder, PAIRS, TriangleCoder};
    use super::*;
    use isospan_io::fixtures::survive;
    use proptest::prelude::*;

    fn coded(elements: &[u8], stride: usize) -> Vec<u8> {
        let (mut coder, mut out) = (AttributeCoder::new(stride), vec![]);
        elements.chunks(stride * 7).for_each(|some| coder.put(some, &mut out));
        coder.finish(&mut out);
        out
    }

    fn coded_triangles(all: &[[u32; 3]]) -> Vec<u8> {
        let (mut coder, mut codes, mut data) = (TriangleCoder::new(), vec![], vec![]);
        all.iter().for_each(|&triangle| coder.put(triangle, &mut codes, &mut data));
        [&[TRIANGLES][..], &codes, &data, &PAIRS].concat()
    }

    /// A triangle from the corner on that makes it least.
    fn turned(&[a, b, c]: &[u32; 3]) -> [u32; 3] {
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap()
    }

    /// A strip of quads, a second one that begins at 0 again, and numbers far apart.
    fn some_triangles() -> Vec<[u32; 3]> {
        let quad = |q: u32| [[q, q + 1, q + 9], [q + 1, q + 10, q + 9]];
        let strip: Vec<_> = (0..40).flat_map(quad).collect();
        let far = [[7, 4_000_000_000, 3], [100_000, 100_001, 5], [100_002, 100_001, 100_000]];
        [&[[0, 1, 2]], &strip[..], &[[0, 1, 2], [2, 1, 3]], &strip, &far].concat()
    }

    /// What meshoptimizer 0.2.30 for Python makes of the same.
    #[test]
    fn bytes_are_those_of_meshoptimizer() {
        let elements: Vec<u8> = (0..40u8).flat_map(|n| [n, n.wrapping_mul(n), 7, n / 16 * 100]).collect();
        let hash = |bytes: &[u8]| (bytes.len(), xxhash_rust::xxh3::xxh3_64(bytes));
        assert_eq!(hash(&coded(&elements, 4)), GOLDEN_ATTRIBUTES);
        assert_eq!(hash(&coded_triangles(&some_triangles())), GOLDEN_TRIANGLES);
    }

    const GOLDEN_ATTRIBUTES: (usize, u64) = (103, 0x6d9e_31a3_6772_495c);
    const GOLDEN_TRIANGLES: (usize, u64) = (213, 0x4436_ddd4_4769_ebb5);

    #[test]
    fn damage_is_told() {
        let elements: Vec<u8> = (0..160u8).collect();
        survive(&coded(&elements, 8), |bytes| drop(attributes(bytes, 20, 8)));
        survive(&coded_triangles(&some_triangles()), |bytes| drop(triangles(bytes, 166)));
        let longer = [coded(&elements, 8), vec![0]].concat();
        assert!(attributes(&longer, 20, 8).is_none());
        assert!(attributes(&coded(&elements, 8), 20, 0).is_none());
        assert!(triangles(&coded_triangles(&[[0, 1, 2]]), 2).is_none());
    }

    proptest! {
        #[test]
        fn what_was_coded_comes_back(
            bytes in prop::collection::vec(prop_oneof![3 => 0u8..3, 1 => any::<u8>()], 1..3000),
            stride in 1usize..5,
            corners in prop::collection::vec([0u32..40, 0u32..40, 0u32..2000], 0..400),
        ) {
            let stride = 4 * stride;
            let mut elements = bytes;
            elements.resize(elements.len().next_multiple_of(stride), 0);
            let count = elements.len() / stride;
            prop_assert_eq!(attributes(&coded(&elements, stride), count, stride), Some(elements));
            let all = [some_triangles(), corners].concat();
            let back = triangles(&coded_triangles(&all), all.len()).unwrap();
            let right: Vec<_> = all.iter().map(turned).collect();
            prop_assert_eq!(back.iter().map(turned).collect::<Vec<_>>(), right);
        }
    }
}
