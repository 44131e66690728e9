//! An array that is made and read chunk by chunk is the one that is made as a whole.

use isospan_wavelet::{
    Accuracy, Box3, Coarse, Compressed, Error, Levels, NoTiles, Pyramid, Scale, Settings, TileBlock, TileId,
    TileSource, blocks_of, compress, decode_corrections, decode_tile, encode_corrections, encode_part,
};
use std::collections::HashMap;
use std::sync::Arc;

fn field(dims: [usize; 3]) -> Vec<f32> {
    let [nx, ny, nz] = dims;
    let value = |i: usize| {
        let [x, y, z] = [i % nx, i / nx % ny, i / nx / ny].map(|n| n as f32);
        let ball = if (x - 250.0).abs() + y + z < 40.0 { 3.0 } else { 0.0 };
        (x * 0.21).sin() + (y * 0.13 + z * 0.17).cos() + ball + (i % 13) as f32 * 0.01
    };
    (0..nx * ny * nz).map(value).collect()
}

/// The parts of an array that were written.
struct Stored {
    pyramid: Pyramid,
    scale: Scale,
    coarse: Coarse,
    chunks: HashMap<[usize; 3], Vec<(TileBlock, Vec<u8>)>>,
    /// The step of a series before.
    before: Option<Arc<Stored>>,
}

impl Stored {
    fn new(samples: &[f32], dims: [usize; 3], delay: [u8; 3], scale: Scale, edge: usize) -> Self {
        Self::after(None, samples, dims, delay, scale, edge)
    }

    fn after(
        before: Option<Arc<Stored>>,
        samples: &[f32],
        dims: [usize; 3],
        delay: [u8; 3],
        scale: Scale,
        edge: usize,
    ) -> Self {
        let pyramid = Pyramid::new(dims, delay);
        let nodes = pyramid.nodes(pyramid.details());
        let mut low = vec![f32::NAN; nodes.iter().product()];
        let [cx, cy, cz] = pyramid.chunks();
        let mut chunks = HashMap::new();
        for at in (0..cx * cy * cz).map(|i| [i % cx, i / cx % cy, i / cx / cy]) {
            let mut tiles = HashMap::new();
            for part in pyramid.parts(at, edge) {
                let Box3 { start, size } = pyramid.window(&part);
                let mut window = vec![];
                for z in start[2]..start[2] + size[2] {
                    for y in start[1]..start[1] + size[1] {
                        let row = (z * dims[1] + y) * dims[0] + start[0];
                        window.extend(samples[row..row + size[0]].iter().map(|s| scale.enter(f64::from(*s))));
                    }
                }
                let made = match &before {
                    Some(before) => encode_part(&pyramid, &scale, &part, window, &mut Reader(before)),
                    None => encode_part(&pyramid, &scale, &part, window, &mut NoTiles),
                };
                let made = made.unwrap();
                tiles.extend(made.tiles);
                let place = pyramid.low_box(&part);
                for (i, value) in made.low.into_iter().enumerate() {
                    let [x, y, _] = place.size;
                    let at = [i % x + place.start[0], i / x % y + place.start[1], i / x / y + place.start[2]];
                    low[(at[2] * nodes[1] + at[1]) * nodes[0] + at[0]] = value;
                }
            }
            let bytes = blocks_of(&pyramid, at, &tiles);
            let blocks: Vec<_> = pyramid.blocks(at).into_iter().zip(bytes).collect();
            let places: usize = blocks.iter().map(|(block, bytes)| block.places(bytes).unwrap().len()).sum();
            assert_eq!(places, tiles.len());
            chunks.insert(at, blocks);
        }
        assert!(low.iter().all(|v| v.is_finite()));
        let bytes = match &before {
            Some(before) => Coarse::encode(&pyramid, &scale, low, &mut Reader(before)),
            None => Coarse::encode(&pyramid, &scale, low, &mut NoTiles),
        };
        let coarse = Coarse::new(&pyramid, bytes.unwrap()).unwrap();
        Self { pyramid, scale, coarse, chunks, before }
    }

    fn detail_bytes(&self) -> usize {
        self.chunks.values().flatten().map(|(_, bytes)| bytes.len()).sum()
    }

    fn nodes(&self, level: usize, wanted: &Box3) -> Vec<f32> {
        let levels = Levels { pyramid: &self.pyramid, scale: &self.scale, top: self.coarse.top() };
        levels.nodes(level, wanted, &mut Reader(self)).unwrap()
    }
}

struct Reader<'a>(&'a Stored);

impl TileSource for Reader<'_> {
    type Error = Error;

    fn tile(&mut self, id: TileId) -> Result<Option<Arc<isospan_wavelet::Tile>>, Error> {
        let of = self.0;
        if id.level > of.pyramid.details() {
            return of.coarse.tile(&of.pyramid, id, self);
        }
        let blocks = &of.chunks[&of.pyramid.chunk_of(id)];
        let (block, bytes) = blocks.iter().find(|(block, _)| block.ids().any(|i| i == id)).unwrap();
        let place = block.places(bytes)?.into_iter().find(|(i, _)| *i == id);
        decode_tile(&of.pyramid, id, place.map(|(_, place)| &bytes[place]), self)
    }

    fn before(&mut self, id: TileId) -> Result<Option<Arc<isospan_wavelet::Tile>>, Error> {
        self.0.before.as_ref().map_or(Ok(None), |before| Reader(before).tile(id))
    }
}

/// A field that moves, one that stands still but for a place, one that stands still, and one that
/// is gone: each is what it is alone, but for what was not worth its bits.
#[test]
fn steps_of_a_series_refer_to_the_one_before() {
    let (dims, delay, step) = ([300, 33, 40], [0; 3], 0.05);
    let scale = Scale::new([-3.0, 6.0], step).unwrap();
    let first = field(dims);
    let mut place = first.clone();
    place[(20 * dims[1] + 16) * dims[0] + 40] += 2.0;
    let moved: Vec<f32> = (0..first.len()).map(|i| first[(i + 1) % first.len()]).collect();
    let steps = [first.clone(), first.clone(), place, moved, vec![1.5; first.len()], first];
    for edge in [128, 256] {
        let (mut before, mut bytes): (Option<Arc<Stored>>, Vec<_>) = (None, vec![]);
        for (n, samples) in steps.iter().enumerate() {
            let alone = Stored::new(samples, dims, delay, scale, edge);
            let stored = Arc::new(Stored::after(before.take(), samples, dims, delay, scale, edge));
            let all = Box3::all(dims);
            let [found, expected] = [&stored, &Arc::new(alone)].map(|of| of.nodes(0, &all));
            let rms = |values: &[f32]| {
                let squares = values.iter().zip(samples).map(|(a, b)| f64::from(a - b).powi(2));
                (squares.sum::<f64>() / samples.len() as f64).sqrt()
            };
            let (with, without) = (rms(&found), rms(&expected));
            assert!(with < 1.1 * without + 1e-6, "step {n}: {with} {without}");
            let part = Box3 { start: [250, 3, 5], size: [20, 9, 30] };
            assert_eq!(stored.nodes(0, &part), all.values_of(&found, &part), "step {n}");
            bytes.push(stored.detail_bytes());
            before = Some(stored);
        }
        assert_eq!(bytes[1], 0, "what stands still takes no bytes");
        assert!(bytes[2] > 0 && bytes[2] < bytes[0] / 4, "{bytes:?}");
        assert!(bytes[3] < bytes[0] && bytes[4] > 0 && bytes[5] <= bytes[0] + 200, "{bytes:?}");
    }
}

#[test]
fn chunks_are_the_whole() {
    for (dims, delay) in [
        ([257, 12, 300], [0, 0, 0]),
        ([513, 9, 40], [0, 0, 0]),
        ([300, 33, 17], [0, 1, 0]),
        ([64, 20, 270], [0, 0, 2]),
        ([5, 6, 7], [0, 0, 0]),
        ([1, 1, 600], [0, 0, 0]),
    ] {
        let samples = field(dims);
        let range = samples
            .iter()
            .fold([f64::MAX, f64::MIN], |[lo, hi], s| [lo.min(f64::from(*s)), hi.max(f64::from(*s))]);
        let settings = Settings { accuracy: Accuracy::Step(0.05), delay: Some(delay) };
        let bytes = compress(&samples, dims, &settings).unwrap();
        let whole = Compressed::new(&bytes, samples.len()).unwrap();
        for edge in [128, 256] {
            let stored = Stored::new(&samples, dims, delay, Scale::new(range, 0.05).unwrap(), edge);
            for level in 0..=whole.pyramid().coarsest() {
                let all = Box3::all(whole.pyramid().nodes(level));
                assert!(
                    stored.nodes(level, &all) == whole.level(level).unwrap(),
                    "{dims:?} {delay:?} {level}"
                );
            }
        }
    }
}

#[test]
fn damaged_blocks_are_errors() {
    let dims = [70, 40, 33];
    let stored = Stored::new(&field(dims), dims, [0; 3], Scale::new([-3.0, 5.0], 0.02).unwrap(), 256);
    for (block, bytes) in &stored.chunks[&[0; 3]] {
        let count = block.places(bytes).unwrap().len();
        assert!(count > 0);
        for end in 0..bytes.len() {
            assert!(end == 0 || block.places(&bytes[..end]).is_err(), "{end} of {}", bytes.len());
        }
    }
}

#[test]
fn corrections_come_back_in_any_box() {
    let chunk = Box3 { start: [256, 0, 512], size: [70, 40, 33] };
    let numbers: Vec<i32> =
        (0..chunk.len()).map(|i| if i % 97 == 0 { i as i32 % 7 - 3 } else { 0 }).collect();
    let bytes = encode_corrections(&chunk, &numbers).unwrap();
    let mut all = vec![0; chunk.len()];
    decode_corrections(&chunk, &bytes, &chunk, &mut all).unwrap();
    assert_eq!(all, numbers);
    let part = Box3 { start: [300, 10, 520], size: [20, 20, 20] };
    let mut some = vec![0; part.len()];
    decode_corrections(&chunk, &bytes, &part, &mut some).unwrap();
    let at = |x: usize, y: usize, z: usize| numbers[((z + 8) * 40 + y + 10) * 70 + x + 44];
    assert!((0..8000).all(|i| some[i] == at(i % 20, i / 20 % 20, i / 400)));
    assert!(encode_corrections(&chunk, &vec![0; chunk.len()]).unwrap().is_empty());
}
