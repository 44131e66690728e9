//! The odds at the beginning of a block. They are part of the format.

use super::DECISIONS;
use crate::archive::range_coder::Odds;

/// For each decision the odds that its bit is set, in 1/65536. They are averages over meshes of all
/// point sets, made by a test of `tests.rs` (`cargo test first_odds -- --ignored`).
#[rustfmt::skip]
pub(super) const SET: [u16; DECISIONS] = [
    59241, 4822, 32768, 32082, 31924, 29139, 0, 0, 0, 0, 65535, 6621, 58859, 43075, 34795, 32937, 27093,
    30497, 35912, 23339, 55870, 39556, 34745, 37596, 35764, 33396, 30775, 8534,
];

/// The same, none of them certain.
static FIRST: [Odds; DECISIONS] = {
    let (mut odds, mut i) = ([Odds::new(0); DECISIONS], 0);
    while i < DECISIONS {
        odds[i] = Odds::new(SET[i]);
        i += 1;
    }
    odds
};

/// What a block begins with.
pub(super) fn first_odds() -> [Odds; DECISIONS] {
    FIRST
}
