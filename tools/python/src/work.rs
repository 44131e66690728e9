//! Work on a thread of its own, without the GIL. The calling thread waits for it, runs signal
//! handlers and reports progress meanwhile; an exception of either (Ctrl-C is one) stops the work
//! and is raised.

use crate::errors::exception;
use crate::words::in_keywords;
use isospan::exec::{Attempt, CancelToken, Progress};
use pyo3::prelude::*;
use std::panic::resume_unwind;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often signals are looked for.
const TICK: Duration = Duration::from_millis(50);

/// A stage of the work, and how far it is.
#[derive(Clone, Debug, PartialEq)]
struct Stage {
    name: String,
    done: u64,
    total: u64,
    unit: String,
}

/// What the work has said, and the caller has not heard yet.
#[derive(Default)]
struct Heard {
    /// The last one is going on.
    stages: Vec<Stage>,
    notices: Vec<String>,
}

#[derive(Default)]
struct Telephone {
    heard: Mutex<Heard>,
    /// The try for a target that stages belong to.
    of_try: Mutex<Option<String>>,
    ended: Mutex<bool>,
    end: Condvar,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Progress for Telephone {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        let of_try = lock(&self.of_try).clone();
        let name = of_try.map_or(stage.to_owned(), |of_try| format!("{of_try}: {stage}"));
        let stage = Stage { name, done: 0, total, unit: unit.to_owned() };
        lock(&self.heard).stages.push(stage);
    }

    fn advance(&self, units: u64) {
        if let Some(stage) = lock(&self.heard).stages.last_mut() {
            stage.done += units;
        }
    }

    fn end(&self) {}

    fn notice(&self, line: &str) {
        lock(&self.heard).notices.push(in_keywords(line));
    }

    fn attempt(&self, attempt: &Attempt) {
        *lock(&self.of_try) = Some(format!("try {} of about {}", attempt.number, attempt.about));
    }
}

/// Ends the waiting, however the work ends.
struct Hangup<'a>(&'a Telephone);

impl Drop for Hangup<'_> {
    fn drop(&mut self) {
        *lock(&self.0.ended) = true;
        self.0.end.notify_all();
    }
}

impl Telephone {
    /// Waits a tick; whether the work has ended.
    fn wait(&self) -> bool {
        let ended = lock(&self.ended);
        let (ended, _) =
            self.end.wait_timeout_while(ended, TICK, |ended| !*ended).unwrap_or_else(PoisonError::into_inner);
        *ended
    }

    /// Reports to the caller what is new: warnings for notices, a call for each stage that went on.
    fn tell(
        &self,
        py: Python<'_>,
        callback: Option<&Bound<'_, PyAny>>,
        last: &mut Option<Stage>,
    ) -> PyResult<()> {
        let (stages, notices) = {
            let mut heard = lock(&self.heard);
            let going_on = heard.stages.last().cloned();
            let stages = std::mem::replace(&mut heard.stages, going_on.into_iter().collect());
            (stages, std::mem::take(&mut heard.notices))
        };
        for notice in notices {
            py.import("isospan._errors")?.call_method1("_warn", (notice,))?;
        }
        let Some(callback) = callback else { return Ok(()) };
        for stage in stages {
            if last.as_ref() != Some(&stage) {
                callback.call1((&stage.name, stage.done, stage.total, &stage.unit))?;
            }
            *last = Some(stage);
        }
        Ok(())
    }
}

/// Does work that can be stopped and reports its progress.
pub(crate) fn run<T: Send>(
    py: Python<'_>,
    callback: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&CancelToken, &dyn Progress) -> isospan::Result<T> + Send,
) -> PyResult<T> {
    let (cancel, telephone) = (CancelToken::new(), Telephone::default());
    let mut stopped = None;
    let result = std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let _hangup = Hangup(&telephone);
            work(&cancel, &telephone)
        });
        let mut last = None;
        while !py.detach(|| telephone.wait()) {
            let answer = py.check_signals().and_then(|()| telephone.tell(py, callback, &mut last));
            if let Err(error) = answer {
                cancel.cancel();
                stopped.get_or_insert(error);
            }
        }
        let result = py.detach(|| worker.join()).unwrap_or_else(|panic| resume_unwind(panic));
        if stopped.is_none() {
            stopped = telephone.tell(py, callback, &mut last).err();
        }
        result
    });
    match (stopped, result) {
        (Some(error), _) => Err(error),
        (None, Ok(found)) => Ok(found),
        (None, Err(error)) => Err(exception(py, &error)),
    }
}
