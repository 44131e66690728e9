//! isospan turns a scalar field that does not fit in memory into a small archive, once, and
//! extracts from it any isosurface, at any isovalue, in time proportional to the surface:
//! watertight, and the same bytes every time.
//!
//! # How does it work?
//!
//! There are two kinds of archives. A volume is a **pyramid**: all its samples, as coefficients of
//! a wavelet transform, with coarser levels. It meets an error that is asked for, 1 % of the range
//! in the root mean square if none is; marching cubes make its surfaces. Unstructured meshes, and
//! volumes for which a point set is named, are **points with their tetrahedra**. The points are a
//! mesh's own vertices, or those of a quasi-Monte Carlo set ([`points`]: Hammersley, Halton,
//! hyperbolic cross, regular) at which the field is sampled, joined by their Delaunay
//! tetrahedralization.
//!
//! Cells or tetrahedra are packed into blocks, and these are indexed by the range of their values
//! in span space. A query reads the blocks that an isovalue crosses and runs marching cubes or
//! marching tetrahedra on them ([`surface`]). How large the surface would be is known before, at
//! any isovalue ([`Step::spectrum`]).
//!
//! All of it streams. A volume is read box by box ([`volume`], [`formats`]). A chunk of a pyramid
//! is transformed with a halo, and its coefficients are those of the whole. A brick of the domain
//! lists its own points from the formula of the point set; a chunk of bricks is meshed by itself,
//! with a halo, and keeps the tetrahedra that are certain to be those of the whole.
//!
//! # Where is what?
//!
//! What most programs need is named here, at the root. [`pipeline`] has all settings and reports,
//! [`formats`] what other programs' files say. The stages themselves are public for benchmarks, and
//! hidden from these pages: they may change with any version. ARCHITECTURE.md describes them.
//!
//! # Example
//!
//! ```
//! use isospan::{Archive, Reduction, volume_of};
//!
//! # fn main() -> isospan::Result<()> {
//! # let folder = tempfile::tempdir().unwrap();
//! # let path = folder.path().join("ball.isospan");
//! let square = |i: usize| (i as f32 - 31.5).powi(2);
//! let samples: Vec<f32> =
//!     (0..64 * 64 * 64).map(|i| (square(i % 64) + square(i / 64 % 64) + square(i / 4096)).sqrt()).collect();
//! Reduction::of(volume_of("ball", [64; 3], samples)?).write(&path)?;
//! let mesh = Archive::open(&path)?.surface(20.0)?;
//! println!("{} triangles", mesh.triangles.len());
//! # assert!(mesh.triangles.len() > 1_000);
//! # Ok(())
//! # }
//! ```
//!
//! Of a file, with surfaces in a file, and little memory:
//!
//! ```
//! use isospan::pipeline::{Bound, Target};
//! use isospan::{Archive, Reduction, Resources};
//!
//! # fn main() -> isospan::Result<()> {
//! # let folder = tempfile::tempdir().unwrap();
//! # let dir = folder.path();
//! // 68³ samples of an electron density, kept to an RMS error of 2 % of their range …
//! let path = dir.join("protein.isospan");
//! let little = Resources::default().with_memory(256 << 20);
//! let error = Target::Rms(Bound::OfRange(0.02));
//! let protein = Reduction::of("datasets/ironprot.vtk").target(error).resources(little.clone());
//! let made = protein.write(&path)?;
//! assert!(made.archive_bytes < 8_000, "a fortieth of the file");
//!
//! // … and any isosurface comes out of them.
//! let archive = Archive::open(&path)?;
//! let found = archive.query(128.0).resources(little).write(dir.join("protein.ply"))?;
//! assert!(found.triangles > 9_000);
//!
//! // Other questions: counts, the field at points, on grids, active tetrahedra.
//! let values = archive.probe(&[[34.0, 34.0, 34.0], [-1.0, 0.0, 0.0]])?;
//! assert!(values[0].is_finite() && values[1].is_nan(), "the second point is outside");
//! # Ok(())
//! # }
//! ```
//!
//! An [`Archive`] has [`Step`]s, which answer everything that the command line can:
//! `archive.step(3)?.query(600.0).mesh()?`. A volume of the program need not be in memory: anything
//! that answers for boxes of samples is one ([`VolumeReader`]).
//!
//! # Guarantees
//!
//! * The same input and parameters give the same bytes: for any number of threads, and after any
//!   interruption. The size of chunks of points changes the layout of an archive, never its
//!   tetrahedra, and never the triangles of a surface.
//! * A surface is an oriented manifold, open only at the boundary of the domain and around missing
//!   samples.
//! * A pyramid is decoded, and compared with its source, before the archive is published.
//!   Tetrahedra fill the domain exactly; that is checked before, too, in integers.
//! * A file that changes while an archive is made of it ends the run, before anything made from the
//!   change is stored. Length, times and inode of a file tell, or what a server says of it.
//! * Bytes from a file never cause a panic or an unchecked allocation; errors name the file, the
//!   place, what was expected and what was found ([`Error`]).
//!
//! # Not promised
//!
//! * A change of an input that leaves its length, times and inode as they were is not noticed, nor
//!   is one while a finished archive is measured against its source.
//! * The check of a surface needs 4 bytes of memory for each of its vertices.
//! * Values are `f32` inside. Where that would lose what matters of `f64` or wide integer samples,
//!   they are counted from an offset ([`Step::offset`]), which is added wherever values come out.
//!   Reports say what is lost all the same, and errors include it.
//!
//! # Features
//!
//! * `compare` (default): distances between surfaces.
//! * `hdf5` (default): HDF5 and NetCDF-4 files, by a pure-Rust reader.
//! * `remote` (default): archives and volumes in object stores (`s3://…`) and on web servers
//!   (`https://…`), read by ranges.
//!
//! The library builds with none of them.
#![cfg_attr(docsrs, feature(doc_cfg))]
// What only vector code of x86-64 uses is looked for there.
#![cfg_attr(not(target_arch = "x86_64"), allow(dead_code, unused_imports, unused_mut))]

#[doc(hidden)]
pub mod archive;
#[cfg(feature = "compare")]
pub mod compare;
#[doc(hidden)]
pub mod density;
pub(crate) mod domain;
pub(crate) mod files;
#[doc(hidden)]
pub mod fit;
/// Other programs' files: volumes and meshes are read, surfaces are read and written.
pub mod formats {
    pub use crate::files::{labels, surface};
    pub use isospan_io::formats::*;
}
#[doc(hidden)]
pub mod index;
pub mod measure;
#[doc(hidden)]
pub mod phase;
pub mod pipeline;
pub mod render;
#[doc(hidden)]
pub mod spectrum;
pub mod surface;
#[doc(hidden)]
pub mod tets;

/// The features that the library was compiled with, in alphabetical order.
pub fn features() -> Vec<&'static str> {
    let all = [
        ("compare", cfg!(feature = "compare")),
        ("hdf5", cfg!(feature = "hdf5")),
        ("remote", cfg!(feature = "remote")),
    ];
    all.into_iter().filter(|(_, is_there)| *is_there).map(|(name, _)| name).collect()
}

#[doc(hidden)]
pub use isospan_io::{bytes, cells, geom};
pub use isospan_io::{error, exec, grid, setting, volume};
#[doc(hidden)]
pub use isospan_mesh::{locate, mesh, raster};
pub use isospan_mesh::{points, sample};

pub use error::{Error, ErrorKind, Result};
pub use exec::{CancelToken, Progress, Resources};
pub use formats::StepSource;
pub use pipeline::{Addition, Archive, ReduceSettings, Reduction, Step, StepChoice, SurfaceQuery};
pub use surface::TriMesh;
pub use volume::VolumeReader;
pub use volume::memory::volume_of;

/// README's example compiles: it is one of the tests of the documentation.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
