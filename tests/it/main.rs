//! Tests of the library and the program from outside: a file a topic, all in one program, since
//! every program links the whole crate anew. `cargo test --test it cli::` runs those of one file.
//!
//! They run side by side in one process. A test that changes what a process has (environment
//! variables, limits, handlers of signals, the current folder) lets a child process do it, or is a
//! program of its own, next to this folder. So is `tests/datasets.rs`, for another reason: the
//! published crate has neither it nor the files that it reads.

mod adapt;
mod adapted_meshes;
mod architecture;
mod cli;
mod colours;
mod common;
mod corruption;
mod crash;
mod defaults;
mod determinism;
mod documents;
mod edges;
mod exits;
mod export_grids;
mod far;
mod fields;
mod fitted_meshes;
mod fuzz_finds;
mod given;
mod grids;
mod io;
mod label_images;
mod label_surfaces;
mod levels;
mod liars;
mod machines;
mod measure;
mod memory;
mod meshes;
mod missing;
mod nightly;
mod notices;
mod numbers;
mod offsets;
mod opens;
mod order;
mod own_meshes;
mod pictures;
mod pipeline;
mod polyhedra;
mod programs;
mod publish;
mod pyramid;
mod quadratic;
mod queries;
mod refine;
mod reports;
mod resample;
mod series;
mod servers;
mod settings;
mod shards;
mod shared_data;
mod slurm;
#[cfg(unix)]
mod special;
mod spectrum;
mod stretched;
mod surface_targets;
mod targets;
mod units;
#[cfg(all(feature = "view", unix))]
mod view;
mod writers;
