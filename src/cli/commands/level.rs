//! The flags that choose a level of a pyramid.

use super::grammar;
use isospan::pipeline::{Bound, LevelChoice};

/// Which level of a pyramid answers.
#[derive(clap::Args, Debug)]
pub(crate) struct LevelArgs {
    /// The level of a pyramid (reduce --points pyramid): 0 is the finest, 1 has every second sample
    /// along each axis, and so on; isospan info lists them [default: 0].
    #[arg(help_heading = "Level", long, value_name = "L", value_parser = grammar::whole::<u32>, allow_negative_numbers = true, conflicts_with_all = ["triangles", "error"])]
    level: Option<u32>,
    /// The finest level of a pyramid whose surfaces have at most N triangles, those of all
    /// isovalues together, before components are chosen and triangles decimated. A surface that is
    /// cut may have some less. Only where there is an isovalue.
    #[arg(help_heading = "Level", long, value_name = "N", value_parser = grammar::natural, allow_negative_numbers = true, conflicts_with = "error")]
    triangles: Option<u64>,
    /// The coarsest level of a pyramid whose RMS error is at most E: 2.5 in units of the field, or
    /// 1% of the range of the samples. The errors of levels were measured by reduce; isospan info
    /// lists them.
    #[arg(help_heading = "Level", long, value_name = "E", value_parser = grammar::error, allow_hyphen_values = true)]
    error: Option<Bound>,
}

impl LevelArgs {
    /// The level that is chosen, if one is.
    pub(crate) fn choice(&self) -> Option<LevelChoice> {
        let level = self.level.map(LevelChoice::Level);
        level.or(self.triangles.map(LevelChoice::Triangles)).or(self.error.map(LevelChoice::Error))
    }

    /// The flags, and whether each is given.
    pub(crate) fn given(&self) -> [(bool, &'static str); 3] {
        [
            (self.level.is_some(), "--level"),
            (self.triangles.is_some(), "--triangles"),
            (self.error.is_some(), "--error"),
        ]
    }
}
