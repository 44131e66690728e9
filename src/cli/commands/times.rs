//! The times of the steps of a series, as a user gives them.

use isospan::formats::StepSource;
use isospan::{Error, Result};

/// The times of steps.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Times {
    List(Vec<f64>),
    /// From a time on, so much later each.
    Regular {
        start: f64,
        step: f64,
    },
}

impl Times {
    /// Gives steps their times, in place of those in their files.
    pub(crate) fn apply(&self, steps: &mut [StepSource]) -> Result<()> {
        // The fields of a step have one time.
        let moment =
            |n: usize, step: &StepSource| step.part().and_then(|p| p.moment).map_or(n, |m| m as usize);
        let count = steps.iter().enumerate().map(|(n, step)| moment(n, step) + 1).max().unwrap_or(0);
        for (n, step) in steps.iter_mut().enumerate() {
            let n = moment(n, step);
            step.time = Some(match self {
                Self::Regular { start, step } => start + step * n as f64,
                Self::List(times) if times.len() == count => times[n],
                Self::List(times) => {
                    return Err(Error::usage(format!("`times` has {} times for {count} steps", times.len())));
                }
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::grammar::times;
    use super::*;
    use std::path::Path;

    #[test]
    fn steps_get_the_times_that_were_told() {
        let mut steps = vec![StepSource::new(Path::new("a"), &Default::default()); 3];
        times("10,10.5,...").unwrap().apply(&mut steps).unwrap();
        assert_eq!(steps[2].time, Some(11.0));
        let error = times("1,2").unwrap().apply(&mut steps).unwrap_err();
        assert_eq!(error.to_string(), "`times` has 2 times for 3 steps");
    }
}
