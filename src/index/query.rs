//! Opens an index and asks it.

use super::page::{Bounds, LEAF_ENTRIES, PAGE_LEVELS, PageCounts, child_sizes, decode_inner, decode_leaf};
use super::{Entry, EntryDigest};
use crate::archive::Malformed;
use crate::archive::segment::{PlanHash, Segment, SegmentKind};
use crate::archive::wire::Cursor;
use isospan_io::error::{Error, Result};
use isospan_mesh::mesh::tet::is_active;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// An open index; may be asked from any thread.
pub struct SpanIndex {
    pages: Pages,
    len: u64,
    bounds: Bounds,
    pages_read: AtomicU64,
}

/// Where the entries are.
enum Pages {
    File(Segment),
    /// In memory, in order of chunk and block: few enough to look at all of them.
    Known(Vec<Entry>),
}

impl SpanIndex {
    /// An index of some entries, in order of chunk and block, that are not stored as such.
    ///
    /// # Panics
    /// When they are in another order, or one is there twice.
    pub fn of_entries(entries: Vec<Entry>) -> Self {
        assert!(entries.is_sorted_by(|a, b| a.place() < b.place()), "each block once, in order");
        let (len, bounds) = (entries.len() as u64, Bounds::of(&entries));
        Self { pages: Pages::Known(entries), len, bounds, pages_read: AtomicU64::new(0) }
    }

    /// Opens an index; reads header, footer and one small block, for any number of entries.
    ///
    /// # Errors
    /// When it is not an index of this plan (`None`: of any plan), or is damaged there.
    pub fn open(path: impl AsRef<Path>, plan: Option<PlanHash>) -> Result<Self> {
        let segment = Segment::open(path, SegmentKind::Index, plan)?;
        if segment.block_count() == 0 {
            return Err(Error::bad_input(segment.path(), "block count", "at least 1", "0"));
        }
        let mut block = vec![];
        segment.block(0, &mut block)?;
        let (len, bounds) =
            read_root(&block, segment.block_count()).map_err(|m| m.in_block(segment.path(), 0))?;
        Ok(Self { pages: Pages::File(segment), len, bounds, pages_read: AtomicU64::new(0) })
    }

    /// Number of entries: blocks that are not void.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Whether every block is void.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Smallest and largest value of all blocks; `None` when there is none.
    pub fn value_range(&self) -> Option<(f32, f32)> {
        (self.len > 0).then_some((self.bounds.lowest, self.bounds.highest))
    }

    /// The container: path, bytes read, verification. None of entries in memory.
    pub fn segment(&self) -> Option<&Segment> {
        match &self.pages {
            Pages::File(segment) => Some(segment),
            Pages::Known(_) => None,
        }
    }

    /// Bytes read from its own file.
    pub fn bytes_read(&self) -> u64 {
        self.segment().map_or(0, Segment::bytes_read)
    }

    /// Pages read by all queries since the index was opened.
    pub fn pages_read(&self) -> u64 {
        self.pages_read.load(Ordering::Relaxed)
    }

    /// The blocks that the isosurface may cross, in order of chunk and block.
    ///
    /// # Errors
    /// [`Error::Usage`] for a NaN; [`Error::BadInput`] for a damaged page.
    pub fn query(&self, isovalue: f32) -> Result<Vec<Entry>> {
        self.query_any(&[isovalue])
    }

    /// The blocks that any of the isosurfaces may cross, each once, in order of chunk and block.
    ///
    /// # Errors
    /// As [`SpanIndex::query`].
    pub fn query_any(&self, isovalues: &[f32]) -> Result<Vec<Entry>> {
        isovalues.iter().try_for_each(|&v| number(v))?;
        self.visit(|lo, hi| isovalues.iter().any(|&v| is_active(lo, hi, v)))
    }

    /// The blocks that have an active tetrahedron for some isovalue in `lo ..= hi`, in order of
    /// chunk and block.
    ///
    /// # Errors
    /// As [`SpanIndex::query`]; [`Error::Usage`] for `lo > hi`.
    pub fn query_range(&self, lo: f32, hi: f32) -> Result<Vec<Entry>> {
        number(lo).and(number(hi))?;
        if lo > hi {
            return Err(Error::usage(format!("the range {lo} to {hi} is empty: give the lower value first")));
        }
        // Some v has lo <= v <= hi and min < v <= max.
        self.visit(|min, max| min < max && min < hi && lo <= max)
    }

    /// The blocks whose values meet `lo ..= hi`, in order of chunk and block: all that can have a
    /// corner in that range.
    ///
    /// # Errors
    /// As [`SpanIndex::query_range`].
    pub fn query_values(&self, lo: f32, hi: f32) -> Result<Vec<Entry>> {
        number(lo).and(number(hi))?;
        if lo > hi {
            return Err(Error::usage(format!("the range {lo} to {hi} is empty: give the lower value first")));
        }
        self.visit(|min, max| min <= hi && lo <= max)
    }

    /// The blocks of certain chunks that have a value at or above the isovalue, each once, in order
    /// of chunk and block.
    ///
    /// # Errors
    /// As [`SpanIndex::query`].
    pub fn query_inside(&self, isovalue: f32, of_chunk: impl Fn(u64) -> bool) -> Result<Vec<Entry>> {
        number(isovalue)?;
        self.visit_some(|_, max| isovalue <= max, |e| of_chunk(e.chunk))
    }

    /// Every entry, in order of chunk and block. Reads the whole index.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged page.
    pub fn entries(&self) -> Result<Vec<Entry>> {
        self.visit(|_, _| true)
    }

    /// Entries whose (min, max) `wanted` accepts. A subtree is entered if `wanted` accepts its
    /// (lowest, highest), so `wanted` must accept what is wider than a range that it accepts.
    fn visit(&self, wanted: impl Fn(f32, f32) -> bool) -> Result<Vec<Entry>> {
        self.visit_some(wanted, |_| true)
    }

    /// As `visit`, of those that `keep` keeps.
    fn visit_some(
        &self,
        wanted: impl Fn(f32, f32) -> bool,
        keep: impl Fn(&Entry) -> bool,
    ) -> Result<Vec<Entry>> {
        let segment = match &self.pages {
            Pages::File(segment) => segment,
            Pages::Known(all) => {
                let found = all.iter().filter(|e| wanted(e.min, e.max) && keep(e));
                return Ok(found.copied().collect());
            }
        };
        let mut found = vec![];
        let mut counts = PageCounts::default();
        let mut bytes = vec![];
        let mut open = vec![];
        if self.len > 0 && wanted(self.bounds.lowest, self.bounds.highest) {
            open.push((1u64, self.len));
        }
        while let Some((page, n)) = open.pop() {
            segment.block(page, &mut bytes)?;
            self.pages_read.fetch_add(1, Ordering::Relaxed);
            let blame = |m: Malformed| m.in_block(segment.path(), page);
            if n <= LEAF_ENTRIES {
                let entries = decode_leaf(&bytes, n).map_err(blame)?;
                found.extend(entries.into_iter().filter(|e| wanted(e.min, e.max) && keep(e)));
                continue;
            }
            let sizes = child_sizes(n);
            let children = decode_inner(&bytes, sizes.len()).map_err(blame)?;
            let mut child_page = page + 1;
            for (child, n) in children.into_iter().zip(sizes) {
                if wanted(child.lowest, child.highest) {
                    open.push((child_page, n));
                }
                child_page += counts.of(n);
            }
        }
        found.sort_unstable_by_key(Entry::place);
        // A block extracted twice would give each of its triangles twice.
        if let Some(twice) = found.windows(2).find(|w| w[0].place() == w[1].place()) {
            let got = format!("block {} of chunk {} twice", twice[0].block, twice[0].chunk);
            return Err(Error::bad_input(segment.path(), "entries", "each block once", got));
        }
        Ok(found)
    }

    /// Reads the whole file: checksums, shape, bounds of every inner page, order and ranges of
    /// entries. Returns the digest of its entries; if it is the digest of a set, none is there
    /// twice.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn verify(&self) -> Result<EntryDigest> {
        let (mut counts, mut digest) = (PageCounts::default(), EntryDigest::default());
        match &self.pages {
            Pages::File(segment) => {
                segment.verify()?;
                if self.len > 0 {
                    let found = verify_subtree(segment, 1, self.len, &mut counts, &mut digest)?;
                    expect_bounds(segment, 0, self.bounds, found)?;
                }
            }
            Pages::Known(all) => all.iter().for_each(|e| digest.add(e)),
        }
        Ok(digest)
    }
}

fn expect_bounds(segment: &Segment, block: u64, said: Bounds, found: Bounds) -> Result<()> {
    if said == found {
        return Ok(());
    }
    Err(Malformed::new("bounds", format!("{found:?}"), format!("{said:?}")).in_block(segment.path(), block))
}

/// The bounds of the entries below a page; an error where a page says others.
fn verify_subtree(
    segment: &Segment,
    page: u64,
    n: u64,
    counts: &mut PageCounts,
    digest: &mut EntryDigest,
) -> Result<Bounds> {
    let mut bytes = vec![];
    segment.block(page, &mut bytes)?;
    let blame = |m: Malformed| m.in_block(segment.path(), page);
    let mut all = Bounds { lowest: f32::INFINITY, highest: f32::NEG_INFINITY };
    let mut join = |b: Bounds| {
        all.lowest = all.lowest.min(b.lowest);
        all.highest = all.highest.max(b.highest);
    };
    if n <= LEAF_ENTRIES {
        let entries = decode_leaf(&bytes, n).map_err(blame)?;
        for e in entries {
            digest.add(&e);
            if e.min.is_nan() || e.max.is_nan() || e.min > e.max {
                let got = format!("{} to {}", e.min, e.max);
                return Err(blame(Malformed::new("range", "min <= max", got)));
            }
            join(Bounds { lowest: e.min, highest: e.max });
        }
        return Ok(all);
    }
    let sizes = child_sizes(n);
    let mut child_page = page + 1;
    for (child, n) in decode_inner(&bytes, sizes.len()).map_err(blame)?.into_iter().zip(sizes) {
        let found = verify_subtree(segment, child_page, n, counts, digest)?;
        expect_bounds(segment, page, child, found)?;
        join(found);
        child_page += counts.of(n);
    }
    Ok(all)
}

fn number(isovalue: f32) -> Result<()> {
    if isovalue.is_nan() {
        return Err(Error::usage("the isovalue is not a number: give a number"));
    }
    Ok(())
}

/// The number of entries and their bounds, from a block 0 that fits a segment of `blocks` blocks.
fn read_root(bytes: &[u8], blocks: u64) -> std::result::Result<(u64, Bounds), Malformed> {
    let mut c = Cursor::new(bytes);
    let len = c.u64("entries")?;
    let bounds = Bounds { lowest: c.f32("lowest")?, highest: c.f32("highest")? };
    let shape = (u64::from(c.u32("leaf entries")?), c.u32("page levels")?);
    c.end("index root")?;
    if shape != (LEAF_ENTRIES, PAGE_LEVELS) {
        let expected = format!("{:?}", (LEAF_ENTRIES, PAGE_LEVELS));
        return Err(Malformed::new("leaf entries, page levels", expected, format!("{shape:?}")));
    }
    // Each page has at least one entry or two children, so the product cannot be reached by a true
    // count.
    let pages = match len {
        0 => 0,
        n if n > blocks.saturating_mul(LEAF_ENTRIES) => u64::MAX,
        n => PageCounts::default().of(n),
    };
    if pages != blocks - 1 {
        return Err(Malformed::new("pages", format!("those of {len} entries"), format!("{}", blocks - 1)));
    }
    Ok((len, bounds))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::index::{BuildSettings, IndexBuilder};
    use proptest::prelude::*;

    const PLAN: PlanHash = PlanHash(9);

    fn index_of(entries: &[Entry], dir: &Path) -> SpanIndex {
        let mut b = IndexBuilder::default();
        entries.iter().for_each(|&e| b.push(e).unwrap());
        let path = dir.join("index.seg");
        b.finish(&path, PLAN).unwrap();
        SpanIndex::open(&path, Some(PLAN)).unwrap()
    }

    fn entries_of(ranges: &[(f32, f32)]) -> Vec<Entry> {
        let place = |i: usize| ((i / 7) as u64, (i % 7) as u32);
        let entry = |(i, &(a, b)): (usize, &(f32, f32))| {
            let (chunk, block) = place(i);
            Entry { min: a.min(b), max: a.max(b), chunk, block, tets: i as u32 + 1 }
        };
        ranges.iter().enumerate().map(entry).collect()
    }

    fn agrees(ranges: &[(f32, f32)], isovalues: &[f32]) {
        let dir = tempfile::tempdir().unwrap();
        let entries = entries_of(ranges);
        let index = index_of(&entries, dir.path());
        index.verify().unwrap();
        assert_eq!((index.len(), index.entries().unwrap()), (entries.len() as u64, entries.clone()));
        for &v in isovalues {
            let brute: Vec<Entry> = entries.iter().copied().filter(|e| is_active(e.min, e.max, v)).collect();
            assert_eq!(index.query(v).unwrap(), brute, "isovalue {v}");
            for &w in isovalues {
                let active = |e: &&Entry| is_active(e.min, e.max, v) || is_active(e.min, e.max, w);
                let brute: Vec<Entry> = entries.iter().filter(active).copied().collect();
                assert_eq!(index.query_any(&[v, w]).unwrap(), brute);
            }
        }
        // Ranges, against all isovalues that matter: those of the entries and the ends of the
        // range.
        for w in isovalues.windows(2) {
            let (lo, hi) = (w[0].min(w[1]), w[0].max(w[1]));
            let within = |e: &&Entry| {
                e.min < hi && {
                    let v = e.max.min(hi);
                    v >= lo && is_active(e.min, e.max, v)
                }
            };
            let brute: Vec<Entry> = entries.iter().filter(within).copied().collect();
            assert_eq!(index.query_range(lo, hi).unwrap(), brute, "{lo} to {hi}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn a_query_is_a_scan(
            ranges in prop::collection::vec((-5i8..6, 0i8..4), 0..1500),
            wide in prop::collection::vec((-1e3f32..1e3, -1e3f32..1e3), 0..700),
            v in -1e3f32..1e3,
        ) {
            // Many equal values, then hardly any.
            let few: Vec<_> = ranges.iter().map(|&(a, d)| (f32::from(a), f32::from(a + d))).collect();
            agrees(&few, &[-5.0, 0.0, -0.0, 0.5, 3.0, 8.0]);
            agrees(&wide, &[v, -v, v * 0.1, 2e3, f32::NEG_INFINITY, f32::INFINITY]);
        }
    }

    #[test]
    fn none_one_and_the_sizes_around_a_page() {
        let isovalues = [-1.0, 0.0, 0.5, 1.0, 2.0, f32::INFINITY];
        for n in [0, 1, 2, 255, 256, 257, 511, 512, 513, 1025] {
            agrees(&vec![(0.0, 1.0); n], &isovalues);
        }
        let dir = tempfile::tempdir().unwrap();
        let none = index_of(&[], dir.path());
        assert_eq!((none.value_range(), none.query(0.0).unwrap()), (None, vec![]));
        let one = index_of(&entries_of(&[(-2.0, 3.5)]), dir.path());
        assert_eq!(one.value_range(), Some((-2.0, 3.5)));
        assert_eq!(one.query(-2.0).unwrap(), vec![], "min < isovalue");
        assert_eq!(one.query(3.5).unwrap().len(), 1, "isovalue <= max");
        assert!(matches!(one.query(f32::NAN), Err(Error::Usage(_))));
        assert!(matches!(one.query_range(1.0, 0.0), Err(Error::Usage(_))));
        assert_eq!(one.pages_read(), 1, "refused and outside queries read nothing");
    }

    /// n ranges whose middles are spread over 0..1 and whose widths are mostly small, without a
    /// generator's help.
    fn synthetic(n: usize) -> Vec<(f32, f32)> {
        let spread = |i: usize, by: u64| ((i as u64).wrapping_mul(by) >> 40) as f32 / (1u64 << 24) as f32;
        (0..n)
            .map(|i| {
                let middle = spread(i, 0x9e37_79b9_7f4a_7c15);
                let width = spread(i, 0xd1b5_4a32_d192_ed03).powi(4) * 0.01;
                (middle - width, middle + width)
            })
            .collect()
    }

    #[test]
    fn the_file_depends_on_the_set_alone() {
        let dir = tempfile::tempdir().unwrap();
        let mut entries = entries_of(&synthetic(3000));
        let bytes = |e: &[Entry]| {
            index_of(e, dir.path());
            std::fs::read(dir.path().join("index.seg")).unwrap()
        };
        let one = bytes(&entries);
        entries.reverse();
        entries.swap(3, 1000);
        assert_eq!(one, bytes(&entries));
    }

    /// Little memory cuts on disk, through one page or two; many equal values make buckets that do
    /// not fit either.
    #[test]
    fn the_file_does_not_depend_on_memory() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("disk.seg");
        let equal = |n: usize| (0..n).map(|i| ((i % 2) as f32 - 1.0, (i % 3) as f32)).collect::<Vec<_>>();
        for ranges in [synthetic(3000), equal(20_000), synthetic(300_000)] {
            let mut entries = entries_of(&ranges);
            let in_memory = index_of(&entries, dir.path());
            entries.reverse();
            let settings = BuildSettings { memory: 0, scratch: Some(dir.path().to_path_buf()) };
            let mut b = IndexBuilder::new(&settings);
            entries.iter().for_each(|&e| b.push(e).unwrap());
            assert_eq!(b.len(), entries.len() as u64);
            b.finish(&path, PLAN).unwrap();
            assert!(
                std::fs::read(&path).unwrap() == std::fs::read(in_memory.segment().unwrap().path()).unwrap()
            );
            let mut digest = EntryDigest::default();
            entries.iter().for_each(|e| digest.add(e));
            assert_eq!(in_memory.verify().unwrap(), digest);
            assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2, "no scratch file is left");
        }
    }

    /// Opening costs the same for any size; a query reads √(n/L) + k/L pages, to a small factor.
    #[test]
    fn pages_read_grow_as_the_root_of_n_plus_k() {
        let dir = tempfile::tempdir().unwrap();
        for n in [10_000usize, 100_000, 1_000_000] {
            let index = index_of(&entries_of(&synthetic(n)), dir.path());
            let opened = index.segment().unwrap().bytes_read();
            assert!(opened < 6_000, "{opened} bytes to open {n} entries");
            for v in [0.001, 0.25, 0.5, 0.9] {
                let before = index.pages_read();
                let k = index.query(v).unwrap().len() as f64;
                let pages = (index.pages_read() - before) as f64;
                let (root, answers) = ((n as f64 / 128.0).sqrt(), k / 128.0);
                assert!(
                    pages <= 3.0 + 2.0 * (root + answers),
                    "{pages} pages of {n} entries for {k} answers"
                );
            }
        }
    }

    #[test]
    fn every_flipped_byte_is_found_or_harmless() {
        let dir = tempfile::tempdir().unwrap();
        let ranges: Vec<_> = synthetic(300);
        let right = index_of(&entries_of(&ranges), dir.path()).query(0.5).unwrap();
        let path = dir.path().join("index.seg");
        let good = std::fs::read(&path).unwrap();
        // Every byte of the frame and of the first pages' heads; of the columns of numbers one in
        // eleven.
        let ends = |&i: &usize| i < 100 || i + 100 > good.len() || i % 11 == 0;
        for i in (0..good.len()).filter(ends) {
            let mut bad = good.clone();
            bad[i] ^= 0x10;
            std::fs::write(&path, &bad).unwrap();
            let index = SpanIndex::open(&path, Some(PLAN));
            assert!(index.as_ref().map_or(true, |x| x.verify().is_err()), "byte {i}");
            if let Ok(found) = index.and_then(|x| x.query(0.5)) {
                assert_eq!(found, right, "byte {i}");
            }
            std::fs::write(&path, &good[..i]).unwrap();
            assert!(SpanIndex::open(&path, Some(PLAN)).is_err(), "cut at {i}");
        }
    }

    #[test]
    fn pages_that_lie_behind_a_good_checksum_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("index.seg");
        let index = index_of(&entries_of(&synthetic(300)), dir.path());
        let mut blocks: Vec<Vec<u8>> = vec![vec![]; index.segment().unwrap().block_count() as usize];
        (0..).zip(&mut blocks).for_each(|(n, b)| index.segment().unwrap().block(n, b).unwrap());
        let (mut cases, mut refused) = (0, 0);
        for block in 0..blocks.len() {
            for at in (0..blocks[block].len().min(120)).step_by(7) {
                let mut bad = blocks.clone();
                bad[block][at] ^= 0x84;
                let mut w =
                    crate::archive::segment::SegmentWriter::create(&path, SegmentKind::Index, PLAN).unwrap();
                for b in &bad {
                    w.push_block(b).unwrap();
                }
                w.finish().unwrap();
                // Never a panic; places may change unnoticed, bounds and shapes may not.
                let survived = SpanIndex::open(&path, None)
                    .is_ok_and(|index| index.query(0.5).is_ok() & index.verify().is_ok());
                (cases, refused) = (cases + 1, refused + u32::from(!survived));
            }
        }
        assert!(refused > cases / 4 && cases > 20, "{refused} of {cases}");
    }
}
