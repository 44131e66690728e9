//! Conventions of programs that use HDF5: finds which one a file follows, and where it places the
//! samples.
//!
//! | convention | known by | |
//! |---|---|---|
//! | VTKHDF | `/VTKHDF`, its `Type` | an image is read here, a mesh and a surface elsewhere; other types are refused |
//! | MINC 2 | `/minc-2.0` | read, an axis of time as a series; of irregular spacing in space, refused |
//! | ITK | `/ITKImage` | read |
//! | EMD, HyperSpy | groups with `emd_group_type`, or `axis-0` | read, see the module `axes` |
//! | those of the table below | groups and attributes of the root group | refused |
//! | Enzo, H5Part, PFLOTRAN, Velox, Data Exchange; VizSchema | names of groups; `vsMesh` | refused |
//!
//! The refused ones keep their voxel size, or their axes, where a plain reader does not look, so
//! the result would be wrong.

use super::{Tree, attribute_numbers, attribute_text, damaged};
use crate::cells::Center;
use crate::error::{Error, Result};
use crate::formats::shared::centers::{Picked, first_sample, pick, samples};
use crate::formats::shared::cf::{Convert, OF_ATOMS, Rules, refused_convention};
use crate::formats::shared::header::geometry;
use crate::formats::shared::minc;
use crate::grid::Geometry;
use crate::volume::units::Units;
use crate::volume::{Assumed, FieldInfo};
use hdf5_reader::attribute_api::Attribute;
use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Hdf5File};
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
const REFUSED: [(&str, &str, &str); 19] = [
    ("DataSetInfo", "an Imaris file (.ims)", AS_TIFF),
    ("ImarisDataSet", "an Imaris file (.ims)", AS_TIFF),
    ("t00000", "a BigDataViewer file, whose voxel size is in its .xml", AS_TIFF),
    ("DataContainers", "a Dream.3D file", "write the array as .vti"),
    ("DataStructure", "a DREAM3D-NX file", "write the array as .vti"),
    ("Chimera", "a Chimera map", "save it as .nrrd, or its array as NPY"),
    ("MDF", "an EMAN2 image", "convert it with e2proc3d.py to .nrrd"),
    ("openPMD", "an openPMD file", "write the mesh's array as .vti, with its gridSpacing"),
    ("CGNSLibraryVersion", "a CGNS file", "convert it to .vtu"),
    ("INFOS_GENERALES", "a MED file", "convert it to .vtu"),
    ("floating_point_word_size", "an Exodus II file of another name", "let its name end in .exo"),
    ("Chombo_global", "a Chombo file", OF_LEVELS),
    ("unknown names", "a FLASH file", OF_LEVELS),
    ("NumMeshBlocks", "an Athena++ file", OF_LEVELS),
    ("gridded_data_format", "a file of the Grid Data Format", OF_LEVELS),
    ("Parameters and Global Attributes", "a file of the Einstein Toolkit (Carpet)", OF_LEVELS),
    ("_silolibinfo", "a Silo file", "convert it to .vti or .vtu, with VisIt"),
    ("cxi_version", "a CXI file", "write the array that is wanted as .vti"),
    ("h5md", "an H5MD file", OF_ATOMS),
];
const AS_TIFF: &str = "export it as OME-Zarr, or as TIFF slices";
/// What to do with boxes of several resolutions.
const OF_LEVELS: &str = "resample it to one grid, with yt or VisIt, and write that as .vti";

/// What is refused by groups and datasets whose names vary, or are common ones: see [`REFUSED`].
fn refused_by_members(
    root: &Group,
    groups: &[String],
    datasets: &[String],
) -> Option<(String, &'static str)> {
    let starting = |start: &str| groups.iter().find(|name| name.starts_with(start));
    let has = |list: &[String], name: &str| list.iter().any(|n| n == name);
    let within = |group: &str, names: &[&str]| {
        let members = root.group(group).and_then(|g| g.member_names()).unwrap_or_default();
        names.iter().any(|name| has(&members.0, name) || has(&members.1, name))
    };
    if let Some(name) = starting("Grid0000") {
        return Some((format!("a file of Enzo, as '{name}' tells"), OF_LEVELS));
    }
    if let Some(name) = starting("Step#") {
        return Some((format!("an H5Part file, as '{name}' tells"), "write the field as .vti"));
    }
    if has(groups, "Coordinates") && starting("Time:").or_else(|| starting("   1 Time")).is_some() {
        let help = "write the field as .vti: here the first axis is x";
        return Some(("a PFLOTRAN file, as its groups of times tell".into(), help));
    }
    let of_velox = ["Image", "Spectrum", "SpectrumImage", "SpectrumStream", "Line"];
    if has(datasets, "Version") && within("Data", &of_velox) {
        let help = "its frames are the last axis: write the stack as .nrrd or TIFF, with HyperSpy or Velox";
        return Some(("a Velox file (.emd), as '/Data' and '/Version' tell".into(), help));
    }
    if within("exchange", &["theta"]) {
        let help = "reconstruct the volume first, with tomopy or another program";
        return Some(("projections of Data Exchange, as '/exchange/theta' tells".into(), help));
    }
    None
}

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
        let of_words = ["Conventions", "conventions", "file_format"].iter().find_map(|name| {
            let text = root.attribute(name).ok().and_then(|a| attribute_text(&a))?;
            refused_convention(&text).map(|(what, help)| (what.to_string(), help))
        });
        if let Some((got, help)) = of_words.or_else(|| refused_by_members(&root, &groups, &datasets)) {
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

    /// Whether a dataset, by its path, may be a field.
    pub(super) fn has(self, name: &str) -> bool {
        match self {
            Self::Plain => true,
            Self::Vtk => name.starts_with("VTKHDF/"),
            Self::Minc => name == IMAGE,
            Self::Itk => name.starts_with("ITKImage/0/VoxelData"),
        }
    }

    /// The name of a field, given the path of its dataset.
    pub(super) fn name_of(self, path: &str) -> &str {
        if self == Self::Minc { "image" } else { path }
    }
}

fn refused(path: &Path, at: &str, got: impl Into<String>, help: &str) -> Error {
    let expected = "plain datasets, NetCDF, a VTKHDF image, MINC 2, ITK, EMD or HyperSpy";
    Error::bad_input(path, at, expected, got).with_help(help)
}

/// A field of a convention, placed as the convention says.
pub(super) struct PlacedField {
    /// Which of the tree's fields.
    pub(super) number: usize,
    /// All fields, by their names in the convention, and the one that is read.
    pub(super) fields: Vec<FieldInfo>,
    pub(super) field: FieldInfo,
    pub(super) geometry: Geometry,
    /// How stored numbers become values, where that is not one line for all.
    pub(super) convert: Option<Convert>,
    pub(super) units: Units,
    pub(super) assumed: Assumed,
}

impl PlacedField {
    /// A field whose numbers are its values, in units that are not known.
    pub(super) fn plain(number: usize, fields: Vec<FieldInfo>, geometry: Geometry) -> Self {
        let field = fields[number].clone();
        Self {
            number,
            fields,
            field,
            geometry,
            convert: None,
            units: Units::default(),
            assumed: Assumed::default(),
        }
    }
}

/// Picks a field of a VTKHDF image.
pub(super) fn vtk(path: &Path, file: &Hdf5File, tree: &Tree, wanted: Option<&str>) -> Result<PlacedField> {
    let at = "/VTKHDF";
    let root = file.root_group().and_then(|r| r.group("VTKHDF")).map_err(|e| damaged(path, at, &e))?;
    expect_one_image(path, &root, at)?;
    let extent = Extent::read(path, &root)?;
    refuse_ghosts(path, tree)?;
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
    let (expected, got) = (samples(extent.points, center), tree.fields[number].dims());
    if expected != got {
        let [expected, got] = [expected, got].map(|[x, y, z]| format!("{z} x {y} x {x}"));
        let expected = format!("{expected} samples, as WholeExtent tells");
        return Err(Error::bad_input(path, tree.fields[number].part.info.name.clone(), expected, got));
    }
    let geometry = extent.geometry(path, center)?;
    Ok(PlacedField {
        number,
        fields,
        field,
        geometry,
        convert: None,
        units: Units::default(),
        assumed: Assumed::default(),
    })
}

/// Refuses VTKHDF files of other kinds, and images of several steps.
fn expect_one_image(path: &Path, root: &Group, at: &str) -> Result<()> {
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
    Ok(())
}

/// Where the points of a VTKHDF image are.
struct Extent {
    /// The number of points along each axis.
    points: [u64; 3],
    /// The first and the last index along each axis.
    whole: [f64; 6],
    origin: [f64; 3],
    spacing: [f64; 3],
    /// The matrix `Direction`, row by row.
    rows: [f64; 9],
}

impl Extent {
    fn read(path: &Path, root: &Group) -> Result<Self> {
        let at = "/VTKHDF";
        let list = |name: &str| root.attribute(name).ok().and_then(|a| attribute_numbers(&a));
        let wrong = |name: &str, n: usize| {
            Error::bad_input(path, format!("{at}, {name}"), format!("{n} numbers"), "another number of them")
        };
        let bounds = list("WholeExtent").ok_or_else(|| wrong("WholeExtent", 6))?;
        let whole = <[f64; 6]>::try_from(bounds).map_err(|_| wrong("WholeExtent", 6))?;
        let fits = whole.iter().all(|b| b.fract() == 0.0 && b.abs() < f64::from(i32::MAX));
        if !fits || (0..3).any(|a| whole[2 * a + 1] < whole[2 * a]) {
            let got = format!("{whole:?}");
            return Err(Error::bad_input(
                path,
                "/VTKHDF, WholeExtent",
                "x0 <= x1 and so on, of 32 bits",
                got,
            ));
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
        Ok(Self { points, whole, origin, spacing, rows })
    }

    /// The placement of the samples: of points, or of the middles of cells.
    fn geometry(&self, path: &Path, center: Center) -> Result<Geometry> {
        let Self { points, whole, origin, spacing, rows } = *self;
        let columns: [[f64; 3]; 3] =
            std::array::from_fn(|a| std::array::from_fn(|i| rows[3 * i + a] * spacing[a]));
        let first = first_sample(points, center);
        let first: [f64; 3] = std::array::from_fn(|a| whole[2 * a] + first[a]);
        let step = |i: usize| -> f64 { (0..3).map(|a| columns[a][i] * first[a]).sum() };
        let origin = std::array::from_fn(|i| origin[i] + step(i));
        geometry(path, "Origin, Spacing and Direction", origin, columns)
    }
}

/// Refuses an image of which some points or cells are hidden.
fn refuse_ghosts(path: &Path, tree: &Tree) -> Result<()> {
    for (group, name) in [("PointData", "points"), ("CellData", "cells")] {
        let ghosts = tree.fields.iter().find(|f| f.part.info.name == format!("VTKHDF/{group}/vtkGhostType"));
        if ghosts.is_some_and(|f| super::any_nonzero(&f.dataset, f.part.info.scalar)) {
            let got = format!("hidden or repeated {name}");
            let help = "blank the samples with NaN, or write them as an unstructured grid (.vtu)";
            return Err(
                Error::bad_input(path, format!("/VTKHDF/{group}/vtkGhostType"), "zeros", got).with_help(help)
            );
        }
    }
    Ok(())
}

/// The image of a file of ITK: `Origin`, `Spacing`, and in each row of `Directions` the direction
/// of an axis.
pub(super) fn itk(path: &Path, file: &Hdf5File, tree: &Tree, wanted: Option<&str>) -> Result<PlacedField> {
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
    Ok(PlacedField::plain(number, fields, geometry))
}

/// The image of a MINC file: axes by `dimorder`, values scaled slice by slice.
pub(super) fn minc(path: &Path, file: &Hdf5File, tree: &Tree, wanted: Option<&str>) -> Result<PlacedField> {
    let fields: Vec<FieldInfo> = tree.fields.iter().map(|f| f.part.info.clone()).collect();
    let number = crate::formats::shared::pick_field(path, &fields, wanted)?;
    let super::Hdf5Field { part, dataset, .. } = &tree.fields[number];
    let axes = minc_axes(dataset);
    let stored = minc::Stored {
        axes: &axes,
        shape: dataset.shape(),
        scalar: part.info.scalar,
        moment: part.time.map(|axis| part.entries[axis]),
    };
    let minc::Image { geometry, convert, units, assumed } = minc::image(&Minc { path, file }, &stored)?;
    Ok(PlacedField { number, field: fields[number].clone(), fields, geometry, convert, units, assumed })
}

/// The names of the axes of an image of MINC.
pub(super) fn minc_axes(image: &Dataset) -> Vec<String> {
    let order = image.attribute("dimorder").ok().and_then(|a| attribute_text(&a)).unwrap_or_default();
    order.split(',').map(|name| name.trim().to_string()).filter(|name| !name.is_empty()).collect()
}

/// The times of the `count` volumes of a MINC file.
pub(super) fn minc_times(path: &Path, file: &Hdf5File, count: u64) -> Option<Vec<f64>> {
    minc::times(&Minc { path, file }, count)
}

/// The image of a MINC file.
const IMAGE: &str = "minc-2.0/image/0/image";

/// The variables of a MINC file.
struct Minc<'a> {
    path: &'a Path,
    file: &'a Hdf5File,
}

impl Minc<'_> {
    fn attribute(&self, variable: &str, name: &str) -> Option<Attribute> {
        self.file.dataset(&minc::Variables::place(self, variable)).ok()?.attribute(name).ok()
    }
}

impl minc::Variables for Minc<'_> {
    fn path(&self) -> &Path {
        self.path
    }

    fn place(&self, variable: &str) -> String {
        let folder = if variable.starts_with("image") { "image/0" } else { "dimensions" };
        format!("minc-2.0/{folder}/{variable}")
    }

    fn text(&self, variable: &str, attribute: &str) -> String {
        self.attribute(variable, attribute).and_then(|a| attribute_text(&a)).unwrap_or_default()
    }

    fn numbers(&self, variable: &str, attribute: &str) -> Option<Vec<f64>> {
        self.attribute(variable, attribute).and_then(|a| attribute_numbers(&a))
    }

    fn table(&self, variable: &str, most: u64) -> Result<Option<(Vec<u64>, Vec<f64>)>> {
        let full = self.place(variable);
        let dataset = self.file.dataset(&full).map_err(|e| damaged(self.path, &full, &e))?;
        if dataset.ndim() > 2 || dataset.num_elements().map_or(true, |n| n > most) {
            return Ok(None);
        }
        let (scalar, _) = super::scalar_of(self.path, &full, &dataset)?;
        let numbers = super::all_f64(&dataset, scalar).map_err(|e| damaged(self.path, &full, &e))?;
        Ok(Some((dataset.shape().to_vec(), numbers)))
    }
}

/// Fails for a dataset whose attributes, or the names of its axes, say that it is no volume, or is
/// placed by what is not read.
///
/// # Errors
/// [`Error::BadInput`] for such a dataset.
pub(super) fn refuse_dataset(path: &Path, name: &str, dataset: &Dataset, axes: &[String]) -> Result<()> {
    if axes.iter().any(|axis| axis == "rotation_angle") {
        let got = "projections, as the axis 'rotation_angle' tells";
        return Err(refused(path, name, got, "reconstruct the volume first, with tomopy or another program"));
    }
    if dataset.attribute("vsMesh").is_ok() {
        let got = "a variable of VizSchema, as 'vsMesh' tells: its first axis is x";
        return Err(refused(path, name, got, "write it as .vti, with the bounds of its mesh"));
    }
    Ok(())
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
