//! Labels on the command line: which are meant, by numbers or by names, and which an archive has.

use super::grammar::{self, LabelChoice};
use super::progress::Talk;
use super::{print, print_json, text};
use isospan::formats::labels::LabelTable;
use isospan::pipeline::{Labels, OneLabel};
use isospan::volume::units::Unit;
use isospan::{Error, Resources, Result, Step};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Flags of labels.
#[derive(clap::Args, Debug)]
pub(crate) struct LabelArgs {
    /// Labels, in place of isovalues: 3,7, names of --label-table, or all but 0, the background:
    /// all. The archive is one of a label image: see reduce --labels.
    #[arg(
        help_heading = "Labels",
        long,
        value_name = "LABEL[,LABEL..]",
        value_delimiter = ',',
        allow_hyphen_values = true,
        value_parser = grammar::label
    )]
    labels: Vec<LabelChoice>,
    /// Names and colours of labels: a CSV with the header label,name,r,g,b, a label description
    /// of ITK-SNAP, or a colour table of 3D Slicer or FreeSurfer. Other labels have colours that
    /// their numbers give.
    #[arg(help_heading = "Labels", long, value_name = "FILE", requires = "labels")]
    label_table: Option<PathBuf>,
}

impl LabelArgs {
    pub(crate) fn are_given(&self) -> bool {
        !self.labels.is_empty()
    }

    /// Names and colours.
    pub(crate) fn table(&self) -> Result<LabelTable> {
        Ok(self.label_table.as_deref().map(LabelTable::read).transpose()?.unwrap_or_default())
    }

    /// The labels that are meant.
    pub(crate) fn wanted(&self, table: &LabelTable) -> Result<Labels> {
        let (mut numbers, mut all) = (vec![], false);
        for choice in &self.labels {
            match choice {
                LabelChoice::All => all = true,
                LabelChoice::One(label) => numbers.push(*label),
                LabelChoice::Named(name) => numbers.push(self.named(name, table)?),
            }
        }
        match (all, &numbers[..]) {
            (false, _) => Ok(Labels::Each(numbers)),
            (true, []) => Ok(Labels::All),
            (true, [0]) => Ok(Labels::AllWithBackground),
            _ => Err(Error::usage("--labels all has every label but 0: name no other than 0 beside it")),
        }
    }

    /// The label of a name.
    fn named(&self, name: &str, table: &LabelTable) -> Result<i64> {
        let Some(path) = &self.label_table else {
            return Err(Error::usage(format!(
                "--labels {name}: a label is a number, or a name of a table that --label-table gives"
            )));
        };
        match table.labels_named(name)[..] {
            [label] => Ok(label),
            [] => Err(Error::usage(format!("--labels {name}: {} has no such name", path.display()))),
            [first, second, ..] => Err(Error::usage(format!(
                "--labels {name}: {} has that name at {first} and {second}: give the number",
                path.display()
            ))),
        }
    }
}

/// What `isospan count --labels` says.
#[derive(Serialize)]
struct Counted<'a> {
    labels: &'a [OneLabel],
}

/// Tells the sizes of labels.
pub(crate) fn tell(
    args: &LabelArgs,
    step: &Step,
    resources: Resources,
    json: bool,
    talk: &Talk,
) -> Result<()> {
    let table = args.table()?;
    let query = step.labels(args.wanted(&table)?).table(table).resources(resources);
    let bar = talk.progress();
    let found = query.progress(&*bar).sizes();
    bar.end();
    let found = found?;
    note_without_voxels(&found, talk);
    if json {
        return print_json("count.labels", &Counted { labels: &found });
    }
    let length = step.units().length.as_ref();
    let mut out = format!("{}\n{}  name\n", text::plural(found.len() as u64, "label"), heads(length));
    for one in &found {
        let _ = writeln!(out, "{}", format!("{}  {}", columns(one), one.name).trim_end());
    }
    print(&out)
}

/// Says which labels no voxel has.
pub(crate) fn note_without_voxels(labels: &[OneLabel], talk: &Talk) {
    let without: Vec<String> =
        labels.iter().filter(|l| l.voxels == 0).map(|l| l.label.to_string()).take(10).collect();
    if !without.is_empty() {
        talk.note(&format!("warning: no voxel has the label {}", without.join(" ")));
    }
}

/// The heads of [`columns`].
pub(crate) fn heads(length: Option<&Unit>) -> String {
    let of = |name: &str, power: u32| format!("{name}{}", text::unit_to_the(power, length));
    let (volume, area) = (of("volume", 3), of("area", 2));
    format!("  {:>9} {:>12} {volume:>12} {area:>12} {:>12}", "label", "voxels", "triangles")
}

/// The numbers of a label, in columns.
pub(crate) fn columns(one: &OneLabel) -> String {
    let [volume, area] = [one.volume, one.area].map(|v| text::value(text::figures(v, 5)));
    let [voxels, triangles] = [one.voxels, one.triangles].map(text::count);
    format!("  {:>9} {voxels:>12} {volume:>12} {area:>12} {triangles:>12}", one.label)
}
