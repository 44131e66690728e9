//! Is a triangle mesh closed, manifold, oriented?
//!
//! # How does it work?
//!
//! The triangles are listed by vertex (a counting sort). Then each vertex `v` is looked at alone, through its *link*: every
//! triangle (v, n, p) contributes the directed edge n → p.
//!
//! ```text
//!        n---p             an end u of link edges is an edge (v, u) of the mesh:
//!       / \ / \              u seen once              boundary edge
//!      /   v   \             once as n, once as p     two triangles, oriented alike
//!      \  / \  /             twice as n               two triangles, one of them turned over
//!       \/___\/              three times or more      non-manifold edge
//! ```
//!
//! `v` is manifold when its link is one cycle (inside) or one path (on the boundary): connected, every end seen at
//! most twice. Edges are counted at their smaller vertex, duplicate triangles at their smallest.
//!
//! Cost: O(t log d) time for t triangles of vertex degree d; about 20 bytes a triangle and 20 a vertex beside the mesh.
//!
//! It does *not* look for triangles that intersect each other.

use super::{TriMesh, Vertex};
use crate::grid::Geometry;
use serde::Serialize;

/// What [`check`] finds. Triangles with a repeated or an absent vertex are counted, and otherwise ignored.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SurfaceReport {
    /// Vertices of the mesh.
    pub vertices: u64,
    /// Triangles of the mesh, good and bad.
    pub triangles: u64,
    /// Edges.
    pub edges: u64,
    /// Edges of one triangle.
    pub boundary_edges: u64,
    /// Connected groups of boundary edges: the rims of the surface.
    pub boundary_loops: u64,
    /// Edges of three or more triangles.
    pub non_manifold_edges: u64,
    /// Edges of two triangles that run along it in the same direction.
    pub misoriented_edges: u64,
    /// Vertices whose triangles form neither one disc nor one half disc.
    pub non_manifold_vertices: u64,
    /// Triangles that name a vertex twice.
    pub degenerate_triangles: u64,
    /// Triangles of three different vertices and area zero.
    pub zero_area_triangles: u64,
    /// Triangles that name a vertex that there is not.
    pub out_of_range_triangles: u64,
    /// Triangles beyond the first on the same three vertices.
    pub duplicate_triangles: u64,
    /// Vertices of no (good) triangle.
    pub unreferenced_vertices: u64,
    /// Vertices with a coordinate that is infinite or NaN.
    pub non_finite_vertices: u64,
    /// Connected pieces.
    pub components: u64,
    /// Vertices in use - edges + triangles: 2 for each sphere, 0 for each torus.
    pub euler: i64,
    /// Area.
    pub area: f64,
    /// Enclosed volume, positive when triangles are counter-clockwise seen from outside; only for a closed, manifold,
    /// oriented surface.
    pub volume: Option<f64>,
    /// Smallest and largest coordinates of the vertices in use.
    pub bounding_box: Option<[[f32; 3]; 2]>,
}

impl SurfaceReport {
    /// Every edge has at most two triangles, every vertex one fan, and no triangle is degenerate, double or out of range.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0
            && self.non_manifold_vertices == 0
            && self.degenerate_triangles == 0
            && self.out_of_range_triangles == 0
            && self.duplicate_triangles == 0
    }

    /// Neighbouring triangles agree on which side is outside.
    pub fn is_oriented(&self) -> bool {
        self.misoriented_edges == 0 && self.non_manifold_edges == 0
    }

    /// There is no boundary edge.
    pub fn is_closed(&self) -> bool {
        self.boundary_edges == 0
    }
}

/// Checks a mesh. Any mesh: nothing about it is taken for granted.
pub fn check(mesh: &TriMesh) -> SurfaceReport {
    let mut report = SurfaceReport {
        vertices: mesh.vertices.len() as u64,
        triangles: mesh.triangles.len() as u64,
        non_finite_vertices: mesh
            .vertices
            .iter()
            .filter(|v| !v.position.iter().all(|x| x.is_finite()))
            .count() as u64,
        ..SurfaceReport::default()
    };
    let good = good_triangles(mesh, &mut report);
    let fans = Fans::new(mesh.vertices.len(), &good);
    let mut pieces = Pieces::new(mesh.vertices.len());
    let mut rims = Pieces::new(mesh.vertices.len());
    let mut link = Link::default();
    for v in 0..mesh.vertices.len() as u32 {
        link.gather(v, fans.of(v), &good);
        count_vertex(v, &mut link, &mut report, &mut pieces, &mut rims);
    }
    report.components = pieces.count();
    report.boundary_loops = rims.count();
    report.euler =
        (report.vertices - report.unreferenced_vertices) as i64 - report.edges as i64 + good.len() as i64;
    measure(mesh, &good, &mut report);
    report
}

/// The boundary edges, each as its triangle runs along it, in the order of their first vertices.
pub fn boundary_edges(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let good = good_triangles(mesh, &mut SurfaceReport::default());
    let fans = Fans::new(mesh.vertices.len(), &good);
    let mut link = Link::default();
    let mut edges = Vec::new();
    for v in 0..mesh.vertices.len() as u32 {
        link.gather(v, fans.of(v), &good);
        edges.extend(link.edges().filter(|e| e.triangles() == 1 && e.out == 1).map(|e| [v, e.to]));
    }
    edges
}

/// Boundary edges that do not lie on a face of the domain box, that of the samples 0 … dims - 1: both ends must be within
/// `tolerance` voxels of the same face. Vertices are rounded to `f32` in the world, so the tolerance must allow for that.
pub fn boundary_outside(mesh: &TriMesh, geometry: &Geometry, dims: [u64; 3], tolerance: f64) -> u64 {
    let faces_of = |v: u32| {
        let ijk = geometry.to_index(mesh.vertices[v as usize].position.map(f64::from));
        (0..3).fold(0u8, |faces, a| {
            let near = |at: f64| u8::from((ijk[a] - at).abs() <= tolerance);
            faces | near(0.0) << (2 * a) | near((dims[a].max(1) - 1) as f64) << (2 * a + 1)
        })
    };
    boundary_edges(mesh).iter().filter(|[a, b]| faces_of(*a) & faces_of(*b) == 0).count() as u64
}

/// The triangles of three different, existing vertices; counts the others.
fn good_triangles(mesh: &TriMesh, report: &mut SurfaceReport) -> Vec<[u32; 3]> {
    let mut good = Vec::with_capacity(mesh.triangles.len());
    for &t in &mesh.triangles {
        let [a, b, c] = t;
        if t.iter().any(|&v| v as usize >= mesh.vertices.len()) {
            report.out_of_range_triangles += 1;
        } else if a == b || b == c || c == a {
            report.degenerate_triangles += 1;
        } else {
            good.push(t);
        }
    }
    good
}

fn count_vertex(v: u32, link: &mut Link, report: &mut SurfaceReport, pieces: &mut Pieces, rims: &mut Pieces) {
    if link.ends.is_empty() {
        report.unreferenced_vertices += 1;
        return;
    }
    let mut simple = true;
    for edge in link.edges() {
        simple &= edge.triangles() <= 2;
        if edge.to > v {
            pieces.join(v, edge.to);
            report.edges += 1;
            match (edge.triangles(), edge.out) {
                (1, _) => {
                    report.boundary_edges += 1;
                    rims.join(v, edge.to);
                }
                (2, 1) => {}
                (2, _) => report.misoriented_edges += 1,
                _ => report.non_manifold_edges += 1,
            }
        }
    }
    report.non_manifold_vertices += u64::from(!simple || !link.is_connected());
    report.duplicate_triangles += link.duplicates(v);
}

/// Areas and the enclosed volume, in triangle order, all in `f64`.
fn measure(mesh: &TriMesh, good: &[[u32; 3]], report: &mut SurfaceReport) {
    let used = good.iter().flatten().map(|&v| mesh.vertices[v as usize]);
    report.bounding_box = used.fold(None, |bounds, v| Some(widen(bounds, &v)));
    let Some([lo, hi]) = report.bounding_box else {
        return;
    };
    // Seen from the middle of the surface, so that a far origin does not cancel the digits of the volume.
    let middle: [f64; 3] = std::array::from_fn(|k| 0.5 * (f64::from(lo[k]) + f64::from(hi[k])));
    let mut volume6 = 0.0;
    for t in good {
        let [a, b, c] = t.map(|v| {
            let p = mesh.vertices[v as usize].position;
            std::array::from_fn(|k| f64::from(p[k]) - middle[k])
        });
        let normal2 = cross(minus(b, a), minus(c, a));
        let length2 = dot(normal2, normal2).sqrt();
        report.zero_area_triangles += u64::from(length2 == 0.0);
        report.area += 0.5 * length2;
        volume6 += dot(a, cross(b, c));
    }
    if report.is_closed() && report.is_manifold() && report.is_oriented() {
        report.volume = Some(volume6 / 6.0);
    }
}

fn widen(bounds: Option<[[f32; 3]; 2]>, v: &Vertex) -> [[f32; 3]; 2] {
    let [lo, hi] = bounds.unwrap_or([v.position; 2]);
    [std::array::from_fn(|k| lo[k].min(v.position[k])), std::array::from_fn(|k| hi[k].max(v.position[k]))]
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The triangles of each vertex.
struct Fans {
    start: Vec<usize>,
    triangles: Vec<u32>,
}

impl Fans {
    fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        assert!(
            vertices.max(triangles.len()) < u32::MAX as usize,
            "a mesh held in memory has fewer than 2^32 vertices and triangles"
        );
        let mut start = vec![0; vertices + 1];
        triangles.iter().flatten().for_each(|&v| start[v as usize] += 1);
        // start[v] becomes the end of v's list, and counts down to its beginning while the list is filled.
        let mut end = 0;
        for s in &mut start {
            end += *s;
            *s = end;
        }
        let mut list = vec![0; 3 * triangles.len()];
        for (i, t) in triangles.iter().enumerate().rev() {
            for &v in t {
                start[v as usize] -= 1;
                list[start[v as usize]] = i as u32;
            }
        }
        Self { start, triangles: list }
    }

    fn of(&self, v: u32) -> &[u32] {
        &self.triangles[self.start[v as usize]..self.start[v as usize + 1]]
    }
}

/// An edge from the vertex looked at.
struct LinkEdge {
    to: u32,
    /// Triangles that run along it away from the vertex, and towards it.
    out: usize,
    back: usize,
}

impl LinkEdge {
    fn triangles(&self) -> usize {
        self.out + self.back
    }
}

/// The link of one vertex; buffers reused from vertex to vertex.
#[derive(Default)]
struct Link {
    /// Link edges n → p.
    arcs: Vec<[u32; 2]>,
    /// (end, whether it is a p), sorted.
    ends: Vec<(u32, bool)>,
    /// Different ends, sorted.
    distinct: Vec<u32>,
    parents: Vec<u32>,
}

impl Link {
    fn gather(&mut self, v: u32, fan: &[u32], triangles: &[[u32; 3]]) {
        self.arcs.clear();
        self.arcs.extend(fan.iter().map(|&t| match triangles[t as usize] {
            [a, n, p] if a == v => [n, p],
            [p, a, n] if a == v => [n, p],
            [n, p, _] => [n, p],
        }));
        self.ends.clear();
        self.ends.extend(self.arcs.iter().flat_map(|&[n, p]| [(n, false), (p, true)]));
        self.ends.sort_unstable();
    }

    /// The edges of the mesh at this vertex, ascending by the other end.
    fn edges(&self) -> impl Iterator<Item = LinkEdge> + '_ {
        self.ends.chunk_by(|a, b| a.0 == b.0).map(|same| {
            let out = same.iter().filter(|end| !end.1).count();
            LinkEdge { to: same[0].0, out, back: same.len() - out }
        })
    }

    /// Union-find over the ends.
    fn is_connected(&mut self) -> bool {
        self.distinct.clear();
        self.distinct.extend(self.ends.iter().map(|end| end.0));
        self.distinct.dedup();
        self.parents.clear();
        self.parents.extend(0..self.distinct.len() as u32);
        let mut groups = self.distinct.len();
        for arc in &self.arcs {
            let [n, p] =
                arc.map(|end| self.distinct.binary_search(&end).expect("every end of an arc is listed"));
            let (n, p) = (root(&mut self.parents, n as u32), root(&mut self.parents, p as u32));
            if n != p {
                self.parents[n as usize] = p;
                groups -= 1;
            }
        }
        groups == 1
    }

    /// Triangles that repeat another of this vertex, which is the smallest of their three. Spoils the arcs' order.
    fn duplicates(&mut self, v: u32) -> u64 {
        self.arcs.retain(|arc| v < arc[0] && v < arc[1]);
        self.arcs.iter_mut().for_each(|arc| arc.sort_unstable());
        self.arcs.sort_unstable();
        self.arcs.windows(2).filter(|pair| pair[0] == pair[1]).count() as u64
    }
}

/// The root of an element, halving the path on the way.
fn root(parents: &mut [u32], mut i: u32) -> u32 {
    while parents[i as usize] != i {
        parents[i as usize] = parents[parents[i as usize] as usize];
        i = parents[i as usize];
    }
    i
}

/// Connected pieces of a graph on the vertices; vertices without an edge are none.
struct Pieces {
    parents: Vec<u32>,
    touched: Vec<bool>,
}

impl Pieces {
    fn new(vertices: usize) -> Self {
        Self { parents: (0..vertices as u32).collect(), touched: vec![false; vertices] }
    }

    fn join(&mut self, a: u32, b: u32) {
        (self.touched[a as usize], self.touched[b as usize]) = (true, true);
        let (a, b) = (root(&mut self.parents, a), root(&mut self.parents, b));
        // The smaller number becomes the root: with path halving that is fast enough, and needs no ranks.
        self.parents[a.max(b) as usize] = a.min(b);
    }

    fn count(&self) -> u64 {
        let roots = self.parents.iter().enumerate().filter(|&(i, &p)| i as u32 == p && self.touched[i]);
        roots.count() as u64
    }
}

#[cfg(test)]
#[path = "check_tests.rs"]
mod tests;
