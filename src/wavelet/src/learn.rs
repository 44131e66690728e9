//! Counts of decisions, of which the tables of the format are made: see `examples/learn.rs`.

use crate::decode::Compressed;
use crate::error::Result;
use crate::model::{CORRECTIONS, Model, Odd};
use crate::range_coder::{Coder, Odds};
use crate::tables::{PER_SET, TABLES};
use crate::tile::walk_numbers;

/// How often a bit was not set and set, of each of the format's odds, in the order of the tables.
pub type Counts = Vec<[u64; 2]>;

/// Counts instead of coding. Each odds are the number of their decision.
struct Counter<'a>(&'a mut Counts);

impl Coder for Counter<'_> {
    const ENCODES: bool = true;

    fn bit(&mut self, odds: &mut Odds, bit: bool) -> bool {
        self.0[odds.set() as usize][usize::from(bit)] += 1;
        bit
    }

    fn even(&mut self, bit: bool) -> bool {
        bit
    }
}

/// Adds the decisions of a compressed array to `counts`, which begin empty.
pub fn count(array: &Compressed<'_>, counts: &mut Counts) -> Result<()> {
    counts.resize(TABLES.len() * PER_SET, [0; 2]);
    for level in 1..=array.pyramid().coarsest() {
        array.each_tile(level, |mut tile, parent| {
            let first = (level - 1) % 3 * 3;
            let set = |highs| Odd::numbered(((first + highs) * PER_SET) as u16);
            let mut model = Model { sets: std::array::from_fn(set) };
            tile.walk(array.pyramid(), parent, &mut model, &mut Counter(counts), None)
        })?;
    }
    array.each_correction(|part| {
        let mut odds = Odd::numbered((CORRECTIONS * PER_SET) as u16);
        walk_numbers(part, &mut odds, &mut Counter(counts))
    })
}

/// The tables that counts and, where there are few, those of now make: the source of `tables.rs`.
pub fn tables(counts: &Counts) -> String {
    let mut text = String::new();
    for (set, old) in TABLES.iter().enumerate() {
        text += "    [\n";
        let new = old.iter().zip(&counts[set * PER_SET..]).map(|(old, [clear, set])| {
            // The old odds count as 8 decisions.
            let (all, set) = ((clear + set + 8) as f64, *set as f64 + 8.0 * f64::from(*old) / 65_536.0);
            let [least, most] = Odds::LIMITS;
            ((65_536.0 * set / all) as u16).clamp(least, most).to_string()
        });
        let new: Vec<String> = new.collect();
        let (head, rows) = new.split_at(6);
        for row in [head].into_iter().chain(rows.chunks(20)) {
            text += &format!("        {},\n", row.join(", "));
        }
        text += "    ],\n";
    }
    text
}
