//! The cases of marching tetrahedra, derived at compile time: which edges are crossed, which
//! triangles they make, and the order of four corners from the comparisons of their ids. The
//! picture is in [`super::marching_tets`].

/// The six edges of a tetrahedron with sorted corners, in the order of their keys.
pub(super) const EDGES: [[u8; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// The triangles in a tetrahedron of sorted corners.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    /// The corners of its crossed edges, ascending; the last is the first again where there are
    /// only three.
    pub(super) edges: [[u8; 2]; 4],
    /// Their places in [`EDGES`].
    pub(super) numbers: [u8; 4],
    /// Triangles of places in `edges`, each beginning with its smallest; the first `triangles`
    /// count.
    pub(super) corners: [[u8; 3]; 2],
    /// The same triangles, of places in [`EDGES`].
    pub(super) sides: [[u8; 3]; 2],
    pub(super) triangles: u8,
}

/// The bit of a case whose corners' order is an odd permutation of a positively oriented
/// tetrahedron.
pub(super) const ODD: u8 = 16;

/// The cases by the mask of corners inside, and [`ODD`].
pub(super) static CASES: [Case; 32] = {
    let none =
        Case { edges: [[0, 1]; 4], numbers: [0; 4], corners: [[0; 3]; 2], sides: [[0; 3]; 2], triangles: 0 };
    let mut cases = [none; 32];
    let mut mask = 1;
    while mask < 15 {
        let case = derive_case(mask);
        cases[mask] = case;
        cases[mask + ODD as usize] =
            Case { corners: turned(case.corners), sides: turned(case.sides), ..case };
        mask += 1;
    }
    cases
};

/// The case of a mask that is neither empty nor full, the corners positively oriented.
///
/// In a positively oriented tetrahedron (i, j, k, l), the triangle (ij, ik, il) looks away from i,
/// and the quadrilateral (ik, il, jl, jk) from i and j to k and l. So list the corners inside, then
/// those outside, each ascending; one corner alone is put first; an odd list, or a corner alone
/// outside, turns the polygon over.
const fn derive_case(mask: usize) -> Case {
    let inside = mask.count_ones();
    let alone_outside = inside == 3;
    let first = if alone_outside { !mask & 15 } else { mask };
    let mut list = [0u8; 4];
    let (mut n, mut corner) = (0, 0);
    while corner < 8 {
        // Two rounds over the four corners: those of `first`, then the others.
        if (first >> (corner % 4) & 1 == 1) == (corner < 4) {
            list[n] = corner as u8 % 4;
            n += 1;
        }
        corner += 1;
    }
    let [i, j, k, l] = list;
    let turn = is_odd(list) != alone_outside;
    if inside != 2 {
        let edges = [edge(i, j), edge(i, k), edge(i, l), edge(i, j)];
        let triangle = if turn { [0, 2, 1] } else { [0, 1, 2] };
        let corners = [triangle, [0; 3]];
        let sides = named(edges, corners);
        return Case { edges: ends(edges), numbers: edges, corners, sides, triangles: 1 };
    }
    let quad = [edge(i, k), edge(i, l), edge(j, l), edge(j, k)];
    let quad = if turn { [quad[0], quad[3], quad[2], quad[1]] } else { quad };
    // Begin at the smallest edge: the diagonal starts there.
    let mut s = 0;
    let mut at = 1;
    while at < 4 {
        if quad[at] < quad[s] {
            s = at;
        }
        at += 1;
    }
    let edges = sorted(quad);
    let [p, q, r, t] = [
        place(edges, quad[s]),
        place(edges, quad[(s + 1) % 4]),
        place(edges, quad[(s + 2) % 4]),
        place(edges, quad[(s + 3) % 4]),
    ];
    let corners = [[p, q, r], [p, r, t]];
    Case { edges: ends(edges), numbers: edges, corners, sides: named(edges, corners), triangles: 2 }
}

/// Triangles that look to the other side.
const fn turned([[a, b, c], [d, e, f]]: [[u8; 3]; 2]) -> [[u8; 3]; 2] {
    [[a, c, b], [d, f, e]]
}

/// Triangles of places in a list of edges, as triangles of these.
const fn named(edges: [u8; 4], [[a, b, c], [d, e, f]]: [[u8; 3]; 2]) -> [[u8; 3]; 2] {
    [
        [edges[a as usize], edges[b as usize], edges[c as usize]],
        [edges[d as usize], edges[e as usize], edges[f as usize]],
    ]
}

const fn ends(edges: [u8; 4]) -> [[u8; 2]; 4] {
    let [a, b, c, d] = edges;
    [EDGES[a as usize], EDGES[b as usize], EDGES[c as usize], EDGES[d as usize]]
}

const fn place(edges: [u8; 4], edge: u8) -> u8 {
    let mut i = 0;
    while edges[i] != edge {
        i += 1;
    }
    i as u8
}

/// The number of the edge between two corners.
const fn edge(a: u8, b: u8) -> u8 {
    let mut e = 0;
    while e < 6 {
        let [i, j] = EDGES[e];
        if (i == a && j == b) || (i == b && j == a) {
            return e as u8;
        }
        e += 1;
    }
    panic!("two different corners of a tetrahedron have an edge");
}

pub(super) const fn is_odd(list: [u8; 4]) -> bool {
    let (mut odd, mut i) = (false, 0);
    while i < 16 {
        odd ^= i / 4 < i % 4 && list[i / 4] > list[i % 4];
        i += 1;
    }
    odd
}

const fn sorted(mut list: [u8; 4]) -> [u8; 4] {
    let mut i = 0;
    while i < 16 {
        let (a, b) = (i / 4, i % 4);
        if a < b && list[a] > list[b] {
            let swap = list[a];
            list[a] = list[b];
            list[b] = swap;
        }
        i += 1;
    }
    list
}

/// The corners of a tetrahedron in the order of their ids.
#[derive(Clone, Copy)]
pub(super) struct OrderOf {
    pub(super) corners: [u8; 4],
    /// [`ODD`] if that is an odd permutation.
    pub(super) odd: u8,
}

/// The orders by the six comparisons of the ids of corners i < j, in the order of [`EDGES`]:
/// whether that of j is less.
pub(super) static ORDERS: [OrderOf; 64] = {
    let mut orders = [OrderOf { corners: [0; 4], odd: 0 }; 64];
    let mut swapped = 0;
    while swapped < 64 {
        let (mut rank, mut odd, mut e) = ([0u8; 4], false, 0);
        while e < 6 {
            let [i, j] = EDGES[e];
            let less = swapped >> e & 1 == 1;
            // The greater of two is one further behind.
            rank[if less { i } else { j } as usize] += 1;
            odd ^= less;
            e += 1;
        }
        let mut corner = 0;
        while corner < 4 {
            // Comparisons that contradict each other do not occur, and give no order.
            orders[swapped].corners[rank[corner] as usize] = corner as u8;
            corner += 1;
        }
        orders[swapped].odd = if odd { ODD } else { 0 };
        swapped += 1;
    }
    orders
};
