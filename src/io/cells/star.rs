//! Convex cells and faces cut from one vertex.

/// A tetrahedron of vertex numbers.
pub type CellTet = [u64; 4];

/// Removes tetrahedra that name a vertex twice, from `start` on.
pub(super) fn drop_collapsed(start: usize, out: &mut Vec<CellTet>) -> usize {
    let mut kept = start;
    for at in start..out.len() {
        let [a, b, c, d] = out[at];
        if a != b && a != c && a != d && b != c && b != d && c != d {
            out[kept] = out[at];
            kept += 1;
        }
    }
    let dropped = out.len() - kept;
    out.truncate(kept);
    dropped
}

/// The star of the smallest vertex of a convex cell. `faces` are seen anticlockwise from outside
/// and index `vertices`.
pub(super) fn star<'a>(
    faces: impl Iterator<Item = &'a [u8]> + Clone,
    vertices: &[u64],
    out: &mut Vec<CellTet>,
) {
    let number = |&i: &u8| vertices[usize::from(i)];
    let Some(apex) = faces.clone().flatten().map(number).min() else { return };
    for face in faces.filter(|f| f.iter().all(|i| number(i) != apex)) {
        fan(face, vertices, |[a, b, c]| out.push([apex, a, b, c]));
    }
}

/// The triangles of a convex face, all from its smallest vertex, anticlockwise as the face is.
pub(super) fn fan(face: &[u8], vertices: &[u64], mut each: impl FnMut([u64; 3])) {
    let number = |at: usize| vertices[usize::from(face[at % face.len()])];
    let first = (0..face.len()).min_by_key(|&at| number(at)).expect("a face has vertices");
    for step in 1..face.len() - 1 {
        each([number(first), number(first + step), number(first + step + 1)]);
    }
}
