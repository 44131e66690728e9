//! Decodes LZF: literals, and matches of what was decoded before.
//!
//! ```text
//!  000LLLLL                        L + 1 literals follow
//!  LLLddddd dddddddd               a match: L + 2 bytes, from d + 1 bytes before; L is 1 to 6
//!  111ddddd LLLLLLLL dddddddd      a match: L + 9 bytes
//! ```
//!
//! The format: Lehmann, liblzf, <http://oldhome.schmorp.de/marc/liblzf.html>.

use super::Decoded;

/// Decodes at most `limit` bytes.
pub(in crate::formats) fn decode(stored: &[u8], limit: usize) -> Decoded<Vec<u8>> {
    let (mut input, mut out) = (stored, Vec::with_capacity(limit.min(4 * stored.len())));
    let next = |input: &mut &[u8]| {
        let (&byte, rest) = input.split_first().ok_or("LZF data that are cut short")?;
        *input = rest;
        Ok::<usize, String>(usize::from(byte))
    };
    while !input.is_empty() {
        let code = next(&mut input)?;
        if code < 32 {
            let literals = input.split_at_checked(code + 1).ok_or("LZF data that are cut short")?;
            out.extend_from_slice(literals.0);
            input = literals.1;
        } else {
            let more = if code >> 5 == 7 { next(&mut input)? } else { 0 };
            let (length, distance) = ((code >> 5) + 2 + more, ((code & 31) << 8) + next(&mut input)? + 1);
            let from = out.len().checked_sub(distance).ok_or("an LZF match before the start")?;
            (from..from + length).for_each(|at| out.push(out[at]));
        }
        if out.len() > limit {
            return Err(format!("more than {limit} bytes"));
        }
    }
    Ok(out)
}
