//! Surface files, for the server alone: a file is written to disk, then sent.

use super::answers::{Sink, SurfaceQuery, numbers};
use super::archives::Archives;
use super::server::PIECE;
use isospan::exec::Silent;
use isospan::formats::surface::SurfaceFormat;
use isospan::render::ColourMap;
use isospan::{Error, Resources, Result};
use std::io::Read as _;

/// A surface file, as `isospan surface` writes it.
pub(super) fn export(
    archives: &Archives,
    archive: usize,
    query: &SurfaceQuery,
    resources: &Resources,
    sink: &mut dyn Sink,
) -> Result<()> {
    let mut settings = query.settings(resources)?;
    let ending = query.format.as_deref().unwrap_or("glb");
    let format = SurfaceFormat::from_path(format!("surface.{ending}").as_ref())?;
    // Triangles of STL have no colours.
    if let Some(choice) = query.colour().filter(|_| format != SurfaceFormat::Stl) {
        let map = query.map.as_deref().map_or(Ok(ColourMap::default()), str::parse)?;
        let mut colours = archives.at(archive, choice)?.colours(map);
        colours.range = query.range.as_deref().map(|text| numbers(text, "range")).transpose()?;
        settings.colour_by = Some(colours);
    }
    let archive = archives.at(archive, query.choice())?;
    let scratch = resources.scratch.clone().unwrap_or_else(std::env::temp_dir);
    let failed = |doing: &str, e| Error::io(doing, &scratch, e);
    let folder = tempfile::tempdir_in(&scratch).map_err(|e| failed("write to", e))?;
    let path = folder.path().join("surface");
    archive.write_surface(&settings, &path, format, &Silent)?;
    let mut file = std::fs::File::open(&path).map_err(|e| failed("read from", e))?;
    let mut piece = vec![0; PIECE];
    loop {
        let bytes = file.read(&mut piece).map_err(|e| failed("read from", e))?;
        if bytes == 0 {
            return Ok(());
        }
        sink.write(&piece[..bytes])?;
    }
}
