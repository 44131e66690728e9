//! HEART, TORSO and HEAD: bodies, their conductivities, and the dipole in each.
//!
//! | | geometry | vertices | regions (S/m) |
//! |---|---|---|---|
//! | HEART | the left ventricle of a heart from medical images (`meshes/kit_heart`, material 31) as it is | 12 528 | muscle 0.24, a poorly perfused zone of 20 mm about the source 0.08 |
//! | TORSO | a torso (`meshes/utah_torso`) whose longest edges are cut until it has the thesis's number | 34 937 | body 0.22, lungs 0.05, heart 0.4 (ellipsoids of ours, the mesh has no regions) |
//! | HEAD | four concentric ellipsoids, meshed by isospan | 137 923 | brain 0.33, fluid 1.79, skull 0.0042, scalp 0.33 |
//!
//! The real geometries lie in the folder that `ISOSPAN_SHARED_DATA` names. Without it HEART is a
//! shell between two ellipsoids and TORSO an ellipsoid with lungs and heart, with the thesis's
//! numbers of vertices, and [`Body::geometry`] says so. Conductivities are of the usual sizes (Rush
//! and Driscoll 1968 for head and skull; Geselowitz 1967).

use super::bisect::refine;
use super::ellipsoids::{Layer, mesh_body};
use super::fem::Dipole;
use super::tets::{TetMesh, dot, minus, volume6};
use isospan::cells::CellBlock;
use isospan::formats::{OpenOptions, open_mesh};
use isospan::{Error, Result};
use std::path::Path;

/// A body in which a dipole is.
pub(crate) struct Body {
    pub(crate) mesh: TetMesh,
    /// By region, in S/m.
    pub(crate) conductivities: Vec<f64>,
    pub(crate) dipole: Dipole,
    /// Where the shape is from.
    pub(crate) geometry: String,
}

const HEART_VERTICES: usize = 11_504;
const TORSO_VERTICES: usize = 34_937;
const HEAD_VERTICES: usize = 137_923;

/// The left ventricle's number in the heart's file.
const LEFT_VENTRICLE: f64 = 31.0;

/// The heart of `shared`, or a shell.
pub(crate) fn heart(shared: Option<&Path>) -> Result<Body> {
    let (mut mesh, geometry) = match shared {
        Some(folder) => {
            let mut mesh = read(&folder.join("meshes/kit_heart/heartT4.ele"), |r| r == LEFT_VENTRICLE)?;
            mesh.keep_largest_part();
            (mesh, "left ventricle from medical images (meshes/kit_heart, material 31), as it is")
        }
        None => {
            let outer = Layer { centre: [0.0; 3], axes: [36.0, 36.0, 52.0], region: Some(0) };
            let cavity = Layer { centre: [0.0, 0.0, 4.0], axes: [23.0, 23.0, 38.0], region: None };
            (
                mesh_body(&[cavity, outer], HEART_VERTICES)?,
                "a shell between two ellipsoids, meshed by isospan",
            )
        }
    };
    // The source lies in the thick of the wall, where the cell is that is farthest from the axis.
    let middle = mid(&mesh);
    let position = mesh.centroid(thickest(&mesh, |c| c[0] > middle[0]));
    for t in 0..mesh.tets.len() {
        let away = minus(mesh.centroid(t), position);
        mesh.regions[t] = u8::from(dot(away, away) < 20.0 * 20.0);
    }
    let dipole = Dipole { position, moment: [600.0, 300.0, -600.0] };
    Ok(Body { mesh, conductivities: vec![0.24, 0.08], dipole, geometry: geometry.into() })
}

/// The torso of `shared`, or an ellipsoid.
pub(crate) fn torso(shared: Option<&Path>) -> Result<Body> {
    let (mut mesh, geometry) = match shared {
        Some(folder) => {
            let mut mesh = read(&folder.join("meshes/utah_torso/body.tet"), |_| true)?;
            refine(&mut mesh, TORSO_VERTICES);
            (mesh, "a torso from medical images (meshes/utah_torso), its longest edges cut")
        }
        None => {
            let body = Layer { centre: [-15.0, 37.0, 200.0], axes: [180.0, 108.0, 200.0], region: Some(0) };
            (mesh_body(&[body], TORSO_VERTICES)?, "an ellipsoid, meshed by isospan")
        }
    };
    let [lo, hi] = mesh.bounds();
    // In parts of the body's box: lungs left and right, the heart between them.
    let organ = |centre: [f64; 3], axes: [f64; 3], region: u8| Layer {
        centre: std::array::from_fn(|k| lo[k] + centre[k] * (hi[k] - lo[k])),
        axes: std::array::from_fn(|k| axes[k] * (hi[k] - lo[k])),
        region: Some(region),
    };
    let heart = organ([0.54, 0.42, 0.62], [0.11, 0.19, 0.12], 2);
    let organs = [
        heart,
        organ([0.32, 0.52, 0.62], [0.13, 0.28, 0.24], 1),
        organ([0.72, 0.52, 0.62], [0.13, 0.28, 0.24], 1),
    ];
    for t in 0..mesh.tets.len() {
        mesh.regions[t] = super::ellipsoids::region_of(&organs, mesh.centroid(t)).unwrap_or(0);
    }
    let dipole = Dipole { position: heart.centre, moment: [12_000.0, -6_000.0, -12_000.0] };
    Ok(Body { mesh, conductivities: vec![0.22, 0.05, 0.4], dipole, geometry: geometry.into() })
}

/// Four concentric ellipsoids.
pub(crate) fn head() -> Result<Body> {
    let shell = |thickness: f64, region: u8| Layer {
        centre: [0.0; 3],
        axes: [78.0, 95.0, 86.0].map(|a| a - thickness),
        region: Some(region),
    };
    let layers = [shell(16.0, 0), shell(13.0, 1), shell(6.0, 2), shell(0.0, 3)];
    Ok(Body {
        mesh: mesh_body(&layers, HEAD_VERTICES)?,
        conductivities: vec![0.33, 1.79, 0.0042, 0.33],
        dipole: Dipole { position: [30.3, 12.1, 40.2], moment: [30.0, 10.0, 40.0] },
        geometry: "four concentric ellipsoids (brain, fluid, skull, scalp), meshed by isospan".into(),
    })
}

fn mid(mesh: &TetMesh) -> [f64; 3] {
    let [lo, hi] = mesh.bounds();
    std::array::from_fn(|k| 0.5 * (lo[k] + hi[k]))
}

/// Of the cells whose centroid is wanted, the one whose corners are farthest from the boundary: the
/// most that no corner is on it, the largest of those.
fn thickest(mesh: &TetMesh, wanted: impl Fn([f64; 3]) -> bool) -> usize {
    let boundary = on_boundary(mesh);
    let inner = |t: usize| mesh.tets[t].iter().filter(|&&v| !boundary[v as usize]).count();
    let size = |t: usize| volume6(mesh.corners(t));
    let better =
        |a: &usize, b: &usize| (inner(*a), size(*a)).partial_cmp(&(inner(*b), size(*b))).expect("finite");
    (0..mesh.tets.len()).filter(|&t| wanted(mesh.centroid(t))).max_by(better).expect("a body has cells")
}

/// Which vertices lie on a face of one tetrahedron.
fn on_boundary(mesh: &TetMesh) -> Vec<bool> {
    let mut count = rustc_hash::FxHashMap::default();
    let faces = mesh.tets.iter().flat_map(|tet| super::tets::FACES.map(|face| face.map(|i| tet[i])));
    for mut face in faces {
        face.sort_unstable();
        *count.entry(face).or_insert(0u32) += 1;
    }
    let mut boundary = vec![false; mesh.points.len()];
    count
        .iter()
        .filter(|(_, n)| **n == 1)
        .for_each(|(face, _)| face.iter().for_each(|&v| boundary[v as usize] = true));
    boundary
}

/// The tetrahedra of a mesh whose region (0 where it has none) is wanted, positively oriented.
fn read(path: &Path, wanted: impl Fn(f64) -> bool) -> Result<TetMesh> {
    let file = open_mesh(path, &OpenOptions::default())?;
    let mut mesh = TetMesh::default();
    let (mut points, mut block) = (file.points()?, vec![]);
    while points.next_block(&mut block)? {
        mesh.points.extend_from_slice(&block);
    }
    let (mut cells, mut block) = (file.cells()?, CellBlock::default());
    while cells.next_block(&mut block)? {
        for (_, corners) in block.iter() {
            let corners: [u64; 4] = corners.try_into().map_err(|_| {
                Error::bad_input(path, "cells", "tetrahedra", format!("a cell of {} vertices", corners.len()))
            })?;
            mesh.tets.push(corners.map(|v| v as u32));
        }
    }
    mesh.regions = vec![0; mesh.tets.len()];
    let region = file.info().fields.iter().position(|f| f.name == "region");
    let mut regions = vec![0.0; mesh.tets.len()];
    if let Some(field) = region {
        let (mut stored, mut block, mut next) = (file.stored(field)?, vec![], 0);
        while stored.next_block(&mut block)? {
            regions[next..next + block.len()].copy_from_slice(&block);
            next += block.len();
        }
    }
    for t in 0..mesh.tets.len() {
        if volume6(mesh.corners(t)) < 0.0 {
            mesh.tets[t].swap(2, 3);
        }
    }
    let flat: Vec<bool> = (0..mesh.tets.len()).map(|t| volume6(mesh.corners(t)) == 0.0).collect();
    mesh.retain(|t| wanted(regions[t]) && !flat[t]);
    Ok(mesh)
}
