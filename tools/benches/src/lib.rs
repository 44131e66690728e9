//! Times the stages of isospan: the programs of `benches`.
