//! What goes to standard error besides errors: progress, notes, and with `-v` details.
//!
//! Progress is a bar with rate and ETA on a terminal, a plain line at most every ten seconds
//! elsewhere, or JSON, one object a line:
//! `{"event":"begin"|"progress"|"end","stage":…,"unit":…,"done":…,"total":…,"elapsed_seconds":…,"eta_seconds":…}`,
//! notes as `{"event":"note","text":…}`, and tries for a target, which begin, as
//! `{"event":"try","try":…,"about":…,"last":{"quantity":…,"value":…,"wanted":…}}`.

use super::text;
use super::words;
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use isospan::exec::{Attempt, Progress, Reached, Silent};
use isospan::pipeline::{self, NO_SURFACE, Notice};
use std::fmt;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The form of progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Form {
    /// A bar on a terminal, else plain lines.
    Auto,
    /// A bar; nothing where there is no terminal.
    Bar,
    /// At most one line every ten seconds.
    Plain,
    /// JSON objects, one per line: at most one per second, and one at the end of each stage.
    Json,
    /// Nothing.
    None,
}

/// How much is printed on standard error.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Talk {
    /// Print nothing but results and errors.
    #[arg(help_heading = "Messages", short, long, global = true)]
    quiet: bool,
    /// Print more: memory, threads, I/O mode, the time of each stage.
    #[arg(help_heading = "Messages", short, long, global = true, conflicts_with = "quiet")]
    verbose: bool,
    /// How progress is shown on standard error.
    #[arg(help_heading = "Messages", long, global = true, value_enum, value_name = "FORM", default_value_t = Form::Auto)]
    progress: Form,
}

impl Talk {
    /// Where a run's progress goes.
    pub(crate) fn progress(&self) -> Box<dyn Progress> {
        match self.progress {
            _ if self.quiet => Box::new(Silent),
            Form::None => Box::new(Notices),
            Form::Auto if std::io::stderr().is_terminal() => Box::new(Bar::new()),
            Form::Bar => Box::new(Bar::new()),
            Form::Auto | Form::Plain => Box::new(Lines::new(false)),
            Form::Json => Box::new(Lines::new(true)),
        }
    }

    /// Prints what a user should know.
    pub(crate) fn note(&self, text: &str) {
        if !self.quiet {
            self.line(text);
        }
    }

    /// Prints what `-v` asks for.
    pub(crate) fn detail(&self, text: &str) {
        if self.verbose {
            self.line(text);
        }
    }

    fn line(&self, text: &str) {
        if self.progress == Form::Json {
            tell(&serde_json::json!({ "event": "note", "text": text }).to_string());
        } else {
            tell(&format!("isospan: {text}"));
        }
    }

    /// What the library found that the user should know.
    pub(crate) fn notices(&self, notices: &[Notice]) {
        notices.iter().for_each(|notice| self.note(&notice.text));
    }

    /// The time of each stage of a report.
    pub(crate) fn stages(&self, seconds: &[(pipeline::Stage, f64)]) {
        for (stage, time) in seconds {
            self.detail(&format!("{stage}: {}", text::duration(Duration::from_secs_f64(*time))));
        }
    }
}

/// Writes a line, its settings as flags; who closed standard error does not want it.
fn tell(line: &str) {
    let line = words::in_flags(line);
    let _ = writeln!(std::io::stderr(), "{}", isospan::error::printable(&line));
}

/// No progress, but what the user should know.
struct Notices;

impl Progress for Notices {
    fn begin(&self, _stage: &str, _total: u64, _unit: &str) {}

    fn advance(&self, _units: u64) {}

    fn end(&self) {}

    fn notice(&self, line: &str) {
        tell(&format!("isospan: {line}"));
    }
}

/// What a try reached, of what was wanted.
fn reached_text(reached: &Reached) -> String {
    let Reached { quantity, value, wanted, .. } = *reached;
    if quantity == "distance" && value >= NO_SURFACE {
        return "one of the two surfaces is missing".into();
    }
    let number = |v: f64| match quantity {
        "bytes" => text::bytes(v as u64),
        _ => text::value(text::figures(v, 4)),
    };
    let what = if quantity == "bytes" { String::new() } else { format!("{quantity} ") };
    format!("{what}{} of {} wanted", number(value), number(wanted))
}

/// The line of a try that begins.
fn attempt_text(attempt: &Attempt) -> String {
    let last = attempt
        .last
        .as_ref()
        .map_or(String::new(), |last| format!("; try {}: {}", attempt.number - 1, reached_text(last)));
    format!("{}{last}", try_text(attempt))
}

fn try_text(attempt: &Attempt) -> String {
    format!("try {} of about {}", attempt.number, attempt.about)
}

struct Bar {
    bar: Mutex<ProgressBar>,
    /// The try that stages belong to.
    of_try: Mutex<Option<String>>,
}

impl Bar {
    fn new() -> Self {
        Self { bar: Mutex::new(ProgressBar::hidden()), of_try: Mutex::default() }
    }

    fn bar(&self) -> MutexGuard<'_, ProgressBar> {
        self.bar.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Bar {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        self.end();
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
        let template = format!("{{msg:10}} [{{bar:40}}] {{done}} of {{total}} {unit}  {{speed}}");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            let style = style.with_key("done", |s: &ProgressState, out: &mut dyn fmt::Write| {
                let _ = out.write_str(&text::count(s.pos()));
            });
            let style = style.with_key("total", |s: &ProgressState, out: &mut dyn fmt::Write| {
                let _ = out.write_str(&text::count(s.len().unwrap_or(0)));
            });
            let style = style.with_key("speed", |s: &ProgressState, out: &mut dyn fmt::Write| {
                let _ = out.write_str(&speed(s.pos(), s.per_sec(), s.eta()));
            });
            bar.set_style(style.progress_chars("=> "));
        }
        let of_try = self.of_try.lock().unwrap_or_else(PoisonError::into_inner);
        bar.set_message(of_try.as_ref().map_or(stage.to_owned(), |of_try| format!("{of_try}: {stage}")));
        *self.bar() = bar;
    }

    fn advance(&self, units: u64) {
        self.bar().inc(units);
    }

    fn end(&self) {
        self.bar().finish_and_clear();
    }

    fn notice(&self, line: &str) {
        self.bar().suspend(|| tell(&format!("isospan: {line}")));
    }

    fn attempt(&self, attempt: &Attempt) {
        if let Some(last) = &attempt.last {
            self.notice(&format!("try {}: {}", attempt.number - 1, reached_text(last)));
        }
        *self.of_try.lock().unwrap_or_else(PoisonError::into_inner) = Some(try_text(attempt));
    }
}

/// Rate and time left; nothing before the first units are done, as nothing is known then.
fn speed(done: u64, rate: f64, left: Duration) -> String {
    if done == 0 {
        return String::new();
    }
    format!("{}, {} left", rate_text(rate), text::rough_duration(left))
}

fn rate_text(rate: f64) -> String {
    if rate >= 1.0 {
        return format!("{} a second", text::count(rate as u64));
    }
    format!("{} each", text::rough_duration(Duration::try_from_secs_f64(1.0 / rate).unwrap_or(Duration::MAX)))
}

struct Stage {
    name: String,
    unit: String,
    total: u64,
    done: u64,
    started: Instant,
    shown: Instant,
}

struct Lines {
    json: bool,
    stage: Mutex<Option<Stage>>,
    started: Instant,
    /// The try that stages belong to.
    of_try: Mutex<Option<String>>,
}

/// A log is not flooded, and a short run says nothing at all.
const BETWEEN_LINES: Duration = Duration::from_secs(10);
/// A program that draws its own bar wants more.
const BETWEEN_OBJECTS: Duration = Duration::from_secs(1);

impl Stage {
    fn seconds_left(&self) -> f64 {
        let elapsed = self.started.elapsed().as_secs_f64();
        elapsed * self.total.saturating_sub(self.done) as f64 / self.done.max(1) as f64
    }

    fn line(&self) -> String {
        let elapsed = self.started.elapsed().as_secs_f64();
        format!(
            "isospan: {}: {} of {} {} ({} %), {}, {} left",
            self.name,
            text::count(self.done),
            text::count(self.total),
            self.unit,
            self.done * 100 / self.total.max(1),
            rate_text(self.done as f64 / elapsed.max(1e-3)),
            text::rough_duration(Duration::from_secs_f64(self.seconds_left())),
        )
    }

    fn object(&self, event: &str) -> String {
        let eta = (self.done > 0).then(|| self.seconds_left());
        serde_json::json!({
            "event": event,
            "stage": self.name,
            "unit": self.unit,
            "done": self.done,
            "total": self.total,
            "elapsed_seconds": self.started.elapsed().as_secs_f64(),
            "eta_seconds": eta,
        })
        .to_string()
    }
}

impl Lines {
    fn new(json: bool) -> Self {
        Self { json, stage: Mutex::new(None), started: Instant::now(), of_try: Mutex::default() }
    }
}

impl Progress for Lines {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        self.end();
        let now = Instant::now();
        let of_try = self.of_try.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let name = of_try.filter(|_| !self.json).map_or(stage.into(), |of_try| format!("{of_try}: {stage}"));
        let stage = Stage { name, unit: unit.into(), total, done: 0, started: now, shown: now };
        if self.json {
            tell(&stage.object("begin"));
        }
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner) = Some(stage);
    }

    fn advance(&self, units: u64) {
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(stage) = stage.as_mut() else { return };
        stage.done += units;
        let between = if self.json { BETWEEN_OBJECTS } else { BETWEEN_LINES };
        // Of what is complete, a reader learns nothing.
        let is_dull = stage.done == 0 || !self.json && stage.done >= stage.total;
        if stage.shown.elapsed() < between || is_dull {
            return;
        }
        stage.shown = Instant::now();
        tell(&if self.json { stage.object("progress") } else { stage.line() });
    }

    fn end(&self) {
        let stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(stage) = stage.filter(|_| self.json) {
            tell(&stage.object("end"));
        }
    }

    fn notice(&self, line: &str) {
        if self.json {
            tell(&serde_json::json!({ "event": "note", "text": line }).to_string());
        } else {
            tell(&format!("isospan: {line}"));
        }
    }

    fn attempt(&self, attempt: &Attempt) {
        self.end();
        *self.of_try.lock().unwrap_or_else(PoisonError::into_inner) = Some(try_text(attempt));
        if self.json {
            let last = attempt.last.map(|last| {
                serde_json::json!({ "quantity": last.quantity, "value": last.value, "wanted": last.wanted })
            });
            let (number, about) = (attempt.number, attempt.about);
            tell(
                &serde_json::json!({ "event": "try", "try": number, "about": about, "last": last })
                    .to_string(),
            );
        } else if self.started.elapsed() >= BETWEEN_LINES {
            tell(&format!("isospan: {}", attempt_text(attempt)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_told_of_the_speed_before_it_is_known() {
        assert_eq!(speed(0, 0.0, Duration::ZERO), "");
        assert_eq!(speed(9, 34267.06, Duration::from_millis(8400)), "34 267 a second, 8 s left");
        assert_eq!(speed(9, 1.5, Duration::from_secs(200)), "1 a second, 3 min 20 s left");
        assert_eq!(speed(9, 0.05, Duration::from_secs(200)), "20 s each, 3 min 20 s left");
    }
}
