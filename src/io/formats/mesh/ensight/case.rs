//! The case file: which files hold the geometry and the variables, and the times of steps.

use crate::bytes::ByteSource;
use crate::cells::Center;
use crate::error::{Error, Result};
use crate::formats::shared::header::sibling;
use std::path::{Path, PathBuf};

/// The most bytes of a case file.
const LARGEST: u64 = 16 << 20;
/// Most steps of a time set.
const MOST_STEPS: usize = 1 << 20;

/// What a case file says.
pub(super) struct Case {
    pub(super) geometry: PathBuf,
    pub(super) variables: Vec<Variable>,
}

/// A variable that is read.
pub(super) struct Variable {
    pub(super) name: String,
    pub(super) center: Center,
    /// Numbers of a node or an element.
    pub(super) components: u32,
    /// The file of each step, and its time.
    pub(super) steps: Vec<(PathBuf, Option<f64>)>,
}

/// How lines that name variables begin.
const KINDS: [(&str, Center, u32); 8] = [
    ("scalar per node", Center::Point, 1),
    ("vector per node", Center::Point, 3),
    ("tensor symm per node", Center::Point, 6),
    ("tensor asym per node", Center::Point, 9),
    ("scalar per element", Center::Cell, 1),
    ("vector per element", Center::Cell, 3),
    ("tensor symm per element", Center::Cell, 6),
    ("tensor asym per element", Center::Cell, 9),
];

/// A name with the number of its time set, where it has one.
struct Named {
    set: Option<u64>,
    /// Whether all steps are in one file.
    is_one_file: bool,
    words: Vec<String>,
    line: usize,
}

/// A time set.
#[derive(Default)]
struct TimeSet {
    number: u64,
    steps: usize,
    start: Option<u64>,
    increment: Option<u64>,
    numbers: Vec<u64>,
    times: Vec<f64>,
}

impl TimeSet {
    /// The number in the names of a step's files.
    fn number_of(&self, step: usize) -> Option<u64> {
        if self.numbers.is_empty() {
            let increment = self.increment.or((self.steps == 1).then_some(1))?;
            return increment.checked_mul(step as u64)?.checked_add(self.start?);
        }
        self.numbers.get(step).copied()
    }
}

impl Case {
    /// Reads a case file.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a malformed file, and for what is not read: other kinds of EnSight,
    /// a geometry that changes, steps in one file.
    pub(super) fn read(source: &ByteSource) -> Result<Self> {
        let path = source.path();
        let wrong = |at: &str, expected: &str, got: &str| Error::bad_input(path, at, expected, got);
        let Sections { kind, model, variables, sets } = Sections::read(source)?;
        match kind.as_deref() {
            Some("ensight gold") => {}
            Some(other) => {
                return Err(wrong("FORMAT", "type: ensight gold", other)
                    .with_help("write it as EnSight Gold or .vtu, e.g. with ParaView"));
            }
            None => return Err(wrong("FORMAT", "type: ensight gold", "none")),
        }
        let model = model.ok_or_else(|| wrong("GEOMETRY", "model: FILE", "none"))?;
        let mut files = steps_of(path, &model, &model.words[0], &sets)?;
        if files.len() > 1 {
            let got = format!("a geometry of {} steps", files.len());
            return Err(wrong("GEOMETRY", "one geometry for all steps", &got)
                .with_help("write a case for each step, or .vtu files and a .pvd list of them"));
        }
        let geometry = files.pop().ok_or_else(|| wrong("GEOMETRY", "a file", "a time set without steps"))?.0;
        let variables = variables.into_iter().map(|NamedVariable { named, center, components }| {
            let steps = steps_of(path, &named, &named.words[1..].join(" "), &sets)?;
            Ok(Variable { name: named.words[0].clone(), center, components, steps })
        });
        Ok(Self { geometry, variables: variables.collect::<Result<_>>()? })
    }
}

/// What the sections of a case file say.
#[derive(Default)]
struct Sections {
    kind: Option<String>,
    model: Option<Named>,
    variables: Vec<NamedVariable>,
    sets: Vec<TimeSet>,
}

/// A variable before its files are found.
struct NamedVariable {
    named: Named,
    center: Center,
    components: u32,
}

impl Sections {
    fn read(source: &ByteSource) -> Result<Self> {
        let path = source.path();
        if source.len() > LARGEST {
            let (expected, got) = (format!("at most {LARGEST} bytes"), format!("{} bytes", source.len()));
            return Err(Error::bad_input(path, "length", expected, got));
        }
        let text = String::from_utf8_lossy(source.slice(0..source.len())?).into_owned();
        source.check()?;
        let (mut section, mut key) = (String::new(), String::new());
        let mut sections = Self::default();
        for (number, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let is_section = !line.is_empty() && line.chars().all(|c| c.is_ascii_uppercase() || c == '_');
            if is_section {
                (section, key) = (line.to_string(), String::new());
                continue;
            }
            // Lists of numbers go on in the lines that follow.
            let values = match line.split_once(':') {
                Some((word, values)) => {
                    key = word.split_whitespace().collect::<Vec<_>>().join(" ").to_ascii_lowercase();
                    values
                }
                None => line,
            };
            let words: Vec<&str> = values.split_whitespace().collect();
            if words.is_empty() {
                continue;
            }
            let wrong = |expected: &str, got: &str| {
                Error::bad_input(path, format!("line {}", number + 1), expected, got)
            };
            match (section.as_str(), key.as_str()) {
                ("FORMAT", "type") => sections.kind = Some(words.join(" ").to_ascii_lowercase()),
                ("GEOMETRY", "model") => sections.model = Some(named(&words, 1, number)),
                ("VARIABLE", key) => {
                    if let Some(&(_, center, components)) = KINDS.iter().find(|(name, ..)| *name == key) {
                        let named = named(&words, 2, number);
                        if named.words.len() < 2 {
                            return Err(wrong("a name and a file", values.trim()));
                        }
                        sections.variables.push(NamedVariable { named, center, components });
                    }
                }
                ("TIME", "time set") => {
                    let number = words[0].parse().map_err(|_| wrong("the number of a time set", words[0]))?;
                    sections.sets.push(TimeSet { number, ..TimeSet::default() });
                }
                ("TIME", key) => {
                    if let Some(set) = sections.sets.last_mut() {
                        set.take(key, &words).map_err(|Unfit { expected, got }| wrong(expected, &got))?;
                    }
                }
                _ => {}
            }
        }
        Ok(sections)
    }
}

/// Words that are not what a time set wants.
struct Unfit {
    expected: &'static str,
    got: String,
}

impl TimeSet {
    /// Takes the words of a key, or of a line that goes on with it.
    fn take(&mut self, key: &str, words: &[&str]) -> std::result::Result<(), Unfit> {
        let unfit = |expected: &'static str, got: &str| Unfit { expected, got: got.to_string() };
        let whole = |word: &str| word.parse().map_err(|_| unfit("a whole number", word));
        match key {
            "number of steps" => self.steps = whole(words[0])? as usize,
            "filename start number" => self.start = Some(whole(words[0])?),
            "filename increment" => self.increment = Some(whole(words[0])?),
            "filename numbers" => {
                for word in words {
                    self.numbers.push(whole(word)?);
                }
            }
            "time values" => {
                for word in words {
                    self.times.push(word.parse().map_err(|_| unfit("a time", word))?);
                }
            }
            "filename numbers file" | "time values file" => {
                return Err(unfit("numbers in the case file", "a file of them"));
            }
            _ => {}
        }
        if self.steps.max(self.numbers.len()).max(self.times.len()) > MOST_STEPS {
            return Err(unfit("at most 2^20 steps", "more"));
        }
        Ok(())
    }
}

/// Splits off the numbers of the time set and the file set; `rest` words stay.
fn named(words: &[&str], rest: usize, line: usize) -> Named {
    let is_number = |word: &&&str| word.parse::<u64>().is_ok();
    let most = words.len().saturating_sub(rest).min(2);
    let numbers = words[..most].iter().take_while(is_number).count();
    let set = (numbers > 0).then(|| words[0].parse().ok()).flatten();
    let words = words[numbers..].iter().map(|w| w.trim_matches('"').to_string()).collect();
    Named { set, is_one_file: numbers == 2, words, line: line + 1 }
}

/// The file of each step, and its time.
fn steps_of(path: &Path, named: &Named, name: &str, sets: &[TimeSet]) -> Result<Vec<(PathBuf, Option<f64>)>> {
    let wrong =
        |expected: &str, got: String| Error::bad_input(path, format!("line {}", named.line), expected, got);
    if named.is_one_file {
        return Err(wrong("a file for each step", format!("{name}, all steps in one file"))
            .with_help("write a file for each step, its number as *** in the name"));
    }
    let stars = name.chars().filter(|&c| c == '*').count();
    let set = match (named.set, sets) {
        (Some(number), _) => Some(
            sets.iter()
                .find(|s| s.number == number)
                .ok_or_else(|| wrong("a time set of the section TIME", format!("time set {number}")))?,
        ),
        (None, [only]) if stars > 0 => Some(only),
        (None, _) if stars > 0 => return Err(wrong("the number of a time set", name.into())),
        (None, _) => None,
    };
    let Some(set) = set else { return Ok(vec![(sibling(path, name), None)]) };
    if set.steps == 0 {
        return Err(wrong("the number of steps of its time set", "none".into()));
    }
    let time = |step: usize| set.times.get(step).copied().filter(|t| t.is_finite());
    if stars == 0 {
        let all = if set.steps > 1 { Err(()) } else { Ok(vec![(sibling(path, name), time(0))]) };
        return all.map_err(|()| wrong("*** for the number of a step in the file's name", name.into()));
    }
    let run: String = "*".repeat(stars);
    if !name.contains(&run) {
        return Err(wrong("one run of *** in the file's name", name.into()));
    }
    let file = |step: usize| {
        let number = set.number_of(step);
        let number = number
            .ok_or_else(|| wrong("a file name number for each step", format!("none for step {step}")))?;
        Ok((sibling(path, name.replace(&run, &format!("{number:0stars$}"))), time(step)))
    };
    (0..set.steps).map(file).collect()
}
