//! Cutting a surface at planes.
//!
//! What lies in all half-spaces stays; a triangle across a plane is cut, and its pieces become a
//! fan of triangles:
//!
//! ```text
//!        a                            A vertex is kept, or cut off. A cut edge has one new vertex, found by the
//!       / \       plane               numbers of its two ends, so both triangles beside the edge use the same.
//!   ───x───y───────────               Planes are taken one after another: an end may be a new vertex of an earlier
//!     / ╲ · \                         plane. A vertex within the precision of f32 of a plane counts as on it, and
//!    b───────c                        is used as it is: no triangle is thinner than can be distinguished.
//! ```
//!
//! # Guarantees
//! A cut manifold is a manifold: each edge keeps its two triangles, or lies on a plane and has one.
//! (A vertex that lies exactly on a plane, where the surface touches itself, is an exception that
//! rounding can make.) The order of what stays is kept: vertices, then new ones by first use; whole
//! triangles, then pieces. So the bytes are a function of the surface and the planes.
//!
//! # Cost
//! Five passes over the surface; 5 bytes of memory a vertex, 100 a triangle across a plane. The new
//! vertices' normals are those of the ends, interpolated.
//!
//! Reference: Sutherland, Hodgman 1974, "Reentrant polygon clipping".

use crate::surface::model::{SurfaceSource, Vertex};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use isospan_io::error::{Error, Result};
use rustc_hash::FxHashMap;

/// The points p with `normal · p >= offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    normal: [f64; 3],
    offset: f64,
    /// The error that `normal · p` of a position in `f32` may have.
    tolerance: f64,
}

impl HalfSpace {
    /// A half-space for positions of at most `scale` along each axis, as they are stored.
    pub fn new(normal: [f64; 3], offset: f64, scale: [f64; 3]) -> Self {
        let size: f64 = (0..3).map(|a| normal[a].abs() * scale[a]).sum();
        Self { normal, offset, tolerance: size * f64::from(f32::EPSILON) * 4.0 }
    }

    /// Across its plane, into it; of any length.
    pub(super) fn normal(&self) -> [f64; 3] {
        self.normal
    }

    /// `normal · p - offset`; zero within the precision of `f32`.
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        let d = (0..3).map(|a| self.normal[a] * p[a]).sum::<f64>() - self.offset;
        if d.abs() <= self.tolerance { 0.0 } else { d }
    }
}

/// Cuts a surface; at most 7 half-spaces. `memory` bounds what is held besides the result;
/// `settings` says where the result is stored.
///
/// # Errors
/// [`Error::Budget`] when the memory does not suffice; those of reading the source and of the
/// scratch file.
pub fn clip(
    source: &dyn SurfaceSource,
    half_spaces: &[HalfSpace],
    settings: &BuilderSettings,
    memory: u64,
) -> Result<StoredSurface> {
    assert!(half_spaces.len() <= 7, "a bit for each half-space");
    let needed = source.vertex_count() * 5;
    if needed > memory {
        return Err(too_little(needed, memory));
    }
    let mut codes = outcodes(source, half_spaces)?;
    let crossing = crossing_triangles(source, &mut codes, memory - needed)?;
    let mut cutter = Cutter::new(source, half_spaces, &crossing)?;
    let pieces = cutter.cut(&crossing);
    for v in pieces.iter().flatten().filter(|&&v| v < FIRST_CUT) {
        codes[*v as usize] |= USED;
    }
    cutter.collect(source, &codes, &pieces, settings)
}

fn too_little(needed: u64, available: u64) -> Error {
    Error::memory("to cut a surface", needed, available)
}

/// A vertex that stays.
const USED: u8 = 0x80;
/// Cut vertices are numbered from here.
const FIRST_CUT: u64 = 1 << 32;

/// For each vertex, a bit for each half-space outside which it is.
fn outcodes(source: &dyn SurfaceSource, half_spaces: &[HalfSpace]) -> Result<Vec<u8>> {
    let (mut codes, origin) = (Vec::with_capacity(source.vertex_count() as usize), source.origin());
    source.vertices(&mut |batch| {
        codes.extend(batch.iter().map(|v| {
            let p = v.world(origin);
            half_spaces.iter().enumerate().fold(0, |code, (i, h)| code | u8::from(h.distance(p) < 0.0) << i)
        }));
        Ok(())
    })?;
    Ok(codes)
}

/// Whether a triangle is inside, or outside one half-space as a whole, or neither.
fn side(codes: [u8; 3]) -> Side {
    let [a, b, c] = codes.map(|code| code & !USED);
    match (a | b | c, a & b & c) {
        (0, _) => Side::Inside,
        (_, 0) => Side::Across,
        _ => Side::Outside,
    }
}

#[derive(PartialEq)]
enum Side {
    Inside,
    Outside,
    Across,
}

/// The triangles across a plane; marks the vertices of those inside.
fn crossing_triangles(source: &dyn SurfaceSource, codes: &mut [u8], memory: u64) -> Result<Vec<[u32; 3]>> {
    const BYTES: u64 = 100;
    let mut crossing = vec![];
    source.triangles(&mut |batch| {
        for &t in batch {
            match side(t.map(|v| codes[v as usize])) {
                Side::Inside => t.iter().for_each(|&v| codes[v as usize] |= USED),
                Side::Across => crossing.push(t),
                Side::Outside => {}
            }
        }
        let needed = crossing.len() as u64 * BYTES;
        if needed > memory { Err(too_little(needed, memory)) } else { Ok(()) }
    })?;
    Ok(crossing)
}

/// Cuts triangles, one after another.
struct Cutter<'a> {
    half_spaces: &'a [HalfSpace],
    /// What positions are counted from.
    origin: [f64; 3],
    /// The vertices of all triangles across, by number.
    rim: Vec<(u32, Vertex)>,
    /// New vertices, numbered from [`FIRST_CUT`].
    cuts: Vec<Vertex>,
    by_ends: FxHashMap<(u64, u64), u64>,
}

impl<'a> Cutter<'a> {
    fn new(source: &dyn SurfaceSource, half_spaces: &'a [HalfSpace], crossing: &[[u32; 3]]) -> Result<Self> {
        let mut numbers: Vec<u32> = crossing.iter().flatten().copied().collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut rim = Vec::with_capacity(numbers.len());
        let (mut first, mut wanted) = (0u64, numbers.into_iter().peekable());
        source.vertices(&mut |batch| {
            let end = first + batch.len() as u64;
            while let Some(v) = wanted.next_if(|&v| u64::from(v) < end) {
                rim.push((v, batch[(u64::from(v) - first) as usize]));
            }
            first = end;
            Ok(())
        })?;
        Ok(Self { half_spaces, origin: source.origin(), rim, cuts: vec![], by_ends: FxHashMap::default() })
    }

    fn vertex(&self, number: u64) -> Vertex {
        if number >= FIRST_CUT {
            return self.cuts[(number - FIRST_CUT) as usize];
        }
        let at = self.rim.binary_search_by_key(&(number as u32), |r| r.0);
        self.rim[at.expect("all vertices of the triangles were gathered")].1
    }

    /// The pieces of triangles, in order.
    fn cut(&mut self, triangles: &[[u32; 3]]) -> Vec<[u64; 3]> {
        let mut pieces = vec![];
        let (mut polygon, mut next) = (vec![], vec![]);
        for t in triangles {
            polygon.clear();
            polygon.extend(t.map(u64::from));
            for half_space in self.half_spaces {
                self.cut_polygon(&polygon, half_space, &mut next);
                std::mem::swap(&mut polygon, &mut next);
                // An edge or a corner on the plane is all that is left.
                if polygon.len() < 3 {
                    polygon.clear();
                    break;
                }
            }
            if !polygon.is_empty() {
                pieces.extend(polygon[1..].windows(2).map(|edge| [polygon[0], edge[0], edge[1]]));
            }
        }
        pieces
    }

    fn cut_polygon(&mut self, polygon: &[u64], half_space: &HalfSpace, out: &mut Vec<u64>) {
        out.clear();
        for (i, &p) in polygon.iter().enumerate() {
            let q = polygon[(i + 1) % polygon.len()];
            let [dp, dq] = [p, q].map(|number| half_space.distance(self.vertex(number).world(self.origin)));
            if dp >= 0.0 {
                out.push(p);
            }
            if (dp > 0.0 && dq < 0.0) || (dp < 0.0 && dq > 0.0) {
                // From the lower number to the higher, so that both triangles at the edge agree.
                out.push(if p < q { self.between(p, q, dp, dq) } else { self.between(q, p, dq, dp) });
            }
        }
    }

    /// The vertex where the edge (p, q) crosses the plane, at which the distance goes from `dp` to
    /// `dq`.
    fn between(&mut self, p: u64, q: u64, dp: f64, dq: f64) -> u64 {
        if let Some(&known) = self.by_ends.get(&(p, q)) {
            return known;
        }
        let (a, b, t) = (self.vertex(p), self.vertex(q), dp / (dp - dq));
        let mix = |a: [f32; 3], b: [f32; 3]| -> [f64; 3] {
            std::array::from_fn(|k| f64::from(a[k]) + t * (f64::from(b[k]) - f64::from(a[k])))
        };
        let normal = mix(a.normal, b.normal);
        let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
        // Opposite normals leave none: then that of an end is as good.
        let normal = if length > 1e-6 { normal.map(|x| (x / length) as f32) } else { a.normal };
        let number = FIRST_CUT + self.cuts.len() as u64;
        self.cuts.push(Vertex { position: mix(a.position, b.position).map(|x| x as f32), normal });
        self.by_ends.insert((p, q), number);
        number
    }

    /// The surface of what stays.
    fn collect(
        &self,
        source: &dyn SurfaceSource,
        codes: &[u8],
        pieces: &[[u64; 3]],
        settings: &BuilderSettings,
    ) -> Result<StoredSurface> {
        let mut out = StoredSurface::like(source, settings);
        let mut numbers = vec![u32::MAX; codes.len()];
        let mut at = 0;
        source.vertices(&mut |batch| {
            for vertex in batch {
                if codes[at] & USED != 0 {
                    numbers[at] = out.vertex_count() as u32;
                    out.push_vertex(*vertex)?;
                }
                at += 1;
            }
            Ok(())
        })?;
        source.triangles(&mut |batch| {
            let inside = |t: &&[u32; 3]| side(t.map(|v| codes[v as usize])) == Side::Inside;
            let moved = |t: &[u32; 3]| t.map(|v| numbers[v as usize]);
            batch.iter().filter(inside).try_for_each(|t| out.push_triangle(moved(t)))
        })?;
        let mut cut_numbers = vec![u32::MAX; self.cuts.len()];
        for piece in pieces {
            let mut triangle = [0; 3];
            for (to, &v) in triangle.iter_mut().zip(piece) {
                *to = match v.checked_sub(FIRST_CUT) {
                    None => numbers[v as usize],
                    Some(cut) => {
                        let number = &mut cut_numbers[cut as usize];
                        if *number == u32::MAX {
                            *number = out.vertex_count() as u32;
                            out.push_vertex(self.cuts[cut as usize])?;
                        }
                        *number
                    }
                };
            }
            out.push_triangle(triangle)?;
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::TriMesh;
    use crate::surface::check::{boundary_edges, check};

    /// A sphere of radius 1: an octahedron whose triangles were cut in four, several times.
    fn sphere(times: u32) -> TriMesh {
        let mut mesh = TriMesh::default();
        let unit = |p: [f32; 3]| {
            let length = p.iter().map(|x| x * x).sum::<f32>().sqrt();
            p.map(|x| x / length)
        };
        let mut points: Vec<[f32; 3]> = [0, 1, 2]
            .iter()
            .flat_map(|&a| [1.0, -1.0].map(|s| std::array::from_fn(|b| if a == b { s } else { 0.0 })))
            .collect();
        let mut triangles: Vec<[u32; 3]> =
            vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        for _ in 0..times {
            let mut middles: FxHashMap<(u32, u32), u32> = FxHashMap::default();
            let mut finer = vec![];
            for [a, b, c] in triangles {
                let mut middle = |a: u32, b: u32| {
                    *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                        let (p, q) = (points[a as usize], points[b as usize]);
                        points.push(unit(std::array::from_fn(|k| p[k] + q[k])));
                        points.len() as u32 - 1
                    })
                };
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
            }
            triangles = finer;
        }
        mesh.vertices = points.iter().map(|&p| Vertex { position: p, normal: p }).collect();
        mesh.triangles = triangles;
        mesh
    }

    fn cut(mesh: &TriMesh, half_spaces: &[HalfSpace]) -> TriMesh {
        let out = clip(mesh, half_spaces, &BuilderSettings::default(), 1 << 20).unwrap();
        TriMesh::from_source(&out).unwrap()
    }

    fn at(normal: [f64; 3], offset: f64) -> HalfSpace {
        HalfSpace::new(normal, offset, [1.0; 3])
    }

    #[test]
    fn a_cut_sphere_is_a_cap_whose_rim_is_on_the_plane() {
        let mesh = sphere(5);
        for offset in [-0.7, 0.0, 0.1234, 0.5] {
            let cap = cut(&mesh, &[at([0.0, 0.0, 1.0], offset)]);
            let report = check(&cap);
            assert!(
                report.is_manifold() && report.is_oriented() && report.zero_area_triangles == 0,
                "{report:?}"
            );
            assert_eq!((report.euler, report.boundary_loops, report.unreferenced_vertices), (1, 1, 0));
            let wanted = 2.0 * std::f64::consts::PI * (1.0 - offset);
            assert!((report.area / wanted - 1.0).abs() < 0.01, "{} of {wanted}", report.area);
            assert!(
                boundary_edges(&cap).iter().flatten().all(|&v| (f64::from(
                    cap.vertices[v as usize].position[2]
                ) - offset)
                    .abs()
                    < 1e-6)
            );
            assert!(cap.vertices.iter().all(|v| v.normal.iter().map(|x| x * x).sum::<f32>() > 0.99));
        }
    }

    #[test]
    fn the_eight_parts_of_a_sphere_add_up() {
        let mesh = sphere(4);
        let mut area = 0.0;
        for part in 0..8 {
            let half_spaces: Vec<HalfSpace> = (0..3)
                .map(|a| {
                    let sign = if part >> a & 1 == 0 { 1.0 } else { -1.0 };
                    let normal = std::array::from_fn(|b| if a == b { sign } else { 0.01 * sign });
                    at(normal, sign * 0.13)
                })
                .collect();
            let piece = cut(&mesh, &half_spaces);
            let report = check(&piece);
            assert!(report.is_manifold() && report.is_oriented() && report.components == 1, "{report:?}");
            area += report.area;
        }
        assert!((area / check(&mesh).area - 1.0).abs() < 1e-6, "{area}");
    }

    #[test]
    fn nothing_and_everything() {
        let mesh = sphere(2);
        assert_eq!(cut(&mesh, &[at([1.0, 0.0, 0.0], 2.0)]), TriMesh::default());
        assert_eq!(cut(&mesh, &[at([1.0, 0.0, 0.0], -2.0)]), mesh);
        assert_eq!(cut(&mesh, &[]), mesh);
        let error = clip(&mesh, &[], &BuilderSettings::default(), 100).unwrap_err();
        assert_eq!(error.exit_code(), 4);
    }
}
