use super::*;
use crate::grid::Geometry;
use crate::surface::WorldMap;
use crate::surface::extract::{
    Workbench,
    cases::EDGES,
    numbered::tests::{Blocks, Three, any_agree, any_values, fields_agree},
};
use proptest::prelude::*;

/// The surface of blocks that have not been numbered, and of those that have, with vectors where
/// there are any and without.
fn surfaces(of: &Blocks, values: &[f32], isovalue: f32, geometry: &Geometry) -> Three {
    let world = WorldMap::new(&of.grid.lattice, geometry);
    let mut bench = Workbench::default();
    let mut surfaces = [(); 3].map(|()| of.start(isovalue));
    of.each(values, |cells| {
        surfaces[0].add(cells, &world, &mut bench);
        let block = bench.precompute(cells, &world).expect("these blocks are small");
        let is_whole = surfaces[1].add_precomputed(block.view(), &world, &mut bench);
        assert!(is_whole);
        let block = Maker::default().make_on(cells, &world, None).unwrap();
        assert!(surfaces[2].add_known_on(block.view(), &world, &mut bench.crossed, (None, None)));
    });
    surfaces.iter_mut().for_each(|surface| surface.finish(&world));
    surfaces
}

#[test]
fn a_known_block_has_the_surface_of_the_block() {
    fields_agree(surfaces);
}

/// Most edges have all their tetrahedra in a large block, and are not looked for.
#[test]
fn edges_inside_a_block_are_alone() {
    let blocks = Blocks::new(5, 384);
    let values = vec![0.0; 125];
    blocks.each(&values, |cells| {
        let world = WorldMap::new(&blocks.grid.lattice, &Geometry::default());
        let block = Maker::default().make(cells, &world).unwrap();
        let block = block.view();
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
    #[test]
    fn any_values_give_the_same_surface(values in any_values(), tets in 1usize..40) {
        any_agree(surfaces(&Blocks::new(4, tets), &values, 0.0, &Geometry::default()))?;
    }
}

/// Blocks whose edges are joined have the same surface as blocks whose edges are not, also where
/// one of them is not at hand.
#[test]
fn joined_blocks_have_the_same_surface() {
    let blocks = Blocks::new(6, 90);
    let values: Vec<f32> =
        (0..216).map(|i| if i == 100 { f32::NAN } else { ((i * 37) % 41) as f32 }).collect();
    let world = WorldMap::new(&blocks.grid.lattice, &Geometry::default());
    let mut bench = Workbench::default();
    for left_out in [usize::MAX, 2] {
        let (mut joiner, mut known, mut n) = (Joiner::default(), vec![], 0);
        blocks.each(&values, |cells| {
            let block = bench.precompute(cells, &world).filter(|_| n != left_out);
            match &block {
                Some(block) => joiner.add(block),
                None => joiner.keep_apart(cells),
            }
            known.push(block);
            n += 1;
        });
        let words = |blocks: &[Option<PrecomputedBlock>]| {
            blocks.iter().flatten().map(|b| b.words.len()).sum::<usize>()
        };
        let before = words(&known);
        for block in known.iter_mut().flatten() {
            *block = joiner.join(block, &world);
        }
        assert!(known.len() > 3 && joiner.count() > 50, "{}", joiner.count());
        assert!(words(&known) + joiner.count() as usize * 3 < before, "joined edges take less");
        for isovalue in [0.0, 7.5, 20.0, 39.0, 50.0] {
            let mut surfaces = [(); 3].map(|()| blocks.start(isovalue));
            surfaces.iter_mut().for_each(|surface| surface.number_edges(joiner.count() as usize));
            let mut number = 0;
            blocks.each(&values, |cells| {
                surfaces[0].add(cells, &world, &mut bench);
                match &known[number] {
                    Some(block) => {
                        let block = block.view();
                        assert!(surfaces[1].add_precomputed(block, &world, &mut bench));
                        assert!(surfaces[2].add_known_on(block, &world, &mut bench.crossed, (None, None)));
                    }
                    None => {
                        surfaces[1..].iter_mut().for_each(|surface| surface.add(cells, &world, &mut bench))
                    }
                }
                number += 1;
            });
            surfaces.iter_mut().for_each(|surface| surface.finish(&world));
            let [right, joined, plain] = &surfaces;
            for surface in [joined, plain] {
                assert!(surface.vertices() == right.vertices(), "isovalue {isovalue}");
                assert!(surface.triangles() == right.triangles(), "isovalue {isovalue}");
                assert!(surface.shared_edges() == right.shared_edges(), "isovalue {isovalue}");
            }
        }
    }
}
