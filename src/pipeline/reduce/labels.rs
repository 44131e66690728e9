//! Makes tiles of labels, chunk by chunk: nothing is transformed, and a tile needs no other.

use super::encoded::EncodedChunk;
use super::source::Work;
use super::workers::MakeChunks;
use crate::pipeline::read::{box3, index_box};
use crate::pipeline::settings::NanPolicy;
use crate::pipeline::stage::StageTimes;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::grid::{Chunk, IndexBox};
use isospan_wavelet::{MOST_LABEL, MaskBuilder, blocks_of, encode_labels};
use std::collections::HashMap;
use std::time::Instant;

/// Makes tiles of labels.
pub(super) struct LabelMaker<'a>(pub(super) Work<'a>);

impl LabelMaker<'_> {
    /// The labels of a box of samples. A missing one has the label before it.
    fn labels(&self, place: &IndexBox, samples: &[f32]) -> Result<Vec<i32>> {
        let (mut labels, mut last) = (Vec::with_capacity(samples.len()), 0);
        for (i, sample) in samples.iter().enumerate() {
            if !sample.is_nan() {
                if sample.fract() != 0.0 || sample.abs() > MOST_LABEL as f32 {
                    return Err(self.refuse(place, i as u64, *sample));
                }
                last = *sample as i32;
            }
            labels.push(last);
        }
        Ok(labels)
    }

    /// The error for a sample that is no label.
    fn refuse(&self, place: &IndexBox, i: u64, sample: f32) -> Error {
        let [nx, ny, _] = place.dims();
        let at = [i % nx, i / nx % ny, i / nx / ny];
        let [x, y, z] = [0, 1, 2].map(|a| place.lo[a] + at[a]);
        let expected = format!("labels: whole numbers from -{MOST_LABEL} to {MOST_LABEL}, which f32 holds");
        Error::bad_input(self.0.path, format!("sample ({x}, {y}, {z})"), expected, sample.to_string())
            .with_help("where samples are quantities and no names, leave `labels` out: `target_max` and `lossless` bound their errors")
    }
}

impl MakeChunks for LabelMaker<'_> {
    fn make(&self, chunk: &Chunk) -> Result<EncodedChunk> {
        let (work, mut times) = (&self.0, StageTimes::default());
        let at = chunk.brick_lo.map(|n| n as usize);
        let place = work.samples(chunk);
        let (mut tiles, mut mask) = (HashMap::new(), MaskBuilder::new(place));
        let refused = |e: isospan_wavelet::Error| Error::usage(format!("labels: {e}"));
        for part in work.pyramid.parts(at, work.edge) {
            work.cancel.check()?;
            let (start, here) = (Instant::now(), index_box(&part));
            let samples = work.read(&here)?;
            if work.field.nan == NanPolicy::Mask {
                mask.add(&part, &part, &samples);
            }
            times.sample += start.elapsed();
            let start = Instant::now();
            let labels = work.bad.note(0, work.number, self.labels(&here, &samples))?;
            for id in work.pyramid.label_tiles(&part) {
                let tile = work.pyramid.label_box(id.at);
                let bytes = encode_labels(&box3(&here).values_of(&labels, &tile), tile.size);
                tiles.insert(id, bytes.map_err(refused)?);
            }
            times.encode += start.elapsed();
        }
        let mut blocks = blocks_of(work.pyramid, at, &tiles);
        blocks.extend(Some(mask.finish()).filter(|mask| !mask.is_empty()));
        Ok(EncodedChunk {
            points: place.len() as u64,
            mesh_blocks: vec![],
            value_blocks: vec![blocks],
            sum_blocks: vec![],
            times,
        })
    }

    fn points(&self, chunk: &Chunk) -> u64 {
        self.0.samples(chunk).len() as u64
    }

    fn product_bytes(&self, chunk: &Chunk, _: u64) -> u64 {
        self.points(chunk) + (64 << 10)
    }

    fn will_need(&self, chunk: &Chunk) {
        self.0.field.reader.will_need(index_box(&self.0.samples(chunk)));
    }

    fn pass(&self, chunk: &Chunk) {
        self.0.field.pass(chunk);
    }

    fn queue(&self) -> u64 {
        self.0.shares.queue
    }

    fn cancel(&self) -> &CancelToken {
        self.0.cancel
    }
}
