//! Conventions of programs that use NetCDF-3: finds which one a file follows.
//!
//! | convention | known by | |
//! |---|---|---|
//! | MINC 1 | a variable `image` with the `varid` of MINC, or `rootvariable` beside it | read |
//! | AMBER, ETSF | `Conventions`, `file_format` | refused |
//! | SIESTA | the variables `gridfunc` and `cell` | refused |
//! | Chimera | the attribute `xyz_origin` | refused |
//! | Exodus II of another name | the attribute `floating_point_word_size` | refused |
//!
//! The refused ones say where samples lie, or that there are none, where a plain reader does not
//! look, so the result would be wrong.

use super::header::{NetcdfHeader, Variable};
use crate::error::{Error, Result};
use crate::formats::shared::cf::{refused_convention, signed_as};
use crate::volume::ScalarType;
use std::path::Path;

/// The convention of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dialect {
    /// CF, or none.
    Plain,
    Minc,
}

impl Dialect {
    /// The convention that a file follows.
    ///
    /// # Errors
    /// [`Error::BadInput`] for one that is not read.
    pub(super) fn of(path: &Path, header: &NetcdfHeader) -> Result<Self> {
        let has = |name: &str| header.variable(name).is_some();
        let of_words = ["Conventions", "conventions", "file_format"]
            .iter()
            .find_map(|name| refused_convention(&header.text(name)));
        let refused = match of_words {
            Some(found) => Some(found),
            None if has("gridfunc") && has("cell") => Some((
                "a grid of SIESTA, whose cell is not read",
                "convert it with grid2cube, and that to .vti",
            )),
            None if header.has("xyz_origin") => Some(("a map of Chimera", "save it as .mrc")),
            None if header.has("floating_point_word_size") => {
                Some(("an Exodus II file of another name", "let its name end in .exo"))
            }
            None => None,
        };
        if let Some((got, help)) = refused {
            let expected = "plain variables, those of CF, or MINC 1";
            return Err(Error::bad_input(path, "kind of NetCDF-3 file", expected, got).with_help(help));
        }
        let is_minc = header.variable("image").is_some_and(|image| {
            image.text("varid").starts_with("MINC") || has("rootvariable") || header.has("minc_version")
        });
        Ok(if is_minc { Self::Minc } else { Self::Plain })
    }

    /// Whether a variable may be a field.
    pub(super) fn has_field(self, name: &str) -> bool {
        self == Self::Plain || name == "image"
    }
}

/// The type of the samples of an image of MINC: bytes have no sign unless `signtype` says so,
/// others have one.
///
/// # Errors
/// [`Error::BadInput`] for text.
pub(super) fn scalar_of_minc(image: &Variable, path: &Path) -> Result<ScalarType> {
    let (stored, sign) = (image.stored(path)?, image.text("signtype"));
    let is_unsigned = sign.starts_with("unsigned") || stored == ScalarType::I8 && !sign.starts_with("signed");
    Ok(signed_as(stored, if is_unsigned { "true" } else { "false" }))
}
