//! Whether the chunks of a source are read through a cache, and how many of them are kept.
//!
//! Chunks of an archive are made in rows along x, rows in layers along z. So a source chunk is
//! decoded once where all that meet a layer are kept, and about twice where those that meet a row
//! are. The rule, which depends on sizes and the memory of the run alone:
//!
//! * those of a layer, where they take at most a quarter of the memory;
//! * those of a row, where they do, and where that decodes a chunk 2.5 times at most;
//! * of the two the one that leaves more threads at work, a layer where both leave as many;
//! * without either, the source is copied into bricks, as a stream is. So are the steps of a series.

use super::passes::SeriesPlan;
use crate::error::Result;
use crate::formats::Input;
use crate::geom::LatticeBox;
use crate::pipeline::plan::{MeshParts, Need, estimate, need_of};
use crate::pipeline::settings::RunSettings;
use crate::volume::VolumeSource;
use crate::volume::chunked::ChunkSource;

/// The part of the memory that decoded chunks may take.
const PART: u64 = 4;
/// How often a chunk may be decoded while the archive is made, on average.
const MOST_DECODES: f64 = 2.5;

/// What the chunks of an archive need, and bytes of decoded chunks of its source that are kept;
/// `None` where those are not read through a cache. The source is then planned to be copied.
pub(super) fn need_with_cache(
    series: &mut SeriesPlan,
    parts: &MeshParts,
    run: &RunSettings,
) -> Result<(Need, Option<u64>)> {
    let steps = series.plan.steps.len();
    let plain = need_of(parts, 0, steps, run.resources.memory, run);
    let [planned] = &mut series.sources[..] else { return Ok((plain, None)) };
    if planned.copied == 0 || planned.is_small() {
        return Ok((plain, None));
    }
    let Input::Volume(VolumeSource::Stream(stream)) = planned.source.open()? else {
        return Ok((plain, None));
    };
    let Some(chunks) = stream.chunks() else { return Ok((plain, None)) };
    let decoding = chunks.decoding_bytes().saturating_mul(run.resources.worker_threads() as u64);
    let with = |room: u64| {
        let need = need_of(parts, decoding.saturating_add(room), steps, run.resources.memory, run);
        let shares = need.shares(run.resources.memory, run.resources.worker_threads()).ok()?;
        Some((shares.workers, need, room))
    };
    let found = rooms(&*chunks, parts, run.resources.memory / PART).into_iter().filter_map(with);
    let Some((_, need, room)) = found.reduce(|a, b| if b.0 > a.0 { b } else { a }) else {
        return Ok((plain, None));
    };
    (planned.copied, planned.copying) = (0, estimate::BASE.saturating_add(stream.working_bytes()));
    Ok((need, Some(room)))
}

/// Bytes of the chunks of a layer, and of those of a row, as far as they are worth keeping and take
/// at most so many.
fn rooms(chunks: &dyn ChunkSource, parts: &MeshParts, most: u64) -> Vec<u64> {
    let (dims, edge) = (chunks.info().dims, chunks.chunk_dims());
    let lattice = parts.chunks.bricks().lattice;
    let along = |b: &LatticeBox, a: usize| {
        let s = lattice.log2_steps[a];
        [u64::from(b.lo[a]) >> s, (u64::from(b.hi[a]) >> s) + 1]
    };
    // Source chunks along each axis that meet one of the archive, at most; and how many times
    // more samples these hold than it has itself, on average.
    let (mut met, mut more, mut count) = ([1u64; 3], [0.0; 3], 0.0);
    let domain = lattice.domain();
    for chunk in estimate::some_chunks(&parts.chunks) {
        let around = estimate::near(&parts.points, &chunk.core, &domain, parts.halo);
        for a in 0..3 {
            let ([lo, hi], [from, to]) = (along(&around, a), along(&chunk.core, a));
            let n = hi.min(dims[a]).div_ceil(edge[a]).saturating_sub(lo / edge[a]);
            met[a] = met[a].max(n);
            let samples = n.saturating_mul(edge[a]).min(dims[a]) as f64;
            more[a] += samples / to.min(dims[a]).saturating_sub(from).max(1) as f64;
        }
        count += 1.0;
    }
    let grid: [u64; 3] = std::array::from_fn(|a| dims[a].div_ceil(edge[a]));
    let one = edge.iter().fold(chunks.info().field.scalar.bytes() as u64, |n, &e| n.saturating_mul(e));
    let bytes = |n: [u64; 3]| n.into_iter().fold(one, u64::saturating_mul);
    let (layer, row) = (bytes([grid[0], grid[1], met[2]]), bytes([grid[0], met[1], met[2]]));
    let decodes = more[1] / count * (more[2] / count);
    let row = Some(row).filter(|_| decodes <= MOST_DECODES);
    [Some(layer), row].into_iter().flatten().filter(|&room| room <= most).collect()
}

#[cfg(test)]
mod tests {
    use crate::exec::Resources;
    use crate::exec::Silent;
    use crate::formats::{OpenOptions, StepSource};
    use crate::pipeline::{
        Amount, ReduceReport, ReduceSettings, RunSettings, Shard, commit_shards, plan_shards, reduce_series,
        work_shard,
    };
    use crate::points::SetKind;
    use crate::sample::Values;
    use std::fs;
    use std::path::Path;

    const DIMS: [usize; 3] = [150, 140, 130];
    const EDGE: usize = 32;

    /// A chunk that is not there reads as 7.
    fn value(x: usize, y: usize, z: usize) -> u16 {
        let [a, b, c] = [x, y, z].map(|v| v.min(DIMS[0] - 1) / EDGE);
        let wave = |v: usize| 300.0 * libm::sin(v as f64 / 9.0);
        if (a, b, c) == (1, 2, 1) { 7 } else { (1000.0 + wave(x) + wave(y + 3) + wave(z + z)) as u16 }
    }

    /// The volume as NRRD, and as Zarr.
    fn write(folder: &Path) {
        let [nx, ny, nz] = DIMS;
        let mut raw = format!(
            "NRRD0004\ntype: ushort\ndimension: 3\nsizes: {nx} {ny} {nz}\nencoding: raw\nendian: little\n\n"
        )
        .into_bytes();
        for (z, y) in (0..nz).flat_map(|z| (0..ny).map(move |y| (z, y))) {
            (0..nx).for_each(|x| raw.extend(value(x, y, z).to_le_bytes()));
        }
        fs::write(folder.join("a.nrrd"), raw).unwrap();
        let zarr = folder.join("a.zarr");
        fs::create_dir(&zarr).unwrap();
        let head = format!(
            r#"{{"zarr_format":2,"shape":[{nz},{ny},{nx}],"chunks":[32,32,32],"dtype":"<u2",
               "compressor":null,"fill_value":7,"order":"C","filters":null}}"#
        );
        fs::write(zarr.join(".zarray"), head).unwrap();
        let parts = DIMS.map(|d| d.div_ceil(EDGE));
        for n in 0..parts.iter().product() {
            let [a, b, c] = [n % parts[0], n / parts[0] % parts[1], n / parts[0] / parts[1]];
            let mut chunk = vec![];
            for (z, y) in (0..EDGE).flat_map(|z| (0..EDGE).map(move |y| (z, y))) {
                let at = |x| value(a * EDGE + x, b * EDGE + y, c * EDGE + z);
                (0..EDGE).for_each(|x| chunk.extend(at(x).to_le_bytes()));
            }
            if (a, b, c) != (1, 2, 1) {
                fs::write(zarr.join(format!("{c}.{b}.{a}")), chunk).unwrap();
            }
        }
    }

    #[test]
    fn chunks_give_the_archive_of_the_plain_file_without_a_copy_and_so_do_shards() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path());
        let run = RunSettings {
            resources: Resources::default()
                .with_threads(2)
                .with_memory(256 << 20)
                .with_scratch(Some(dir.path().join("a.nrrd/nowhere"))),
            ..RunSettings::default()
        };
        for (n, values) in [Values::Sample, Values::Fit].into_iter().enumerate() {
            let settings = ReduceSettings {
                points: Some(SetKind::Halton),
                amount: Amount::Fraction(1.0 / 32.0),
                chunk_points: 2_000,
                measure: true,
                values,
                ..ReduceSettings::default()
            };
            let out = |name: &str| dir.path().join(format!("{name}{n}.isospan"));
            let make = |input: &str, run: &RunSettings| {
                let (options, path) = (OpenOptions::default(), dir.path().join(input));
                reduce_series(&[StepSource::new(&path, &options)], &settings, &out(input), run, &Silent)
                    .unwrap()
            };
            let told = |r: &ReduceReport| (r.points, r.chunks, r.range, r.error.clone());
            let plain = told(&make("a.nrrd", &run));
            assert!(plain.3.is_some());
            assert_eq!(plain, told(&make("a.zarr", &run)));
            let (sharded, silent) = (out("sharded"), &Silent);
            let source = StepSource::new(&dir.path().join("a.zarr"), &OpenOptions::default());
            plan_shards(&[source], &settings, &sharded, 3, &run, silent).unwrap();
            for shard in 0..3 {
                work_shard(&sharded, Shard::new(shard, 3).unwrap(), &run, silent).unwrap();
            }
            assert_eq!(plain.0, commit_shards(&sharded, &run, silent).unwrap().points);
            let manifest = |archive: &Path| fs::read(archive.join("manifest.json")).unwrap();
            assert!(manifest(&sharded) == manifest(&out("a.zarr")));
        }
    }
}
