//! The thesis's five data sets, made again (its Tables 3.1 and 4.1): each the same bytes on every
//! machine.
//!
//! | name | what | file | isovalue |
//! |---|---|---|---|
//! | SPHERE | x² + y² + z² - 0.4² on [-½, ½]³, 50³ samples | `sphere.vti` | 0 |
//! | SEIS | the size of the particle velocity of an elastic wave in a layered basin ([`seis`]), 50³ samples | `seis.vti`; the series `seis/step_*.vti`, `seis/seis.pvd` | 0.49 |
//! | HEART, TORSO, HEAD | the potential of a current dipole in a conducting body ([`fem`], [`anatomy`]) | `*.vtu` | see [`Made::isovalue`] |

mod anatomy;
mod bisect;
mod ellipsoids;
mod fem;
mod seis;
pub(crate) mod tets;
mod wave;

use anatomy::Body;
use isospan::exec::CancelToken;
use isospan::formats::samples::{GridMeta, SampleField, SampleFile, SampleFormat};
use isospan::grid::Geometry;
use isospan::{Error, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use tets::TetMesh;

/// A data set of the thesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Dataset {
    Sphere,
    Seis,
    Heart,
    Torso,
    Head,
}

/// The data themselves.
pub(crate) enum Content {
    /// 50³ samples, x fastest.
    Grid {
        geometry: Geometry,
        samples: Vec<f32>,
    },
    Mesh(TetMesh),
}

/// A data set that was made.
pub(crate) struct Made {
    pub(crate) dataset: Dataset,
    pub(crate) file: PathBuf,
    pub(crate) content: Content,
    pub(crate) isovalue: f32,
    /// How it was made, one sentence.
    pub(crate) origin: String,
}

/// Samples along each axis of the structured sets.
pub(crate) const GRID: usize = seis::SAMPLES;

impl Made {
    /// Samples, or values of the vertices.
    pub(crate) fn values(&self) -> &[f32] {
        match &self.content {
            Content::Grid { samples, .. } => samples,
            Content::Mesh(mesh) => &mesh.values,
        }
    }
}

impl Dataset {
    pub(crate) const ALL: [Self; 5] = [Self::Sphere, Self::Seis, Self::Heart, Self::Torso, Self::Head];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Sphere => "SPHERE",
            Self::Seis => "SEIS",
            Self::Heart => "HEART",
            Self::Torso => "TORSO",
            Self::Head => "HEAD",
        }
    }

    /// Makes the data set and writes its files into a folder. `shared` holds real geometries.
    ///
    /// # Errors
    /// Those of reading a geometry and of writing the files.
    pub(crate) fn make(self, folder: &Path, shared: Option<&Path>) -> Result<Made> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io("create the folder", folder, e))?;
        match self {
            Self::Sphere => sphere(folder),
            Self::Seis => seis_in(folder),
            Self::Heart => self.field_in(anatomy::heart(shared)?, folder),
            Self::Torso => self.field_in(anatomy::torso(shared)?, folder),
            Self::Head => self.field_in(anatomy::head()?, folder),
        }
    }

    fn field_in(self, body: Body, folder: &Path) -> Result<Made> {
        let Body { mut mesh, conductivities, dipole, geometry } = body;
        let solved = fem::solve(&mut mesh, &conductivities, &dipole)?;
        let file = folder.join(format!("{}.vtu", self.name().to_lowercase()));
        mesh.write(&file)?;
        let [x, y, z] = dipole.position;
        let [p, q, r] = dipole.moment;
        let conductivities = conductivities.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        let origin = format!(
            "{geometry}; potential (µV) of a dipole of ({p}, {q}, {r}) nA·m at ({x:.1}, {y:.1}, {z:.1}) mm, conductivities \
             {conductivities} S/m; {} conjugate gradient steps to a residual of {:.0e}",
            solved.iterations, solved.residual
        );
        let share = if self == Self::Head { 0.7 } else { 0.9 };
        let isovalue = two_digits(quantile(&mesh.values, share));
        Ok(Made { dataset: self, file, content: Content::Mesh(mesh), isovalue, origin })
    }
}

/// The value that a share of the values is below.
pub(crate) fn quantile(values: &[f32], share: f64) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    sorted[(share * (sorted.len() - 1) as f64) as usize]
}

/// The nearest number of two significant digits.
fn two_digits(value: f32) -> f32 {
    format!("{value:.1e}").parse().expect("a number was written")
}

fn sphere(folder: &Path) -> Result<Made> {
    let last = (GRID - 1) as f64;
    let at = |i: usize| i as f64 / last - 0.5;
    let f = |n: usize| {
        let [x, y, z] = [n % GRID, n / GRID % GRID, n / GRID / GRID].map(at);
        (x * x + y * y + z * z - 0.4 * 0.4) as f32
    };
    let samples: Vec<f32> = (0..GRID * GRID * GRID).map(f).collect();
    let geometry = Geometry { origin: [-0.5; 3], spacing: [1.0 / last; 3], ..Geometry::default() };
    let file = folder.join("sphere.vti");
    write_grid(&file, &geometry, "f", &samples)?;
    let origin = "x² + y² + z² - 0.4² on [-½, ½]³".into();
    Ok(Made {
        dataset: Dataset::Sphere,
        file,
        content: Content::Grid { geometry, samples },
        isovalue: 0.0,
        origin,
    })
}

fn seis_in(folder: &Path) -> Result<Made> {
    let series = folder.join("seis");
    std::fs::create_dir_all(&series).map_err(|e| Error::io("create the folder", &series, e))?;
    // Depth is downwards: the third axis is mirrored, so that up is up.
    let spacing = seis::SPACING / 1000.0;
    let direction = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]];
    let geometry = Geometry { origin: [0.0; 3], spacing: [spacing; 3], direction };
    let mut frames = seis::simulate();
    let mut list = String::from(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n  <Collection>\n",
    );
    for frame in &frames {
        let name = format!("step_{:04}.vti", frame.step);
        write_grid(&series.join(&name), &geometry, "speed", &frame.speeds)?;
        let _ = writeln!(list, "    <DataSet timestep=\"{:.3}\" file=\"{name}\"/>", frame.seconds);
    }
    list += "  </Collection>\n</VTKFile>\n";
    let pvd = series.join("seis.pvd");
    std::fs::write(&pvd, list).map_err(|e| Error::io("write", &pvd, e))?;
    let recorded = frames.pop().expect("the last frame is the recorded one");
    let file = folder.join("seis.vti");
    write_grid(&file, &geometry, "speed", &recorded.speeds)?;
    let origin = format!(
        "3-D elastic finite differences (velocity-stress, staggered) in a layered basin; size of the particle velocity after {} \
         steps ({:.2} s), in units of its 95th percentile; {} steps as a series",
        recorded.step,
        recorded.seconds,
        frames.len() + 1
    );
    let content = Content::Grid { geometry, samples: recorded.speeds };
    Ok(Made { dataset: Dataset::Seis, file, content, isovalue: 0.49, origin })
}

fn write_grid(path: &Path, geometry: &Geometry, field: &str, samples: &[f32]) -> Result<()> {
    let meta = GridMeta::even([GRID as u64; 3], *geometry, SampleField::floats(field, 0.0));
    let file = SampleFile::create(path, SampleFormat::Vti, &meta, false, None)?;
    file.write(0, samples)?;
    file.publish(None, &CancelToken::default())?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_to_two_digits() {
        assert_eq!([two_digits(0.0234), two_digits(-1270.0), two_digits(9.96)], [0.023, -1300.0, 10.0]);
        assert_eq!(quantile(&[5.0, 1.0, 3.0, 4.0, 2.0], 0.75), 4.0);
    }

    /// Of the sets that are made in no time: their files are those of the table.
    #[test]
    fn files_have_their_checksums() {
        use sha2::{Digest, Sha256};
        let folder = tempfile::tempdir().unwrap();
        let table = include_str!("../../../../datasets/generated.tsv");
        for dataset in [Dataset::Sphere, Dataset::Heart] {
            let made = dataset.make(folder.path(), None).unwrap();
            let bytes = std::fs::read(&made.file).unwrap();
            let sum: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
            let mut row = table.lines().map(|l| l.split('\t').collect::<Vec<_>>()).filter(|r| r[2] == sum);
            assert_eq!(row.next().map(|r| (r[0], r[4])), Some((dataset.name(), &*made.isovalue.to_string())));
        }
    }

    #[test]
    fn a_sphere_has_its_radius() {
        let folder = tempfile::tempdir().unwrap();
        let made = Dataset::Sphere.make(folder.path(), None).unwrap();
        let Content::Grid { geometry, samples } = made.content else { panic!("a grid") };
        assert_eq!(samples.len(), 125_000);
        assert!(geometry.to_world([49.0; 3]).iter().all(|x| (x - 0.5).abs() < 1e-12));
        let inside = samples.iter().filter(|&&v| v < made.isovalue).count() as f64;
        let volume = 4.0 / 3.0 * std::f64::consts::PI * 0.4f64.powi(3) * 49f64.powi(3);
        assert!((inside / volume - 1.0).abs() < 0.01);
    }
}
