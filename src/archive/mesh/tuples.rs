//! The plain coder of a tetrahedron block: sorted tuples, differences, zstd. It takes any
//! tetrahedra at all.
//!
//! The vertices of the block are listed in ascending order, as differences. Each tetrahedron is
//! turned (by even permutations, which keep its orientation) so that its smallest vertex comes
//! first and the smallest of the other three second; the tetrahedra are sorted; each is then four
//! small numbers, in positions of the list: the difference of the first vertex to the previous
//! tetrahedron's, and the distances from the first to the second, and from the second to the third
//! and fourth. The four streams are compressed together: about 21 bits a tetrahedron in blocks of
//! 1 000.

use crate::archive::wire::{Cursor, Malformed, put_varint, to_zstd, unzstd};
use isospan_mesh::mesh::tet::Tet;

/// The most bytes that a body may expand to, for each tetrahedron: four vertex differences and four
/// numbers of five bytes.
const MOST_BYTES_EACH: usize = 40;

/// The sorted distinct vertices of `tets`.
pub(crate) fn vertex_list(tets: &[Tet]) -> Vec<u32> {
    let mut list: Vec<u32> = tets.iter().flatten().copied().collect();
    list.sort_unstable();
    list.dedup();
    list
}

/// Encodes tetrahedra with four different vertices each; `tets` is canonical and sorted.
pub(crate) fn encode(tets: &[Tet], out: &mut Vec<u8>) {
    let list = vertex_list(tets);
    let mut body = vec![];
    put_varint(&mut body, list.len() as u64);
    let mut next = 0;
    for &v in &list {
        put_varint(&mut body, u64::from(v - next));
        next = v + 1;
    }
    let position = |v: u32| list.binary_search(&v).expect("the list has every vertex") as u64;
    let local: Vec<[u64; 4]> = tets.iter().map(|t| t.map(position)).collect();
    let firsts = std::iter::once(0).chain(local.iter().map(|t| t[0]));
    local.iter().zip(firsts).for_each(|(t, before)| put_varint(&mut body, t[0] - before));
    local.iter().for_each(|t| put_varint(&mut body, t[1] - t[0] - 1));
    local.iter().for_each(|t| put_varint(&mut body, t[2] - t[1] - 1));
    local.iter().for_each(|t| put_varint(&mut body, t[3] - t[1] - 1));
    put_varint(out, tets.len() as u64);
    out.extend(to_zstd(&body, 12));
}

/// Decodes what [`encode`] wrote; every vertex is below `vertices`.
pub(crate) fn decode(bytes: &[u8], vertices: u32, out: &mut Vec<Tet>) -> Result<(), Malformed> {
    let mut c = Cursor::new(bytes);
    let count = c.varint32("tetrahedra")? as usize;
    let body = unzstd(c.rest(), count.saturating_mul(MOST_BYTES_EACH).saturating_add(5), "tetrahedra")?;
    let mut c = Cursor::new(&body);
    let list = decode_list(&mut c, vertices)?;
    // A tetrahedron has at least four bytes: a count beyond that is a lie, found before anything is
    // allocated for it.
    if c.rest().len() / 4 < count {
        return Err(Malformed::new("tetrahedra", format!("{count}"), format!("{} bytes", c.rest().len())));
    }
    let mut local = vec![[0u64; 4]; count];
    let mut before = 0u64;
    for t in &mut local {
        before = before.saturating_add(c.varint("first vertex")?);
        t[0] = before;
    }
    for (at, base) in [(1, 0), (2, 1), (3, 1)] {
        for t in &mut local {
            t[at] = t[base].saturating_add(c.varint("vertex")?).saturating_add(1);
        }
    }
    c.end("tetrahedra")?;
    for t in local {
        let vertex = |i: u64| list.get(usize::try_from(i).unwrap_or(usize::MAX)).copied();
        let (Some(a), Some(b), Some(c), Some(d)) = (vertex(t[0]), vertex(t[1]), vertex(t[2]), vertex(t[3]))
        else {
            return Err(Malformed::new(
                "vertex",
                format!("a position below {}", list.len()),
                format!("{t:?}"),
            ));
        };
        out.push([a, b, c, d]);
    }
    Ok(())
}

fn decode_list(c: &mut Cursor<'_>, vertices: u32) -> Result<Vec<u32>, Malformed> {
    let len = c.varint32("vertices")? as usize;
    if len > c.rest().len() {
        return Err(Malformed::new("vertices", format!("at most {}", c.rest().len()), len.to_string()));
    }
    let mut list = Vec::with_capacity(len);
    let mut next = 0u64;
    for _ in 0..len {
        let v = next.saturating_add(c.varint("vertex list")?);
        if v >= u64::from(vertices) {
            return Err(Malformed::new("vertex list", format!("ids below {vertices}"), v.to_string()));
        }
        list.push(v as u32);
        next = v + 1;
    }
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_mesh::mesh::tet::canonical;

    #[test]
    fn no_damage_panics_or_gives_a_vertex_that_is_not_there() {
        let mut tets: Vec<Tet> = crate::archive::mesh::chunk::tests::cubes([3, 2, 2]);
        tets.iter_mut().for_each(|t| *t = canonical(*t));
        tets.sort_unstable();
        let mut good = vec![];
        encode(&tets, &mut good);
        let mut out = vec![];
        decode(&good, 36, &mut out).unwrap();
        assert_eq!(out, tets);
        assert!(decode(&good, 35, &mut vec![]).is_err(), "vertex 35 is in use");
        for i in 0..good.len() {
            assert!(decode(&good[..i], 36, &mut vec![]).is_err());
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                let mut out = vec![];
                if decode(&bad, 36, &mut out).is_ok() {
                    assert!(out.iter().flatten().all(|&v| v < 36));
                }
            }
        }
    }
}
