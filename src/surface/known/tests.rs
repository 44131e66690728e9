use super::*;
use crate::grid::Geometry;
use crate::surface::WorldMap;
use crate::surface::cases::EDGES;
use crate::surface::marching_tets::{ChunkSurface, Workbench};
use crate::surface::numbered::tests::{Blocks, bits};
use crate::surface::testing::mirrored;
use proptest::prelude::*;

/// The surface of blocks that have not been numbered, and of those that have, with vectors where there are any and without.
fn surfaces(of: &Blocks, values: &[f32], isovalue: f32, geometry: &Geometry) -> [ChunkSurface; 3] {
    let world = WorldMap::new(&of.grid.lattice, geometry);
    let mut bench = Workbench::default();
    let mut surfaces = [(); 3].map(|()| of.start(isovalue));
    of.each(values, |cells| {
        surfaces[0].add(cells, &world);
        let block = bench.know(cells, &world).expect("these blocks are small");
        surfaces[1].add_known(&block, &world, &mut bench);
        let block = Maker::default().make_on(cells, &world, None).unwrap();
        surfaces[2].add_known_on(&block, &world, &mut bench.crossed, (None, None));
    });
    surfaces.iter_mut().for_each(|surface| surface.finish(&world));
    surfaces
}

#[test]
fn a_known_block_has_the_surface_of_the_block() {
    let gyroid = |p: [f64; 3]| {
        let [x, y, z] = p.map(|x| x * 0.7);
        x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
    };
    for (tets, geometry) in [(7, Geometry::default()), (150, mirrored()), (300, Geometry::default())] {
        let blocks = Blocks::new(9, tets);
        let values = blocks.grid.sample(gyroid);
        for isovalue in [-0.4, 0.0, 0.3, values[100], 9.0] {
            let [read, numbered, plain] = surfaces(&blocks, &values, isovalue, &geometry);
            assert_eq!(read.triangles().is_empty(), isovalue == 9.0);
            assert!(bits(&read) == bits(&numbered), "{tets} tetrahedra, isovalue {isovalue}");
            assert!(bits(&read) == bits(&plain), "{tets} tetrahedra, isovalue {isovalue}, without vectors");
        }
    }
}

/// Most edges have all their tetrahedra in a large block, and are not looked for.
#[test]
fn edges_inside_a_block_are_alone() {
    let blocks = Blocks::new(5, 384);
    let values = vec![0.0; 125];
    blocks.each(&values, |cells| {
        let world = WorldMap::new(&blocks.grid.lattice, &Geometry::default());
        let block = Maker::default().make(cells, &world).unwrap();
        let mut edges: Vec<(u16, [u8; 2])> = vec![];
        for (tet, of_tet) in block.tets().iter().zip(block.edges_of_tets()) {
            assert!(tet.is_sorted());
            let ends = EDGES.map(|e| e.map(|i| tet[usize::from(i)]));
            edges.extend(of_tet.iter().map(|e| e & !TURNED).zip(ends));
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
            assert_eq!(block.edges()[usize::from(edge)], [a, b]);
            let together = on_face(a).into_iter().zip(on_face(b)).any(|(a, b)| a[0] && b[0] || a[1] && b[1]);
            let is_open = block.slots_of_edges()[usize::from(edge)] & OPEN != 0;
            assert_eq!(is_open, together, "edge {edge} between {a} and {b}");
        }
    });
}

proptest! {
    /// Values at which tetrahedra are void, degenerate, and of any size.
    #[test]
    fn any_values_give_the_same_surface(
        values in prop::collection::vec(
            prop_oneof![6 => -2.0f32..2.0, 1 => Just(f32::NAN), 1 => Just(f32::INFINITY), 1 => Just(1e-44f32), 1 => Just(0.0f32), 1 => Just(f32::MAX)],
            64,
        ),
        tets in 1usize..40,
    ) {
        let blocks = Blocks::new(4, tets);
        let [read, numbered, plain] = surfaces(&blocks, &values, 0.0, &Geometry::default());
        prop_assert!(bits(&numbered) == bits(&plain));
        prop_assert_eq!(read.triangles(), numbered.triangles());
        let positions = |s: &ChunkSurface| s.vertices().iter().map(|v| v.position.map(f32::to_bits)).collect::<Vec<_>>();
        prop_assert_eq!(positions(&read), positions(&numbered));
    }
}
