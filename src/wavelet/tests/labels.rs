//! Labels are what they were, in tiles of any size, and damaged ones are errors.

use isospan_wavelet::{Error, MOST_LABEL, Pyramid, blocks_of, decode_labels, encode_labels};
use proptest::prelude::*;
use std::collections::HashMap;

fn noise(i: usize, seed: u32) -> u32 {
    let mut x = (i as u32 ^ seed.wrapping_mul(0x9e37_79b9)).wrapping_mul(0x85eb_ca6b);
    x = (x ^ x >> 13).wrapping_mul(0xc2b2_ae35);
    x ^ x >> 16
}

/// The nearest of some random places is the label of a node.
fn cells(size: [usize; 3], places: usize, seed: u32) -> Vec<i32> {
    let place = |n: usize| [0, 1, 2].map(|a| noise(3 * n + a, seed) as usize % 32);
    let places: Vec<[usize; 3]> = (0..places).map(place).collect();
    let nearest = |i: usize| {
        let at = [i % size[0], i / size[0] % size[1], i / size[0] / size[1]];
        let far = |p: &[usize; 3]| (0..3).map(|a| at[a].abs_diff(p[a]).pow(2)).sum::<usize>();
        (0..places.len()).min_by_key(|n| far(&places[*n])).unwrap() as i32
    };
    (0..size.iter().product()).map(nearest).collect()
}

fn there_and_back(labels: &[i32], size: [usize; 3]) -> usize {
    let bytes = encode_labels(labels, size).unwrap();
    assert!(decode_labels(&bytes, size).unwrap() == labels, "{size:?}");
    bytes.len()
}

#[test]
fn a_tile_of_one_label_is_a_few_bytes() {
    let size = [32; 3];
    assert_eq!(there_and_back(&vec![0; 32 * 32 * 32], size), 0);
    for label in [1, -1, 255, 70_000, MOST_LABEL, -MOST_LABEL] {
        assert!(there_and_back(&vec![label; 32 * 32 * 32], size) < 8, "{label}");
    }
}

#[test]
fn tiles_of_all_kinds_come_back() {
    for size in [[32, 32, 32], [1, 1, 1], [32, 1, 1], [1, 32, 1], [1, 1, 32], [7, 32, 19]] {
        let n = size.iter().product();
        for places in [1, 2, 20, 400] {
            there_and_back(&cells(size, places, places as u32), size);
        }
        let random = |modulo: u32| (0..n).map(|i| (noise(i, 5) % modulo) as i32).collect::<Vec<_>>();
        for modulo in [2, 3, 1000, 1 << 24] {
            there_and_back(&random(modulo), size);
        }
        // Differences of all lengths, and more labels than are remembered.
        let ends: Vec<i32> =
            (0..n as i32).map(|i| if i % 2 == 0 { MOST_LABEL - i } else { i - MOST_LABEL }).collect();
        there_and_back(&ends, size);
    }
}

#[test]
fn cells_take_a_bit_a_node_or_less() {
    let size = [32; 3];
    let bits = |places| 8.0 * there_and_back(&cells(size, places, 1), size) as f64 / 32_768.0;
    let found = [2, 20, 200].map(bits);
    assert!(found[0] < 0.09 && found[1] < 0.24 && found[2] < 0.75, "{found:?}");
}

#[test]
fn labels_that_f32_has_not_and_boxes_that_are_no_tiles_are_refused() {
    assert_eq!(encode_labels(&[0, MOST_LABEL + 1], [2, 1, 1]), Err(Error::Label { index: 1 }));
    assert_eq!(encode_labels(&[i32::MIN], [1; 3]), Err(Error::Label { index: 0 }));
    for (labels, size) in [(33, [33, 1, 1]), (0, [0, 1, 1]), (5, [2, 2, 1])] {
        assert!(matches!(encode_labels(&vec![0; labels], size), Err(Error::Size { .. })), "{size:?}");
        if labels != 5 {
            assert!(matches!(decode_labels(&[], size), Err(Error::Size { .. })), "{size:?}");
        }
    }
}

#[test]
fn damaged_tiles_are_errors_or_labels() {
    let size = [20, 32, 32];
    for labels in [cells(size, 60, 3), vec![7; 20 * 32 * 32]] {
        let bytes = encode_labels(&labels, size).unwrap();
        for n in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[n] ^= 1 << (n % 8);
            let _ = decode_labels(&damaged, size);
            let _ = decode_labels(&bytes[..n], size);
        }
        assert!(decode_labels(&[bytes, vec![1; 8]].concat(), size).is_err());
    }
}

#[test]
fn the_tiles_of_chunks_are_all_tiles_once() {
    let pyramid = Pyramid::of_labels([300, 33, 257]);
    assert!(pyramid.coarsest() == 0 && pyramid.has_labels() && !Pyramid::new([5; 3], [0; 3]).has_labels());
    let [nx, ny, nz] = pyramid.chunks();
    let mut seen = HashMap::new();
    for at in (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / nx / ny]) {
        let blocks = pyramid.blocks(at);
        let tiles: Vec<_> = blocks.iter().flat_map(|block| block.ids()).collect();
        for part in pyramid.parts(at, 128) {
            assert!(pyramid.label_tiles(&part).all(|id| tiles.contains(&id)));
        }
        let bytes: HashMap<_, _> = tiles.iter().map(|id| (*id, vec![id.at[0] as u8; 3])).collect();
        let stored = blocks_of(&pyramid, at, &bytes);
        for (number, (block, stored)) in blocks.iter().zip(&stored).enumerate() {
            for (id, place) in block.places(stored).unwrap() {
                assert_eq!(stored[place], bytes[&id]);
                assert_eq!((pyramid.chunk_of(id), pyramid.block_of(at, id).0), (at, number));
                assert_eq!(seen.insert(id, ()), None, "{id:?}");
            }
        }
    }
    assert_eq!(seen.len(), 10 * 2 * 9);
    let nodes: usize = seen.keys().map(|id| pyramid.label_box(id.at).len()).sum();
    assert_eq!(nodes, 300 * 33 * 257);
}

fn any_size() -> impl Strategy<Value = [usize; 3]> {
    [1..=32_usize, 1..=32_usize, 1..=9_usize]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_labels_come_back(size in any_size(), seed in any::<u32>(), modulo in 1..5000_u32, places in 1..60_usize) {
        let mut labels = cells(size, places, seed);
        there_and_back(&labels, size);
        let n = labels.len();
        (0..n).for_each(|i| if noise(i, seed).is_multiple_of(3) { labels[i] = (noise(i, !seed) % modulo) as i32 - 99 });
        there_and_back(&labels, size);
    }

    #[test]
    fn any_bytes_are_labels_or_an_error(size in any_size(), bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        if let Ok(labels) = decode_labels(&bytes, size) {
            prop_assert!(labels.iter().all(|label| label.abs() <= MOST_LABEL));
        }
    }
}
