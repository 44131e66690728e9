//! `isospan info` of a mesh.

use super::progress::Talk;
use super::text;
use isospan::Result;
use isospan::cells::scan::{FieldScan, MeshScan, scan, scan_field};
use isospan::cells::{CellField, CellMesh, Center};
use isospan::pipeline::mesh_notices;
use std::fmt::Write as _;

/// Prints what is in a mesh; without `read` only what its header says.
pub(super) fn run(mesh: &CellMesh, read: bool, json: bool, talk: &Talk) -> Result<()> {
    let info = mesh.info();
    let (mut found, mut ranges) = (None, vec![]);
    ranges.resize_with(info.fields.len(), || None);
    if read {
        found = Some(scan(mesh)?);
        for (field, range) in ranges.iter_mut().enumerate() {
            *range = Some(scan_field(mesh, field));
        }
    }
    let chosen = mesh.field().ok().map(|f| f.name.clone());
    // A field that cannot be read is reported with its range.
    let notices = match &chosen {
        Some(_) if read => mesh_notices(mesh).unwrap_or_default(),
        _ => vec![],
    };
    talk.notices(&notices);
    if json {
        return super::print_json(
            "info.mesh",
            &serde_json::json!({
                "kind": "mesh", "info": info, "field": chosen, "scan": found, "notices": notices,
                "field_scans": ranges.iter().map(|r| r.as_ref().map(range_json)).collect::<Vec<_>>(),
            }),
        );
    }
    let mut out = String::new();
    let _ = writeln!(out, "{}: {}", info.path.display(), info.format);
    let _ = writeln!(out, "  points     {}", text::count(info.points));
    let _ = writeln!(out, "  cells      {}", cells_text(info.cells, found.as_ref()));
    if let Some(found) = &found {
        scan_text(&mut out, found);
    }
    if let Some(chosen) = chosen {
        let _ = writeln!(out, "  field      {chosen}");
    }
    let names: Vec<String> = info.fields.iter().map(field_text).collect();
    let width = names.iter().map(|n| n.chars().count()).max().unwrap_or(0);
    for (i, (name, range)) in names.iter().zip(&ranges).enumerate() {
        let head = if i == 0 { "fields" } else { "" };
        let pad = width - name.chars().count();
        let line =
            format!("  {head:<9}  {name}{:pad$}{}", "", range.as_ref().map_or(String::new(), range_text));
        let _ = writeln!(out, "{}", line.trim_end());
    }
    if names.is_empty() {
        let _ = writeln!(out, "  fields     none, but the coordinates x, y, z");
    }
    super::print(&out)
}

/// "128 976: 128 976 tetrahedra".
fn cells_text(cells: u64, found: Option<&MeshScan>) -> String {
    let kinds = found.into_iter().flat_map(|f| &f.kinds);
    let kinds: Vec<String> =
        kinds.map(|(kind, n)| format!("{} {}", text::count(*n), kind.plural())).collect();
    if kinds.is_empty() {
        text::count(cells)
    } else {
        format!("{}: {}", text::count(cells), kinds.join(", "))
    }
}

fn scan_text(out: &mut String, found: &MeshScan) {
    let _ = write!(out, "  split      {} tetrahedra", text::count(found.tetrahedra));
    if found.collapsed > 0 {
        let _ = write!(out, ", {} left out that name a vertex twice", text::count(found.collapsed));
    }
    if found.ghosts > 0 {
        let _ = write!(out, ", {} left out as ghosts", text::plural(found.ghosts, "cell"));
    }
    let _ = writeln!(out);
    if let Some([lo, hi]) = found.bounds {
        let axis = |a: usize| text::range([lo[a], hi[a]]);
        let _ = writeln!(out, "  bounds     x {}, y {}, z {}", axis(0), axis(1), axis(2));
    }
}

fn field_text(f: &CellField) -> String {
    let components = if f.components == 1 { String::new() } else { format!(" x{}", f.components) };
    let cells = if f.center == Center::Cell { ", on cells" } else { "" };
    format!("{} ({}{components}{cells})", f.name, f.scalar.name())
}

fn range_json(range: &Result<FieldScan>) -> serde_json::Value {
    match range {
        Ok(range) => serde_json::json!(range),
        Err(e) => serde_json::json!({ "error": e.to_string() }),
    }
}

/// One field may be damaged and the others good.
fn range_text(range: &Result<FieldScan>) -> String {
    let range = match range {
        Ok(range) => range,
        Err(e) => return format!("  cannot be read: {e}"),
    };
    let mut out = match (range.min, range.max) {
        (Some(lo), Some(hi)) => format!("  {}", text::range([lo, hi])),
        _ => "  no finite value".into(),
    };
    if range.nan > 0 || range.infinite > 0 {
        let _ = write!(out, "  ({} NaN, {} infinite)", text::count(range.nan), text::count(range.infinite));
    }
    out
}
