//! The samples of a pyramid, or the nodes of a coarser level, as a volume, which is reduced like
//! any other: point sets can be made from an archive when its source is gone.

use super::export_grid::field_of;
use crate::archive::manifest::MANIFEST_NAME;
use crate::pipeline::read::{LevelChoice, OpenArchive, StepView};
use isospan_io::error::{Error, Result};
use isospan_io::formats::StepSource;
use isospan_io::formats::samples::push_samples;
use isospan_io::grid::{Geometry, IndexBox};
use isospan_io::volume::chunked::ChunkSource;
use isospan_io::volume::memory::info_of;
use isospan_io::volume::{FieldInfo, ScalarType, VolumeInfo};
use std::ops::Range;
use std::sync::Arc;

/// Samples along each axis of a part that is decoded at a time.
const EDGE: u64 = 64;
/// Bytes that decoding one takes: its nodes with margins, at several levels, and what is cached.
const DECODING_BYTES: u64 = 16 * (EDGE + 20).pow(3);
/// Bytes that all threads share: tiles, and the coarse levels.
const SHARED_BYTES: u64 = 64 << 20;

/// A step of a pyramid, as a source of samples.
struct ArchiveVolume {
    view: StepView,
    level: usize,
    info: VolumeInfo,
    offset: f64,
}

impl ChunkSource for ArchiveVolume {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        [EDGE; 3]
    }

    fn decoding_bytes(&self) -> u64 {
        DECODING_BYTES
    }

    fn index_bytes(&self) -> u64 {
        SHARED_BYTES
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        out.clear();
        let lo = at.map(|n| n * EDGE);
        let hi = std::array::from_fn(|a| (lo[a] + EDGE).min(self.info.dims[a]));
        let values = self.view.nodes(self.level, &IndexBox { lo, hi })?;
        push_samples(out, self.info.field.scalar, self.offset, &values)
    }
}

/// The steps at some positions of the manifest, as sources: of the nodes of a level.
///
/// # Errors
/// [`Error::Usage`] for an archive of tetrahedra, for a grid with coordinates of its own, and for a
/// level that is not there;
/// [`Error::BadInput`] for a damaged archive.
pub(in crate::pipeline) fn archive_sources(
    archive: &Arc<OpenArchive>,
    positions: Range<usize>,
    level: u32,
) -> Result<Vec<StepSource>> {
    let path = archive.path().display();
    if !archive.is_pyramid() {
        return Err(Error::usage(format!(
            "{path} has tetrahedra: of archives, only pyramids are read as volumes; isospan probe `grid` writes its \
             field on a grid"
        )));
    }
    if archive.coordinate_record().is_some() {
        return Err(Error::usage(format!(
            "{path} is of a grid with coordinates of its own, which would be lost: isospan export writes it as .vtr or \
             .vts, which can be reduced"
        )));
    }
    positions.map(|position| source_of(archive.step_at(position), level)).collect()
}

fn source_of(view: StepView, level: u32) -> Result<StepSource> {
    let level = view.level(Some(LevelChoice::Level(level)))?;
    // A damaged archive is refused now.
    let pyramid = &view.pyramid()?.pyramid;
    let [dims, stride] = [pyramid.nodes(level), pyramid.stride(level)].map(|list| list.map(|n| n as u64));
    let (step, of) = (view.step(), &view.step().plan.source);
    let (name, time) = (view.path().display().to_string(), step.plan.time);
    let kind = field_of(&view, level);
    let field = FieldInfo { name: step.field().to_owned(), scalar: kind.scalar, components: 1 };
    let info = VolumeInfo {
        path: view.path().to_path_buf(),
        // What the world is of follows from the first word.
        format: format!("{}, as an archive has it", of.format),
        geometry: Geometry {
            spacing: std::array::from_fn(|a| of.geometry.spacing[a] * stride[a] as f64),
            ..of.geometry
        },
        units: of.units.clone(),
        fields: vec![field.clone()],
        data_files: vec![view.path().join(MANIFEST_NAME)],
        is_labels: view.has_labels(),
        field,
        ..info_of(&name, dims, ScalarType::F32)
    };
    let identity = match level {
        0 => format!("isospan step {}", view.step_hash()),
        _ => format!("isospan step {}, level {level}", view.step_hash()),
    };
    let volume = ArchiveVolume { info, level, offset: kind.offset, view };
    Ok(StepSource::given_in_chunks(&name, Arc::new(volume), &identity, time))
}
