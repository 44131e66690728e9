//! A fingerprint of an input file: enough to notice that it is not the file an archive was made from.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// Up to here files are hashed whole.
const WHOLE: u64 = 16 << 20;
/// Of the others together, this many evenly spaced pieces, the first at their start and the last at their end.
const PIECES: u64 = 64;
const PIECE: u64 = 64 << 10;

/// xxh3-128 of the lengths and contents of the files that make up an input, in hexadecimal. The first files are hashed
/// whole, up to 16 MiB together; of the others all lengths and 64 evenly spaced pieces, as if they were one file: the cost
/// of a stack of a thousand slices is that of one large file.
///
/// # Errors
/// [`Error::Io`] when a file cannot be read.
pub fn fingerprint(files: &[PathBuf]) -> Result<String> {
    let (mut hash, mut whole, mut rest, mut total) = (Xxh3::new(), 0, vec![], 0);
    for file in files {
        let about = std::fs::metadata(file).map_err(|e| Error::io("read", file, e))?;
        hash.update(&about.len().to_le_bytes());
        if about.len() <= WHOLE - whole {
            whole += about.len();
            add(&mut hash, file, 0, about.len()).map_err(|e| Error::io("read", file, e))?;
        } else {
            rest.push((file, total, about.len()));
            total += about.len();
        }
    }
    let piece = PIECE.min(total);
    for i in 0..if rest.is_empty() { 0 } else { PIECES } {
        let start = (u128::from(total - piece) * u128::from(i) / u128::from(PIECES - 1)) as u64;
        // The files that the piece touches: those before end before it starts.
        let first = rest.partition_point(|&(_, at, len)| at + len <= start);
        for &(file, at, len) in rest[first..].iter().take_while(|f| f.1 < start + piece) {
            let (lo, hi) = (start.max(at) - at, (start + piece).min(at + len) - at);
            add(&mut hash, file, lo, hi - lo).map_err(|e| Error::io("read", file, e))?;
        }
    }
    Ok(format!("{:032x}", hash.digest128()))
}

/// Adds `len` bytes of a file from `at` on.
fn add(hash: &mut Xxh3, path: &Path, at: u64, len: u64) -> std::io::Result<()> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::Start(at))?;
    let mut part = file.take(len);
    let mut buffer = vec![0; PIECE as usize];
    loop {
        match part.read(&mut buffer)? {
            0 => return Ok(()),
            n => hash.update(&buffer[..n]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn content_and_length_matter() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&[1; 100]).unwrap();
        let a = fingerprint(&[file.path().to_path_buf()]).unwrap();
        file.write_all(&[1]).unwrap();
        let b = fingerprint(&[file.path().to_path_buf()]).unwrap();
        assert_ne!(a, b);
        file.as_file().set_len(WHOLE + 12345).unwrap();
        let c = fingerprint(&[file.path().to_path_buf()]).unwrap();
        assert_eq!(c, fingerprint(&[file.path().to_path_buf()]).unwrap());
        file.as_file_mut().seek(SeekFrom::End(-1)).unwrap();
        file.write_all(&[7]).unwrap();
        assert_ne!(c, fingerprint(&[file.path().to_path_buf()]).unwrap());
    }

    #[test]
    fn a_stack_is_hashed_as_one_file() {
        let dir = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = (0..3).map(|i| dir.path().join(format!("{i}"))).collect();
        for file in &files {
            File::create(file).unwrap().set_len(WHOLE / 2 + 1).unwrap();
        }
        let before = fingerprint(&files).unwrap();
        let swapped = fingerprint(&[files[1].clone(), files[0].clone(), files[2].clone()]).unwrap();
        assert_eq!(before, swapped, "the names do not matter, the order of contents does");
        let mut last = std::fs::OpenOptions::new().write(true).open(&files[2]).unwrap();
        last.seek(SeekFrom::Start(WHOLE / 2)).unwrap();
        last.write_all(&[1]).unwrap();
        assert_ne!(before, fingerprint(&files).unwrap(), "the last byte of the last file");
        assert!(fingerprint(&[dir.path().join("none")]).is_err());
    }
}
