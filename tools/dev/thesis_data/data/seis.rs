//! SEIS: the particle velocity of an earthquake in a layered basin, 50³ samples.
//!
//! The thesis's SEIS comes from a simulation of the Salt Lake Basin whose model it does not print.
//! Ours is a basin of the same kind: soft and stiff sediments in a bowl of rock, under a free
//! surface, shaken by a dip-slip source in the rock at its rim:
//!
//! ```text
//!          0                    10 km
//!   0    ──┬──────────────────────┬──  free surface
//!          │╲  1  soft sediments ╱│    1: P 2500  S 1300 m/s  2000 kg/m³   down to half of the bowl
//!          │ ╲_________________╱  │    2: P 3500  S 2000 m/s  2300 kg/m³   down to 3.2 km (1 - r²)²
//!          │  ╲  2  stiff     ╱   │    3: P 5500  S 3200 m/s  2700 kg/m³
//!          │   ╲____________╱     │
//!          │ ✶        3  rock     │    ✶ source, M_xz, Ricker wavelet
//!  10 km   └──────────────────────┘
//! ```
//!
//! r is the distance from the bowl's middle in units of its half-axes (4.4 and 3.6 km). The numbers
//! are round ones of ours. The grid is 200 m: a dozen cells a wavelength of the slowest wave at the
//! peak frequency.
//!
//! A sample is the size of the particle velocity, |v|, in the middle of a cell. The unit of the
//! thesis is not known; here it is the 95th percentile of the recorded step, so that the thesis's
//! isovalue, 0.49, goes through the waves.

use super::wave::{Material, Settings, Simulation};

/// Samples along each axis of what is recorded.
pub(crate) const SAMPLES: usize = 50;
/// Metres between samples.
pub(crate) const SPACING: f64 = 200.0;
/// The step that is SEIS.
pub(crate) const RECORDED: usize = 300;
/// The series has a file each so many steps.
pub(crate) const EACH: usize = 30;

/// Cells of sponge.
const SPONGE: usize = 20;
/// Cells of air.
const AIR: usize = 2;

/// A step of the simulation.
pub(crate) struct SeismicStep {
    pub(crate) step: usize,
    pub(crate) seconds: f64,
    /// |v|, x fastest, z downwards.
    pub(crate) speeds: Vec<f32>,
}

fn settings() -> Settings {
    let across = SAMPLES + 2 * SPONGE;
    Settings {
        dims: [across, across, AIR + SAMPLES + SPONGE],
        spacing: SPACING,
        time_step: 0.018,
        sponge: SPONGE,
        source: [SPONGE + 10, SPONGE + 15, AIR + 32],
        frequency: 0.55,
    }
}

/// The material of a cell; the sponge continues what is at its side.
fn material([x, y, z]: [usize; 3]) -> Material {
    let depth = z.checked_sub(AIR)? as f64 * SPACING;
    // Metres from the middle.
    let along = |cell: usize| {
        (cell.clamp(SPONGE, SPONGE + SAMPLES - 1) - SPONGE) as f64 * SPACING
            - 0.5 * (SAMPLES - 1) as f64 * SPACING
    };
    let (u, v) = (along(x) / 4400.0, along(y) / 3600.0);
    let bowl = (1.0 - u * u - v * v).max(0.0);
    let floor = 3200.0 * bowl * bowl;
    Some(if depth < 0.5 * floor {
        [2500.0, 1300.0, 2000.0]
    } else if depth < floor {
        [3500.0, 2000.0, 2300.0]
    } else {
        [5500.0, 3200.0, 2700.0]
    })
}

/// Simulates; the frames of the series, the last of which is SEIS.
pub(crate) fn simulate() -> Vec<SeismicStep> {
    let mut simulation = Simulation::new(settings(), material);
    let mut frames = vec![];
    for step in 1..=RECORDED {
        simulation.advance();
        if step % EACH == 0 {
            frames.push(SeismicStep { step, seconds: simulation.time(), speeds: speeds(&simulation) });
        }
    }
    let recorded = frames.last().expect("the recorded step is one of the series");
    let unit = super::quantile(&recorded.speeds, 0.95);
    for frame in &mut frames {
        frame.speeds.iter_mut().for_each(|v| *v /= unit);
    }
    frames
}

fn speeds(simulation: &Simulation) -> Vec<f32> {
    let size = |cell: [usize; 3]| {
        let v = simulation.particle_velocity(cell);
        (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
    };
    let samples = 0..SAMPLES * SAMPLES * SAMPLES;
    samples
        .map(|n| {
            let (x, y, z) = (n % SAMPLES, n / SAMPLES % SAMPLES, n / SAMPLES / SAMPLES);
            size([SPONGE + x, SPONGE + y, AIR + z])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_ends_with_the_recorded_step() {
        assert_eq!(RECORDED % EACH, 0);
    }

    #[test]
    fn the_basin_is_a_bowl_in_rock_under_air() {
        let middle = SPONGE + SAMPLES / 2;
        let p = |x: usize, z: usize| material([x, middle, z]).map(|m| m[0]);
        assert_eq!(p(middle, AIR - 1), None);
        assert_eq!(p(middle, AIR), Some(2500.0));
        assert_eq!(p(middle, AIR + 10), Some(3500.0));
        assert_eq!(p(middle, AIR + 20), Some(5500.0));
        assert_eq!(p(SPONGE, AIR), Some(5500.0));
        let s = settings();
        // Courant's condition of the scheme in three dimensions.
        assert!(s.time_step < s.spacing / (3f64.sqrt() * 5500.0));
        assert_eq!(material(s.source).map(|m| m[0]), Some(5500.0));
    }
}
