//! Which axes are split at which level, and where bands and tiles lie.

/// Nodes of the finer level along each axis of a tile.
pub const TILE: usize = 32;
/// An axis with fewer nodes is not split any more.
const LEAST: usize = 8;
/// Levels that depend on each other: the last of them has no parent.
pub const GROUP: usize = 3;

/// The levels of an array. Level 0 has its samples; each further one about half as many nodes along
/// the axes that are split.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pyramid {
    /// Nodes of level 0, 1, …
    nodes: Vec<[usize; 3]>,
    /// The axes that are split from level l to level l + 1.
    splits: Vec<[bool; 3]>,
    /// Whether tiles have labels.
    of_labels: bool,
}

/// The coefficients of one level that are high along some of its split axes and low along the rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Band {
    /// Axes along which it is high.
    pub high: [bool; 3],
    /// Its size.
    pub size: [usize; 3],
    /// Whether there is a band with the same axes one level up, in the same group.
    pub has_parent: bool,
}

/// A box of nodes or of coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Box3 {
    /// The first ones along x, y, z.
    pub start: [usize; 3],
    /// How many along x, y, z.
    pub size: [usize; 3],
}

impl Box3 {
    /// All of an array.
    pub fn all(size: [usize; 3]) -> Self {
        Self { start: [0; 3], size }
    }

    /// How many nodes it has.
    pub fn len(&self) -> usize {
        self.size.iter().product()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One behind the last ones.
    pub fn end(&self) -> [usize; 3] {
        std::array::from_fn(|a| self.start[a] + self.size[a])
    }

    /// With so many more on each side, but none before 0.
    pub fn widened(&self, by: usize) -> Self {
        let start = self.start.map(|s| s.saturating_sub(by));
        Self { start, size: std::array::from_fn(|a| self.end()[a] + by - start[a]) }
    }

    /// Widened along the axes that are split, and beginning at an even place there.
    pub(crate) fn around(&self, split: [bool; 3], by: usize) -> Self {
        let wide = self.widened(by);
        let start: [usize; 3] =
            std::array::from_fn(|a| if split[a] { wide.start[a] / 2 * 2 } else { self.start[a] });
        let end: [usize; 3] = std::array::from_fn(|a| if split[a] { wide.end()[a] } else { self.end()[a] });
        Self { start, size: std::array::from_fn(|a| end[a] - start[a]) }
    }

    /// The low coefficients of a box whose start is even along the axes that are split.
    pub(crate) fn halved(&self, split: [bool; 3]) -> Self {
        let half = |n: usize, a: usize| if split[a] { n.div_ceil(2) } else { n };
        Self {
            start: std::array::from_fn(|a| half(self.start[a], a)),
            size: std::array::from_fn(|a| half(self.size[a], a)),
        }
    }

    /// What it has in common with another.
    pub fn cut(&self, other: &Self) -> Self {
        let start: [usize; 3] = std::array::from_fn(|a| self.start[a].max(other.start[a]));
        let end = |a: usize| self.end()[a].min(other.end()[a]);
        Self { start, size: std::array::from_fn(|a| end(a).saturating_sub(start[a])) }
    }

    /// Calls with the place of each row of a part of the box in an array over the box.
    pub(crate) fn each_row(&self, part: &Self, mut row: impl FnMut(usize)) {
        let first: [usize; 3] = std::array::from_fn(|a| part.start[a] - self.start[a]);
        for z in first[2]..first[2] + part.size[2] {
            for y in first[1]..first[1] + part.size[1] {
                row((z * self.size[1] + y) * self.size[0] + first[0]);
            }
        }
    }

    /// The values of a part of the box, of an array over the box; both x fastest.
    ///
    /// # Panics
    /// If the part reaches out of the box, or the array is shorter than the box.
    pub fn values_of<T: Copy>(&self, values: &[T], part: &Self) -> Vec<T> {
        let mut found = Vec::with_capacity(part.len());
        self.each_row(part, |at| found.extend_from_slice(&values[at..at + part.size[0]]));
        found
    }

    /// Leaves the values of a part of the box, in place.
    ///
    /// # Panics
    /// As [`Box3::values_of`].
    pub(crate) fn crop<T: Copy>(&self, values: &mut Vec<T>, part: &Self) {
        let mut end = 0;
        // A row moves to a lower place, or stays.
        self.each_row(part, |at| {
            values.copy_within(at..at + part.size[0], end);
            end += part.size[0];
        });
        values.truncate(end);
    }

    /// Copies what an array over another box has of this one into an array over this one.
    ///
    /// # Panics
    /// If an array is shorter than its box.
    pub fn copy_common<T: Copy>(&self, values: &mut [T], other: &Self, of_other: &[T]) {
        let (common, mut rows) = (self.cut(other), vec![]);
        if common.is_empty() {
            return;
        }
        other.each_row(&common, |at| rows.push(at));
        let mut rows = rows.into_iter();
        self.each_row(&common, |to| {
            if let Some(from) = rows.next() {
                let width = common.size[0];
                values[to..to + width].copy_from_slice(&of_other[from..from + width]);
            }
        });
    }
}

impl Pyramid {
    /// The levels of an array, as many as there can be. The splits of axis `a` begin `delay[a]`
    /// levels later than those of others: where samples lie far apart along it, or the field is
    /// less smooth, that takes fewer bytes.
    pub fn new(dims: [usize; 3], delay: [u8; 3]) -> Self {
        let (mut nodes, mut splits) = (vec![dims], vec![]);
        let mut now = dims;
        for step in 0_usize.. {
            if now.iter().all(|n| *n < LEAST) {
                break;
            }
            let split = std::array::from_fn(|a| now[a] >= LEAST && step >= usize::from(delay[a]));
            if split != [false; 3] {
                now = std::array::from_fn(|a| if split[a] { now[a].div_ceil(2) } else { now[a] });
                nodes.push(now);
                splits.push(split);
            }
        }
        Self { nodes, splits, of_labels: false }
    }

    /// An array of labels, which has one level: there is no mean of two of them.
    pub fn of_labels(dims: [usize; 3]) -> Self {
        Self { nodes: vec![dims], splits: vec![], of_labels: true }
    }

    /// Whether it is one of labels.
    pub fn has_labels(&self) -> bool {
        self.of_labels
    }

    /// The coarsest level.
    pub fn coarsest(&self) -> usize {
        self.splits.len()
    }

    /// Nodes of a level along each axis. Node i of it is sample `i * stride`.
    pub fn nodes(&self, level: usize) -> [usize; 3] {
        self.nodes[level]
    }

    /// Samples from one node of a level to the next, along each axis.
    pub fn stride(&self, level: usize) -> [usize; 3] {
        let splits = &self.splits[..level];
        std::array::from_fn(|a| 1 << splits.iter().filter(|s| s[a]).count())
    }

    /// The axes that are split to get a level from the finer one. Levels begin with 1 here.
    pub fn split(&self, level: usize) -> [bool; 3] {
        self.splits[level - 1]
    }

    /// The axes that are split at each level, from the finest.
    pub fn splits(&self) -> &[[bool; 3]] {
        &self.splits
    }

    /// The bands between level - 1 and a level, in the order in which they are coded.
    pub fn bands(&self, level: usize) -> impl Iterator<Item = Band> + '_ {
        const ORDER: [usize; 7] = [1, 2, 4, 3, 5, 6, 7];
        let (split, fine, coarse) = (self.split(level), self.nodes[level - 1], self.nodes[level]);
        let parents = (!level.is_multiple_of(GROUP)).then(|| self.splits.get(level)).flatten();
        let bands = ORDER.into_iter().map(|bits| [0, 1, 2].map(|a| bits >> a & 1 == 1));
        bands.filter(move |high| (0..3).all(|a| !high[a] || split[a])).map(move |high| Band {
            high,
            size: std::array::from_fn(|a| if high[a] { fine[a] - coarse[a] } else { coarse[a] }),
            has_parent: parents.is_some_and(|up| (0..3).all(|a| !high[a] || up[a])),
        })
    }

    /// Tiles along each axis between level - 1 and a level; of level 0, those of labels.
    pub fn tiles(&self, level: usize) -> [usize; 3] {
        self.nodes[level.saturating_sub(1)].map(|n| n.div_ceil(TILE))
    }

    /// The nodes of a tile of labels.
    pub fn label_box(&self, tile: [usize; 3]) -> Box3 {
        Box3 { start: tile.map(|n| TILE * n), size: [TILE; 3] }.cut(&Box3::all(self.nodes[0]))
    }

    /// The coefficients of a band that are in a tile.
    pub fn part(&self, level: usize, band: &Band, tile: [usize; 3]) -> Box3 {
        let split = self.split(level);
        let edge = split.map(|s| if s { TILE / 2 } else { TILE });
        let start = std::array::from_fn(|a| edge[a] * tile[a]);
        Box3 { start, size: edge }.cut(&Box3::all(band.size))
    }

    /// The tile one level up that has the parents of a tile.
    pub fn parent(&self, level: usize, tile: [usize; 3]) -> [usize; 3] {
        let split = self.split(level);
        std::array::from_fn(|a| if split[a] { tile[a] / 2 } else { tile[a] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_end_below_eight_nodes() {
        let p = Pyramid::new([128, 20, 5], [0; 3]);
        assert_eq!(p.nodes, [[128, 20, 5], [64, 10, 5], [32, 5, 5], [16, 5, 5], [8, 5, 5], [4, 5, 5]]);
        assert_eq!(p.split(3), [true, false, false]);
        assert_eq!(p.stride(5), [32, 4, 1]);
        assert_eq!(Pyramid::new([7, 1, 7], [0; 3]).coarsest(), 0);
    }

    #[test]
    fn a_delayed_axis_is_split_later_but_never_left() {
        let p = Pyramid::new([16, 16, 64], [0, 0, 2]);
        assert_eq!(p.nodes[..4], [[16, 16, 64], [8, 8, 64], [4, 4, 64], [4, 4, 32]]);
        // No other axis is left to wait for.
        let p = Pyramid::new([4, 4, 64], [0, 0, 9]);
        assert_eq!(p.nodes[1], [4, 4, 32]);
    }

    #[test]
    fn the_parts_of_tiles_are_the_bands() {
        for (dims, delay) in [([70, 33, 65], [0, 0, 0]), ([65, 40, 70], [0, 0, 1]), ([9, 8, 1], [0, 0, 0])] {
            let p = Pyramid::new(dims, delay);
            for level in 1..=p.coarsest() {
                let mut coefficients: usize = p.nodes(level).iter().product();
                for band in p.bands(level) {
                    let [tx, ty, tz] = p.tiles(level);
                    let all = (0..tx * ty * tz).map(|i| [i % tx, i / tx % ty, i / tx / ty]);
                    let parts: usize = all.map(|t| p.part(level, &band, t).len()).sum();
                    assert_eq!(parts, band.size.iter().product::<usize>());
                    coefficients += parts;
                }
                assert_eq!(coefficients, p.nodes(level - 1).iter().product::<usize>());
            }
        }
    }
}
