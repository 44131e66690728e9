//! Unpacked blocks that were changed, with checksums that fit: for the fuzzer, and for tests.

/// Gives the words of an unpacked block the checksums that fit them, as the format has them, if it
/// is as long as it says.
pub(crate) fn seal_words(bytes: &mut [u8]) {
    let mut words: Vec<u32> = bytes.as_chunks().0.iter().map(|&word| u32::from_le_bytes(word)).collect();
    let Some(&[c, e, t, s]) = words.first_chunk() else { return };
    let [c, e, t, s] = [c, e, t, s].map(|n| n as usize % (1 << 16));
    let groups = t.div_ceil(16);
    let lists = 8 + groups;
    let tets_end = lists + 3 * groups + 5 * c + e + t;
    let edges_end = tets_end + 3 * t;
    let ids = edges_end + s..edges_end + s + 2 * c;
    if words.len() < ids.end {
        return;
    }
    let crc = |crc: u32, words: &[u32]| {
        crc32c::crc32c_append(crc, &words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<_>>())
    };
    let mut begin = 0;
    for n in 0..groups {
        let end = ((words[lists + 3 * n + 2] >> 16) as usize).clamp(begin, s);
        let edges = &words[tets_end + 48 * n..edges_end.min(tets_end + 48 * (n + 1))];
        words[8 + n] = crc(crc(0, edges), &words[edges_end + begin..edges_end + end]);
        begin = end;
    }
    words[5] = crc(crc(crc(0, &words[..5]), &words[8..lists]), &words[lists..tets_end]);
    words[6] = crc(0, &words[ids]);
    for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
        *bytes = word.to_le_bytes();
    }
}
