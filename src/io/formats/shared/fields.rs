//! Fields of a file: picks the one that is wanted.

use crate::error::{Error, Result};
use crate::volume::FieldInfo;
use glob::Pattern;
use std::path::Path;

/// The index of the field to read: the one that is `wanted`, the first that a pattern matches, or
/// the only scalar one.
///
/// # Errors
/// [`Error::Usage`] listing the fields when `wanted` is not a scalar field of the file, or is
/// needed and not given; [`Error::BadInput`] when there is no scalar field at all.
pub fn pick_field(path: &Path, fields: &[FieldInfo], wanted: Option<&str>) -> Result<usize> {
    let scalar: Vec<usize> = (0..fields.len()).filter(|&i| fields[i].components == 1).collect();
    if scalar.is_empty() {
        let got = if fields.is_empty() { "no field".into() } else { list_fields(fields) };
        return Err(Error::bad_input(path, "fields", "a field with one number a sample", got)
            .with_help("write the component or the magnitude to a field of its own"));
    }
    match (wanted, &scalar[..]) {
        (None, &[only]) => Ok(only),
        (None, _) => Err(Error::usage(format!(
            "{}: several fields: {}; choose one with `field=NAME`, or steps of a series with `field=PATTERN`",
            path.display(),
            list_fields(fields)
        ))),
        (Some(name), _) => {
            let named = scalar.iter().find(|&&i| fields[i].name == name);
            let matching = || scalar.iter().find(|&&i| field_matches(name, &fields[i].name));
            named.or_else(matching).copied().ok_or_else(|| {
                let fields = list_fields(fields);
                Error::usage(format!("{}: no scalar field {name}; its fields: {fields}", path.display()))
            })
        }
    }
}

/// "speed (float32), velocity (3 x float32, not scalar)"; only the first if there are very many.
fn list_fields(fields: &[FieldInfo]) -> String {
    const MOST: usize = 40;
    let one = |f: &FieldInfo| match f.components {
        1 => format!("{} ({})", f.name, f.scalar.name()),
        n => format!("{} ({n} x {}, not scalar)", f.name, f.scalar.name()),
    };
    let mut list: Vec<String> = fields.iter().take(MOST).map(one).collect();
    if fields.len() > MOST {
        list.push(format!("… {} in all", fields.len()));
    }
    list.join(", ")
}

/// Whether a field's name matches a pattern.
pub(in crate::formats) fn field_matches(pattern: &str, name: &str) -> bool {
    is_pattern(pattern) && Pattern::new(pattern).is_ok_and(|p| p.matches(name))
}

/// Whether a name is a pattern.
pub(in crate::formats) fn is_pattern(text: &str) -> bool {
    text.contains(['*', '?', '['])
}
