//! The directions of the axes of an NRRD, in a space of three dimensions, or of three and time.
//!
//! ```text
//!  space dimension: 4                                        or   space: right-anterior-superior-time
//!  space directions: (1,0,0,0) (0,2,0,0) (0,0,3,0) (0,0,0,0.5)    the last one is the axis of time
//!  space origin: (1,2,3,10)                                       the first volume is at time 10
//! ```

use super::NrrdHeader;
use crate::error::{Error, Result};
use crate::formats::shared::header::numbers;

/// Short names of spaces with time.
const WITH_TIME: [&str; 3] = ["rast", "last", "lpst"];

/// The directions of all axes.
pub(super) struct Directions {
    /// In space; `None` of an axis that has none.
    pub(super) of_axes: Vec<Option<[f64; 3]>>,
    /// The axis along time, and its step.
    pub(super) time: Option<(usize, f64)>,
}

impl NrrdHeader {
    /// The directions of `count` axes, where the header has them.
    ///
    /// # Errors
    /// [`Error::BadInput`] for vectors of another form, and for time that is mixed with space.
    pub(super) fn directions(&self, count: usize) -> Result<Option<Directions>> {
        let Some(text) = self.get("spacedirections") else { return Ok(None) };
        let mut found = Directions { of_axes: vec![], time: None };
        for (axis, vector) in self.vectors("space directions", text, count)?.into_iter().enumerate() {
            let (in_space, step) = vector.map_or((None, 0.0), |[x, y, z, t]| (Some([x, y, z]), t));
            if step == 0.0 {
                found.of_axes.push(in_space);
                continue;
            }
            if in_space != Some([0.0; 3]) || found.time.replace((axis, step)).is_some() {
                let expected = "one axis along time, at right angles to those of space";
                return Err(Error::bad_input(&self.path, "space directions", expected, text)
                    .with_help("cut out one volume, e.g. with `unu slice`"));
            }
            found.of_axes.push(None);
        }
        Ok(Some(found))
    }

    /// The origin in space, and in time.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a vector of another form.
    pub(super) fn origin(&self) -> Result<Option<([f64; 3], f64)>> {
        let Some(text) = self.get("spaceorigin") else { return Ok(None) };
        let found = self.vectors("space origin", text, 1)?;
        Ok(found[0].map(|[x, y, z, t]| ([x, y, z], t)))
    }

    /// The dimensions of the space: 3, or 4 with time.
    pub(super) fn space_dimension(&self) -> Result<usize> {
        let name = self.get("space").unwrap_or_default().to_ascii_lowercase();
        if name.ends_with("-time") || WITH_TIME.contains(&&*name) {
            return Ok(4);
        }
        let Some(text) = self.get("spacedimension") else { return Ok(3) };
        match numbers::<usize, 1>(&self.path, "space dimension", text)? {
            [known @ (3 | 4)] => Ok(known),
            [other] => {
                Err(Error::bad_input(&self.path, "space dimension", "3, or 4 with time", other.to_string()))
            }
        }
    }

    /// `count` vectors "(x,y,z)", or "(x,y,z,t)" of a space with time; `None` of an axis that has
    /// "none".
    fn vectors(&self, at: &str, text: &str, count: usize) -> Result<Vec<Option<[f64; 4]>>> {
        let size = self.space_dimension()?;
        let wrong = || {
            let form = if size == 4 { "(x,y,z,t)" } else { "(x,y,z)" };
            let expected = format!("{count} vector(s) of the form {form}, or none for an axis of no space");
            Error::bad_input(&self.path, at, expected, text)
        };
        let (mut vectors, mut rest) = (vec![], text.trim());
        while !rest.is_empty() {
            if let Some(after) = rest.strip_prefix("none") {
                vectors.push(None);
                rest = after.trim_start();
                continue;
            }
            let (inside, after) = rest.strip_prefix('(').and_then(|r| r.split_once(')')).ok_or_else(wrong)?;
            let parts: Option<Vec<f64>> = inside.split(',').map(|x| x.trim().parse().ok()).collect();
            let mut parts = parts.filter(|parts| parts.len() == size).ok_or_else(wrong)?;
            parts.resize(4, 0.0);
            vectors.push(Some(parts.try_into().map_err(|_| wrong())?));
            rest = after.trim_start();
        }
        if vectors.len() == count { Ok(vectors) } else { Err(wrong()) }
    }
}
