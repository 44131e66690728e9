//! A precomputed block as words of a file, and what must be true of such words before they are
//! used.
//!
//! ```text
//!  corners │ edges │ tetrahedra │ words of slots │ whether some are void │ checksums: first lists, ids │ 0
//!   │ a checksum for each group │ the lists of the block │ zeros up to a cache line
//! ```
//!
//! The lists are used where they lie, in a mapped file too. So [`Precomputed::open`] checks that
//! they are as long as the words. [`Stored::check`] checks that they have their checksums, and that
//! everything they name is there. Then no words, whoever wrote them, lead outside of a list. Of the
//! later lists (edges of tetrahedra, slots) a question reads the part of the groups that it may
//! cross. So these have checksums of their own, and only what is read of a block is checked, once.
//! What the slots of open edges name, and whether the triangles of a block have the vertices of
//! their edges, is checked when they are used ([`super::crossed`]). Whether the words mean what the
//! archive means is another question, answered by making them again.

use super::super::ordered::SHARED;
use super::super::patch::CORNERS;
use super::{
    EDGES_MOST, GROUP, OPEN, Precomputed, PrecomputedBlock, SLOTS_BEHIND, SLOTS_MOST, Shape, TURNED,
};
use crate::mesh::tet::is_active;
use crate::simd::with_vectors;
use std::ops::Range;

/// Words before the checksums of groups; those of them that have their checksum with the first
/// lists.
const HEAD: usize = 8;
const COUNTS: usize = 5;
/// Where in the head the checksums are.
const OF_LISTS: usize = 5;
const OF_IDS: usize = 6;
/// A bit of what is noted of a block: all but what is checked group by group was found to be right.
/// The groups have a bit each, from the lowest on.
const LISTS_ARE_RIGHT: u64 = 1 << 63;
/// Words of a cache line.
const LINE: usize = 16;
/// The largest coordinate.
const LATTICE_MOST: f32 = 16_777_216.0;
/// The most tetrahedra of a block.
const TETS_MOST: usize = u16::MAX as usize - 1;

/// What is wrong with words that are no block.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Flaw {
    pub(crate) at: &'static str,
    pub(crate) expected: String,
    pub(crate) got: String,
}

impl Flaw {
    pub(crate) fn new(at: &'static str, expected: impl ToString, got: impl ToString) -> Self {
        Self { at, expected: expected.to_string(), got: got.to_string() }
    }
}

impl Shape {
    /// Words of the head, the lists, and the zeros behind.
    fn stored_words(&self) -> usize {
        (HEAD + self.tets.div_ceil(GROUP) + self.ends()[6] + 2 * self.corners).next_multiple_of(LINE)
    }
}

/// The CRC32C of words behind others.
fn crc_behind(crc: u32, words: &[u32]) -> u32 {
    crc32c::crc32c_append(crc, bytemuck::cast_slice(words))
}

impl PrecomputedBlock {
    /// Replaces `out` by the words of the block.
    pub(crate) fn store(&self, out: &mut Vec<u32>) {
        let Shape { corners, edges, tets, slots, has_void } = self.shape;
        let groups = tets.div_ceil(GROUP);
        out.clear();
        // Each is below 2^16.
        out.extend([corners as u32, edges as u32, tets as u32, slots as u32, has_void.into(), 0, 0, 0]);
        out.resize(HEAD + groups, 0);
        out.extend_from_slice(&self.words);
        out.resize(self.shape.stored_words(), 0);
        let stored = Precomputed::open(out).expect("it is as long as it tells");
        let of_groups: Vec<u32> =
            stored.ranges().enumerate().map(|(n, slots)| stored.crc_of(n, slots)).collect();
        out[HEAD..HEAD + groups].copy_from_slice(&of_groups);
        let stored = Precomputed::open(out).expect("it is as long as it tells");
        [out[OF_LISTS], out[OF_IDS]] = [stored.crc_of_lists(), crc_behind(0, stored.block.ids())];
    }
}

impl<'a> Precomputed<'a> {
    /// The block of some words, as [`PrecomputedBlock::store`] gives them. What its lists hold is
    /// not looked at: see [`Stored::check`].
    ///
    /// # Errors
    /// When they are not as long as they say.
    #[inline]
    pub(crate) fn open(words: &'a [u32]) -> Result<Stored<'a>, Flaw> {
        let Some((head, rest)) = words.split_first_chunk::<HEAD>() else {
            return Err(Flaw::new("words", format!("{HEAD} or more"), words.len()));
        };
        let &[corners, edges, tets, slots, void, ..] = head;
        let [corners, edges, tets, slots] = [corners, edges, tets, slots].map(|n| n as usize);
        let most =
            [(corners, CORNERS), (edges, EDGES_MOST), (tets, TETS_MOST), (slots, SLOTS_MOST + SLOTS_BEHIND)];
        if most.iter().any(|(n, most)| n > most) || void > 1 || corners == 0 || tets == 0 {
            let got = format!("{corners}, {edges}, {tets}, {slots}, {void}");
            return Err(Flaw::new("numbers of corners, edges, tetrahedra, slots", "those of a block", got));
        }
        let shape = Shape { corners, edges, tets, slots, has_void: void == 1 };
        if words.len() != shape.stored_words() {
            return Err(Flaw::new("words", shape.stored_words(), words.len()));
        }
        let (of_groups, lists) = rest.split_at(tets.div_ceil(GROUP));
        let block = Self { words: &lists[..shape.ends()[6] + 2 * corners], shape };
        Ok(Stored { block, head, of_groups })
    }
}

/// A precomputed block of a file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stored<'a> {
    /// The block, to be used once it has been checked.
    pub(crate) block: Precomputed<'a>,
    head: &'a [u32; HEAD],
    /// The checksum of each group.
    of_groups: &'a [u32],
}

impl Stored<'_> {
    /// Checks what a question about these isovalues (none: about all) reads of the block, in a
    /// chunk of so many corners. `known` says what was found to be right before; it comes back with
    /// what was found now.
    ///
    /// # Errors
    /// The first list with something that is not.
    pub(crate) fn check(&self, of_chunk: usize, isovalues: Option<&[f32]>, known: u64) -> Result<u64, Flaw> {
        let mut right = known;
        if right & LISTS_ARE_RIGHT == 0 {
            self.check_lists(of_chunk)?;
            right |= LISTS_ARE_RIGHT;
        }
        if isovalues.is_none() {
            self.check_ids()?;
        }
        for (n, (group, slots)) in self.block.groups().iter().zip(self.ranges()).enumerate() {
            // A group without a bit is checked each time: blocks of so many groups are rare.
            let bit = if n < 63 { 1 << n } else { 0 };
            let is_read =
                || isovalues.is_none_or(|all| all.iter().any(|&v| is_active(group.least, group.most, v)));
            if right & bit == 0 && is_read() {
                self.check_group(n, slots)?;
                right |= bit;
            }
        }
        Ok(right)
    }

    /// Where in the slots each group's are. Ends that do not ascend are moved to where they may be;
    /// the checksum shows that they are wrong.
    fn ranges(&self) -> impl Iterator<Item = Range<usize>> {
        let (groups, most) = (self.block.groups(), self.block.shape.slots);
        groups.iter().scan(0, move |begin, group| {
            let slots = *begin..usize::from(group.slots_end).clamp(*begin, most);
            *begin = slots.end;
            Some(slots)
        })
    }

    /// The checksum of the edges and slots of a group.
    fn crc_of(&self, n: usize, slots: Range<usize>) -> u32 {
        crc_behind(crc32c::crc32c(bytemuck::cast_slice(self.edges_of(n))), &self.block.slots()[slots])
    }

    fn edges_of(&self, n: usize) -> &[[u16; 6]] {
        let tets = self.block.edges_of_tets();
        &tets[n * GROUP..tets.len().min((n + 1) * GROUP)]
    }

    /// The checksum of the counts, the checksums of groups, and all lists before the edges of
    /// tetrahedra.
    fn crc_of_lists(&self) -> u32 {
        let crc = crc_behind(crc32c::crc32c(bytemuck::cast_slice(&self.head[..COUNTS])), self.of_groups);
        crc_behind(crc, &self.block.words[..self.block.ends()[4]])
    }

    fn check_group(&self, n: usize, slots: Range<usize>) -> Result<(), Flaw> {
        same_crc("edges of tetrahedra, slots", self.of_groups[n], self.crc_of(n, slots))?;
        // The mark of the first edge is above all numbers: it is left out.
        let most =
            self.edges_of(n).as_flattened().iter().fold(0, |most: u16, &edge| most.max(edge & !TURNED));
        // A block of void tetrahedra has no edges, and 0 for each.
        below("edges of tetrahedra", most.into(), self.block.shape.edges.max(1))
    }

    fn check_lists(&self, of_chunk: usize) -> Result<(), Flaw> {
        same_crc("groups, corners, edges", self.head[OF_LISTS], self.crc_of_lists())?;
        let Shape { corners, edges, slots, .. } = self.block.shape;
        let [groups, numbers, ends, of_edges, tets] = with_vectors(
            #[inline(always)]
            || self.block.most_named(),
        );
        below("groups", groups, 1)?;
        let lattice = 0.0..=LATTICE_MOST;
        let is_there = |[x, y, z, _]: &[f32; 4]| [x, y, z].iter().all(|x| lattice.contains(*x));
        if !self.block.at().iter().fold(true, |all, at| all & is_there(at)) {
            return Err(Flaw::new("corners", format!("coordinates up to {LATTICE_MOST}"), "others"));
        }
        below("numbers of corners", numbers, of_chunk)?;
        below("ends of edges", ends, if edges > 0 { corners } else { 1 })?;
        below("slots of edges", of_edges + SLOTS_BEHIND, slots.max(SLOTS_BEHIND) + 1)?;
        below("corners of tetrahedra", tets, corners)?;
        // Questions about isovalues read the ids of corners that other chunks have.
        let is_shared = self.block.numbers().iter().fold(0, |any, n| any | n) & SHARED != 0;
        if is_shared { self.check_ids() } else { Ok(()) }
    }

    fn check_ids(&self) -> Result<(), Flaw> {
        same_crc("ids", self.head[OF_IDS], crc_behind(0, self.block.ids()))
    }
}

fn below(at: &'static str, most: usize, limit: usize) -> Result<(), Flaw> {
    match most < limit {
        true => Ok(()),
        false => Err(Flaw::new(at, format!("numbers below {limit}"), most)),
    }
}

fn same_crc(at: &'static str, expected: u32, got: u32) -> Result<(), Flaw> {
    match expected == got {
        true => Ok(()),
        false => Err(Flaw::new(at, format!("CRC32C {expected:08x}"), format!("{got:08x}"))),
    }
}

impl Precomputed<'_> {
    /// The greatest number in each of the first lists; of groups 1 if one does not end where it
    /// may.
    #[inline(always)]
    fn most_named(&self) -> [usize; 5] {
        let Shape { edges, slots, .. } = self.shape;
        let mut ends = (0, 0);
        let mut wrong = false;
        for group in self.groups() {
            let next = (group.edges_end, group.slots_end);
            wrong |= next.0 < ends.0 || next.1 < ends.1;
            ends = next;
        }
        wrong |= usize::from(ends.0) > edges || usize::from(ends.1) > slots;
        let bytes = |list: &[u8]| list.iter().fold(0, |most: u8, &n| most.max(n));
        let of_edges = self.slots_of_edges().iter().fold(0, |most: u16, &n| most.max(n & !OPEN));
        [
            wrong.into(),
            self.numbers().iter().fold(0, |most, &n| most.max(n & !SHARED)) as usize,
            bytes(self.edges().as_flattened()).into(),
            of_edges.into(),
            bytes(self.tets().as_flattened()).into(),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::super::*;
    use super::*;
    use crate::grid::Geometry;
    use crate::surface::WorldMap;
    use crate::surface::extract::numbered::tests::Blocks;

    /// The words of the blocks of a small grid, some of which have void tetrahedra, and the number
    /// of corners of its chunk.
    fn stored() -> (Vec<Vec<u32>>, usize) {
        let blocks = Blocks::new(5, 60);
        let values: Vec<f32> = (0..125).map(|i| if i == 62 { f32::NAN } else { i as f32 }).collect();
        let world = WorldMap::new(&blocks.grid.lattice, &Geometry::default());
        let mut all = vec![];
        blocks.each(&values, |cells| {
            let (block, mut words) = (Maker::default().make(cells, &world).unwrap(), vec![]);
            block.store(&mut words);
            let known = Precomputed::open(&words).unwrap().block;
            assert_eq!((known.words, known.shape), (&*block.words, block.shape));
            assert_eq!(words.len() % LINE, 0);
            all.push(words);
        });
        (all, 125)
    }

    #[test]
    fn a_stored_block_is_the_block() {
        let (all, of_chunk) = stored();
        assert!(all.iter().any(|words| words[4] == 1) && all.iter().any(|words| words[4] == 0));
        for words in &all {
            let stored = Precomputed::open(words).unwrap();
            let groups = stored.block.groups();
            assert_eq!(stored.check(of_chunk, None, 0), Ok(LISTS_ARE_RIGHT | ((1 << groups.len()) - 1)));
            // Group by group, as isovalues read them.
            let isovalue = groups[0].most;
            let read = groups.iter().map(|g| is_active(g.least, g.most, isovalue));
            let right = (0..).zip(read).fold(LISTS_ARE_RIGHT, |all, (n, read)| all | u64::from(read) << n);
            assert_eq!(stored.check(of_chunk, Some(&[isovalue]), 0), Ok(right));
            assert_eq!(stored.check(of_chunk, Some(&[f32::MAX]), 1 << 3), Ok(LISTS_ARE_RIGHT | 1 << 3));
            let most = stored.block.numbers().iter().map(|n| n & !SHARED).max().unwrap() as usize;
            assert_eq!(stored.check(most, None, 0).unwrap_err().at, "numbers of corners");
            for cut in [0, HEAD - 1, HEAD, words.len() - LINE] {
                assert!(Precomputed::open(&words[..cut]).is_err());
            }
        }
    }

    /// Gives words the checksums that fit them.
    fn seal(words: &mut [u32]) {
        let Ok(stored) = Precomputed::open(words) else { return };
        let of_groups: Vec<u32> =
            stored.ranges().enumerate().map(|(n, slots)| stored.crc_of(n, slots)).collect();
        words[HEAD..HEAD + of_groups.len()].copy_from_slice(&of_groups);
        let stored = Precomputed::open(words).unwrap();
        let (of_lists, of_ids) = (stored.crc_of_lists(), crc_behind(0, stored.block.ids()));
        (words[OF_LISTS], words[OF_IDS]) = (of_lists, of_ids);
    }

    /// Any change of a word is reported, or its checksum is not looked at. With a checksum that
    /// fits, what the lists name is there, or is reported as missing.
    #[test]
    fn nothing_that_is_named_is_missing() {
        let (all, of_chunk) = stored();
        let (mut refused, mut taken) = (0, 0);
        for n in 0..all[0].len() {
            for change in [1, 1 << 8, 1 << 15, 1 << 16, 1 << 31, u32::MAX] {
                let mut words = all[0].clone();
                words[n] ^= change;
                let check = |words: &[u32]| Precomputed::open(words)?.check(of_chunk, None, 0).map(drop);
                let [_, .., slots_at, slots_end] = Precomputed::open(&all[0]).unwrap().block.ends();
                let first = HEAD + Precomputed::open(&all[0]).unwrap().of_groups.len();
                // Neither the word and the zeros at the ends, nor those behind the slots, nor ids
                // that are not asked for.
                if n != HEAD - 1 && n != OF_IDS && n < first + slots_end - SLOTS_BEHIND {
                    assert!(check(&words).is_err(), "word {n}, slots from {slots_at}");
                }
                seal(&mut words);
                if check(&words).is_err() {
                    refused += 1;
                    continue;
                }
                let known = Precomputed::open(&words).unwrap().block;
                taken += 1;
                let Shape { corners, edges, slots, .. } = known.shape;
                let is_there = |n: u8| usize::from(n) < corners;
                assert!(known.edges().as_flattened().iter().all(|&n| is_there(n)));
                assert!(known.tets().as_flattened().iter().all(|&n| is_there(n)));
                assert!(known.numbers().iter().all(|&n| ((n & !SHARED) as usize) < of_chunk));
                let edge_is_there = |&n: &u16| usize::from(n & !TURNED) < edges;
                assert!(known.edges_of_tets().as_flattened().iter().all(edge_is_there));
                let slot_is_there = |&n: &u16| usize::from(n & !OPEN) + SLOTS_BEHIND <= slots;
                assert!(known.slots_of_edges().iter().all(slot_is_there));
                let ends: Vec<u16> = known.groups().iter().map(|g| g.edges_end).collect();
                assert!(ends.is_sorted() && usize::from(ends[ends.len() - 1]) <= edges);
            }
        }
        assert!(refused > 100 && taken > 100, "{refused} and {taken}");
    }
}
