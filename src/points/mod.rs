//! Quasi-Monte Carlo point sets, enumerated box by box.
