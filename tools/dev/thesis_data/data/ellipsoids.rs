//! Bodies made of ellipsoids, meshed by isospan's own Delaunay kernel.
//!
//! A body is a list of ellipsoids, innermost first; a place belongs to the first that holds it. Its
//! points are
//!
//! * a Fibonacci lattice on each ellipsoid (Swinbank and Purser 2006: equal steps along the axis,
//!   turned by the golden angle; stretched with the ellipsoid), so that regions end where they
//!   should, and
//! * inside, a body-centred cubic lattice, half a spacing away from all ellipsoids, each point
//!   moved by up to 0.15 spacings in a direction hashed from its number: no point set that the mesh
//!   is later reduced to coincides with it.
//!
//! Their Delaunay tetrahedra are kept where their centroid is in a region; flat ones with all
//! corners on one surface of the body are not. Then edges are cut until there are as many vertices
//! as asked for ([`refine`]).

use super::bisect::refine;
use super::tets::{TetMesh, dot};
use isospan::Result;
use isospan::geom::curve::Order;
use isospan::mesh::mesher::Mesher;
use std::f64::consts::PI;

/// An ellipsoid along the axes, in millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Layer {
    pub(crate) centre: [f64; 3],
    /// Semi-axes.
    pub(crate) axes: [f64; 3],
    /// The region inside; `None` of a cavity.
    pub(crate) region: Option<u8>,
}

impl Layer {
    /// Distance from the centre in units of the semi-axes: 1 on the surface.
    fn radius(&self, p: [f64; 3]) -> f64 {
        let scaled: [f64; 3] = std::array::from_fn(|k| (p[k] - self.centre[k]) / self.axes[k]);
        dot(scaled, scaled).sqrt()
    }

    /// Distance from the surface, to first order: |F| / |∇F| of F = radius - 1.
    fn distance(&self, p: [f64; 3]) -> f64 {
        let radius = self.radius(p).max(1e-9);
        let slope: [f64; 3] =
            std::array::from_fn(|k| (p[k] - self.centre[k]) / (self.axes[k] * self.axes[k] * radius));
        (radius - 1.0).abs() / dot(slope, slope).sqrt().max(1e-9)
    }

    /// Knud Thomsen's formula, right to 1.1 %.
    fn area(&self) -> f64 {
        const POWER: f64 = 1.6075;
        let [a, b, c] = self.axes;
        let of = |x: f64, y: f64| libm::pow(x * y, POWER);
        4.0 * PI * libm::pow((of(a, b) + of(a, c) + of(b, c)) / 3.0, 1.0 / POWER)
    }

    fn volume(&self) -> f64 {
        4.0 / 3.0 * PI * self.axes[0] * self.axes[1] * self.axes[2]
    }

    /// `n` points on the surface.
    fn fibonacci(&self, n: usize) -> impl Iterator<Item = [f64; 3]> + '_ {
        // π (3 - √5)
        let golden = PI * (3.0 - 5f64.sqrt());
        (0..n).map(move |i| {
            let z = 1.0 - (2 * i + 1) as f64 / n as f64;
            let across = (1.0 - z * z).sqrt();
            let turn = golden * i as f64;
            let unit = [across * libm::cos(turn), across * libm::sin(turn), z];
            std::array::from_fn(|k| self.centre[k] + self.axes[k] * unit[k])
        })
    }
}

/// The region of a place: that of the first ellipsoid that holds it; `None` in a cavity and
/// outside.
pub(crate) fn region_of(layers: &[Layer], p: [f64; 3]) -> Option<u8> {
    layers.iter().find(|l| l.radius(p) < 1.0)?.region
}

/// A mesh of a body with so many vertices. Every ellipsoid lies in the last one.
pub(crate) fn mesh_body(layers: &[Layer], vertices: usize) -> Result<TetMesh> {
    let outer = layers.last().expect("a body has an ellipsoid");
    // The first guess lacks what surfaces add; a few steps find a spacing with a little fewer
    // vertices than wanted.
    let mut spacing = libm::cbrt(outer.volume() / vertices as f64);
    for _ in 0..20 {
        let points = place(layers, spacing);
        let share = points.positions.len() as f64 / vertices as f64;
        if (0.9..=0.99).contains(&share) {
            let mut mesh = join(layers, &points)?;
            refine(&mut mesh, vertices);
            return Ok(mesh);
        }
        spacing *= libm::cbrt(share / 0.95);
    }
    unreachable!("the number of points falls with the spacing, without jumps of a tenth")
}

/// Points of a body.
struct BodyPoints {
    positions: Vec<[f64; 3]>,
    /// The ellipsoid on which each lies.
    on: Vec<Option<usize>>,
}

fn place(layers: &[Layer], spacing: f64) -> BodyPoints {
    let mut placed = BodyPoints { positions: vec![], on: vec![] };
    for (number, layer) in layers.iter().enumerate() {
        let n = (layer.area() / (spacing * spacing)).round().max(12.0) as usize;
        placed.positions.extend(layer.fibonacci(n));
        placed.on.resize(placed.positions.len(), Some(number));
    }
    let outer = layers.last().expect("a body has an ellipsoid");
    // Two points a cube.
    let edge = spacing * libm::cbrt(2.0);
    let count = outer.axes.map(|a| (2.0 * a / edge).ceil() as u64 + 1);
    for n in 0..2 * count[0] * count[1] * count[2] {
        let (cell, half) = (n / 2, (n % 2) as f64 * 0.5);
        let ijk = [cell % count[0], cell / count[0] % count[1], cell / count[0] / count[1]];
        let p = std::array::from_fn(|k| {
            let jitter = 0.15 * spacing * signed(3 * n + k as u64);
            outer.centre[k] - outer.axes[k] + (ijk[k] as f64 + half) * edge + jitter
        });
        let clear = layers.iter().all(|l| l.distance(p) > 0.5 * spacing);
        if clear && region_of(layers, p).is_some() {
            placed.positions.push(p);
        }
    }
    placed.on.resize(placed.positions.len(), None);
    placed
}

/// A number from -1 to 1, hashed (SplitMix64: Steele, Lea and Flood 2014).
fn signed(n: u64) -> f64 {
    let mut z = n.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Tetrahedra of the points; positions become those of the lattice on which the kernel works.
fn join(layers: &[Layer], placed: &BodyPoints) -> Result<TetMesh> {
    let outer = layers.last().expect("a body has an ellipsoid");
    let longest = outer.axes.iter().fold(0.0, |a: f64, &b| a.max(b));
    let step = 2.0 * longest / f64::from((1u32 << 24) - 2);
    let lo: [f64; 3] = std::array::from_fn(|k| outer.centre[k] - outer.axes[k]);
    let lattice: Vec<[u32; 3]> = placed
        .positions
        .iter()
        .map(|p| std::array::from_fn(|k| ((p[k] - lo[k]) / step).round().max(0.0) as u32))
        .collect();
    let mut mesher = Mesher::new();
    mesher.delaunay(&lattice, &Order::for_count(lattice.len() as u64))?;
    let back = |p: &[u32; 3]| std::array::from_fn(|k| lo[k] + f64::from(p[k]) * step);
    let mut mesh = TetMesh { points: lattice.iter().map(back).collect(), ..TetMesh::default() };
    mesher.for_each_tet(|tet| mesh.tets.push(tet));
    // The kernel numbers records as it likes.
    mesh.tets.sort_unstable();
    let regions: Vec<Option<u8>> =
        (0..mesh.tets.len()).map(|t| region_of(layers, mesh.centroid(t))).collect();
    mesh.regions = regions.iter().map(|r| r.unwrap_or_default()).collect();
    let is_skin = |on: usize| on == layers.len() - 1 || layers[on].region.is_none();
    let flat: Vec<bool> = mesh
        .tets
        .iter()
        .map(|tet| {
            let [a, b, c, d] = tet.map(|v| placed.on[v as usize]);
            a.is_some_and(is_skin) && a == b && b == c && c == d
        })
        .collect();
    mesh.retain(|t| regions[t].is_some() && !flat[t]);
    mesh.keep_largest_part();
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::super::tets::volume6;
    use super::*;

    #[test]
    fn a_shell_has_its_volume_and_regions() {
        let layers = [
            Layer { centre: [1.0, 0.0, 0.0], axes: [10.0; 3], region: None },
            Layer { centre: [0.0; 3], axes: [20.0, 18.0, 16.0], region: Some(1) },
            Layer { centre: [0.0; 3], axes: [30.0, 27.0, 24.0], region: Some(2) },
        ];
        let mesh = mesh_body(&layers, 6_000).unwrap();
        assert_eq!(mesh.points.len(), 6_000);
        let volume = |region: u8| -> f64 {
            let of_region = (0..mesh.tets.len()).filter(|&t| mesh.regions[t] == region);
            of_region.map(|t| volume6(mesh.corners(t)) / 6.0).sum()
        };
        assert!((0..mesh.tets.len()).all(|t| volume6(mesh.corners(t)) > 0.0));
        let expected = [layers[1].volume() - layers[0].volume(), layers[2].volume() - layers[1].volume()];
        for (region, expected) in [(1, expected[0]), (2, expected[1])] {
            let share = volume(region) / expected;
            assert!((0.95..1.03).contains(&share), "region {region}: {share}");
        }
    }

    #[test]
    fn numbers_are_spread() {
        let mean = (0..10_000).map(signed).sum::<f64>() / 1e4;
        assert!(mean.abs() < 0.02 && (0..10_000).all(|n| signed(n).abs() <= 1.0));
    }
}
