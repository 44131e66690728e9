//! A fingerprint of an input file: enough to notice that it is not the file an archive was made from.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// Up to here all of a file is hashed.
const WHOLE: u64 = 16 << 20;
/// Of a larger file, this many evenly spaced pieces, the first at its start and the last at its end.
const PIECES: u64 = 64;
const PIECE: u64 = 64 << 10;

/// xxh3-128 of the lengths and contents of the files that make up an input, in hexadecimal; of a large file, of 64 evenly
/// spaced pieces of its content.
///
/// # Errors
/// [`Error::Io`] when a file cannot be read.
pub fn fingerprint(files: &[PathBuf]) -> Result<String> {
    let mut hash = Xxh3::new();
    for file in files {
        add(&mut hash, file).map_err(|e| Error::io("read", file, e))?;
    }
    Ok(format!("{:032x}", hash.digest128()))
}

fn add(hash: &mut Xxh3, path: &Path) -> std::io::Result<()> {
    let mut file = File::open(path)?;
    let len = file.metadata()?.len();
    hash.update(&len.to_le_bytes());
    let mut buffer = vec![0; PIECE as usize];
    if len <= WHOLE {
        loop {
            let n = file.read(&mut buffer)?;
            if n == 0 {
                return Ok(());
            }
            hash.update(&buffer[..n]);
        }
    }
    for i in 0..PIECES {
        let at = u128::from(len - PIECE) * u128::from(i) / u128::from(PIECES - 1);
        file.seek(SeekFrom::Start(at as u64))?;
        file.read_exact(&mut buffer)?;
        hash.update(&buffer);
    }
    Ok(())
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
}
