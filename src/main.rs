//! The `isospan` program.

fn main() {}
