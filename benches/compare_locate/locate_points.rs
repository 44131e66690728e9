//! Our part of `compare.py`: locates points in a tetrahedral mesh and interpolates its field, on
//! one thread.
//!
//! `locate_points MESH FIELD POINTS VALUES REPEAT`: POINTS are little-endian f64 triples in world
//! coordinates; the values (f32, NaN outside) go to VALUES. Prints a line a repetition: CPU seconds
//! of the grid over the points (built, cells streamed past, values), of building the kd-tree over
//! the cells, and of its answers with values. Both must give the same answers.

#![allow(clippy::print_stdout)]

use isospan::cells::{CellBlock, CellKind};
use isospan::formats::{OpenOptions, open_mesh};
use isospan::locate::{CellBatch, CellHit, FinePos, KdTree, PointGrid, is_positive, linear};
use std::error::Error;
use std::path::Path;

/// Fine steps along the longest side of the mesh, as in a reduction.
const LONGEST: f64 = (1u64 << 38) as f64;

struct Mesh {
    lo: [f64; 3],
    scale: f64,
    cells: CellBatch,
    values: Vec<f32>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let [mesh, field, points, values, repeat] = args[..] else {
        return Err("MESH FIELD POINTS VALUES REPEAT".into());
    };
    let mesh = read_mesh(Path::new(mesh), field)?;
    let points: Vec<FinePos> = read_points(points)?.iter().map(|&p| mesh.fine(p)).collect();
    for _ in 0..repeat.parse()? {
        let start = cpu_seconds()?;
        let mut found = vec![CellHit::default(); points.len()];
        PointGrid::new(&points).locate(&mesh.cells, &mut found);
        let answers = mesh.interpolate(&found);
        let grid = cpu_seconds()? - start;
        let start = cpu_seconds()?;
        let tree = KdTree::new(&mesh.cells);
        let build = cpu_seconds()? - start;
        let start = cpu_seconds()?;
        let mut by_tree = vec![CellHit::default(); points.len()];
        tree.locate(&points, &mut by_tree);
        let same = mesh.interpolate(&by_tree);
        let answer = cpu_seconds()? - start;
        assert!(found == by_tree && answers.len() == same.len(), "grid and tree differ");
        println!("{grid} {build} {answer}");
        std::fs::write(values, answers.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
    }
    Ok(())
}

/// CPU seconds of this thread so far, as Linux reports them.
fn cpu_seconds() -> Result<f64, Box<dyn Error>> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanoseconds: u64 = text.split_whitespace().next().ok_or("an empty schedstat")?.parse()?;
    Ok(nanoseconds as f64 * 1e-9)
}

impl Mesh {
    fn fine(&self, p: [f64; 3]) -> FinePos {
        std::array::from_fn(|a| ((p[a] - self.lo[a]) * self.scale).round() as i64)
    }

    fn interpolate(&self, found: &[CellHit]) -> Vec<f32> {
        let value = |found: &CellHit| {
            let corners = self.cells.corners[found.cell as usize];
            linear(&found.weights, &corners.map(|v| f64::from(self.values[v as usize]))) as f32
        };
        found.iter().map(|f| if f.id == CellHit::NOWHERE { f32::NAN } else { value(f) }).collect()
    }
}

fn read_points(path: &str) -> Result<Vec<[f64; 3]>, Box<dyn Error>> {
    let bytes = std::fs::read(path)?;
    let number = |i: usize| f64::from_le_bytes(bytes[8 * i..8 * i + 8].try_into().expect("eight bytes"));
    Ok((0..bytes.len() / 24).map(|i| std::array::from_fn(|a| number(3 * i + a))).collect())
}

fn read_mesh(path: &Path, field: &str) -> Result<Mesh, Box<dyn Error>> {
    let mesh = open_mesh(path, &OpenOptions { field: Some(field.into()), ..OpenOptions::default() })?;
    let (mut points, mut stream, mut block) = (vec![], mesh.points()?, vec![]);
    while stream.next_block(&mut block)? {
        points.extend_from_slice(&block);
    }
    let (mut values, mut stream, mut block) = (vec![], mesh.values(1 << 30, |_| false)?, vec![]);
    while stream.next_block(&mut block)? {
        values.extend(block.iter().map(|&v| v as f32));
    }
    let bound = |pick: fn(f64, f64) -> f64| -> [f64; 3] {
        std::array::from_fn(|a| points.iter().map(|p| p[a]).reduce(pick).expect("a mesh has points"))
    };
    let (lo, hi) = (bound(f64::min), bound(f64::max));
    let scale = LONGEST / (0..3).map(|a| hi[a] - lo[a]).fold(0.0, f64::max);
    let mut made = Mesh { lo, scale, cells: CellBatch::default(), values };
    made.cells.positions = points.iter().map(|&p| made.fine(p)).collect();
    let (mut stream, mut block) = (mesh.cells()?, CellBlock::default());
    while stream.next_block(&mut block)? {
        for (kind, vertices) in block.iter().filter(|(kind, _)| *kind == CellKind::Tetrahedron) {
            assert_eq!(vertices.len(), kind.vertices());
            let mut tet: [u32; 4] = std::array::from_fn(|i| vertices[i] as u32);
            if !is_positive(tet.map(|v| made.cells.positions[v as usize])) {
                tet.swap(2, 3);
            }
            made.cells.ids.push(made.cells.corners.len() as u64);
            made.cells.corners.push(tet);
        }
    }
    Ok(made)
}
