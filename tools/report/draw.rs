//! A surface as a picture: orthographic, flat triangles, a z-buffer, three lights.
//!
//! Flat triangles show how smooth a surface is, which normals from the field's gradient would hide. The far side of an open surface is
//! drawn in another colour. Drawn three times as large and averaged.

use crate::plots::shrink;
use isospan::surface::TriMesh;

type Vec3 = [f64; 3];

const LARGER: u32 = 3;
/// sRGB of the near side, and of the far side of open surfaces.
const NEAR: Vec3 = [226.0, 203.0, 160.0];
const FAR: Vec3 = [150.0, 166.0, 190.0];
/// Directions to the lights in the viewer's frame (right, up, towards), and how strong they are.
const LIGHTS: [(Vec3, f64); 3] =
    [([-0.5, 0.62, 0.6], 0.72), ([0.74, 0.1, 0.66], 0.26), ([0.0, 0.95, -0.3], 0.12)];
const AMBIENT: f64 = 0.2;

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Where surfaces are seen from: the same for all panels of a data set.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// Right, up, towards the viewer.
    axes: [Vec3; 3],
    /// What is in the middle, along these axes.
    middle: [f64; 2],
    /// Pixels a unit.
    scale: f64,
    side: u32,
}

impl View {
    /// A view from an azimuth about the z axis and an elevation, in degrees, in which a surface fills a square of `side` pixels.
    pub(crate) fn fit(surface: &TriMesh, azimuth: f64, elevation: f64, side: u32) -> Self {
        let (a, e) = (azimuth.to_radians(), elevation.to_radians());
        let towards = [a.cos() * e.cos(), a.sin() * e.cos(), e.sin()];
        let right = [-a.sin(), a.cos(), 0.0];
        let up = [-a.cos() * e.sin(), -a.sin() * e.sin(), e.cos()];
        let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for v in &surface.vertices {
            let p = v.position.map(f64::from);
            for (k, x) in [dot(p, right), dot(p, up)].into_iter().enumerate() {
                (lo[k], hi[k]) = (lo[k].min(x), hi[k].max(x));
            }
        }
        let middle = [0, 1].map(|k| (lo[k] + hi[k]) / 2.0);
        let widest = (hi[0] - lo[0]).max(hi[1] - lo[1]).max(f64::MIN_POSITIVE);
        Self { axes: [right, up, towards], middle, scale: 0.9 * f64::from(side * LARGER) / widest, side }
    }

    /// Red, green, blue of each pixel.
    pub(crate) fn draw(&self, surface: &TriMesh) -> Vec<u8> {
        let side = self.side * LARGER;
        let half = f64::from(side) / 2.0;
        let place = |p: [f32; 3]| -> Vec3 {
            let p = p.map(f64::from);
            let [x, y, z] = self.axes.map(|a| dot(p, a));
            [
                half + self.scale * (x - self.middle[0]),
                half - self.scale * (y - self.middle[1]),
                self.scale * z,
            ]
        };
        let placed: Vec<Vec3> = surface.vertices.iter().map(|v| place(v.position)).collect();
        let mut pixels = vec![255u8; (side * side * 3) as usize];
        let mut depths = vec![f64::NEG_INFINITY; (side * side) as usize];
        for t in &surface.triangles {
            fill(t.map(|v| placed[v as usize]), side as usize, &mut depths, &mut pixels);
        }
        shrink(&pixels, (side, side), LARGER)
    }
}

/// Draws a triangle where it is nearer than what is there.
fn fill([a, b, c]: [Vec3; 3], side: usize, depths: &mut [f64], pixels: &mut [u8]) {
    let double = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    if double == 0.0 {
        return;
    }
    let colour = colour_of([a, b, c]);
    let range = |k: usize| {
        let (lo, hi) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
        (lo - 0.5).ceil().max(0.0) as usize..(hi + 0.5).floor().clamp(0.0, side as f64) as usize
    };
    for y in range(1) {
        for x in range(0) {
            let p = [x as f64 + 0.5, y as f64 + 0.5];
            let part =
                |u: Vec3, v: Vec3| ((u[0] - p[0]) * (v[1] - p[1]) - (v[0] - p[0]) * (u[1] - p[1])) / double;
            let [wa, wb, wc] = [part(b, c), part(c, a), part(a, b)];
            let depth = wa * a[2] + wb * b[2] + wc * c[2];
            let at = y * side + x;
            if wa >= 0.0 && wb >= 0.0 && wc >= 0.0 && depth > depths[at] {
                depths[at] = depth;
                pixels[3 * at..3 * at + 3].copy_from_slice(&colour);
            }
        }
    }
}

fn colour_of([a, b, c]: [Vec3; 3]) -> [u8; 3] {
    let (u, v): (Vec3, Vec3) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
    // Rows of the picture go down; the outside is on the side from which a triangle runs counter-clockwise.
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let n = [-n[0], n[1], -n[2]];
    let length = dot(n, n).sqrt();
    let outside = n[2] >= 0.0;
    let n = n.map(|x| if outside { x } else { -x } / length);
    let light: f64 =
        LIGHTS.iter().map(|(to, strength)| strength * (dot(n, *to) / dot(*to, *to).sqrt()).max(0.0)).sum();
    let base = if outside { NEAR } else { FAR };
    base.map(|x| (x * (AMBIENT + light)).min(255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::surface::Vertex;

    #[test]
    fn the_near_triangle_is_seen_from_its_side() {
        let vertex = |position: [f32; 3]| Vertex { position, normal: [0.0; 3] };
        // Seen from x: y is to the right, z up. A large triangle whose outside is towards the viewer, a small one behind it.
        let corners = [
            [1.0, -1.0, -1.0],
            [1.0, 1.0, -1.0],
            [1.0, 0.0, 1.0],
            [0.0, -0.1, -0.1],
            [0.0, 0.1, -0.1],
            [0.0, 0.0, 0.1],
        ];
        let mut mesh =
            TriMesh { vertices: corners.map(vertex).to_vec(), triangles: vec![[0, 1, 2], [3, 5, 4]] };
        let view = View::fit(&mesh, 0.0, 0.0, 32);
        let middle = |mesh: &TriMesh| {
            let picture = view.draw(mesh);
            let at = 3 * (16 * 32 + 16);
            [picture[at], picture[at + 1], picture[at + 2]]
        };
        let near = middle(&mesh);
        assert!(near[0] > near[2], "{near:?}: the near side");
        assert_eq!(view.draw(&mesh)[..3], [255; 3]);
        mesh.triangles.swap_remove(0);
        let far = middle(&mesh);
        assert!(far[2] > far[0], "{far:?}: the far side of the other");
    }
}
