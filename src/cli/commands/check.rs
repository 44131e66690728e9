//! `isospan check`: is an archive whole, is a surface sound?

use super::grammar::{self, Value};
use super::level::LevelArgs;
use super::numbers::{self, With};
use super::progress::Talk;
use super::text;
use isospan::formats::surface::load_surface;
use isospan::pipeline::{self, ArchiveCheck, ArchiveSummary, Roi, RoiSpace};
use isospan::surface::SurfaceSource;
use isospan::surface::check::{
    CheckSettings, Domain, OpenEdges, SurfaceCheckReport, check_source, check_within,
};
use isospan::surface::edit::clip::HalfSpace;
use isospan::volume::units::{Unit, Units};
use isospan::{Archive, Error, Resources, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Check an archive or a surface.
///
/// Of an archive every checksum and structural invariant is verified. A surface should be an
/// oriented manifold; boundary, Euler number, area and volume are printed.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan check scan.isospan\n  isospan check scan.isospan --isovalue 600\n  isospan check bone.ply --within scan.isospan\n  isospan check part.ply --within scan.isospan --roi 10:90,:,:"
)]
pub struct Args {
    /// An archive, also by address (s3://... or https://...), or a surface file: .ply .stl .obj
    /// .vtp .vtkhdf .glb.
    input: PathBuf,
    /// For a surface: also check that boundary edges lie on the boundary of this archive's domain,
    /// or where it has no data.
    #[arg(long, value_name = "ARCHIVE")]
    within: Option<PathBuf>,
    /// With --within: the box at which the surface was cut, as `surface --roi` has it. Boundary
    /// edges may lie on its faces, too.
    #[arg(long, value_name = "BOX", requires = "within", allow_hyphen_values = true, value_parser = grammar::region)]
    roi: Option<Roi>,
    /// For an archive: also measure at this isovalue, as count --numbers does. The surface is
    /// that of the first step.
    #[arg(long, short = 'i', value_name = "VALUE", allow_hyphen_values = true, value_parser = grammar::value)]
    isovalue: Option<Value>,
    #[command(flatten)]
    level: LevelArgs,
    /// For a surface or an isovalue: limit of memory, 4GiB, 500MB or 50% [default: half of what the
    /// process may use].
    #[arg(help_heading = "Resources", long, value_name = "SIZE", value_parser = grammar::memory, allow_hyphen_values = true)]
    memory: Option<u64>,
    /// For a surface or an isovalue: folder for what does not fit in memory [default: the system's
    /// temporary folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    if pipeline::is_archive(&args.input) {
        return check_archive(args, talk);
    }
    if args.isovalue.is_some() {
        return Err(Error::usage("--isovalue is for archives: the input is a surface"));
    }
    let settings = CheckSettings {
        memory: super::memory(args.memory, talk),
        scratch: args.scratch.clone().unwrap_or_else(std::env::temp_dir),
    };
    talk.detail(&format!("memory {}", text::bytes(settings.memory)));
    let within = args.within.as_ref().map(Archive::open).transpose()?;
    if let (None, Some((_, flag))) = (&within, args.level.given().into_iter().find(|(given, _)| *given)) {
        return Err(Error::usage(format!(
            "{flag} is for --within: which level the surface was extracted from"
        )));
    }
    let summary = within.as_ref().map(|archive| archive.info()).transpose()?;
    if summary.as_ref().is_some_and(|s| s.grid_cells.is_some() || s.mesh.is_some()) {
        return Err(isospan::Error::usage(
            "--within an archive of a mesh, or of a rectilinear or curvilinear grid, is not possible: its domain is no box",
        ));
    }
    let dims = within.as_ref().map(|archive| archive.dims_of_level(args.level.choice())).transpose()?;
    let surface = load_surface(&args.input, &settings)?;
    let (origin, units) = (surface.origin(), surface.units().clone());
    let cuts = summary.as_ref().zip(args.roi).map_or(vec![], |(s, roi)| cuts(&roi, s, origin));
    let domain = summary.as_ref().map(|s| Domain {
        geometry: &s.geometry,
        dims: dims.unwrap_or(s.dims),
        cuts: &cuts,
        tolerance: BOUNDARY_TOLERANCE,
    });
    let (report, open) = match (&domain, &within) {
        (Some(domain), Some(archive)) => {
            let (report, open) =
                check_within(&surface, domain, &settings, &mut |edges| archive.edges_at_missing(edges))?;
            (report, Some(open))
        }
        _ => (check_source(&surface, None, &settings)?.0, None),
    };
    if args.json {
        super::print_json("check.surface", &surface_json(&report, open, &units)?)?;
    } else {
        super::print(&surface_text(&args.input, &report, open, units.length.as_ref()))?;
    }
    expect_sound(args, &report, open)
}

fn surface_json(
    report: &SurfaceCheckReport,
    open: Option<OpenEdges>,
    units: &Units,
) -> Result<serde_json::Value> {
    let failed = |e| Error::io("write JSON to", "standard output", std::io::Error::other(e));
    let mut value = serde_json::to_value(report).map_err(failed)?;
    if let Some(open) = open {
        value["boundary_edges_outside"] = open.outside.into();
        value["boundary_edges_at_missing"] = open.at_missing.into();
    }
    if !units.are_unknown() {
        value["units"] = serde_json::to_value(units).map_err(failed)?;
    }
    Ok(value)
}

/// An error that names the defects of a surface, where it has some.
fn expect_sound(args: &Args, report: &SurfaceCheckReport, open: Option<OpenEdges>) -> Result<()> {
    let defects = defects(report, open);
    if defects.is_empty() {
        return Ok(());
    }
    let error = Error::bad_input(
        &args.input,
        "surface",
        "an oriented manifold without degenerate triangles",
        defects.join(", "),
    );
    let may_be_cut = args.roi.is_none() && open.is_some_and(|open| open.outside > 0);
    Err(if may_be_cut {
        error.with_help("a surface that was cut at a box is checked with the same --roi BOX")
    } else {
        error
    })
}

fn check_archive(args: &Args, talk: &Talk) -> Result<()> {
    let only = [("--within", args.within.is_some()), ("--roi", args.roi.is_some())];
    let of_both = [("--memory", args.memory.is_some()), ("--scratch", args.scratch.is_some())];
    let levels = args.level.given().map(|(given, flag)| (flag, given));
    let measured = of_both.into_iter().chain(levels).filter(|_| args.isovalue.is_none());
    if let Some((flag, _)) = only.into_iter().chain(measured).find(|(_, given)| *given) {
        return Err(Error::usage(format!("{flag} is for surfaces")));
    }
    let archive = Archive::open(&args.input)?;
    let cancel = super::signals::cancel_token();
    let report = archive.check_until(&cancel)?;
    let numbers = |isovalue: &Value| {
        let resources = Resources::default().with_memory(super::memory(args.memory, talk));
        let resources = resources.with_scratch(args.scratch.clone()).with_cancel(cancel.clone());
        let isovalue = isovalue.of(archive.value_range())?;
        numbers::of(&archive, isovalue, args.level.choice(), resources, talk)
    };
    let numbers = args.isovalue.as_ref().map(numbers).transpose()?;
    if args.json {
        return super::print_json("check.archive", &With { report: &report, numbers });
    }
    let mut out = archive_text(&args.input, &report);
    if let Some(numbers) = &numbers {
        let words = numbers::in_words(numbers, archive.units());
        let _ = write!(out, "isovalue {}:\n{words}", numbers.isovalue);
    }
    super::print(&out)
}

/// The planes of a box, and how far a vertex may lie from each.
fn cuts(roi: &Roi, summary: &ArchiveSummary, origin: [f64; 3]) -> Vec<(HalfSpace, f64)> {
    let unit = match roi.space {
        RoiSpace::Index => 1.0,
        RoiSpace::World => summary.geometry.spacing.into_iter().fold(f64::INFINITY, f64::min),
    };
    let planes = roi.half_spaces(&summary.geometry, summary.dims, origin);
    planes.into_iter().map(|plane| (plane, BOUNDARY_TOLERANCE * unit)).collect()
}

/// How far from the domain's faces, in voxel edges, a boundary edge may lie: positions in a file
/// are `f32`.
const BOUNDARY_TOLERANCE: f64 = 1e-2;

fn defects(r: &SurfaceCheckReport, open: Option<OpenEdges>) -> Vec<String> {
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
    note(open.map_or(0, |open| open.outside), "boundary edges inside the domain");
    list
}

fn surface_text(
    path: &Path,
    r: &SurfaceCheckReport,
    open: Option<OpenEdges>,
    length: Option<&Unit>,
) -> String {
    let measure = |v: f64, power: u32, words: &str| match length {
        Some(_) => format!("{}{}", text::number(v), text::unit_to_the(power, length)),
        None => format!("{} {words} world units", text::number(v)),
    };
    let mut out = String::new();
    let sound = defects(r, open).is_empty();
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
        format!("{} in {}", text::count(r.boundary_edges), text::plural(r.boundary_loops, "loop")),
    );
    if let Some(open) = open {
        row("  inside the domain", text::count(open.outside));
        if open.at_missing > 0 {
            row("  at missing samples", text::count(open.at_missing));
        }
    }
    row("non-manifold edges", text::count(r.non_manifold_edges));
    row("non-manifold vertices", text::count(r.non_manifold_vertices));
    row("misoriented edges", text::count(r.misoriented_edges));
    row("degenerate triangles", text::count(r.degenerate_triangles + r.zero_area_triangles));
    row("area", measure(r.area, 2, "square"));
    row(
        "enclosed volume",
        r.volume.map_or_else(|| "none: the surface is not closed".into(), |v| measure(v, 3, "cubic")),
    );
    out
}

fn archive_text(path: &Path, r: &ArchiveCheck) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "{}: sound", path.display());
    let _ = writeln!(out, "  segments    {} verified, {}", text::count(r.segments), text::bytes(r.bytes));
    let _ = writeln!(out, "  blocks      {} verified", text::count(r.blocks));
    let _ = writeln!(out, "  points      {}", text::count(r.points));
    if r.tetrahedra > 0 {
        let _ = writeln!(out, "  tetrahedra  {}, all positively oriented", text::count(r.tetrahedra));
        let volume = if r.own { "have the volume of the mesh, exactly" } else { "fill the domain exactly" };
        let _ = writeln!(out, "  volume      the tetrahedra {volume}");
    }
    let _ =
        writeln!(out, "  index       {} entries, equal to the blocks' ranges", text::count(r.index_entries));
    for file in &r.strays {
        let name = file.strip_prefix(path).unwrap_or(file).display();
        let _ = writeln!(out, "  stray       {name} is no part of the archive; it can be deleted");
    }
    out
}
