//! Progress on standard error: a bar with an ETA on a terminal, a plain line at most every ten seconds elsewhere.

use super::text;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use isospan::exec::{Progress, Silent};
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What suits standard error.
pub(crate) fn for_stderr(quiet: bool) -> Box<dyn Progress> {
    if quiet {
        Box::new(Silent)
    } else if std::io::stderr().is_terminal() {
        Box::new(Bar(Mutex::new(ProgressBar::hidden())))
    } else {
        Box::new(Lines(Mutex::new(None)))
    }
}

struct Bar(Mutex<ProgressBar>);

impl Progress for Bar {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        self.end();
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
        let template =
            format!("{{msg:10}} [{{bar:40}}] {{human_pos}}/{{human_len}} {unit}  {{per_sec}}  ETA {{eta}}");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(stage.to_owned());
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = bar;
    }

    fn advance(&self, units: u64) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).inc(units);
    }

    fn end(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).finish_and_clear();
    }
}

struct Stage {
    name: String,
    unit: String,
    total: u64,
    done: u64,
    started: Instant,
    told: Instant,
}

struct Lines(Mutex<Option<Stage>>);

/// A log is not flooded, and a short run says nothing at all.
const BETWEEN_LINES: Duration = Duration::from_secs(10);

impl Progress for Lines {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        let now = Instant::now();
        let stage = Stage { name: stage.into(), unit: unit.into(), total, done: 0, started: now, told: now };
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(stage);
    }

    fn advance(&self, units: u64) {
        let mut stage = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(stage) = stage.as_mut() else { return };
        stage.done += units;
        if stage.told.elapsed() < BETWEEN_LINES || stage.done == 0 {
            return;
        }
        stage.told = Instant::now();
        let elapsed = stage.started.elapsed().as_secs_f64();
        let left = elapsed * stage.total.saturating_sub(stage.done) as f64 / stage.done as f64;
        let _ = writeln!(
            std::io::stderr(),
            "isospan: {}: {} of {} {} ({} %), {} left",
            stage.name,
            text::count(stage.done),
            text::count(stage.total),
            stage.unit,
            stage.done * 100 / stage.total.max(1),
            text::duration(Duration::from_secs_f64(left)),
        );
    }

    fn end(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}
