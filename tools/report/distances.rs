//! How far are two surfaces from each other?
//!
//! From the vertices and the middle of every triangle of one surface, the nearest point of the other, exactly; and back. The largest of
//! these distances is the Hausdorff distance, up to what lies between the samples; root mean squares are weighted by area. The
//! deviation of normals is the angle between a triangle and the nearest one of the other surface at its middle.
//!
//! Triangles lie in a grid of cells; a query looks at cells in rings around its own, until the best distance is less than that of the next
//! ring.

use isospan::Result;
use isospan::surface::TriMesh;
use rayon::prelude::*;

type Vec3 = [f64; 3];

/// Both ways together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Distances {
    /// The larger of the two largest distances.
    pub(crate) hausdorff: f64,
    /// Root mean square.
    pub(crate) rms: f64,
    /// Root mean square angle between normals, in degrees.
    pub(crate) normal: f64,
}

impl Distances {
    /// The same, lengths in units of `length`.
    pub(crate) fn in_units_of(self, length: f64) -> Self {
        Self { hausdorff: self.hausdorff / length, rms: self.rms / length, ..self }
    }
}

fn sub(a: Vec3, b: Vec3) -> Vec3 {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn along(a: Vec3, b: Vec3, t: f64) -> Vec3 {
    std::array::from_fn(|k| a[k] + t * b[k])
}

/// Twice the area times the unit normal.
fn normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    let (u, v) = (sub(b, a), sub(c, a));
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// Squared distance of a point from a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
fn squared_distance(p: Vec3, [a, b, c]: [Vec3; 3]) -> f64 {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let from = |q: Vec3| dot(sub(p, q), sub(p, q));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return from(a);
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return from(b);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return from(along(a, ab, d1 / (d1 - d3)));
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return from(c);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return from(along(a, ac, d2 / (d2 - d6)));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return from(along(b, sub(c, b), (d4 - d3) / ((d4 - d3) + (d5 - d6))));
    }
    let scale = 1.0 / (va + vb + vc);
    from(along(along(a, ab, vb * scale), ac, vc * scale))
}

/// Triangles in a grid.
struct Grid {
    vertices: Vec<Vec3>,
    triangles: Vec<[Vec3; 3]>,
    lo: Vec3,
    edge: f64,
    dims: [i64; 3],
    /// Where each cell's triangles begin, x fastest.
    starts: Vec<u32>,
    numbers: Vec<u32>,
}

impl Grid {
    fn new(mesh: &TriMesh) -> Self {
        let vertices: Vec<Vec3> = mesh.vertices.iter().map(|v| v.position.map(f64::from)).collect();
        let corner = |v: u32| vertices[v as usize];
        let triangles: Vec<[Vec3; 3]> = mesh.triangles.iter().map(|t| t.map(corner)).collect();
        let all = || triangles.iter().flatten();
        let lo: Vec3 = std::array::from_fn(|k| all().map(|p| p[k]).fold(f64::INFINITY, f64::min));
        let hi: Vec3 = std::array::from_fn(|k| all().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max));
        let area: f64 = triangles.iter().map(|&t| 0.5 * dot(normal(t), normal(t)).sqrt()).sum();
        let longest = (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max);
        // Cells about as large as four triangles, and at most 256 along an axis.
        let edge = (4.0 * area / triangles.len() as f64).sqrt().max(longest / 256.0).max(f64::MIN_POSITIVE);
        let dims = std::array::from_fn(|k| ((hi[k] - lo[k]) / edge) as i64 + 1);
        let mut grid = Self { vertices, triangles, lo, edge, dims, starts: vec![], numbers: vec![] };
        grid.fill();
        grid
    }

    fn cell_of(&self, p: Vec3) -> [i64; 3] {
        std::array::from_fn(|k| ((p[k] - self.lo[k]) / self.edge).floor() as i64)
    }

    fn place(&self, [x, y, z]: [i64; 3]) -> usize {
        ((z * self.dims[1] + y) * self.dims[0] + x) as usize
    }

    /// A counting sort of triangles by the cells that their bounding boxes meet.
    fn fill(&mut self) {
        let mut entries: Vec<(u32, u32)> = vec![];
        for (n, t) in self.triangles.iter().enumerate() {
            let [lo, hi] = [f64::min as fn(f64, f64) -> f64, f64::max]
                .map(|pick| self.cell_of(std::array::from_fn(|k| pick(pick(t[0][k], t[1][k]), t[2][k]))));
            for z in lo[2]..=hi[2] {
                for y in lo[1]..=hi[1] {
                    entries.extend((lo[0]..=hi[0]).map(|x| (self.place([x, y, z]) as u32, n as u32)));
                }
            }
        }
        entries.sort_unstable();
        let cells: i64 = self.dims.iter().product();
        self.starts = vec![0; cells as usize + 1];
        entries.iter().for_each(|e| self.starts[e.0 as usize + 1] += 1);
        (0..cells as usize).for_each(|c| self.starts[c + 1] += self.starts[c]);
        self.numbers = entries.into_iter().map(|e| e.1).collect();
    }

    /// Squared distance and number of the nearest triangle.
    fn nearest(&self, p: Vec3) -> (f64, u32) {
        let own = self.cell_of(p);
        // From the point to the nearest side of its own cell.
        let inside: Vec3 = std::array::from_fn(|k| p[k] - self.lo[k] - own[k] as f64 * self.edge);
        let margin = inside.iter().map(|x| x.min(self.edge - x).max(0.0)).fold(f64::INFINITY, f64::min);
        let mut best = (f64::INFINITY, u32::MAX);
        for ring in 0i64.. {
            let reach = margin + self.edge * (ring - 1) as f64;
            if ring > 0 && best.1 != u32::MAX && best.0 <= reach * reach {
                break;
            }
            for z in (own[2] - ring).max(0)..=(own[2] + ring).min(self.dims[2] - 1) {
                for y in (own[1] - ring).max(0)..=(own[1] + ring).min(self.dims[1] - 1) {
                    let inner = (z - own[2]).abs() < ring && (y - own[1]).abs() < ring;
                    let step = if inner { 2 * ring } else { 1 };
                    for x in (own[0] - ring..=own[0] + ring).step_by(step as usize) {
                        if (0..self.dims[0]).contains(&x) {
                            self.look([x, y, z], p, &mut best);
                        }
                    }
                }
            }
        }
        best
    }

    fn look(&self, cell: [i64; 3], p: Vec3, best: &mut (f64, u32)) {
        let cell = self.place(cell);
        for &n in &self.numbers[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
            let d = squared_distance(p, self.triangles[n as usize]);
            if (d, n) < *best {
                *best = (d, n);
            }
        }
    }

    /// Sums over the triangles of `self` as seen from `other`.
    fn one_way(&self, other: &Self) -> Sums {
        let of = |t: &[Vec3; 3]| {
            let [a, b, c] = *t;
            let n = normal(*t);
            let length = dot(n, n).sqrt();
            let middle: Vec3 = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0);
            let (d, nearest) = other.nearest(middle);
            let m = normal(other.triangles[nearest as usize]);
            let cosine = (dot(n, m) / (length * dot(m, m).sqrt())).clamp(-1.0, 1.0);
            // A triangle that rounding has flattened has no direction, and no area.
            let angle = if cosine.is_nan() { 0.0 } else { libm::acos(cosine).to_degrees() };
            Sums { most: d, squares: d * length, angles: angle * angle * length, area: length }
        };
        let all: Vec<Sums> = self.triangles.par_iter().map(of).collect();
        let sums = all.into_iter().fold(Sums::default(), Sums::and);
        let corners: Vec<f64> = self.vertices.par_iter().map(|&p| other.nearest(p).0).collect();
        Sums { most: corners.into_iter().fold(sums.most, f64::max), ..sums }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    most: f64,
    squares: f64,
    angles: f64,
    area: f64,
}

impl Sums {
    fn and(self, o: Self) -> Self {
        Self {
            most: self.most.max(o.most),
            squares: self.squares + o.squares,
            angles: self.angles + o.angles,
            area: self.area + o.area,
        }
    }
}

/// Distances between two surfaces; infinite if one is empty.
pub(crate) fn compare(a: &TriMesh, b: &TriMesh) -> Result<Distances> {
    if a.triangles.is_empty() || b.triangles.is_empty() {
        return Ok(Distances { hausdorff: f64::INFINITY, rms: f64::INFINITY, normal: f64::NAN });
    }
    let (a, b) = (Grid::new(a), Grid::new(b));
    let sums = a.one_way(&b).and(b.one_way(&a));
    Ok(Distances {
        hausdorff: sums.most.sqrt(),
        rms: (sums.squares / sums.area).sqrt(),
        normal: (sums.angles / sums.area).sqrt(),
    })
}

/// RMS angle between triangles that share an edge, weighted by its length, in degrees: how smooth a surface looks.
pub(crate) fn roughness(mesh: &TriMesh) -> f64 {
    let at = |v: u32| mesh.vertices[v as usize].position.map(f64::from);
    let normals: Vec<Vec3> = mesh.triangles.iter().map(|t| normal(t.map(at))).collect();
    let mut sides: Vec<([u32; 2], usize)> = vec![];
    for (n, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        sides.extend([[a, b], [b, c], [c, a]].map(|[a, b]| ([a.min(b), a.max(b)], n)));
    }
    sides.sort_unstable();
    let (mut squares, mut lengths) = (0.0, 0.0);
    for pair in sides.windows(2).filter(|p| p[0].0 == p[1].0) {
        let [m, n] = [0, 1].map(|i| normals[pair[i].1]);
        let along = sub(at(pair[0].0[0]), at(pair[0].0[1]));
        let length = dot(along, along).sqrt();
        let cosine = (dot(m, n) / (dot(m, m) * dot(n, n)).sqrt()).clamp(-1.0, 1.0);
        if !cosine.is_nan() {
            let angle = libm::acos(cosine).to_degrees();
            squares += angle * angle * length;
            lengths += length;
        }
    }
    if lengths > 0.0 { (squares / lengths).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::surface::Vertex;

    /// A square in the plane z, in 2·n² triangles.
    fn square(z: f32, n: u32) -> TriMesh {
        let vertex = |i: u32| Vertex {
            position: [(i % (n + 1)) as f32 / n as f32, (i / (n + 1)) as f32 / n as f32, z],
            normal: [0.0; 3],
        };
        let at = |x: u32, y: u32| y * (n + 1) + x;
        let cells = (0..n * n).map(|c| (c % n, c / n));
        let triangles = cells.flat_map(|(x, y)| {
            let (a, b, c, d) = (at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1));
            [[a, b, c], [a, c, d]]
        });
        TriMesh { vertices: (0..(n + 1) * (n + 1)).map(vertex).collect(), triangles: triangles.collect() }
    }

    #[test]
    fn parallel_squares() {
        let found = compare(&square(0.0, 13), &square(0.25, 4)).unwrap();
        assert_eq!((found.hausdorff, found.rms), (0.25, 0.25));
        assert!(found.normal < 1e-5);
        let far = compare(&square(0.0, 3), &square(40.0, 30)).unwrap();
        assert!(far.hausdorff == 40.0 && (far.rms - 40.0).abs() < 1e-12 * 40.0, "{}", far.rms);
    }

    #[test]
    fn a_fold_has_its_angle() {
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 1.0]];
        let vertices = vertices.map(|position| Vertex { position, normal: [0.0; 3] }).to_vec();
        let fold = TriMesh { vertices, triangles: vec![[0, 1, 2], [1, 0, 3]] };
        assert!((roughness(&fold) - 45.0).abs() < 1e-9, "{}", roughness(&fold));
        assert_eq!(roughness(&square(0.0, 5)), 0.0);
    }

    #[test]
    fn the_nearest_is_the_nearest() {
        let mut mesh = square(0.0, 9);
        for (i, v) in mesh.vertices.iter_mut().enumerate() {
            v.position[2] = (i * 37 % 11) as f32 / 20.0;
        }
        let grid = Grid::new(&mesh);
        for i in 0..200 {
            let p = [7, 11, 13].map(|m| f64::from(i * 37 % (m * 9)) / f64::from(m * 4) - 0.5);
            let all = grid.triangles.iter().map(|&t| squared_distance(p, t));
            assert_eq!(grid.nearest(p).0, all.fold(f64::INFINITY, f64::min));
        }
    }
}
