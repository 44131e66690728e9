//! Makes the tables of the format from volumes, and shows what these take with those of now.
//!
//! `cargo run --release -p isospan-wavelet --example learn -- LIST TARGETS [TABLES.rs]`. Each line
//! of LIST has a name, a file of raw little-endian `f32` samples, and samples along x, y, z.
//! TARGETS are RMS errors in percent of the range: 1,2; or largest errors: max1,max2; or
//! `lossless`.
#![allow(clippy::print_stdout)]

use std::time::Instant;

use isospan_wavelet::{Accuracy, Compressed, Settings, compress, learn};

struct Volume {
    name: String,
    samples: Vec<f32>,
    dims: [usize; 3],
}

fn volumes(list: &str) -> impl Iterator<Item = Volume> + '_ {
    list.lines().filter(|l| !l.trim().is_empty()).map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let bytes = std::fs::read(words[1]).expect("a file of samples");
        let samples = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        Volume { name: words[0].into(), samples, dims: [2, 3, 4].map(|i| words[i].parse().expect("a size")) }
    })
}

fn rms(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    (sum / a.len() as f64).sqrt()
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let list = std::fs::read_to_string(&args[1]).expect("a list of volumes");
    let targets: Vec<&str> = args[2].split(',').collect();
    let mut counts = vec![];
    let mut logs = vec![0.0; targets.len()];
    let mut n = 0.0;
    for volume in volumes(&list) {
        let range = volume.samples.iter().fold([f32::MAX, f32::MIN], |r, s| [r[0].min(*s), r[1].max(*s)]);
        let extent = f64::from(range[1]) - f64::from(range[0]);
        n += 1.0;
        for (target, log) in targets.iter().zip(&mut logs) {
            let percent = |text: &str| text.parse::<f64>().expect("an error in percent") / 100.0 * extent;
            let accuracy = match target.strip_prefix("max") {
                Some(bound) => Accuracy::Max(percent(bound)),
                None if *target == "lossless" => Accuracy::Lossless,
                None => Accuracy::Rms(percent(target)),
            };
            let settings = Settings { accuracy, delay: None };
            let bytes = compress(&volume.samples, volume.dims, &settings).expect("it compresses");
            let bits = 8.0 * bytes.len() as f64 / volume.samples.len() as f64;
            let compressed = Compressed::new(&bytes, usize::MAX).expect("it is whole");
            let (step, delay) = (compressed.step(), Some(compressed.delay()));
            let start = Instant::now();
            let _ =
                compress(&volume.samples, volume.dims, &Settings { accuracy: Accuracy::Step(step), delay });
            let write = start.elapsed().as_secs_f64();
            let start = Instant::now();
            let back = compressed.level(0).expect("it decodes");
            let read = start.elapsed().as_secs_f64();
            let error = rms(&volume.samples, &back);
            let speed = |s: f64| volume.samples.len() as f64 / s / 1e6;
            println!(
                "{:10} {target} {:?}: {bits:.4} bits a sample, error {:.3} %, {} bytes, M samples/s: write {:.0}, read {:.0}",
                volume.name,
                compressed.delay(),
                100.0 * error / extent,
                bytes.len(),
                speed(write),
                speed(read),
            );
            *log += bits.ln();
            learn::count(&compressed, &mut counts).expect("it decodes");
        }
    }
    for (target, log) in targets.iter().zip(&logs) {
        println!("geometric mean at {target}: {:.5} bits a sample", (log / n).exp());
    }
    if let Some(file) = args.get(3).filter(|f| f.ends_with(".rs")) {
        let head = std::fs::read_to_string(file).expect("tables.rs");
        let at = head.find("= [\n").expect("a table") + 4;
        std::fs::write(file, format!("{}{}];\n", &head[..at], learn::tables(&counts))).expect("tables.rs");
    }
}
