//! Values for missing samples, which cost few bytes: the means of blocks around them.
//!
//! A block of 2^k samples along each axis has the mean of its halves that have one. From the
//! largest blocks on, those without one get what lies between their neighbours. So values go over
//! into each other, and depend on no more than samples near by: any window has the same ones.

use crate::pyramid::Box3;

/// Blocks have up to 2^LEVELS samples along each axis. Farther samples do not count.
const LEVELS: usize = 5;

/// Fills the samples of a window of an array that are missing: those that are NaN. Where none are
/// known near by, they get the value `far`. `read` gives samples of other boxes of the array.
///
/// # Errors
/// Those of reading.
pub fn fill<E>(
    dims: [usize; 3],
    window: &Box3,
    values: &mut [f32],
    far: f32,
    mut read: impl FnMut(&Box3) -> Result<Vec<f32>, E>,
) -> Result<(), E> {
    let Some(holes) = holes(window, values) else { return Ok(()) };
    let mut levels = vec![Means { place: holes, cells: dims, values: vec![] }];
    for level in 0..LEVELS {
        levels.push(levels[level].coarser());
    }
    let edge = 1 << LEVELS;
    let last = levels[LEVELS].place;
    let near = Box3 { start: last.start.map(|n| n * edge), size: last.size.map(|n| n * edge) };
    let near = near.cut(&Box3::all(dims));
    for z in (near.start[2]..near.end()[2]).step_by(edge) {
        for y in (near.start[1]..near.end()[1]).step_by(edge) {
            let row = Box3 { start: [near.start[0], y, z], size: [near.size[0], edge, edge] }.cut(&near);
            let (mut place, mut found) = (row, read(&row)?);
            for level in &mut levels[1..] {
                (place, found) = halved(&place, &found);
                level.place.copy_common(&mut level.values, &place, &found);
            }
        }
    }
    levels[LEVELS].values.iter_mut().filter(|v| v.is_nan()).for_each(|v| *v = far);
    for level in (1..LEVELS).rev() {
        let (fine, coarse) = levels.split_at_mut(level + 1);
        let Means { place, values, .. } = &mut fine[level];
        coarse[0].fill(place, values, place);
    }
    levels[1].fill(window, values, &holes);
    Ok(())
}

/// The box around the samples that are missing.
fn holes(window: &Box3, values: &[f32]) -> Option<Box3> {
    let (mut least, mut most) = (window.end(), [0; 3]);
    let [nx, ny, _] = window.size;
    for (row, values) in values.chunks(nx.max(1)).enumerate() {
        let is_hole = |v: &f32| v.is_nan();
        let Some(first) = values.iter().position(is_hole) else { continue };
        let last = values.iter().rposition(is_hole).unwrap_or(first);
        let place = |x: usize| [x, row % ny, row / ny];
        for (a, (first, last)) in place(first).into_iter().zip(place(last)).enumerate() {
            least[a] = least[a].min(window.start[a] + first);
            most[a] = most[a].max(window.start[a] + last + 1);
        }
    }
    (least[0] < most[0]).then(|| Box3 { start: least, size: [0, 1, 2].map(|a| most[a] - least[a]) })
}

/// The means of blocks of a size, NaN where no sample is known.
struct Means {
    place: Box3,
    /// Blocks of the whole array.
    cells: [usize; 3],
    values: Vec<f32>,
}

impl Means {
    /// Blocks of twice the size that are needed to fill these.
    fn coarser(&self) -> Self {
        let cells = self.cells.map(|n| n.div_ceil(2));
        let start = self.place.start.map(|n| n.saturating_sub(1) / 2);
        let end = self.place.end().map(|n| n / 2 + 1);
        let place = Box3 { start, size: [0, 1, 2].map(|a| end[a].min(cells[a]) - start[a]) };
        Self { place, cells, values: vec![f32::NAN; place.len()] }
    }

    /// Fills blocks of half the size in a part of a box with what lies between these.
    fn fill(&self, place: &Box3, values: &mut [f32], part: &Box3) {
        let (mut rows, width) = (vec![], part.size[0]);
        place.each_row(part, |at| rows.push(at));
        for (row, at) in rows.into_iter().enumerate() {
            let (y, z) = (part.start[1] + row % part.size[1], part.start[2] + row / part.size[1]);
            for (x, v) in values[at..at + width].iter_mut().enumerate().filter(|(_, v)| v.is_nan()) {
                *v = self.between([part.start[0] + x, y, z]);
            }
        }
    }

    /// What lies between these at a block of half the size.
    fn between(&self, at: [usize; 3]) -> f32 {
        // The block that has it, and the next one on its side.
        let ends: [[usize; 2]; 3] = std::array::from_fn(|a| {
            let own = at[a] / 2;
            let next = if at[a] % 2 == 1 { (own + 1).min(self.cells[a] - 1) } else { own.saturating_sub(1) };
            [own, next].map(|n| n - self.place.start[a])
        });
        let [nx, ny, _] = self.place.size;
        let mut sum = 0.0;
        for corner in 0..8 {
            let [x, y, z] = [0, 1, 2].map(|a| ends[a][corner >> a & 1]);
            let far = (corner as u32).count_ones() as usize;
            sum += [27.0, 9.0, 3.0, 1.0][far] * f64::from(self.values[(z * ny + y) * nx + x]);
        }
        (sum / 64.0) as f32
    }
}

/// The means of blocks of two along each axis, of those that have a value. The box begins at an
/// even place.
fn halved(place: &Box3, values: &[f32]) -> (Box3, Vec<f32>) {
    let start = place.start.map(|n| n / 2);
    let size = [0, 1, 2].map(|a| place.end()[a].div_ceil(2) - start[a]);
    let half = Box3 { start, size };
    let mut sums = vec![(0.0f64, 0.0f64); half.len()];
    let [nx, ny, _] = place.size;
    for (row, values) in values.chunks(nx.max(1)).enumerate() {
        let to = ((row / ny / 2) * size[1] + row % ny / 2) * size[0];
        for (x, v) in values.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
            let (sum, count) = &mut sums[to + x / 2];
            (*sum, *count) = (*sum + f64::from(*v), *count + 1.0);
        }
    }
    // No number where there is none.
    (half, sums.into_iter().map(|(sum, count)| (sum / count) as f32).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const DIMS: [usize; 3] = [150, 70, 90];

    fn array() -> Vec<f32> {
        let one = |i: usize| {
            let [x, y, z] = [i % DIMS[0], i / DIMS[0] % DIMS[1], i / DIMS[0] / DIMS[1]];
            let is_hole = x + 2 * y + z < 180 || (x * 7919 + y * 31 + z * 101) % 37 == 0;
            if is_hole { f32::NAN } else { (x as f32 * 0.1).sin() + y as f32 * 0.01 }
        };
        (0..DIMS.iter().product()).map(one).collect()
    }

    fn part(all: &[f32], place: &Box3) -> Vec<f32> {
        Box3::all(DIMS).values_of(all, place)
    }

    fn filled(all: &[f32], place: &Box3) -> Vec<f32> {
        let mut found = part(all, place);
        fill(DIMS, place, &mut found, 9.0, |b| Ok::<_, ()>(part(all, b))).unwrap();
        found
    }

    #[test]
    fn any_window_is_filled_with_the_same_values() {
        let all = array();
        let whole = filled(&all, &Box3::all(DIMS));
        assert!(whole.iter().all(|v| v.is_finite()));
        let known = all.iter().zip(&whole).filter(|(v, _)| !v.is_nan());
        assert!(known.into_iter().all(|(a, b)| a == b), "known samples stay");
        for start in [[0, 0, 0], [17, 3, 40], [120, 40, 8], [3, 69, 89]] {
            let place = Box3 { start, size: [40, 33, 50] }.cut(&Box3::all(DIMS));
            assert!(filled(&all, &place) == part(&whole, &place), "{start:?}");
        }
    }

    #[test]
    fn values_lie_between_known_ones_and_far_ones() {
        let dims = [300, 3, 2];
        let mut values = vec![f32::NAN; 1800];
        (0..6).for_each(|row| values[300 * row] = 1.0);
        let given = values.clone();
        let whole = Box3::all(dims);
        fill(dims, &whole, &mut values, 5.0, |b| Ok::<_, ()>(whole.values_of(&given, b))).unwrap();
        assert!(values[..300].is_sorted() && values[..300].iter().all(|v| (1.0..=5.0).contains(v)));
        assert!(values[1] < 1.01 && values[299] == 5.0);
        let steepest = values[..300].windows(2).map(|v| v[1] - v[0]).fold(0.0, f32::max);
        assert!(steepest < 0.2, "{steepest}");
    }
}
