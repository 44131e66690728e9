//! Times of the methods that the thesis reviews, and of isospan's index, over the same cells: to
//! build, to ask, and what they hold.
//!
//! `cargo run --release --bin reviewed_methods -- [VOLUME…]`: a Markdown table each of 50³
//! samples of a sphere, of the 705 894 tetrahedra of these, of 200³ samples, without and with
//! noise, and of volumes that are named. One thread; queries are medians of nine, of the isovalue
//! of 63 over the range with the fewest active cells and that with the most, in turn.

#![allow(clippy::print_stdout)]

mod methods;

use isospan::Result;
use isospan::mesh::tet::Tet;
use methods::marching::surface;
use methods::volume::Volume;
use methods::{Cells, compare, coordinates, few_and_many, sample_of};
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

fn main() -> ExitCode {
    let named: Vec<String> = std::env::args().skip(1).collect();
    if named.iter().any(|a| a.starts_with('-')) {
        eprintln!("usage: reviewed_methods [VOLUME...]");
        return ExitCode::from(2);
    }
    match run(&named) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("reviewed_methods: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(named: &[String]) -> Result<()> {
    let small = Volume::sphere(50, 0.0);
    cubes("sphere, 50³", &small)?;
    let corners = tetrahedra(small.dims);
    print("sphere, 50³, tetrahedra", &Cells::Tets { values: &small.samples, corners: &corners })?;
    cubes("sphere, 200³", &Volume::sphere(200, 0.0))?;
    cubes("sphere with noise, 200³", &Volume::sphere(200, 0.05))?;
    named.iter().try_for_each(|file| cubes(file, &Volume::read(Path::new(file))?))
}

/// Each cube of a grid as six tetrahedra around its diagonal, cube after cube.
fn tetrahedra(dims: [usize; 3]) -> Vec<Tet> {
    const PATHS: [[usize; 2]; 6] = [[0, 1], [1, 2], [2, 0], [0, 2], [1, 0], [2, 1]];
    let strides = [1, dims[0], dims[0] * dims[1]];
    let last: usize = strides.iter().sum();
    let cubes = dims.map(|d| d - 1);
    let firsts = (0..cubes.iter().product()).map(|n| sample_of(dims, coordinates(cubes, n)));
    let of_cube = |first: usize| {
        PATHS.map(|[a, b]| [0, strides[a], strides[a] + strides[b], last].map(|step| (first + step) as u32))
    };
    firsts.flat_map(of_cube).collect()
}

fn cubes(name: &str, volume: &Volume) -> Result<()> {
    let cells = Cells::Cubes { dims: volume.dims, samples: &volume.samples };
    let isovalue = print(name, &cells)?;
    let started = Instant::now();
    let surface = surface(volume.dims, &volume.samples, &volume.geometry, isovalue);
    let (triangles, took) = (surface.triangles.len(), 1e3 * started.elapsed().as_secs_f64());
    println!("Marching cubes, with triangles: {took:.1} ms for {triangles} of the second isovalue.\n");
    Ok(())
}

/// Prints the table of some cells; returns the isovalue with the most active ones.
fn print(name: &str, cells: &Cells<'_>) -> Result<f32> {
    let isovalues = few_and_many(cells);
    let [few, many] = isovalues.map(|(_, count)| count);
    println!("{name}: {} cells, of which {few} and {many} are active\n", cells.len());
    println!(
        "| method | build, ms | bytes a cell | {few} active, ms | {many} active, ms |\n|---|---|---|---|---|"
    );
    for row in compare(cells, &isovalues, 9)? {
        let [few, many] = [0, 1].map(|i| 1e3 * row.query_seconds[i]);
        let bytes = row.bytes as f64 / cells.len() as f64;
        println!("| {} | {:.1} | {bytes:.3} | {few:.3} | {many:.3} |", row.name, 1e3 * row.build_seconds);
    }
    println!();
    Ok(isovalues[1].0)
}
