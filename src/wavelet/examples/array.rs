//! Compresses a file of raw samples, and decodes one.
//!
//! `array compress SAMPLES NX NY NZ ACCURACY OUT`: raw little-endian `f32`, x fastest. ACCURACY is
//! `STEP` (of the quantiser), `rms:ERROR`, `max:ERROR` or `lossless`, in units of the samples.
//! `array decode FILE LEVEL OUT`: the nodes of a level.
use std::process::ExitCode;

use isospan_wavelet::{Accuracy, Compressed, Settings, compress};

fn run(args: &[&str]) -> Result<(), Box<dyn std::error::Error>> {
    match args {
        ["compress", samples, nx, ny, nz, step, out] => {
            let bytes = std::fs::read(samples)?;
            let samples: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            let accuracy = match step.split_once(':') {
                Some(("rms", error)) => Accuracy::Rms(error.parse()?),
                Some(("max", bound)) => Accuracy::Max(bound.parse()?),
                None if *step == "lossless" => Accuracy::Lossless,
                _ => Accuracy::Step(step.parse()?),
            };
            let settings = Settings { accuracy, delay: None };
            std::fs::write(out, compress(&samples, [nx.parse()?, ny.parse()?, nz.parse()?], &settings)?)?;
        }
        ["decode", file, level, out] => {
            let bytes = std::fs::read(file)?;
            let nodes = Compressed::new(&bytes, 1 << 32)?.level(level.parse()?)?;
            std::fs::write(out, nodes.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>())?;
        }
        _ => {
            return Err(
                "usage: array compress SAMPLES NX NY NZ ACCURACY OUT, or array decode FILE LEVEL OUT".into(),
            );
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match run(&args.iter().map(String::as_str).collect::<Vec<_>>()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("array: {error}");
            ExitCode::FAILURE
        }
    }
}
