//! Which axes of an array are of space, which one has the volumes of a series, and which one has
//! channels: one rule for all formats whose arrays have axes.
//!
//! Each axis has a kind: 'x', 'y', 'z', 's' (of space, which one is not told), 't' (time, or
//! volumes in some other order), 'c' (channels), or '?'. The axes of space are x, y and z, in any
//! places; where these are not all there, the last three of those that are no others. Of the others
//! one may have the volumes of a series and one channels; more axes must have a single entry.

/// The axes of an array, whose sizes and kinds are given slowest first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::formats) struct AxisLayout {
    /// Those of space, the last one (the fastest) first.
    pub(in crate::formats) space: [usize; 3],
    /// The one with the volumes of a series, where it has several entries.
    pub(in crate::formats) series: Option<usize>,
    /// The one with channels, where it has several entries.
    pub(in crate::formats) channels: Option<usize>,
}

/// What is expected of an array that has no such layout.
pub(in crate::formats) type Expected = &'static str;

const SPACE: Expected = "three axes of space";
const OTHERS: Expected =
    "three axes of space, and of time and of channels one each; all others must have one entry";
const COMPONENTS: Expected = "one number a sample: the last of four axes without names is that short";

/// The layout of an array.
///
/// # Errors
/// What is expected instead, where its axes are not understood.
pub(in crate::formats) fn layout(shape: &[u64], kinds: &[char]) -> Result<AxisLayout, Expected> {
    let rank = shape.len();
    let is_nameless = rank == 4 && kinds.iter().all(|&k| k == '?');
    // Vectors or colours; a single entry is no axis.
    let is_short = is_nameless && shape[3] <= 4 && shape[1] > 4 && shape[2] > 4;
    if is_short && shape[3] > 1 {
        return Err(COMPONENTS);
    }
    let space = if is_short { [2, 1, 0] } else { space(kinds).ok_or(SPACE)? };
    let (mut series, mut channels) = (None, None);
    for axis in (0..rank).filter(|axis| !space.contains(axis) && shape[*axis] != 1) {
        let place = match kinds[axis] {
            't' => &mut series,
            'c' => &mut channels,
            // Of four axes the first one has volumes, whatever its name is.
            '?' if (axis, rank) == (0, 4) => &mut series,
            _ => return Err(OTHERS),
        };
        if place.replace(axis).is_some() {
            return Err(OTHERS);
        }
    }
    Ok(AxisLayout { space, series, channels })
}

/// The axes of space, the last one first.
fn space(kinds: &[char]) -> Option<[usize; 3]> {
    let of = |wanted: &dyn Fn(char) -> bool| -> Vec<usize> {
        (0..kinds.len()).rev().filter(|&axis| wanted(kinds[axis])).collect()
    };
    let named = of(&|k| matches!(k, 'x' | 'y' | 'z'));
    let are_all = ['x', 'y', 'z'].iter().all(|k| named.iter().any(|&axis| kinds[axis] == *k));
    if let (true, Ok(named)) = (are_all, <[usize; 3]>::try_from(&named[..])) {
        return Some(named);
    }
    if let Ok(told) = <[usize; 3]>::try_from(of(&|k| matches!(k, 'x' | 'y' | 'z' | 's'))) {
        return Some(told);
    }
    <[usize; 3]>::try_from(of(&|k| !matches!(k, 't' | 'c')).get(..3)?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    type Found = ([usize; 3], Option<usize>, Option<usize>);

    fn of(shape: &[u64], kinds: &str) -> Result<Found, Expected> {
        let kinds: Vec<char> = kinds.chars().collect();
        layout(shape, &kinds).map(|found| (found.space, found.series, found.channels))
    }

    #[test]
    fn axes_are_found_by_their_kinds() {
        for (shape, kinds, expected) in [
            (&[5u64, 6, 7][..], "???", ([2, 1, 0], None, None)),
            (&[5, 6, 7], "zyx", ([2, 1, 0], None, None)),
            (&[5, 6, 7], "xyz", ([2, 1, 0], None, None)),
            // ilastik's exports.
            (&[5, 6, 7, 1], "zyxc", ([2, 1, 0], None, None)),
            (&[5, 6, 7, 2], "zyxc", ([2, 1, 0], None, Some(3))),
            (&[1, 5, 6, 7, 2], "tzyxc", ([3, 2, 1], None, Some(4))),
            (&[3, 5, 6, 7, 2], "tzyxc", ([3, 2, 1], Some(0), Some(4))),
            (&[3, 2, 5, 6, 7], "tczyx", ([4, 3, 2], Some(0), Some(1))),
            (&[5, 2, 6, 7], "zcyx", ([3, 2, 0], None, Some(1))),
            (&[6, 7, 5, 4], "yxzt", ([2, 1, 0], Some(3), None)),
            (&[9, 5, 6, 7], "????", ([3, 2, 1], Some(0), None)),
            (&[9, 5, 6, 7], "?zyx", ([3, 2, 1], Some(0), None)),
            (&[5, 6, 7, 1], "????", ([2, 1, 0], None, None)),
            (&[1, 1, 5, 6, 7], "?????", ([4, 3, 2], None, None)),
            (&[2, 5, 6, 7], "csss", ([3, 2, 1], None, Some(0))),
            (&[5, 6, 7, 4], "ssst", ([2, 1, 0], Some(3), None)),
        ] {
            assert_eq!(of(shape, kinds), Ok(expected), "{kinds} {shape:?}");
        }
    }

    #[test]
    fn others_are_refused() {
        for (shape, kinds) in [
            (&[3u64, 6, 7][..], "tyx"),
            (&[3, 6, 7], "cyx"),
            (&[3, 6], "yx"),
            (&[5, 6, 7, 3], "????"),
            (&[2, 3, 5, 6, 7], "?????"),
            (&[2, 3, 5, 6, 7], "ttzyx"),
            (&[5, 6, 7, 3], "zyx?"),
        ] {
            assert!(of(shape, kinds).is_err(), "{kinds} {shape:?}");
        }
    }
}
