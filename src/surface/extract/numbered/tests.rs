use super::*;
use crate::surface::extract::{ChunkSurface, SharedEdge, Workbench};
use crate::surface::testing::{Grid, mirrored};
use crate::surface::{Vertex, WorldMap};
use isospan_io::geom::LatticePos;
use isospan_io::grid::Geometry;
use isospan_mesh::simd::Avx2;
use proptest::prelude::*;

/// Blocks of neighbouring tetrahedra, with corners of their own; those on the faces of the grid are
/// shared.
pub(in crate::surface) struct Blocks {
    pub(in crate::surface) grid: Grid,
    blocks: Vec<(Vec<u32>, Vec<Tet>)>,
}

impl Blocks {
    pub(in crate::surface) fn new(edge: u64, tets: usize) -> Self {
        let grid = Grid::new([edge; 3]);
        let block = |tets: &[Tet]| {
            let mut numbers: Vec<u32> = tets.iter().flatten().copied().collect();
            numbers.sort_unstable_by_key(|v| std::cmp::Reverse(*v));
            numbers.dedup();
            let own = |v: u32| numbers.iter().position(|&n| n == v).unwrap() as u32;
            let tets = tets.iter().map(|t| t.map(own)).collect();
            (numbers, tets)
        };
        let blocks = grid.tets.chunks(tets).map(block).collect();
        Self { grid, blocks }
    }

    /// Calls `each` with every block.
    pub(in crate::surface) fn each(&self, values: &[f32], mut each: impl FnMut(&CellSource<'_>)) {
        let top = self.grid.lattice.max();
        for (numbers, tets) in &self.blocks {
            let all = || numbers.iter().map(|&v| v as usize);
            let positions: Vec<LatticePos> = all().map(|v| self.grid.positions[v]).collect();
            each(&CellSource {
                positions: &positions,
                values: &all().map(|v| values[v]).collect::<Vec<_>>(),
                ids: &all().map(|v| self.grid.ids[v]).collect::<Vec<_>>(),
                shared: &positions
                    .iter()
                    .map(|p| (0..3).any(|a| p[a] == 0 || p[a] == top[a]))
                    .collect::<Vec<_>>(),
                numbers: Some(numbers),
                tets,
            });
        }
    }

    pub(in crate::surface) fn start(&self, isovalue: f32) -> ChunkSurface {
        let mut surface = ChunkSurface::default();
        surface.start(isovalue, self.grid.ids.len());
        surface
    }

    /// The surface of blocks that have not been numbered, and of those that have, with vectors
    /// where there are any and without.
    fn surfaces(&self, values: &[f32], isovalue: f32, geometry: &Geometry) -> [ChunkSurface; 3] {
        let world = WorldMap::new(&self.grid.lattice, geometry);
        let mut bench = Workbench::default();
        let mut surfaces = [(); 3].map(|()| self.start(isovalue));
        self.each(values, |cells| {
            surfaces[0].add(cells, &world, &mut bench);
            let block = bench.number(cells).expect("these blocks are small");
            surfaces[1].add_numbered_on(&block, &world, &mut bench, Avx2::found());
            surfaces[2].add_numbered_on(&block, &world, &mut bench, None);
        });
        surfaces.iter_mut().for_each(|surface| surface.finish(&world));
        surfaces
    }
}

pub(in crate::surface) type Bits = (u64, Vec<[u32; 6]>, Vec<[u32; 3]>, Vec<SharedEdge>);

pub(in crate::surface) fn bits(surface: &ChunkSurface) -> Bits {
    let vertex = |v: &Vertex| bytemuck::cast::<Vertex, [u32; 6]>(*v);
    let shared = surface.shared_edges().to_vec();
    let vertices = surface.vertices().iter().map(vertex).collect();
    (surface.active_cells(), vertices, surface.triangles().to_vec(), shared)
}

/// The surface of blocks as they were read, with vectors, and without.
pub(in crate::surface) type Three = [ChunkSurface; 3];

/// Surfaces of blocks of a smooth field are the same three times, bit by bit.
pub(in crate::surface) fn fields_agree(surfaces: impl Fn(&Blocks, &[f32], f32, &Geometry) -> Three) {
    let gyroid = |p: [f64; 3]| {
        let [x, y, z] = p.map(|x| x * 0.7);
        x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
    };
    for (tets, geometry) in [(7, Geometry::default()), (150, mirrored()), (300, Geometry::default())] {
        let blocks = Blocks::new(9, tets);
        let values = blocks.grid.sample(gyroid);
        for isovalue in [-0.4, 0.0, 0.3, values[100], 9.0] {
            let [read, vectors, plain] = surfaces(&blocks, &values, isovalue, &geometry);
            assert_eq!(read.triangles().is_empty(), isovalue == 9.0);
            assert!(bits(&read) == bits(&vectors), "{tets} tetrahedra, isovalue {isovalue}");
            assert!(bits(&read) == bits(&plain), "{tets} tetrahedra, isovalue {isovalue}, without vectors");
        }
    }
}

/// With values of any kind normals may be no numbers; all else is the same.
pub(in crate::surface) fn any_agree([read, vectors, plain]: Three) -> Result<(), TestCaseError> {
    prop_assert!(bits(&vectors) == bits(&plain));
    prop_assert_eq!(read.triangles(), vectors.triangles());
    let positions =
        |s: &ChunkSurface| -> Vec<_> { s.vertices().iter().map(|v| v.position.map(f32::to_bits)).collect() };
    prop_assert_eq!(positions(&read), positions(&vectors));
    Ok(())
}

/// Values at which tetrahedra are void, degenerate, and of any size.
pub(in crate::surface) fn any_values() -> impl Strategy<Value = Vec<f32>> {
    let value = prop_oneof![
        6 => -2.0f32..2.0,
        1 => Just(f32::NAN),
        1 => Just(f32::INFINITY),
        1 => Just(1e-44f32),
        1 => Just(0.0f32),
        1 => Just(f32::MAX)
    ];
    prop::collection::vec(value, 64)
}

#[test]
fn a_numbered_block_has_the_surface_of_the_block() {
    fields_agree(Blocks::surfaces);
}

/// Most edges have all their tetrahedra in a large block, and are not looked for.
#[test]
fn edges_inside_a_block_are_alone() {
    let blocks = Blocks::new(5, 384);
    let mut buffers = BlockBuffers::default();
    let values = vec![0.0; 125];
    blocks.each(&values, |cells| {
        let block = NumberedBlock::of(cells, &mut buffers).unwrap();
        let mut edges: Vec<(u16, [u8; 2])> = vec![];
        for tet in block.tets() {
            let [a, b, c, d] = tet.corners;
            let sorted = [a, b, c.min(d), c.max(d)];
            assert!(sorted.is_sorted());
            edges.extend(tet.edges.into_iter().zip(EDGES.map(|e| e.map(|i| sorted[usize::from(i)]))));
        }
        edges.sort_unstable();
        edges.dedup();
        assert!(
            edges.iter().map(|e| usize::from(e.0)).eq(0..edges.len()),
            "numbers without gaps, one an edge"
        );
        let top = blocks.grid.lattice.max();
        let on_face = |v: u8| -> Vec<[bool; 2]> {
            let position = block.at()[usize::from(v)];
            (0..3).map(|k| [position[k] == 0.0, position[k] == top[k] as f32]).collect()
        };
        for &(edge, [a, b]) in &edges {
            let together = on_face(a).into_iter().zip(on_face(b)).any(|(a, b)| a[0] && b[0] || a[1] && b[1]);
            assert_eq!(edge < block.alone, !together, "edge {edge} between {a} and {b}");
        }
    });
}

proptest! {
    #[test]
    fn any_values_give_the_same_surface(values in any_values(), tets in 1usize..40) {
        any_agree(Blocks::new(4, tets).surfaces(&values, 0.0, &Geometry::default()))?;
    }
}
