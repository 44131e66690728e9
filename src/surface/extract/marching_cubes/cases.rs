//! The cases of marching cubes and of their caps, derived at compile time from one rule.
//!
//! Corner x + 2y + 4z of a cube lies at (x, y, z). Edge 4a + b runs along axis a; b numbers the
//! places of the other two axes, the lower axis first.
//!
//! On each face, seen from outside and walked counter-clockwise, the corners inside form runs. The
//! surface bounds a run by a segment from the edge before it to the edge behind it:
//!
//! ```text
//!   d───────c      D───x───c      d───x───C      A, C and D are inside. Two corners on a
//!   │       │      │   │   │      │    ╲  │      diagonal are two runs, and so kept apart.
//!   x       │      │   │   │      x     ╲ x
//!   │ ╲     │      │   │   │      │ ╲     │
//!   A───x───b      A───x───b      A───x───b
//! ```
//!
//! A crossed edge lies on two faces, which walk it in opposite directions: there the segment of one
//! ends and that of the other begins. So segments join to loops. A loop of n edges is cut into
//! n - 2 triangles such that no cut lies in a face, where a neighbour could have the same one, and
//! the cuts are short in all.

/// A face of the cube.
#[derive(Clone, Copy)]
pub(super) struct Face {
    /// Its corners, counter-clockwise seen from outside.
    pub(super) corners: [u8; 4],
    /// Its edges: edge i goes from corner i to the next.
    pub(super) edges: [u8; 4],
}

/// The faces: 2a is the lower one of axis a, 2a + 1 the upper one.
pub(super) static FACES: [Face; 6] = FACES_OF_CUBE;

const FACES_OF_CUBE: [Face; 6] = {
    let mut faces = [Face { corners: [0; 4], edges: [0; 4] }; 6];
    let mut f = 0;
    while f < 6 {
        let (axis, upper) = (f / 2, f % 2);
        let (u, v) = (1u8 << ((axis + 1) % 3), 1u8 << ((axis + 2) % 3));
        let at = (upper as u8) << axis;
        let corners =
            if upper == 1 { [at, at + u, at + u + v, at + v] } else { [at, at + v, at + u + v, at + u] };
        let mut i = 0;
        while i < 4 {
            faces[f].corners[i] = corners[i];
            faces[f].edges[i] = edge_between(corners[i], corners[(i + 1) % 4]);
            i += 1;
        }
        f += 1;
    }
    faces
};

/// The number of the edge between two corners.
const fn edge_between(p: u8, q: u8) -> u8 {
    let (axis, low) = ((p ^ q).trailing_zeros() as u8, p & q);
    4 * axis + ((low >> (axis + 1) << axis) | (low & ((1 << axis) - 1)))
}

/// The lower corner of an edge.
pub(super) const fn lower_corner(edge: u8) -> u8 {
    let (axis, place) = (edge / 4, edge % 4);
    (place >> axis << (axis + 1)) | (place & ((1 << axis) - 1))
}

/// The most triangles in a cube.
pub(super) const MOST: usize = 5;

/// The surface in a cube.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    /// The crossed edges, of which the first `count` count.
    pub(super) edges: [u8; 12],
    pub(super) count: u8,
    /// Triangles of edges, counter-clockwise seen from outside the surface, of which the first
    /// `triangles` count.
    pub(super) corners: [[u8; 3]; MOST],
    pub(super) triangles: u8,
}

/// The cases by the mask of corners inside.
pub(super) static CASES: [Case; 256] = {
    let mut cases = [Case { edges: [0; 12], count: 0, corners: [[0; 3]; MOST], triangles: 0 }; 256];
    let mut mask = 0;
    while mask < 256 {
        cases[mask] = derive_case(mask as u8);
        mask += 1;
    }
    cases
};

/// No edge.
const NONE: u8 = u8::MAX;

const fn derive_case(mask: u8) -> Case {
    let mut case = Case { edges: [0; 12], count: 0, corners: [[0; 3]; MOST], triangles: 0 };
    let mut next = segments(mask);
    let mut edge = 0;
    while edge < 12 {
        let (mut line, mut n) = ([0u8; 12], 0);
        let mut at = edge as u8;
        while next[at as usize] != NONE {
            line[n] = at;
            n += 1;
            let behind = next[at as usize];
            next[at as usize] = NONE;
            at = behind;
        }
        let mut i = 0;
        while i < n {
            case.edges[case.count as usize] = line[i];
            case.count += 1;
            i += 1;
        }
        if n > 0 {
            case = cut(case, &line, n);
        }
        edge += 1;
    }
    case
}

/// For each edge at which a segment of the surface begins, the edge at which it ends.
const fn segments(mask: u8) -> [u8; 12] {
    let mut next = [NONE; 12];
    let mut f = 0;
    while f < 6 {
        let Face { corners, edges } = FACES_OF_CUBE[f];
        let mut square = 0;
        let mut i = 0;
        while i < 4 {
            square |= (mask >> corners[i] & 1) << i;
            i += 1;
        }
        let mut start = 0;
        while start < 4 {
            if begins_run(square, start) {
                next[edges[(start + 3) % 4] as usize] = edges[(start + run_of(square, start) + 3) % 4];
            }
            start += 1;
        }
        f += 1;
    }
    next
}

/// Whether a run of corners inside begins at a corner of a square.
const fn begins_run(square: u8, start: usize) -> bool {
    square >> start & 1 == 1 && square >> ((start + 3) % 4) & 1 == 0
}

/// The corners of the run that begins at a corner.
const fn run_of(square: u8, start: usize) -> usize {
    let mut run = 0;
    while run < 4 && square >> ((start + run) % 4) & 1 == 1 {
        run += 1;
    }
    run
}

/// The most edges of a loop.
const LONGEST: usize = MOST + 2;

/// Cuts a loop of `n` edges into triangles: the sum of the cuts' weights is the least.
const fn cut(mut case: Case, line: &[u8; 12], n: usize) -> Case {
    assert!(n >= 3 && n <= LONGEST);
    // Of the polygon from place i to place j: its weight, and the third corner at the side (i, j).
    let (mut weight, mut third) = ([[0u32; LONGEST]; LONGEST], [[0usize; LONGEST]; LONGEST]);
    let mut length = 2;
    while length < n {
        let mut i = 0;
        while i + length < n {
            let j = i + length;
            weight[i][j] = u32::MAX;
            let mut k = i + 1;
            while k < j {
                let sides = side_weight(line, n, i, k) + side_weight(line, n, k, j);
                let all = weight[i][k] + weight[k][j] + sides;
                if all < weight[i][j] {
                    weight[i][j] = all;
                    third[i][j] = k;
                }
                k += 1;
            }
            i += 1;
        }
        length += 1;
    }
    list(&mut case, line, &third, 0, n - 1);
    case
}

/// Lists the triangles of the polygon from place i to place j.
const fn list(case: &mut Case, line: &[u8; 12], third: &[[usize; LONGEST]; LONGEST], i: usize, j: usize) {
    if j - i < 2 {
        return;
    }
    let k = third[i][j];
    case.corners[case.triangles as usize] = [line[i], line[k], line[j]];
    case.triangles += 1;
    list(case, line, third, i, k);
    list(case, line, third, k, j);
}

/// The weight of a cut between two places of a loop; a side of the loop has none.
const fn side_weight(line: &[u8; 12], n: usize, i: usize, j: usize) -> u32 {
    if j - i == 1 || j - i == n - 1 { 0 } else { cut_weight(line[i], line[j]) }
}

/// More than all cuts of a loop weigh.
const IN_A_FACE: u32 = 1000;

/// The squared distance of the middles of two edges, in half sides; far more in a face.
const fn cut_weight(a: u8, b: u8) -> u32 {
    if share_face(a, b) {
        return IN_A_FACE;
    }
    let (p, q) = (middle(a), middle(b));
    let (mut sum, mut k) = (0, 0);
    while k < 3 {
        sum += p[k].abs_diff(q[k]).pow(2);
        k += 1;
    }
    sum
}

const fn middle(edge: u8) -> [u32; 3] {
    let corner = lower_corner(edge);
    let (mut at, mut k) = ([0; 3], 0);
    while k < 3 {
        at[k] = 2 * (corner >> k & 1) as u32 + (edge as usize / 4 == k) as u32;
        k += 1;
    }
    at
}

/// Whether two edges lie in one face.
pub(super) const fn share_face(a: u8, b: u8) -> bool {
    let mut f = 0;
    while f < 6 {
        let edges = FACES_OF_CUBE[f].edges;
        let (mut found, mut i) = (0, 0);
        while i < 4 {
            found += (edges[i] == a) as u8 + (edges[i] == b) as u8;
            i += 1;
        }
        if found == 2 {
            return true;
        }
        f += 1;
    }
    false
}

/// The inside of a square, as triangles counter-clockwise seen from outside: 0 … 3 are its
/// corners, 4 … 7 its edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cap {
    pub(super) corners: [[u8; 3]; 3],
    pub(super) triangles: u8,
}

/// The caps by the mask of corners inside: a polygon for each run.
pub(super) static CAPS: [Cap; 16] = {
    let mut caps = [Cap { corners: [[0; 3]; 3], triangles: 0 }; 16];
    let mut square = 1;
    while square < 16 {
        let mut start = 0;
        while start < 4 {
            if begins_run(square, start) {
                caps[square as usize] = add_run(caps[square as usize], start, run_of(square, start));
            }
            start += 1;
        }
        square += 1;
    }
    caps[15] = Cap { corners: [[0, 1, 2], [0, 2, 3], [0; 3]], triangles: 2 };
    caps
};

/// Adds the polygon of a run, as a fan around the corner in its middle.
const fn add_run(mut cap: Cap, start: usize, run: usize) -> Cap {
    let mut polygon = [0; 5];
    polygon[0] = 4 + ((start + 3) % 4) as u8;
    let mut i = 0;
    while i < run {
        polygon[i + 1] = ((start + i) % 4) as u8;
        i += 1;
    }
    polygon[run + 1] = 4 + ((start + run + 3) % 4) as u8;
    let (n, hub) = (run + 2, run.div_ceil(2));
    let mut i = 1;
    while i + 1 < n {
        cap.corners[cap.triangles as usize] =
            [polygon[hub], polygon[(hub + i) % n], polygon[(hub + i + 1) % n]];
        cap.triangles += 1;
        i += 1;
    }
    cap
}
