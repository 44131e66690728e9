//! The decoder's end of the star coder.

use super::bits::BitReader;
use super::link::{Gate, Gates, Link, VERTICES};
use super::odds::first_odds;
use super::{DECISIONS, End, LARGEST_LIST, LARGEST_STARS, Local, NONE, Stars};
use crate::archive::mesh::heads::BlockHead;
use crate::archive::range_coder::{Decoder, Odds};
use crate::archive::wire::{Cursor, Malformed};
use isospan_io::geom::LatticePos;
use isospan_mesh::mesh::tet::Tet;

/// The decoder's end.
struct ReadEnd<'a, 'o> {
    coder: Decoder<'a>,
    bits: BitReader<'a>,
    is_odd: bool,
    /// The vertices by local number.
    ids: &'o [u32; VERTICES],
    /// Space for the tetrahedra, and how many of them are decoded.
    out: &'o mut [Tet],
    read: usize,
}

impl End for ReadEnd<'_, '_> {
    const KNOWS: bool = false;

    #[inline(always)]
    fn bit(&mut self, odds: &mut [Odds; DECISIONS], at: usize, _: bool) -> bool {
        self.coder.bit(&mut odds[at])
    }

    #[inline]
    fn raw(&mut self, bits: u32, _: u32) -> u32 {
        self.coder.raw(bits)
    }

    #[inline(always)]
    fn star(&mut self, _: Local, _: &Link) -> Option<()> {
        self.is_odd = self.bits.take(1) == 1;
        Some(())
    }

    #[inline(always)]
    fn hits(&mut self, _: &Link, gates: &Gates) -> (u32, bool) {
        let bits = self.bits.take(gates.len as u32 + u32::from(self.is_odd));
        (bits & !(u32::MAX << gates.len), bits >> gates.len != 0)
    }

    #[inline(always)]
    fn apex(&mut self, _: &Link, _: Gate) -> Local {
        NONE
    }

    #[inline(always)]
    fn is_odd(&mut self) -> bool {
        self.is_odd
    }

    #[inline(always)]
    fn has_uncoded(&self) -> bool {
        false
    }

    #[inline(always)]
    fn end_star(&mut self) {}

    fn uncoded(&self, _: &Link, _: &mut Vec<[Local; 3]>) {}

    #[inline(always)]
    fn tell(&mut self, tet: [Local; 4]) {
        let id = |v: Local| self.ids[usize::from(v) % VERTICES];
        let tet = [id(tet[0]), id(tet[1]), id(tet[2]), id(tet[3])];
        // Stars with more tetrahedra than there is space for are refused.
        if let Some(room) = self.out.get_mut(self.read) {
            *room = tet;
        }
        self.read += 1;
    }
}

fn bad() -> Malformed {
    Malformed::new("tetrahedra", "the stars of a run of vertices", "something else")
}

/// Memory that decoding reuses.
pub(crate) struct Scratch {
    pub(super) stars: Stars,
    ids: Box<[u32; VERTICES]>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { stars: Stars::default(), ids: Box::new([0; VERTICES]) }
    }
}

/// A block whose vertices are known, and that waits for their positions.
pub(crate) struct Reader<'a> {
    coder: Decoder<'a>,
    bits: BitReader<'a>,
    own: usize,
    tets: usize,
    size: u8,
}

impl<'a> Reader<'a> {
    /// Reads the vertices of a block, and appends them to `ids`; each is below `vertices`.
    pub(crate) fn open(
        bytes: &'a [u8],
        size: u8,
        &BlockHead { first, own, tets }: &BlockHead,
        vertices: u32,
        ids: &mut Vec<u32>,
    ) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let others = c.varint32("other vertices")?;
        let bits = c.varint32("bytes of bits")? as usize;
        let mut bits = BitReader::new(c.take(bits, "bits")?);
        let fits = first.checked_add(own).is_some_and(|end| end <= vertices);
        if tets as usize > LARGEST_STARS || own.max(others) >= LARGEST_LIST || !fits {
            return Err(bad());
        }
        ids.reserve((own + others) as usize);
        ids.extend(first..first + own);
        let mut least = first + own;
        for _ in 0..others {
            let v = bits.take_number().and_then(|gap| least.checked_add(gap)).filter(|&v| v < vertices);
            let v = v.ok_or_else(bad)?;
            ids.push(v);
            least = v + 1;
        }
        Ok(Self { coder: Decoder::new(c.rest()), bits, own: own as usize, tets: tets as usize, size })
    }

    /// Appends the tetrahedra, given the vertices and their positions.
    pub(crate) fn decode(
        self,
        scratch: &mut Scratch,
        ids: &[u32],
        positions: &[LatticePos],
        out: &mut Vec<Tet>,
    ) -> Result<(), Malformed> {
        let stars = &mut scratch.stars;
        stars.odds = first_odds();
        stars.set(self.own, positions, self.size, self.tets);
        scratch.ids[..ids.len()].copy_from_slice(ids);
        let before = out.len();
        out.resize(before + self.tets, [0; 4]);
        let (ids, room) = (&*scratch.ids, &mut out[before..]);
        let mut end = ReadEnd { coder: self.coder, bits: self.bits, is_odd: false, ids, out: room, read: 0 };
        stars.tell(&mut end, self.tets).ok_or_else(bad)?;
        if end.coder.at_end() && end.bits.at_end() { Ok(()) } else { Err(bad()) }
    }
}
