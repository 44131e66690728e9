//! `isospan check`: is an archive whole, is a surface sound?

use super::text;
use isospan::formats::surface::read_surface;
use isospan::pipeline::{self, ArchiveCheck};
use isospan::surface::check::{SurfaceReport, boundary_outside, check};
use isospan::{Error, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Check an archive (every checksum and structural invariant) or a surface (manifold, boundary, orientation, Euler number).
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// An archive, or a surface file: .ply .stl .obj .vtp.
    input: PathBuf,
    /// Surface: also check that boundary edges lie on the boundary of this archive's domain.
    #[arg(long, value_name = "ARCHIVE")]
    within: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if pipeline::is_archive(&args.input) {
        if args.within.is_some() {
            return Err(Error::usage("--within is for surfaces"));
        }
        let report = pipeline::check_archive(&args.input)?;
        return if args.json {
            super::print_json(&report)
        } else {
            super::print(&archive_text(&args.input, &report))
        };
    }
    let mesh = read_surface(&args.input)?;
    let report = check(&mesh);
    let outside = match &args.within {
        Some(archive) => {
            let summary = pipeline::summarize(archive)?;
            Some(boundary_outside(&mesh, &summary.geometry, summary.dims, BOUNDARY_TOLERANCE))
        }
        None => None,
    };
    if args.json {
        let mut value = serde_json::to_value(&report)
            .map_err(|e| Error::io("write JSON to", "standard output", std::io::Error::other(e)))?;
        if let Some(n) = outside {
            value["boundary_edges_outside"] = n.into();
        }
        super::print_json(&value)?;
    } else {
        super::print(&surface_text(&args.input, &report, outside))?;
    }
    let defects = defects(&report, outside);
    if defects.is_empty() {
        return Ok(());
    }
    Err(Error::bad_input(
        &args.input,
        "surface",
        "an oriented manifold without degenerate triangles",
        defects.join(", "),
    ))
}

/// How far from the domain's faces, in voxel edges, a boundary edge may lie: positions in a file are `f32`.
const BOUNDARY_TOLERANCE: f64 = 1e-2;

fn defects(r: &SurfaceReport, outside: Option<u64>) -> Vec<String> {
    let mut list = vec![];
    let mut note = |n: u64, what: &str| {
        if n > 0 {
            list.push(format!("{} {what}", text::count(n)));
        }
    };
    note(r.non_manifold_edges, "non-manifold edges");
    note(r.misoriented_edges, "misoriented edges");
    note(r.non_manifold_vertices, "non-manifold vertices");
    note(r.duplicate_triangles, "duplicate triangles");
    note(r.degenerate_triangles, "triangles with a repeated vertex");
    note(r.zero_area_triangles, "triangles without area");
    note(r.out_of_range_triangles, "triangles with a vertex that does not exist");
    note(r.non_finite_vertices, "vertices that are no numbers");
    note(outside.unwrap_or(0), "boundary edges inside the domain");
    list
}

fn surface_text(path: &Path, r: &SurfaceReport, outside: Option<u64>) -> String {
    let mut out = String::new();
    let sound = defects(r, outside).is_empty();
    let _ = writeln!(out, "{}: {}", path.display(), if sound { "sound" } else { "NOT SOUND" });
    let mut row = |name: &str, value: String| {
        let _ = writeln!(out, "  {name:<22} {value}");
    };
    row("vertices", text::count(r.vertices));
    row("triangles", text::count(r.triangles));
    row("components", text::count(r.components));
    row("Euler number", r.euler.to_string());
    row(
        "boundary edges",
        format!("{} in {} loops", text::count(r.boundary_edges), text::count(r.boundary_loops)),
    );
    if let Some(n) = outside {
        row("  inside the domain", text::count(n));
    }
    row("non-manifold edges", text::count(r.non_manifold_edges));
    row("non-manifold vertices", text::count(r.non_manifold_vertices));
    row("misoriented edges", text::count(r.misoriented_edges));
    row("degenerate triangles", text::count(r.degenerate_triangles + r.zero_area_triangles));
    row("area", r.area.to_string());
    row(
        "enclosed volume",
        r.volume.map_or_else(|| "none: the surface is not closed".into(), |v| v.to_string()),
    );
    out
}

fn archive_text(path: &Path, r: &ArchiveCheck) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "{}: sound", path.display());
    let _ = writeln!(out, "  segments    {} verified, {}", text::count(r.segments), text::bytes(r.bytes));
    let _ = writeln!(out, "  blocks      {} verified", text::count(r.blocks));
    let _ = writeln!(out, "  points      {}", text::count(r.points));
    let _ = writeln!(out, "  tetrahedra  {}, all positively oriented", text::count(r.tetrahedra));
    let _ = writeln!(out, "  volume      the tetrahedra fill the domain exactly");
    let _ =
        writeln!(out, "  index       {} entries, equal to the blocks' ranges", text::count(r.index_entries));
    out
}
