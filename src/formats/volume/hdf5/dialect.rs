//! Conventions of programs that use HDF5: finds which one a file follows, and where it places the
//! samples.
//!
//! | convention | known by | |
//! |---|---|---|
//! | VTKHDF | `/VTKHDF`, its `Type` | an image is read here, a mesh and a surface elsewhere; other types are refused |
//! | MINC 2 | `/minc-2.0` | read; of irregular spacing, or with a time axis, refused |
//! | ITK | `/ITKImage` | read |
//! | Imaris, BigDataViewer, Dream.3D, Chimera, EMAN2, openPMD, CGNS, MED; Exodus II of another name | groups and attributes | refused |
//!
//! The refused ones keep their voxel size, or their axes, where a plain reader does not look, so
//! the result would be wrong.

use super::{Field, Tree, attribute_numbers, attribute_text, damaged};
use crate::cells::Center;
use crate::error::{Error, Result};
use crate::formats::shared::centers::{Picked, first_sample, pick, samples};
use crate::formats::shared::cf::{Convert, Rules};
use crate::formats::shared::header::geometry;
use crate::grid::Geometry;
use crate::volume::units::{Unit, Units, common};
use crate::volume::{FieldInfo, ScalarType};
use hdf5_reader::group::Group;
use hdf5_reader::{Hdf5File, messages::datatype::Datatype};
use std::path::Path;

/// The convention of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dialect {
    /// None, or NetCDF's, or that of single datasets.
    Plain,
    Vtk,
    Minc,
    Itk,
}

/// What is refused: a group or an attribute of the root group, the program that writes it, and what
/// to do.
const REFUSED: [(&str, &str, &str); 10] = [
    ("DataSetInfo", "an Imaris file (.ims)", AS_TIFF),
    ("ImarisDataSet", "an Imaris file (.ims)", AS_TIFF),
    ("t00000", "a BigDataViewer file, whose voxel size is in its .xml", AS_TIFF),
    ("DataContainers", "a Dream.3D file", "write the array as .vti"),
    ("Chimera", "a Chimera map", "save it as .nrrd, or its array as NPY"),
    ("MDF", "an EMAN2 image", "convert it with e2proc3d.py to .nrrd"),
    ("openPMD", "an openPMD file", "write the mesh's array as .vti, with its gridSpacing"),
    ("CGNSLibraryVersion", "a CGNS file", "convert it to .vtu"),
    ("INFOS_GENERALES", "a MED file", "convert it to .vtu"),
    ("floating_point_word_size", "an Exodus II file of another name", "let its name end in .exo"),
];
const AS_TIFF: &str = "export it as OME-Zarr, or as TIFF slices";

impl Dialect {
    /// The convention that a file follows.
    ///
    /// # Errors
    /// [`Error::BadInput`] for one that is not read.
    pub(super) fn of(path: &Path, file: &Hdf5File) -> Result<Self> {
        let root = file.root_group().map_err(|e| damaged(path, "/", &e))?;
        let (groups, datasets) = root.member_names().map_err(|e| damaged(path, "/", &e))?;
        let has = |name: &str| groups.iter().chain(&datasets).any(|n| n == name);
        let marked = |name: &str| has(name) || root.attribute(name).is_ok();
        if let Some((name, what, help)) = REFUSED.into_iter().find(|(name, ..)| marked(name)) {
            let got = format!("{what}, as '{name}' tells");
            return Err(refused(path, "kind of HDF5 file", got, help));
        }
        match () {
            () if has("VTKHDF") => Ok(Self::Vtk),
            () if has("minc-2.0") => Ok(Self::Minc),
            () if has("ITKImage") => Ok(Self::Itk),
            () => Ok(Self::Plain),
        }
    }

    /// Its common name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Plain => "HDF5",
            Self::Vtk => "VTKHDF",
            Self::Minc => "MINC 2",
            Self::Itk => "ITK's HDF5",
        }
    }

    /// How its arrays have frames, channels and components.
    pub(super) fn rules(self) -> Rules {
        match self {
            Self::Plain => Rules::Plain,
            Self::Minc => Rules::Volumes,
            Self::Vtk | Self::Itk => Rules::Vectors,
        }
    }

    /// The group of the datasets that are fields; the whole file where it has no such group.
    pub(super) fn within(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Vtk => "VTKHDF/",
            Self::Minc => "minc-2.0/image/0/image",
            Self::Itk => "ITKImage/0/VoxelData",
        }
    }
}

fn refused(path: &Path, at: &str, got: impl Into<String>, help: &str) -> Error {
    let expected = "plain datasets, NetCDF, a VTKHDF image, MINC 2 or ITK";
    Error::bad_input(path, at, expected, got).with_help(help)
}

/// A field of a convention, placed as the convention says.
pub(super) struct Placed {
    /// Which of the tree's fields.
    pub(super) number: usize,
    /// All fields, by their names in the convention, and the one that is read.
    pub(super) fields: Vec<FieldInfo>,
    pub(super) field: FieldInfo,
    pub(super) geometry: Geometry,
    /// How stored numbers become values, where that is not one line for all.
    pub(super) convert: Option<Convert>,
    pub(super) units: Units,
}

impl Placed {
    /// A field whose numbers are its values, in units that are not known.
    pub(super) fn plain(number: usize, fields: Vec<FieldInfo>, geometry: Geometry) -> Self {
        let field = fields[number].clone();
        Self { number, fields, field, geometry, convert: None, units: Units::default() }
    }
}

/// Picks a field of a VTKHDF image.
pub(super) fn vtk(path: &Path, file: &Hdf5File, tree: &Tree, wanted: Option<&str>) -> Result<Placed> {
    let at = "/VTKHDF";
    let root = file.root_group().and_then(|r| r.group("VTKHDF")).map_err(|e| damaged(path, at, &e))?;
    let kind = root.attribute("Type").ok().and_then(|a| attribute_text(&a)).unwrap_or_default();
    if kind != "ImageData" {
        let got = format!("a VTKHDF file of type '{kind}'");
        let help = match &*kind {
            "PolyData" => "of surfaces, isospan check tells what is in them",
            // It is read as a mesh, unless it is on a server.
            "UnstructuredGrid" => "copy it to a disk, and name that copy",
            _ => "write it as .vtu, .vti, .vtr or .vts",
        };
        return Err(refused(path, at, got, help));
    }
    if root.group("Steps").is_ok() {
        let got = "a VTKHDF image of several steps";
        return Err(refused(path, at, got, "write each step as .vti, and a .pvd list of them"));
    }
    let list = |name: &str| root.attribute(name).ok().and_then(|a| attribute_numbers(&a));
    let wrong = |name: &str, n: usize| {
        Error::bad_input(path, format!("{at}, {name}"), format!("{n} numbers"), "another number of them")
    };
    let bounds = list("WholeExtent").ok_or_else(|| wrong("WholeExtent", 6))?;
    let whole = <[f64; 6]>::try_from(bounds).map_err(|_| wrong("WholeExtent", 6))?;
    let fits = whole.iter().all(|b| b.fract() == 0.0 && b.abs() < f64::from(i32::MAX));
    if !fits || (0..3).any(|a| whole[2 * a + 1] < whole[2 * a]) {
        let got = format!("{whole:?}");
        return Err(Error::bad_input(path, "/VTKHDF, WholeExtent", "x0 <= x1 and so on, of 32 bits", got));
    }
    let points: [u64; 3] = std::array::from_fn(|a| (whole[2 * a + 1] - whole[2 * a]) as u64 + 1);
    let origin: [f64; 3] =
        list("Origin").map_or(Ok([0.0; 3]), |v| v.try_into().map_err(|_| wrong("Origin", 3)))?;
    let spacing: [f64; 3] =
        list("Spacing").map_or(Ok([1.0; 3]), |v| v.try_into().map_err(|_| wrong("Spacing", 3)))?;
    let rows: [f64; 9] = list("Direction")
        .map_or(Ok([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), |v| {
            v.try_into().map_err(|_| wrong("Direction", 9))
        })?;
    let names = |group: &str| -> Vec<(usize, FieldInfo)> {
        let prefix = format!("VTKHDF/{group}/");
        let fields = tree.fields.iter().enumerate();
        let named = fields.filter_map(|(n, f)| {
            let name = f.part.info.name.strip_prefix(&prefix)?;
            Some((n, FieldInfo { name: name.into(), ..f.part.info.clone() }))
        });
        named.filter(|(_, f)| f.name != "vtkGhostType").collect()
    };
    let (at_points, at_cells) = (names("PointData"), names("CellData"));
    for (group, name) in [("PointData", "points"), ("CellData", "cells")] {
        let ghosts = tree.fields.iter().find(|f| f.part.info.name == format!("VTKHDF/{group}/vtkGhostType"));
        if ghosts.is_some_and(|f| super::any_nonzero(&f.dataset, f.part.info.scalar)) {
            let got = format!("hidden or repeated {name}");
            let help = "blank the samples with NaN, or write them as an unstructured grid (.vtu)";
            return Err(
                Error::bad_input(path, format!("{at}/{group}/vtkGhostType"), "zeros", got).with_help(help)
            );
        }
    }
    let infos = |list: &[(usize, FieldInfo)]| list.iter().map(|(_, f)| f.clone()).collect::<Vec<_>>();
    let wanted = wanted.map(|w| {
        ["VTKHDF/PointData/", "VTKHDF/CellData/"].iter().find_map(|p| w.strip_prefix(p)).unwrap_or(w)
    });
    let active = |center| {
        let group = if center == Center::Cell { "CellData" } else { "PointData" };
        let found = root.group(group).ok()?.attribute("Scalars").ok()?;
        attribute_text(&found)
    };
    let active = [active(Center::Point), active(Center::Cell)];
    let Picked { field, fields, center, index } =
        pick(path, infos(&at_points), infos(&at_cells), wanted, |center| {
            active[usize::from(center == Center::Cell)].as_deref()
        })?;
    let number = if center == Center::Cell { at_cells[index].0 } else { at_points[index].0 };
    let (expected, got) = (samples(points, center), tree.fields[number].dims());
    if expected != got {
        let [expected, got] = [expected, got].map(|[x, y, z]| format!("{z} x {y} x {x}"));
        let expected = format!("{expected} samples, as WholeExtent tells");
        return Err(Error::bad_input(path, tree.fields[number].part.info.name.clone(), expected, got));
    }
    let columns: [[f64; 3]; 3] =
        std::array::from_fn(|a| std::array::from_fn(|i| rows[3 * i + a] * spacing[a]));
    let first = first_sample(points, center);
    let first: [f64; 3] = std::array::from_fn(|a| whole[2 * a] + first[a]);
    let step = |i: usize| -> f64 { (0..3).map(|a| columns[a][i] * first[a]).sum() };
    let origin = std::array::from_fn(|i| origin[i] + step(i));
    let geometry = geometry(path, "Origin, Spacing and Direction", origin, columns)?;
    Ok(Placed { number, fields, field, geometry, convert: None, units: Units::default() })
}

/// The image of a file of ITK: `Origin`, `Spacing`, and in each row of `Directions` the direction
/// of an axis.
pub(super) fn itk(path: &Path, file: &Hdf5File, tree: &Tree, wanted: Option<&str>) -> Result<Placed> {
    let read = |name: &str| -> Result<Vec<f64>> {
        let full = format!("ITKImage/0/{name}");
        let dataset = file.dataset(&full).map_err(|e| damaged(path, &full, &e))?;
        let (scalar, _) = super::scalar_of(path, &full, &dataset)?;
        let small = dataset.num_elements().is_ok_and(|n| n <= 16);
        let wrong = || Error::bad_input(path, &full, "one number an axis", "many");
        if small {
            super::all_f64(&dataset, scalar).map_err(|e| damaged(path, &full, &e))
        } else {
            Err(wrong())
        }
    };
    let wrong = |name: &str| {
        Error::bad_input(path, format!("ITKImage/0/{name}"), "an image of three axes", "another number")
    };
    let origin: [f64; 3] = read("Origin")?.try_into().map_err(|_| wrong("Origin"))?;
    let spacing: [f64; 3] = read("Spacing")?.try_into().map_err(|_| wrong("Spacing"))?;
    let rows: [f64; 9] = read("Directions")?.try_into().map_err(|_| wrong("Directions"))?;
    let columns = std::array::from_fn(|a| std::array::from_fn(|i| rows[3 * a + i] * spacing[a]));
    let geometry = geometry(path, "Origin, Spacing and Directions", origin, columns)?;
    let fields: Vec<FieldInfo> = tree.fields.iter().map(|f| f.part.info.clone()).collect();
    let number = crate::formats::shared::pick_field(path, &fields, wanted)?;
    Ok(Placed::plain(number, fields, geometry))
}

/// The image of a MINC file: axes by `dimorder`, values scaled slice by slice.
pub(super) fn minc(path: &Path, file: &Hdf5File, tree: &Tree, wanted: Option<&str>) -> Result<Placed> {
    let at = "minc-2.0/image/0/image";
    let fields: Vec<FieldInfo> = tree.fields.iter().map(|f| f.part.info.clone()).collect();
    let wanted = wanted.map(|w| if w == "image" { at } else { w });
    let number = crate::formats::shared::pick_field(path, &fields, wanted)?;
    let field = &tree.fields[number];
    let bad = |what: &str, expected: &str, got: String| {
        Error::bad_input(path, format!("{at}, {what}"), expected, got)
            .with_help("convert it: mnc2nii, or mincresample to regular axes")
    };
    let order = field.dataset.attribute("dimorder").ok().and_then(|a| attribute_text(&a)).unwrap_or_default();
    let names: Vec<&str> = order.split(',').map(str::trim).filter(|n| !n.is_empty()).collect();
    let axes = names.iter().map(|n| ["xspace", "yspace", "zspace"].iter().position(|a| a == n));
    let axes: Option<Vec<usize>> = axes.collect();
    let axes = axes.filter(|a| a.len() == 3 && (0..3).all(|n| a.contains(&n)) && field.dataset.ndim() == 3);
    if axes.is_none() {
        let got = format!("'{order}'");
        return Err(bad("dimorder", "xspace, yspace and zspace in some order", got));
    }
    let (mut columns, mut origin, mut lengths) = ([[0.0; 3]; 3], [0.0; 3], vec![]);
    for (n, name) in names.iter().enumerate() {
        let axis = dimension(path, file, name)?;
        // The last name is the fastest axis, our x.
        columns[2 - n] = axis.direction.map(|d| d * axis.step);
        lengths.push(axis.unit);
        for (o, d) in origin.iter_mut().zip(axis.direction) {
            *o += d * axis.start;
        }
    }
    let geometry = geometry(path, "start, step and direction_cosines", origin, columns)?;
    let convert = match field.part.info.scalar {
        ScalarType::F32 | ScalarType::F64 => None,
        scalar => Some(slices(path, file, field, scalar, bad)?),
    };
    let name = |f: FieldInfo| FieldInfo { name: "image".into(), ..f };
    let fields: Vec<FieldInfo> = fields.into_iter().map(name).collect();
    let value = field.dataset.attribute("units").ok().and_then(|a| attribute_text(&a));
    let value = value.and_then(|unit| Unit::new(&unit));
    let units = Units { value, ..Units::of_length(common(lengths)) };
    Ok(Placed { number, field: fields[number].clone(), fields, geometry, convert, units })
}

struct Dimension {
    start: f64,
    step: f64,
    direction: [f64; 3],
    unit: Option<Unit>,
}

/// An axis of a MINC file.
fn dimension(path: &Path, file: &Hdf5File, name: &str) -> Result<Dimension> {
    let full = format!("minc-2.0/dimensions/{name}");
    let dataset = file.dataset(&full).map_err(|e| damaged(path, &full, &e))?;
    let list = |key: &str| dataset.attribute(key).ok().and_then(|a| attribute_numbers(&a));
    let one = |key: &str, default: f64| list(key).and_then(|v| v.first().copied()).unwrap_or(default);
    let spacing = dataset.attribute("spacing").ok().and_then(|a| attribute_text(&a)).unwrap_or_default();
    if spacing.starts_with("irregular") {
        return Err(Error::bad_input(path, full, "regular spacing", "irregular spacing")
            .with_help("resample it to regular axes (mincresample)"));
    }
    let mut axis = [0.0; 3];
    axis[["xspace", "yspace", "zspace"].iter().position(|a| *a == name).unwrap_or(0)] = 1.0;
    let direction = list("direction_cosines").map_or(Ok(axis), |v| {
        <[f64; 3]>::try_from(v).map_err(|v| {
            let got = format!("{} of them", v.len());
            Error::bad_input(path, format!("{full}, direction_cosines"), "three numbers", got)
        })
    })?;
    let unit = dataset.attribute("units").ok().and_then(|a| attribute_text(&a));
    let unit = unit.and_then(|unit| Unit::length(&unit));
    Ok(Dimension { start: one("start", 0.0), step: one("step", 1.0), direction, unit })
}

/// The lines from stored integers to values: `valid_range` is stretched to `image-min` …
/// `image-max` of each slice.
fn slices(
    path: &Path,
    file: &Hdf5File,
    field: &Field,
    scalar: ScalarType,
    bad: impl Fn(&str, &str, String) -> Error,
) -> Result<Convert> {
    let bits = 8 * scalar.bytes() as i32;
    let signed = matches!(field.dataset.dtype(), Datatype::FixedPoint { signed: true, .. });
    let full = if signed {
        [-libm::exp2(f64::from(bits - 1)), libm::exp2(f64::from(bits - 1)) - 1.0]
    } else {
        [0.0, libm::exp2(f64::from(bits)) - 1.0]
    };
    let valid = field.dataset.attribute("valid_range").ok().and_then(|a| attribute_numbers(&a));
    let valid = valid.map_or(Ok(full), |v| <[f64; 2]>::try_from(v).map_err(|v| format!("{v:?}")));
    let valid = valid.and_then(|[a, b]| if a < b { Ok([a, b]) } else { Err(format!("{a} .. {b}")) });
    let valid = valid.map_err(|got| bad("valid_range", "two numbers, the first the lesser", got))?;
    let shape = field.dataset.shape();
    let table = |name: &str| -> Result<(Vec<f64>, usize)> {
        let full = format!("minc-2.0/image/0/{name}");
        let dataset = file.dataset(&full).map_err(|e| damaged(path, &full, &e))?;
        let (own, (scalar, _)) = (dataset.shape().to_vec(), super::scalar_of(path, &full, &dataset)?);
        if own.len() > 2 || own != shape[..own.len()] {
            let expected = "one number, one a slice, or one a row";
            return Err(bad(name, expected, format!("{own:?} of them")));
        }
        let numbers = super::all_f64(&dataset, scalar).map_err(|e| damaged(path, &full, &e))?;
        Ok((numbers, own.len()))
    };
    let ((least, rank), (most, other)) = (table("image-min")?, table("image-max")?);
    if rank != other || least.len() != most.len() {
        return Err(bad("image-min, image-max", "as many of either", format!("{rank} and {other} axes")));
    }
    let line = |(lo, hi): (&f64, &f64)| {
        let slope = (hi - lo) / (valid[1] - valid[0]);
        [slope, lo - slope * valid[0]]
    };
    let lines: Vec<[f64; 2]> = least.iter().zip(&most).map(line).collect();
    if let Some(wrong) = lines.iter().position(|l| !l[0].is_finite() || !l[1].is_finite()) {
        let got = format!("{} and {}", least[wrong], most[wrong]);
        return Err(bad("image-min, image-max", "finite numbers", got));
    }
    let slices = [if rank > 1 { shape[1] } else { 1 }, if rank > 0 { shape[0] } else { 1 }];
    Ok(Convert { valid, missing: None, lines, slices })
}

/// Groups that NeXus marks: the names of the axes of the datasets in an `NXdata`.
///
/// # Errors
/// [`Error::BadInput`] where they have a form that is not read.
pub(super) fn nexus_axes(
    path: &Path,
    group: &Group,
    at: &str,
    lines: &[String],
) -> Result<Option<Vec<String>>> {
    let text = |name: &str| group.attribute(name).ok().and_then(|a| attribute_text(&a));
    if text("NX_class").as_deref() != Some("NXdata") {
        return Ok(None);
    }
    let axes = group.attribute("axes").ok().map(|a| match (a.read_strings(), attribute_text(&a)) {
        (Ok(names), _) if names.len() > 1 => names,
        (_, Some(one)) => one.split([':', ',']).map(|n| n.trim_matches(['[', ']', ' ']).into()).collect(),
        (names, None) => names.unwrap_or_default(),
    });
    // Older files mark each axis by an attribute of its own.
    let marked = |name: &&String| group.dataset(name).is_ok_and(|d| d.attribute("axis").is_ok());
    if let (None, Some(name)) = (&axes, lines.iter().find(marked)) {
        let got = format!("axes marked one by one, as '{name}' is");
        let help = "write the attribute `axes` of the group: the names of the axes, slowest first";
        return Err(refused(path, at, got, help));
    }
    Ok(axes)
}
