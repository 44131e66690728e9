//! A 3-D elastic wave by finite differences: the velocity-stress scheme on a staggered grid.
//!
//! Velocities v and stresses σ of an isotropic elastic body of density ρ and Lamé's parameters λ, μ
//! obey
//!
//! ```text
//! ρ ∂v_i/∂t  = Σ_j ∂σ_ij/∂x_j
//! ∂σ_ij/∂t   = λ δ_ij Σ_k ∂v_k/∂x_k + μ (∂v_i/∂x_j + ∂v_j/∂x_i)  -  ∂M_ij/∂t / V at the source
//! ```
//!
//! Each component lives half a cell away from the others (Virieux 1986; Madariaga 1976), so all
//! differences are central, of second order in space and time, and v and σ alternate:
//!
//! ```text
//!        z                     σxx σyy σzz   (i, j, k)
//!        │  vz ──── σxz        vx            (i+½, j, k)      σxy  (i+½, j+½, k)
//!        │  │       │          vy            (i, j+½, k)      σxz  (i+½, j, k+½)
//!        │  σxx ─── vx ──▶ x   vz            (i, j, k+½)      σyz  (i, j+½, k+½)
//! ```
//!
//! Densities at velocities are means of two cells, μ at shear stresses the harmonic mean of four:
//! zero where one of them is air. So air (λ = μ = 0, no motion) above the ground makes the free
//! surface by itself, with its Rayleigh waves (Zahradník, Moczo and Hron 1993). The other five
//! sides are lined with a sponge (Cerjan, Kosloff, Kosloff and Reshef 1985) that takes the waves
//! away.
//!
//! The source is a point dislocation, M_xz = M_zx, with a Ricker wavelet as moment rate. Everything
//! is `f32` and only `+ - *`, each cell by itself: the same bits for any number of threads. Memory:
//! 17 numbers a cell.

use rayon::prelude::*;

/// The material of a cell: P velocity, S velocity (m/s) and density (kg/m³); air has none.
pub(crate) type Material = Option<[f64; 3]>;

/// A simulation's settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Settings {
    /// Cells along each axis, z downwards.
    pub(crate) dims: [usize; 3],
    /// Edge of a cell in metres.
    pub(crate) spacing: f64,
    /// Seconds a step.
    pub(crate) time_step: f64,
    /// Cells of sponge at all sides but the upper one.
    pub(crate) sponge: usize,
    /// The cell of the source.
    pub(crate) source: [usize; 3],
    /// Peak frequency of its wavelet in hertz.
    pub(crate) frequency: f64,
}

/// Velocities, stresses and what they need of the material.
pub(crate) struct Simulation {
    settings: Settings,
    /// vx, vy, vz.
    velocity: [Vec<f32>; 3],
    /// σxx, σyy, σzz.
    normal: [Vec<f32>; 3],
    /// σyz, σxz, σxy: opposite of the axis.
    shear: [Vec<f32>; 3],
    /// Δt/(h ρ) at each velocity; zero where nothing moves.
    mobility: [Vec<f32>; 3],
    /// λ Δt/h.
    lambda: Vec<f32>,
    /// 2 μ Δt/h.
    twice_mu: Vec<f32>,
    /// μ Δt/h at σyz, σxz, σxy.
    mu: [Vec<f32>; 3],
    /// What the sponge leaves, by distance from a side.
    damping: [Vec<f32>; 3],
    step: usize,
}

impl Simulation {
    /// At rest.
    pub(crate) fn new(settings: Settings, material: impl Fn([usize; 3]) -> Material) -> Self {
        let [nx, ny, nz] = settings.dims;
        let cells = nx * ny * nz;
        let at = |n: usize| [n % nx, n / nx % ny, n / nx / ny];
        let solid: Vec<Material> = (0..cells).map(|n| material(at(n))).collect();
        let rate = settings.time_step / settings.spacing;
        let mu_of = |m: Material| m.map_or(0.0, |[_, s, density]| s * s * density);
        let lambda_of = |m: Material| m.map_or(0.0, |[p, s, density]| (p * p - 2.0 * s * s) * density);
        let next = |n: usize, axis: usize| {
            let inside = at(n)[axis] + 1 < settings.dims[axis];
            inside.then(|| n + [1, nx, nx * ny][axis])
        };
        let mobility = |axis: usize| -> Vec<f32> {
            let of = |n: usize| {
                let (Some(here), Some(there)) = (solid[n], next(n, axis).and_then(|m| solid[m])) else {
                    // Half of the cell at the ground is air: the mean density is half.
                    let ground = solid[n].or(next(n, axis).and_then(|m| solid[m]));
                    let on_ground = axis == 2 && next(n, axis).is_some();
                    return ground.filter(|_| on_ground).map_or(0.0, |[_, _, d]| rate / (0.5 * d));
                };
                rate / (0.5 * (here[2] + there[2]))
            };
            (0..cells).map(|n| of(n) as f32).collect()
        };
        let shear_mu = |axis: usize| -> Vec<f32> {
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            let of = |n: usize| {
                let four = [Some(n), next(n, b), next(n, c), next(n, b).and_then(|m| next(m, c))];
                let mus = four.map(|m| m.map_or(0.0, |m| mu_of(solid[m])));
                let all = mus.iter().all(|&mu| mu > 0.0);
                if all { rate * 4.0 / mus.iter().map(|mu| 1.0 / mu).sum::<f64>() } else { 0.0 }
            };
            (0..cells).map(|n| of(n) as f32).collect()
        };
        let zeros = || std::array::from_fn(|_| vec![0f32; cells]);
        Self {
            settings,
            velocity: zeros(),
            normal: zeros(),
            shear: zeros(),
            mobility: std::array::from_fn(mobility),
            lambda: solid.iter().map(|&m| (rate * lambda_of(m)) as f32).collect(),
            twice_mu: solid.iter().map(|&m| (rate * 2.0 * mu_of(m)) as f32).collect(),
            mu: std::array::from_fn(shear_mu),
            damping: std::array::from_fn(|axis| sponge(&settings, axis)),
            step: 0,
        }
    }

    /// Seconds since the start.
    pub(crate) fn time(&self) -> f64 {
        self.step as f64 * self.settings.time_step
    }

    /// Goes one time step on.
    pub(crate) fn advance(&mut self) {
        self.move_velocities();
        self.move_stresses();
        self.add_source();
        self.damp();
        self.step += 1;
    }

    fn move_velocities(&mut self) {
        let [nx, ny, _] = self.settings.dims;
        let plane = nx * ny;
        let (normal, shear, mobility) = (&self.normal, &self.shear, &self.mobility);
        for axis in 0..3 {
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            let strides = [1, nx, plane];
            let (own, by_b, by_c) = (&normal[axis], &shear[c], &shear[b]);
            each_row(&mut self.velocity[axis], self.settings.dims, |row, from| {
                for (i, v) in row.iter_mut().enumerate().skip(1) {
                    let n = from + i;
                    let force = own[n + strides[axis]] - own[n] + by_b[n] - by_b[n - strides[b]] + by_c[n]
                        - by_c[n - strides[c]];
                    *v += mobility[axis][n] * force;
                }
            });
        }
    }

    fn move_stresses(&mut self) {
        let [nx, ny, _] = self.settings.dims;
        let strides = [1, nx, nx * ny];
        let [vx, vy, vz] = &self.velocity;
        let (lambda, twice_mu) = (&self.lambda, &self.twice_mu);
        for axis in 0..3 {
            let (own, stride) = (&self.velocity[axis], strides[axis]);
            each_row(&mut self.normal[axis], self.settings.dims, |row, from| {
                for (i, stress) in row.iter_mut().enumerate().skip(1) {
                    let n = from + i;
                    let growth = vx[n] - vx[n - 1] + vy[n] - vy[n - strides[1]] + vz[n] - vz[n - strides[2]];
                    *stress += lambda[n] * growth + twice_mu[n] * (own[n] - own[n - stride]);
                }
            });
        }
        for axis in 0..3 {
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            let (vb, vc, mu) = (&self.velocity[b], &self.velocity[c], &self.mu[axis]);
            each_row(&mut self.shear[axis], self.settings.dims, |row, from| {
                for (i, stress) in row.iter_mut().enumerate().skip(1) {
                    let n = from + i;
                    *stress += mu[n] * (vb[n + strides[c]] - vb[n] + vc[n + strides[b]] - vc[n]);
                }
            });
        }
    }

    /// Adds the moment rate, of size 1, to σxz at the source: the field is scaled afterwards
    /// anyway.
    fn add_source(&mut self) {
        let s = &self.settings;
        let n = (s.source[2] * s.dims[1] + s.source[1]) * s.dims[0] + s.source[0];
        let delay = 1.2 / s.frequency;
        let a = std::f64::consts::PI * s.frequency * (self.time() - delay);
        self.shear[1][n] -= ((1.0 - 2.0 * a * a) * libm::exp(-a * a)) as f32;
    }

    fn damp(&mut self) {
        let (dims, damping) = (self.settings.dims, &self.damping);
        let fields = self.velocity.iter_mut().chain(&mut self.normal).chain(&mut self.shear);
        for field in fields {
            field.par_chunks_mut(dims[0]).enumerate().for_each(|(number, row)| {
                let (y, z) = (number % dims[1], number / dims[1]);
                let outer = damping[1][y] * damping[2][z];
                row.iter_mut().zip(&damping[0]).for_each(|(v, d)| *v *= d * outer);
            });
        }
    }

    /// The particle velocity in the middle of a cell that is not at a side.
    pub(crate) fn particle_velocity(&self, [x, y, z]: [usize; 3]) -> [f32; 3] {
        let [nx, ny, _] = self.settings.dims;
        let n = (z * ny + y) * nx + x;
        let strides = [1, nx, nx * ny];
        std::array::from_fn(|k| 0.5 * (self.velocity[k][n] + self.velocity[k][n - strides[k]]))
    }
}

/// Hands each row of cells that is not at a side, and the number of its first cell, to `each`; its
/// last cell is left out.
fn each_row(field: &mut [f32], [nx, ny, nz]: [usize; 3], each: impl Fn(&mut [f32], usize) + Sync) {
    field.par_chunks_mut(nx).enumerate().for_each(|(number, row)| {
        let (y, z) = (number % ny, number / ny);
        if (1..ny - 1).contains(&y) && (1..nz - 1).contains(&z) {
            each(&mut row[..nx - 1], number * nx);
        }
    });
}

/// Factors along an axis: exp(-(0.015 d)²), d cells into the sponge; none above the ground.
fn sponge(settings: &Settings, axis: usize) -> Vec<f32> {
    let n = settings.dims[axis];
    let depth = |i: usize| {
        let low = if axis == 2 { 0 } else { settings.sponge.saturating_sub(i) };
        low.max((i + 1 + settings.sponge).saturating_sub(n)) as f64
    };
    let factor = |d: f64| libm::exp(-(0.015 * d) * (0.015 * d)) as f32;
    (0..n).map(|i| factor(depth(i))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rock(_: [usize; 3]) -> Material {
        Some([4000.0, 2300.0, 2500.0])
    }

    fn settings() -> Settings {
        Settings {
            dims: [60, 50, 50],
            spacing: 100.0,
            time_step: 0.01,
            sponge: 8,
            source: [20, 25, 25],
            frequency: 2.5,
        }
    }

    /// Seconds at which the magnitude of the velocity at each cell first exceeds a tenth of its
    /// largest.
    fn arrivals<const N: usize>(cells: [[usize; 3]; N]) -> [f64; N] {
        let mut simulation = Simulation::new(settings(), rock);
        let mut seen = cells.map(|_| vec![]);
        for _ in 0..150 {
            simulation.advance();
            for (cell, seen) in cells.iter().zip(&mut seen) {
                let v = simulation.particle_velocity(*cell);
                seen.push((simulation.time(), v.iter().map(|x| x * x).sum::<f32>().sqrt()));
            }
        }
        seen.map(|seen| {
            let most = seen.iter().map(|s| s.1).fold(0.0, f32::max);
            assert!(most > 0.0 && most.is_finite());
            seen.iter().find(|s| s.1 > 0.1 * most).expect("the largest is larger than a tenth of it").0
        })
    }

    /// A double couple in the xz plane radiates only S waves along x, and P waves in the diagonal
    /// of x and z.
    #[test]
    fn waves_travel_at_their_velocities() {
        let [near_s, far_s, near_p, far_p] =
            arrivals([[28, 25, 25], [44, 25, 25], [26, 25, 31], [36, 25, 41]]);
        let s = 1600.0 / (far_s - near_s);
        assert!((2000.0..2600.0).contains(&s), "S wave at {s} m/s");
        let p = 1000.0 * 2f64.sqrt() / (far_p - near_p);
        assert!((3300.0..4700.0).contains(&p), "P wave at {p} m/s");
    }

    /// The same bits on every machine, and for any number of threads.
    #[test]
    fn a_wave_is_the_same_everywhere() {
        let mut simulation = Simulation::new(settings(), rock);
        (0..40).for_each(|_| simulation.advance());
        let bits: Vec<u8> = simulation.velocity.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(format!("{:016x}", xxhash_rust::xxh3::xxh3_64(&bits)), "6b2bbc1c89063cec");
    }

    #[test]
    fn waves_leave_through_the_sides_and_not_into_the_air() {
        let ground = |[_, _, z]: [usize; 3]| if z < 3 { None } else { rock([0; 3]) };
        let thick = Settings { dims: [80, 70, 60], sponge: 20, source: [40, 35, 20], ..settings() };
        let mut simulation = Simulation::new(thick, ground);
        let energy = |s: &Simulation| -> f64 {
            s.velocity.iter().flatten().map(|&v| f64::from(v) * f64::from(v)).sum()
        };
        let mut most = 0f64;
        for _ in 0..400 {
            simulation.advance();
            most = most.max(energy(&simulation));
        }
        assert!(energy(&simulation) < 0.02 * most, "{} of {most}", energy(&simulation));
        let top: f32 = (1..79).map(|x| simulation.particle_velocity([x, 35, 1])[0].abs()).sum();
        assert_eq!(top, 0.0);
    }
}
