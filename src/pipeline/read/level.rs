//! Which level of a pyramid a question is asked of.

use super::pyramid::pyramid_of;
use super::step_view::StepView;
use crate::error::{Error, Result};
use crate::pipeline::settings::Bound;

/// Which level of a pyramid answers a question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LevelChoice {
    /// The one of this number: 0 is the finest, each further one has half as many nodes along each
    /// axis that is split.
    Level(u32),
    /// The finest one whose surfaces have at most so many triangles, those of all isovalues
    /// together, before components are chosen and triangles decimated.
    Triangles(u64),
    /// The coarsest one whose RMS error is at most this, as it was measured when the archive was
    /// made. A part is one of the range of the samples.
    Error(Bound),
}

impl LevelChoice {
    /// The flag of the command line.
    pub(in crate::pipeline) fn flag(self) -> &'static str {
        match self {
            Self::Level(_) => "--level",
            Self::Triangles(_) => "--triangles",
            Self::Error(_) => "--error",
        }
    }
}

impl StepView {
    /// The level of a question that has no surface; the finest one where none is chosen.
    ///
    /// # Errors
    /// [`Error::Usage`] for an archive without levels, for a level that is not there, for an error
    /// that no level has, and for a number of triangles.
    pub(in crate::pipeline) fn level(&self, choice: Option<LevelChoice>) -> Result<usize> {
        let Some(choice) = choice else { return Ok(0) };
        let coarsest = self.coarsest_level(choice)?;
        match choice {
            LevelChoice::Level(level) => match usize::try_from(level).ok().filter(|l| *l <= coarsest) {
                Some(level) => Ok(level),
                None => Err(Error::usage(format!(
                    "{} has no level {level}: it has levels 0 (the finest) to {coarsest}",
                    self.path().display()
                ))),
            },
            LevelChoice::Triangles(_) => Err(Error::usage(
                "--triangles chooses a level by its surfaces, and here is none: give --level or --error",
            )),
            LevelChoice::Error(bound) => self.level_of_error(bound),
        }
    }

    /// The coarsest level.
    ///
    /// # Errors
    /// [`Error::Usage`] for an archive without levels, from which a level is chosen.
    pub(in crate::pipeline) fn coarsest_level(&self, choice: LevelChoice) -> Result<usize> {
        let pyramid = pyramid_of(self.manifest.plan.points);
        pyramid.map(|pyramid| pyramid.coarsest()).ok_or_else(|| {
            Error::usage(format!(
                "{} is no pyramid: it has no levels, from which {} chooses one",
                self.path().display(),
                choice.flag()
            ))
        })
    }

    /// The coarsest level with an error of at most so much.
    fn level_of_error(&self, bound: Bound) -> Result<usize> {
        let _ = bound;
        Err(Error::usage("--error: not yet"))
    }
}
