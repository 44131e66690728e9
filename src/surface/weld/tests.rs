use super::super::extract::{Workbench, extract};
use super::super::testing::{Grid, assert_sound, triangle_set};
use super::*;
use crate::surface::TriMesh;
use isospan_io::grid::Geometry;

fn wave(p: [f64; 3]) -> f64 {
    (p[0] * 0.7).sin() + (p[1] * 0.5).cos() + p[2] * 0.2
}

/// Six slabs of tetrahedra, and the extracted surface of each.
fn slabs(grid: &Grid, world: &WorldMap) -> Vec<ChunkSurface> {
    let chunk: Vec<usize> = (0..grid.tets.len()).map(|i| i * 6 / grid.tets.len()).collect();
    let surface = |part: &super::super::testing::OwnedChunk| {
        let mut out = ChunkSurface::default();
        extract(&part.source(), 1.0, world, &mut Workbench::default(), &mut out);
        out
    };
    grid.parts(&grid.sample(wave), &chunk).iter().map(surface).collect()
}

fn build(chunks: &[ChunkSurface], world: &WorldMap, settings: &BuilderSettings) -> TriMesh {
    let mut builder = SurfaceBuilder::new(world, settings);
    chunks.iter().for_each(|c| builder.push(c).unwrap());
    TriMesh::from_source(&builder.finish().unwrap()).unwrap()
}

#[test]
fn memory_does_not_show() {
    let grid = Grid::new([20, 18, 16]);
    let world = WorldMap::new(&grid.lattice, &Geometry::default());
    let chunks = slabs(&grid, &world);
    let plenty = build(&chunks, &world, &BuilderSettings::default());
    let scratch = tempfile::tempdir().unwrap();
    for memory_bytes in [0, 1000, 20_000] {
        let settings = BuilderSettings { memory_bytes, scratch: scratch.path().to_path_buf() };
        assert_eq!(build(&chunks, &world, &settings), plenty);
    }
    assert_sound(&plenty);
}

#[test]
fn edges_closed_after_their_last_chunk_change_nothing() {
    let grid = Grid::new([20, 18, 16]);
    let world = WorldMap::new(&grid.lattice, &Geometry::default());
    let chunks = slabs(&grid, &world);
    let plain = build(&chunks, &world, &BuilderSettings::default());
    let scratch = tempfile::tempdir().unwrap();
    for memory_bytes in [0, 1 << 20] {
        let settings = BuilderSettings { memory_bytes, scratch: scratch.path().to_path_buf() };
        let mut builder = SurfaceBuilder::new(&world, &settings);
        let mut most = 0;
        for (i, chunk) in chunks.iter().enumerate() {
            builder.push(chunk).unwrap();
            let later = |key| chunks[i + 1..].iter().any(|c| c.shared_edges().iter().any(|e| e.key == key));
            builder.keep_open(|a, b| later((a, b))).unwrap();
            most = most.max(builder.open_edges());
        }
        assert_eq!(builder.open_edges(), 0);
        assert!(most > 0, "slabs share edges");
        let closed = TriMesh::from_source(&builder.finish().unwrap()).unwrap();
        assert_eq!(closed, plain);
    }
}

#[test]
fn all_corners_shared_is_right_too() {
    let grid = Grid::new([10, 9, 8]);
    let world = WorldMap::new(&grid.lattice, &Geometry::default());
    let chunk: Vec<usize> = (0..grid.tets.len()).map(|i| i % 3).collect();
    let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
    for mut part in grid.parts(&grid.sample(wave), &chunk) {
        part.shared.fill(true);
        let mut out = ChunkSurface::default();
        extract(&part.source(), 1.0, &world, &mut Workbench::default(), &mut out);
        // All edges but those around which the chunk has all tetrahedra.
        assert!(out.shared_edges().len() * 10 > out.vertices().len() * 9);
        builder.push(&out).unwrap();
    }
    let mesh = TriMesh::from_source(&builder.finish().unwrap()).unwrap();
    let whole = grid.surface(&grid.sample(wave), 1.0, &Geometry::default());
    assert_eq!(triangle_set(&mesh), triangle_set(&whole));
}

#[test]
fn an_empty_surface_is_empty() {
    let world = WorldMap::new(&Grid::new([2; 3]).lattice, &Geometry::default());
    let surface = SurfaceBuilder::new(&world, &BuilderSettings::default()).finish().unwrap();
    assert_eq!((surface.vertex_count(), surface.triangle_count()), (0, 0));
    assert_eq!(TriMesh::from_source(&surface).unwrap(), TriMesh::default());
}

#[test]
fn too_many_vertices_are_refused_before_they_are_numbered() {
    let grid = Grid::new([10, 9, 8]);
    let world = WorldMap::new(&grid.lattice, &Geometry::default());
    let builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
    assert!(builder.check_room(u64::from(u32::MAX) - 1).is_ok());
    let error = builder.check_room(u64::from(u32::MAX)).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("4294967295 vertices"), "{error}");
}

#[test]
fn parts_put_together_are_the_surface() {
    let grid = Grid::new([20, 18, 16]);
    let world = WorldMap::new(&grid.lattice, &Geometry::default());
    let chunks = slabs(&grid, &world);
    let whole = build(&chunks, &world, &BuilderSettings::default());
    let scratch = tempfile::tempdir().unwrap();
    for (memory_bytes, every) in [(1 << 20, 1), (1 << 20, 4), (1000, 1), (0, 2)] {
        let settings = BuilderSettings { memory_bytes, scratch: scratch.path().to_path_buf() };
        let mut builder = SurfaceBuilder::new(&world, &settings);
        let (mut shown, mut changes) = (TriMesh::default(), 0);
        let mut take = |builder: &mut SurfaceBuilder| {
            let take = |part: &SurfaceAddition<'_>| {
                let added = TriMesh::from_source(part)?;
                assert_eq!(added.vertices.len() as u64, part.vertex_count());
                assert_eq!(added.triangles.len() as u64, part.triangle_count());
                shown.vertices.extend(added.vertices);
                shown.triangles.extend(added.triangles);
                let count = shown.vertices.len() as u32;
                assert!(shown.triangles.iter().flatten().all(|&v| v < count), "vertices come first");
                for &(number, vertex) in part.changed {
                    assert_eq!(shown.vertices[number as usize].position, vertex.position);
                    shown.vertices[number as usize] = vertex;
                    changes += 1;
                }
                Ok(())
            };
            builder.hand_on(take).unwrap();
        };
        for (n, chunk) in chunks.iter().enumerate() {
            builder.push(chunk).unwrap();
            if n == 3 {
                // What was in the first two slabs alone is closed.
                let lowest = chunk.shared_edges().iter().map(|e| e.key.0).min().unwrap();
                builder.keep_open(|a, _| a >= lowest).unwrap();
            }
            if n % every == 0 {
                take(&mut builder);
            }
        }
        builder.close().unwrap();
        take(&mut builder);
        assert!(changes > 100, "{changes} vertices lie between slabs");
        assert_eq!(shown, whole, "{memory_bytes} bytes");
        assert_eq!(TriMesh::from_source(&builder.finish().unwrap()).unwrap(), whole);
    }
}
