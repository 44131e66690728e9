//! isospan turns a scalar field that does not fit in memory into a small archive, once, and extracts from it any
//! isosurface, at any isovalue, in time proportional to the surface: watertight, and the same bytes every time.
//!
//! # How does it work?
//!
//! The field is sampled at quasi-Monte Carlo points ([`points`]: Hammersley, Halton, hyperbolic cross, and two lattices),
//! the points are joined by their Delaunay tetrahedralization ([`mesh`]), tetrahedra are packed into blocks ([`archive`]), and the
//! blocks are indexed by the range of their values in span space ([`index`]). A query reads the blocks that an isovalue
//! crosses and runs marching tetrahedra on them ([`surface`]). How large the surface would be is known before, at any isovalue ([`spectrum`]).
//!
//! All of it streams. A volume is read box by box ([`volume`], [`formats`]); a brick of the domain lists its own points from
//! the formula of the point set; a chunk of bricks is meshed by itself, with a halo, and keeps the tetrahedra that are certain to be
//! those of the whole. [`pipeline`] knows the order of these stages, and nothing else does.
//!
//! # Example
//!
//! ```
//! use isospan::exec::Silent;
//! use isospan::formats::{OpenOptions, surface::SurfaceFormat};
//! use isospan::Archive;
//! use isospan::pipeline::{Amount, ReduceSettings, RunSettings, SurfaceSettings, reduce};
//!
//! # fn main() -> isospan::Result<()> {
//! # let folder = tempfile::tempdir().unwrap();
//! # let dir = folder.path();
//! // 68³ samples of an electron density become 40 000 points …
//! let settings = ReduceSettings { amount: Amount::Count(40_000), ..ReduceSettings::default() };
//! let (volume, archive) = ("datasets/ironprot.vtk".as_ref(), dir.join("protein.isospan"));
//! let made = reduce(volume, &OpenOptions::default(), &settings, &archive, &RunSettings::default(), &Silent)?;
//! assert!((36_000..44_000).contains(&made.points), "a lattice has whole cells");
//!
//! // … and any isosurface comes out of them.
//! let query = SurfaceSettings::of(128.0);
//! let archive = Archive::open(&archive)?;
//! let found = archive.write_surface(&query, &dir.join("protein.ply"), SurfaceFormat::Ply, &Silent)?;
//! assert!(found.triangles > 9_000);
//! # Ok(())
//! # }
//! ```
//!
//! [`Archive`] asks everything that the command line can: surfaces in memory, counts, active tetrahedra, the field at points and on
//! grids, tetrahedra for other programs.
//!
//! ```
//! use isospan::Archive;
//! # use isospan::exec::Silent;
//! # use isospan::pipeline::{Amount, ReduceSettings, RunSettings, reduce};
//! # fn main() -> isospan::Result<()> {
//! # let folder = tempfile::tempdir().unwrap();
//! # let path = folder.path().join("protein.isospan");
//! # let settings = ReduceSettings { amount: Amount::Count(20_000), ..ReduceSettings::default() };
//! # reduce("datasets/ironprot.vtk".as_ref(), &Default::default(), &settings, &path, &RunSettings::default(), &Silent)?;
//! let archive = Archive::open(&path)?;
//! let mesh = archive.surface(128.0)?;
//! println!("{} triangles", mesh.triangles.len());
//! let values = archive.probe(&[[34.0, 34.0, 34.0], [-1.0, 0.0, 0.0]])?;
//! assert!(values[0].is_finite() && values[1].is_nan(), "the second point is outside");
//! # Ok(())
//! # }
//! ```
//!
//! A volume need not be in a file: samples in memory are one, and so is anything that answers for boxes of
//! samples ([`volume::VolumeReader`]).
//!
//! ```
//! use isospan::exec::Silent;
//! use isospan::formats::StepSource;
//! use isospan::pipeline::{Archive, ReduceSettings, RunSettings, reduce_series};
//! use isospan::volume::memory::volume_of;
//! use std::sync::Arc;
//!
//! # fn main() -> isospan::Result<()> {
//! # let folder = tempfile::tempdir().unwrap();
//! # let path = folder.path().join("ball.isospan");
//! let square = |i: usize| (i as f32 - 31.5).powi(2);
//! let samples: Vec<f32> =
//!     (0..64 * 64 * 64).map(|i| (square(i % 64) + square(i / 64 % 64) + square(i / 4096)).sqrt()).collect();
//! let volume = Arc::new(volume_of("ball", [64; 3], samples)?);
//! let (settings, run) = (ReduceSettings::default(), RunSettings::default());
//! reduce_series(&[StepSource::given("ball", volume)], &settings, &path, &run, &Silent)?;
//! let mesh = Archive::open(&path)?.surface(20.0)?;
//! assert!(mesh.triangles.len() > 1_000);
//! # Ok(())
//! # }
//! ```
//!
//! # Guarantees
//!
//! * The same input and parameters give the same bytes: for any number of threads, and after any interruption. Chunk size changes
//!   the layout of an archive, never its tetrahedra, and never the triangles of a surface.
//! * A surface is an oriented manifold, open only at the boundary of the domain and around missing samples.
//! * The tetrahedra of an archive fill the domain exactly; it is checked, in integers, before the archive is published.
//! * Bytes from a file never cause a panic or an unchecked allocation; errors name the file, the place, what was expected
//!   and what was found ([`Error`]).
//!
//! # Not promised
//!
//! * An input that is changed while it is read, without becoming shorter, is not noticed.
//! * The check of a surface needs 4 bytes of memory for each of its vertices.
//! * Values are `f32` inside. Where that would lose what matters of `f64` or wide integer samples, they are counted from an offset
//!   ([`Archive::offset`]), which is added wherever values come out. What is lost all the same is told, and errors include it.
//!
//! # Features
//!
//! * `cli` (default): the `isospan` program.
//! * `hdf5` (default): HDF5 and NetCDF-4 files, by a pure-Rust reader.
//! * `remote`: archives in object stores (`s3://…`) and on web servers (`https://…`), read by range requests.
//!
//! The library builds with none of them.
// What only vector code of x86-64 uses is looked for there.
#![cfg_attr(not(target_arch = "x86_64"), allow(dead_code, unused_imports, unused_mut))]

#[cfg(target_endian = "big")]
compile_error!(
    "isospan is for machines whose integers begin with the lowest byte: on s390x, Hammersley points were wrong"
);

pub mod archive;
pub mod bytes;
pub mod cells;
pub mod compare;
pub(crate) mod cpu;
pub mod density;
pub(crate) mod domain;
pub mod error;
pub mod exec;
pub mod fit;
pub mod formats;
pub mod geom;
pub mod grid;
pub mod index;
pub mod locate;
pub mod measure;
pub mod mesh;
pub mod pipeline;
pub mod points;
pub mod raster;
pub mod render;
pub mod sample;
pub mod spectrum;
pub mod surface;
pub mod tets;
pub mod volume;

pub use error::{Error, Result};
pub use exec::Resources;
pub use pipeline::Archive;

/// README's example compiles: it is one of the tests of the documentation.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
