//! From the steps of a simulation to one archive, and the surface at any moment:
//! `cargo run --example time_series`.
#![allow(clippy::print_stdout)]

use isospan::formats::StepSource;
use isospan::{Archive, Reduction, Result, StepChoice, volume_of};
use std::path::Path;

const SIDE: u64 = 48;

/// The radius less the distance from the middle: a ball at 0. x runs fastest.
fn ball(radius: f32) -> Vec<f32> {
    let square = |i: u64| (i as f32 - (SIDE - 1) as f32 / 2.0).powi(2);
    let distance = |i: u64| (square(i % SIDE) + square(i / SIDE % SIDE) + square(i / (SIDE * SIDE))).sqrt();
    (0..SIDE.pow(3)).map(|i| radius - distance(i)).collect()
}

/// Makes an archive in a folder, and returns moments with the triangles of their surfaces.
pub(crate) fn run(folder: &Path) -> Result<Vec<(f64, usize)>> {
    // All steps have one grid. Files of a simulation state their times; here we say them.
    let mut steps = vec![];
    for (radius, time) in [(8.0, 0.0), (12.0, 0.5), (16.0, 1.0)] {
        let volume = volume_of(&format!("a ball of {radius}"), [SIDE; 3], ball(radius))?;
        steps.push(StepSource::from(volume).at(Some(time)));
    }
    let path = folder.join("ball.isospan");
    Reduction::of_steps(steps).replace(true).write(&path)?;

    // A step by its number, or a moment by its time: between two steps values are linear.
    let archive = Archive::open(&path)?;
    let mut found = vec![];
    for number in 0..3 {
        let step = archive.step(number)?;
        let time = step.time().expect("each step has one");
        found.push((time, step.surface(0.0)?.triangles.len()));
    }
    let between = archive.at(StepChoice::Time(0.75))?;
    found.push((0.75, between.surface(0.0)?.triangles.len()));
    Ok(found)
}

#[allow(dead_code, reason = "the test calls run")]
fn main() -> Result<()> {
    for (time, triangles) in run(&std::env::temp_dir())? {
        println!("at {time}: {triangles} triangles");
    }
    Ok(())
}
