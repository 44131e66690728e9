//! Is a triangle mesh closed, manifold, oriented?
//!
//! # How does it work?
//!
//! The triangles are listed by vertex (a counting sort). Then each vertex `v` is examined alone,
//! through its *link*: every triangle (v, n, p) contributes the directed edge n → p.
//!
//! ```text
//!        n---p             an end u of link edges is an edge (v, u) of the mesh:
//!       / \ / \              u seen once              boundary edge
//!      /   v   \             once as n, once as p     two triangles, oriented alike
//!      \  / \  /             twice as n               two triangles, one of them turned over
//!       \/___\/              three times or more      non-manifold edge
//! ```
//!
//! `v` is manifold when its link is one cycle (inside) or one path (on the boundary): connected,
//! every end seen at most twice. Edges are counted at their smaller vertex, duplicate triangles at
//! their smallest.
//!
//! # Surfaces larger than memory
//! Arcs (v, n, p) of all triangles are sorted by v, on disk if they exceed memory, and the links
//! come out one after the other. Positions lie in a store that is read through a cache. The
//! following must be in memory, and is asked for in [`CheckSettings::memory`]:
//!
//! * 4 bytes a vertex for the connected pieces (union-find; one array, used for the surface and
//!   then for its rims);
//! * the link of one vertex, about 80 bytes a triangle at the vertex of the most triangles.
//!
//! The report is the same for any memory: the same steps are taken, and sums run over the triangles
//! in their order.
//!
//! Cost: O(t log t) time for t triangles. Disk, if memory does not hold them: 36 bytes a triangle,
//! 12 a vertex, 8 a boundary edge.
//!
//! It does *not* look for triangles that intersect each other.

use crate::surface::edit::clip::HalfSpace;
use crate::surface::model::{SurfaceSource, TriMesh, corner_of, world_of};
use isospan_io::bytes::sorter::{Sorted, Sorter};
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::error::{Error, Result};
use isospan_io::geom::vec3::{cross, dot, minus};
use isospan_io::grid::Geometry;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// What [`check`] finds. Triangles with a repeated or an absent vertex are counted, and otherwise
/// ignored.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SurfaceCheckReport {
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
    /// Enclosed volume, positive when triangles are counter-clockwise seen from outside; only for a
    /// closed, manifold, oriented surface.
    pub volume: Option<f64>,
    /// Smallest and largest coordinates of the vertices in use.
    pub bounding_box: Option<[[f64; 3]; 2]>,
}

impl SurfaceCheckReport {
    /// Every edge has at most two triangles, every vertex one fan, and no triangle is degenerate,
    /// double or out of range.
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

/// How a surface is checked.
#[derive(Clone, Debug)]
pub struct CheckSettings {
    /// Bytes for everything that grows with the surface. An eighth of them is the source's own: see
    /// [`CheckSettings::of_source`].
    pub memory: u64,
    /// Folder for what does not fit in memory.
    pub scratch: PathBuf,
}

impl Default for CheckSettings {
    fn default() -> Self {
        Self { memory: u64::MAX, scratch: std::env::temp_dir() }
    }
}

impl CheckSettings {
    /// Bytes that the source of the surface may hold meanwhile.
    pub fn of_source(&self) -> usize {
        in_memory(self.memory / 8)
    }
}

/// Where the boundary of a surface may lie: on the faces of a volume's box, that of the samples 0 …
/// dims - 1, and where the surface was cut.
#[derive(Clone, Copy, Debug)]
pub struct Domain<'a> {
    /// Index space to the world, where the surface is.
    pub geometry: &'a Geometry,
    /// Samples along x, y, z.
    pub dims: [u64; 3],
    /// Planes at which the surface was cut, at most six, each with the distance at which a vertex
    /// counts as on it, in the units of [`HalfSpace::distance`].
    pub cuts: &'a [(HalfSpace, f64)],
    /// How far, in voxels, a vertex may lie from a face. Vertices are rounded to `f32` in the
    /// world: it must allow for that.
    pub tolerance: f64,
}

impl Domain<'_> {
    /// The faces and cuts that a position lies on, a bit each.
    fn faces_of(&self, position: [f64; 3]) -> u16 {
        let ijk = self.geometry.to_index(position);
        let faces = (0..3).fold(0u16, |faces, a| {
            let near = |at: f64| u16::from((ijk[a] - at).abs() <= self.tolerance);
            faces | near(0.0) << (2 * a) | near((self.dims[a].max(1) - 1) as f64) << (2 * a + 1)
        });
        self.cuts.iter().enumerate().fold(faces, |faces, (n, (plane, tolerance))| {
            faces | u16::from(plane.distance(position).abs() <= *tolerance) << (6 + n)
        })
    }
}

/// Checks a mesh in memory. Any mesh: nothing about it is taken for granted.
pub fn check(mesh: &TriMesh) -> SurfaceCheckReport {
    check_source(mesh, None, &CheckSettings::default())
        .expect("nothing of a mesh in memory is read or written")
        .0
}

/// Checks a surface within a given memory. If a domain is given, it also counts the boundary edges
/// that are not on a face of the domain.
///
/// # Errors
/// [`Error::Budget`] when the memory does not suffice, naming what does; [`Error::Usage`] for
/// 2^32 - 1 vertices or more; those of reading the source, and of the scratch folder.
pub fn check_source(
    source: &dyn SurfaceSource,
    domain: Option<&Domain<'_>>,
    settings: &CheckSettings,
) -> Result<(SurfaceCheckReport, Option<u64>)> {
    let (report, open) =
        check_in(source, domain, &Shares::of(source.vertex_count(), settings)?, &mut |_| Ok(0))?;
    Ok((report, domain.map(|_| open.outside)))
}

/// Boundary edges that lie on no face of the domain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct OpenEdges {
    /// Edges that nothing explains: holes.
    pub outside: u64,
    /// Edges at samples without data.
    pub at_missing: u64,
}

/// Takes edges as the positions of their ends, in the world; returns how many of them lie where
/// there is no data.
pub type Explain<'a> = dyn FnMut(&[[[f64; 3]; 2]]) -> Result<u64> + 'a;

/// As [`check_source`], but boundary edges may also lie where there is no data. `at_missing` is
/// asked about those on no face, at most [`EDGES_ASKED`] at a time.
///
/// # Errors
/// As [`check_source`], and those of `at_missing`.
pub fn check_within(
    source: &dyn SurfaceSource,
    domain: &Domain<'_>,
    settings: &CheckSettings,
    at_missing: &mut Explain<'_>,
) -> Result<(SurfaceCheckReport, OpenEdges)> {
    check_in(source, Some(domain), &Shares::of(source.vertex_count(), settings)?, at_missing)
}

/// Boundary edges that are asked about at a time, at most.
pub const EDGES_ASKED: usize = 1 << 13;

fn check_in(
    source: &dyn SurfaceSource,
    domain: Option<&Domain<'_>>,
    shares: &Shares<'_>,
    at_missing: &mut Explain<'_>,
) -> Result<(SurfaceCheckReport, OpenEdges)> {
    let mut report = SurfaceCheckReport {
        vertices: source.vertex_count(),
        triangles: source.triangle_count(),
        ..SurfaceCheckReport::default()
    };
    let positions = positions(source, shares, &mut report)?;
    let mut places = Cached::new(&positions, shares.positions);
    let mut arcs = Arcs::new(sorted_arcs(source, shares, &mut report)?)?;
    let mut pieces = VertexPieces::new(report.vertices as usize);
    let mut rims = Store::new(shares.positions / 4, shares.scratch);
    let (mut link, mut ends) = (Link::default(), None);
    for v in 0..report.vertices as u32 {
        link.gather(&mut arcs, v, shares)?;
        count_vertex(v, &mut link, &mut report, &mut pieces, &mut rims)?;
        if !link.ends.is_empty() {
            let position = places.get(v.into())?;
            ends = Some(widen(ends, position));
        }
    }
    report.components = pieces.count();
    report.boundary_loops = loops(&rims, &mut pieces)?;
    measure(source, &mut places, ends, &mut report)?;
    let origin = source.origin();
    report.bounding_box = ends.map(|ends| ends.map(|corner| corner_of(corner, origin)));
    let mut world = |v: u32| Ok(world_of(places.get(v.into())?, origin));
    let open = domain.map(|domain| edges_outside(&rims, &mut world, domain, at_missing)).transpose()?;
    Ok((report, open.unwrap_or_default()))
}

/// Triangles whose corners lie on a line: `f32` may have rounded them to that. `memory` bounds what
/// is held besides the surface; the rest is in the folder.
///
/// # Errors
/// Those of reading the source, and of the scratch folder.
pub(crate) fn zero_area_triangles(source: &dyn SurfaceSource, memory: usize, scratch: &Path) -> Result<u64> {
    let mut positions = Store::new(memory / 2, scratch);
    source.vertices(&mut |batch| batch.iter().try_for_each(|v| positions.push(v.position)))?;
    let (mut places, mut found) = (Cached::new(&positions, memory / 2), 0);
    let on_a_line = |corners: [[f32; 3]; 3]| {
        let [a, b, c] = corners.map(|p| p.map(f64::from));
        u64::from(cross(minus(b, a), minus(c, a)) == [0.0; 3])
    };
    let all = positions.in_memory();
    source.triangles(&mut |batch| {
        found += match all {
            Some(all) => batch.iter().map(|t| on_a_line(t.map(|v| all[v as usize]))).sum::<u64>(),
            None => {
                let corners = |t: &[u32; 3]| -> Result<u64> {
                    let mut at = |n: usize| places.get(t[n].into());
                    Ok(on_a_line([at(0)?, at(1)?, at(2)?]))
                };
                batch.iter().map(corners).sum::<Result<u64>>()?
            }
        };
        Ok(())
    })?;
    Ok(found)
}

/// The boundary edges, each as its triangle runs along it, in the order of their first vertices.
pub fn boundary_edges(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let (settings, mut report, mut link) =
        (CheckSettings::default(), SurfaceCheckReport::default(), Link::default());
    let all = "nothing of a mesh in memory is read or written";
    let shares = Shares::of(mesh.vertex_count(), &settings).expect(all);
    let mut arcs = Arcs::new(sorted_arcs(mesh, &shares, &mut report).expect(all)).expect(all);
    let mut edges = Vec::new();
    for v in 0..mesh.vertices.len() as u32 {
        link.gather(&mut arcs, v, &shares).expect(all);
        edges.extend(link.edges().filter(|e| e.triangles() == 1 && e.out == 1).map(|e| [v, e.to]));
    }
    edges
}

/// Boundary edges that do not lie on a face of the domain box, that of the samples 0 … dims - 1:
/// both ends must be within `tolerance` voxels of the same face. Vertices are rounded to `f32` in
/// the world, so the tolerance must allow for that.
pub fn boundary_outside(mesh: &TriMesh, geometry: &Geometry, dims: [u64; 3], tolerance: f64) -> u64 {
    let domain = Domain { geometry, dims, cuts: &[], tolerance };
    let checked = check_source(mesh, Some(&domain), &CheckSettings::default());
    checked.expect("nothing of a mesh in memory is read or written").1.expect("a domain was given")
}

/// What the process needs besides: code and tables, stacks, buffers.
const FIXED: u64 = 16 << 20;
/// Below this the rest of the memory is not worth sorting in.
const LEAST_REST: u64 = 4 << 20;
/// Bytes of a link for each of its triangles: the arc, two ends, their distinct numbers and
/// union-find; twice, as lists grow.
const LINK_BYTES: u64 = 80;

/// The memory of a check, as it is shared out.
struct Shares<'a> {
    arcs: usize,
    positions: usize,
    /// Triangles at one vertex.
    fan: u64,
    given: u64,
    vertices: u64,
    scratch: &'a Path,
}

impl<'a> Shares<'a> {
    fn of(vertices: u64, settings: &'a CheckSettings) -> Result<Self> {
        if vertices >= u32::MAX.into() {
            return Err(Error::usage(format!(
                "a surface of {vertices} vertices: {} is the most",
                u32::MAX - 1
            )));
        }
        let given = settings.memory;
        let needed = least(vertices, LEAST_REST);
        if given < needed {
            return Err(Error::memory("", needed, given));
        }
        let rest = given - given / 8 - FIXED - 4 * vertices;
        let fan = rest / 4 / LINK_BYTES;
        Ok(Self {
            arcs: in_memory(rest / 2),
            positions: in_memory(rest / 8),
            fan,
            given,
            vertices,
            scratch: &settings.scratch,
        })
    }

    fn fan_too_large(&self, triangles: u64) -> Error {
        let needed = least(self.vertices, 4 * LINK_BYTES * (triangles + 1));
        Error::memory(format!("for {triangles} triangles at one vertex"), needed, self.given)
    }
}

/// The memory that leaves `rest` besides what the source has and the pieces need.
fn least(vertices: u64, rest: u64) -> u64 {
    (FIXED + 4 * vertices).saturating_add(rest).div_ceil(7).saturating_mul(8)
}

fn in_memory(bytes: u64) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}

/// The vertices' positions, for random access.
fn positions(
    source: &dyn SurfaceSource,
    shares: &Shares<'_>,
    report: &mut SurfaceCheckReport,
) -> Result<Store<[f32; 3]>> {
    let mut positions = Store::new(shares.positions / 2, shares.scratch);
    source.vertices(&mut |batch| {
        for v in batch {
            report.non_finite_vertices += u64::from(!v.position.iter().all(|x| x.is_finite()));
            positions.push(v.position)?;
        }
        Ok(())
    })?;
    Ok(positions)
}

/// The three different, existing vertices of a triangle.
fn is_good([a, b, c]: [u32; 3], vertices: u64) -> bool {
    [a, b, c].iter().all(|&v| u64::from(v) < vertices) && a != b && b != c && c != a
}

/// The arcs of the triangles of three different, existing vertices, by vertex; counts the other
/// triangles.
fn sorted_arcs(
    source: &dyn SurfaceSource,
    shares: &Shares<'_>,
    report: &mut SurfaceCheckReport,
) -> Result<Sorted<[u32; 3]>> {
    let mut arcs = Sorter::new(shares.arcs, shares.scratch);
    source.triangles(&mut |batch| {
        for &t in batch {
            if is_good(t, shares.vertices) {
                let [a, b, c] = t;
                [[a, b, c], [b, c, a], [c, a, b]].into_iter().try_for_each(|arc| arcs.push(arc))?;
            } else if t.iter().any(|&v| u64::from(v) >= shares.vertices) {
                report.out_of_range_triangles += 1;
            } else {
                report.degenerate_triangles += 1;
            }
        }
        Ok(())
    })?;
    arcs.finish()
}

fn count_vertex(
    v: u32,
    link: &mut Link,
    report: &mut SurfaceCheckReport,
    pieces: &mut VertexPieces,
    rims: &mut Store<[u32; 2]>,
) -> Result<()> {
    if link.ends.is_empty() {
        report.unreferenced_vertices += 1;
        return Ok(());
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
                    rims.push([v, edge.to])?;
                }
                (2, 1) => {}
                (2, _) => report.misoriented_edges += 1,
                _ => report.non_manifold_edges += 1,
            }
        }
    }
    report.non_manifold_vertices += u64::from(!simple || !link.is_connected());
    report.duplicate_triangles += link.duplicates(v);
    Ok(())
}

/// Connected groups of edges.
fn loops(edges: &Store<[u32; 2]>, pieces: &mut VertexPieces) -> Result<u64> {
    pieces.clear();
    edges.each(&mut |batch| {
        batch.iter().for_each(|&[a, b]| pieces.join(a, b));
        Ok(())
    })?;
    Ok(pieces.count())
}

fn edges_outside(
    edges: &Store<[u32; 2]>,
    world: &mut dyn FnMut(u32) -> Result<[f64; 3]>,
    domain: &Domain<'_>,
    at_missing: &mut Explain<'_>,
) -> Result<OpenEdges> {
    let (mut open, mut waiting) = (OpenEdges::default(), vec![]);
    let mut ask = |edges: &mut Vec<[[f64; 3]; 2]>| {
        let explained = if edges.is_empty() { 0 } else { at_missing(edges)? };
        open.at_missing += explained;
        open.outside += edges.len() as u64 - explained;
        edges.clear();
        Ok(())
    };
    edges.each(&mut |batch| {
        for &[a, b] in batch {
            let ends = [world(a)?, world(b)?];
            if domain.faces_of(ends[0]) & domain.faces_of(ends[1]) == 0 {
                waiting.push(ends);
                if waiting.len() == EDGES_ASKED {
                    ask(&mut waiting)?;
                }
            }
        }
        Ok(())
    })?;
    ask(&mut waiting)?;
    Ok(open)
}

/// Areas, the enclosed volume and the Euler number, in triangle order, all in `f64`.
fn measure(
    source: &dyn SurfaceSource,
    places: &mut Cached<'_, [f32; 3]>,
    ends: Option<[[f32; 3]; 2]>,
    report: &mut SurfaceCheckReport,
) -> Result<()> {
    let Some([lo, hi]) = ends else {
        return Ok(());
    };
    // Seen from the middle of the surface, so that a far origin does not cancel the digits of the
    // volume.
    let middle: [f64; 3] = std::array::from_fn(|k| 0.5 * (f64::from(lo[k]) + f64::from(hi[k])));
    let (mut volume6, mut good) = (0.0, 0);
    source.triangles(&mut |batch| {
        for &t in batch.iter().filter(|t| is_good(**t, report.vertices)) {
            let mut at = |v: u32| {
                let p = places.get(v.into())?;
                Ok(std::array::from_fn(|k| f64::from(p[k]) - middle[k]))
            };
            let [a, b, c]: [[f64; 3]; 3] = [at(t[0])?, at(t[1])?, at(t[2])?];
            let normal2 = cross(minus(b, a), minus(c, a));
            let length2 = dot(normal2, normal2).sqrt();
            report.zero_area_triangles += u64::from(length2 == 0.0);
            report.area += 0.5 * length2;
            volume6 += dot(a, cross(b, c));
            good += 1;
        }
        Ok(())
    })?;
    report.euler = (report.vertices - report.unreferenced_vertices) as i64 - report.edges as i64 + good;
    if report.is_closed() && report.is_manifold() && report.is_oriented() {
        report.volume = Some(volume6 / 6.0);
    }
    Ok(())
}

fn widen(bounds: Option<[[f32; 3]; 2]>, p: [f32; 3]) -> [[f32; 3]; 2] {
    let [lo, hi] = bounds.unwrap_or([p; 2]);
    // A zero has no sign: which of two zeros is the lesser one differs from machine to machine.
    [std::array::from_fn(|k| lo[k].min(p[k]) + 0.0), std::array::from_fn(|k| hi[k].max(p[k]) + 0.0)]
}

/// Arcs (v, n, p) in the order of v, the next one seen beforehand.
struct Arcs {
    sorted: Sorted<[u32; 3]>,
    next: Option<[u32; 3]>,
}

impl Arcs {
    fn new(mut sorted: Sorted<[u32; 3]>) -> Result<Self> {
        let next = sorted.next()?;
        Ok(Self { sorted, next })
    }

    /// The next arc n → p of the link of `v`.
    fn of(&mut self, v: u32) -> Result<Option<[u32; 2]>> {
        let Some([_, n, p]) = self.next.filter(|arc| arc[0] == v) else { return Ok(None) };
        self.next = self.sorted.next()?;
        Ok(Some([n, p]))
    }
}

/// An edge from the vertex that is examined.
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
    fn gather(&mut self, arcs: &mut Arcs, v: u32, shares: &Shares<'_>) -> Result<()> {
        self.arcs.clear();
        while let Some(arc) = arcs.of(v)? {
            self.arcs.push(arc);
            if self.arcs.len() as u64 > shares.fan {
                let mut triangles = self.arcs.len() as u64;
                while arcs.of(v)?.is_some() {
                    triangles += 1;
                }
                return Err(shares.fan_too_large(triangles));
            }
        }
        self.ends.clear();
        self.ends.extend(self.arcs.iter().flat_map(|&[n, p]| [(n, false), (p, true)]));
        self.ends.sort_unstable();
        Ok(())
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

    /// Triangles that repeat another of this vertex, which is the smallest of their three. Spoils
    /// the arcs' order.
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
struct VertexPieces {
    /// The parent of each vertex; [`ALONE`] as long as it has no edge.
    parents: Vec<u32>,
}

/// There are fewer vertices than this.
const ALONE: u32 = u32::MAX;

impl VertexPieces {
    fn new(vertices: usize) -> Self {
        Self { parents: vec![ALONE; vertices] }
    }

    fn clear(&mut self) {
        self.parents.fill(ALONE);
    }

    fn root_of(&mut self, v: u32) -> u32 {
        if self.parents[v as usize] == ALONE {
            self.parents[v as usize] = v;
        }
        root(&mut self.parents, v)
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root_of(a), self.root_of(b));
        // The smaller number becomes the root: with path halving that is fast enough, and needs no
        // ranks.
        self.parents[a.max(b) as usize] = a.min(b);
    }

    fn count(&self) -> u64 {
        self.parents.iter().enumerate().filter(|&(i, &p)| i as u32 == p).count() as u64
    }
}

#[cfg(test)]
mod tests;
