//! How much of a cell lies inside: the volume that its piece of the surface bounds.
//!
//! By the theorem of Gauss, three times the volume is the integral of the position along normals
//! over all that bounds it. Faces of the cell at 0 add nothing, so the piece of the surface counts,
//! and the parts inside of the three faces at 1: these are the caps.

use super::cases::{CAPS, CASES, FACES, lower_corner};
use crate::surface::world_map::WorldMap;
use isospan_io::geom::vec3::{cross, dot};

/// The part of a cell that marching cubes has inside, 0 to 1: `values` are those of its corners
/// less the isovalue, x fastest. Vertices are where surfaces of `world` have them.
pub fn share_inside(values: &[f64; 8], world: &WorldMap) -> f64 {
    let mask = (0..8).fold(0usize, |mask, c| mask | usize::from(values[c] >= 0.0) << c);
    if mask == 0 || mask == 255 {
        return f64::from(u8::from(mask == 255));
    }
    let corner = |c: u8| std::array::from_fn(|k| f64::from(c >> k & 1));
    let crossing = |edge: u8| {
        let (axis, low) = (usize::from(edge / 4), lower_corner(edge));
        let (a, b) = (values[usize::from(low)], values[usize::from(low) + (1 << axis)]);
        let mut place: [f64; 3] = corner(low);
        place[axis] = world.part_of_edge(-a / (b - a));
        place
    };
    let twice = |[a, b, c]: [[f64; 3]; 3]| dot(a, cross(b, c));
    let case = &CASES[mask];
    let pieces = case.corners[..usize::from(case.triangles)].iter();
    let mut six: f64 = pieces.map(|triangle| twice(triangle.map(crossing))).sum();
    for face in [1, 3, 5].map(|n| &FACES[n]) {
        let square = (0..4).fold(0, |square, i| square | (mask >> face.corners[i] & 1) << i);
        let cap = &CAPS[square];
        for triangle in &cap.corners[..usize::from(cap.triangles)] {
            six += twice(triangle.map(|at| match usize::from(at) {
                at @ 0..4 => corner(face.corners[at]),
                at => crossing(face.edges[at - 4]),
            }));
        }
    }
    six / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::extract::ChunkSurface;
    use crate::surface::extract::marching_cubes::{CubeBench, GridBlock, marching_cubes};
    use isospan_io::grid::Geometry;

    /// What a surface and its caps enclose.
    fn enclosed(values: &[f32; 8], world: &WorldMap) -> f64 {
        let (mut bench, mut out) = (CubeBench::default(), ChunkSurface::default());
        let block = GridBlock {
            grid: [2; 3],
            stride: [1; 3],
            start: [0; 3],
            size: [2; 3],
            values,
            cells: [[0, 1]; 3],
        };
        marching_cubes(&block, 0.0, true, world, &mut bench, &mut out);
        let at = |v: u32| out.vertices()[v as usize].position.map(f64::from);
        let six = |t: &[u32; 3]| dot(at(t[0]), cross(at(t[1]), at(t[2])));
        out.triangles().iter().map(six).sum::<f64>() / 6.0
    }

    #[test]
    fn all_cases_have_the_volume_that_surface_and_caps_enclose() {
        let world = WorldMap::of_samples(&Geometry::default());
        for mask in 0..256usize {
            let value = |c: usize| {
                let size = 0.25 + 0.1 * c as f32 + 0.05 * (mask % 7) as f32;
                if mask >> c & 1 == 1 { size } else { -size }
            };
            let values: [f32; 8] = std::array::from_fn(value);
            let (found, expected) = (share_inside(&values.map(f64::from), &world), enclosed(&values, &world));
            assert!((found - expected).abs() < 1e-6, "{mask:08b}: {found}, not {expected}");
        }
    }
}
