//! Exodus II (`.exo`, `.e`, `.ex2`), in NetCDF-3 files of all versions and in NetCDF-4.
//!
//! ```text
//! num_nodes, num_elem, num_el_blk, num_el_in_blk1, …       dimensions
//! coordx(num_nodes), coordy, coordz                        or coord(3, num_nodes) in old files
//! connect1(num_el_in_blk1, nodes)                          elem_type = "HEX8"; nodes are counted from 1
//! time_whole(time_step)
//! name_nod_var(variables, characters)
//! vals_nod_var1(time_step, num_nodes)                      or vals_nod_var(time_step, variables, num_nodes)
//! name_elem_var(variables, characters)
//! vals_elem_var1eb2(time_step, num_el_in_blk2)             variable 1 in block 2, where it has that
//! ```
//!
//! **Blocks** follow each other. Those of elements without a volume (shells, bars, spheres) count
//! as cells without a volume. Nodes have their places in `connect`; the ids that maps give them
//! decide nothing. Sets of nodes and of sides are passed over.
//!
//! **Fields** are the variables on nodes and on elements, each number by itself: the components of
//! a vector have names of their own. An element block without a variable has NaN. Of a file with
//! several steps, `heat:t0`, `heat:t1`, … are the steps of `heat`. Positions are those at rest:
//! displacements are fields like others.
//!
//! A part of a mesh that was divided among processes is refused: `epu` joins them. Memory: a block
//! of points or cells; in NetCDF-4 a chunk of each array that is read, of at most 16 MiB.

mod blocks;

use crate::cells::{CellField, CellFile, CellMesh, CellStream, CellsInfo, Center, NumberStream};
use crate::error::{Error, Result};
use crate::formats::shared::arrays::Arrays;
use crate::formats::shared::cf::netcdf_fill;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::mesh_file::MeshFile;
use crate::formats::shared::{Frames, OpenOptions, has_suffix, known_times};
use crate::formats::volume::{hdf5, netcdf};
use blocks::{Block, Elements, blocks_of};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Exodus II.
pub(in crate::formats) struct Exodus;

/// Names that say enough of a NetCDF file.
const SUFFIXES: [&str; 7] = [".exo", ".ex2", ".exii", ".exoii", ".e", ".g", ".gen"];

static ABOUT: About =
    About { meshes: &["Exodus II"], suffixes: SUFFIXES.split_at(3).0, ..About::named("an Exodus II file") };

impl Format for Exodus {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        let is_classic = head.bytes.starts_with(b"CDF");
        let names_blocks = || head.bytes.windows(10).any(|w| w == b"num_el_blk");
        let is_called = || has_suffix(head.path, &SUFFIXES);
        is_classic && (is_called() || names_blocks()) || head.is_hdf5() && is_called()
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let source = head.file()?;
        let arrays = if head.is_hdf5() { hdf5::arrays(source, 0)? } else { netcdf::arrays(source)? };
        Ok(Box::new(MeshFile::new(Mesh(Arc::new(Shared::of(head.path, arrays)?)))?))
    }
}

impl Dataset for MeshFile<Mesh> {
    fn is_mesh(&self) -> bool {
        true
    }

    fn mesh(&self, options: &OpenOptions) -> Result<CellMesh> {
        self.of_field(options)
    }

    fn time(&self, _: &OpenOptions) -> Result<Option<f64>> {
        let times = &self.file.0.times;
        Ok(if times.len() == 1 { times[0] } else { None })
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        let file = &self.file.0;
        let name = match &options.field {
            Some(name) => name,
            // The only variable needs no name.
            None if file.variables.len() == 1 => &file.variables[0].name,
            None => return Ok(vec![]),
        };
        let is_known = file.times.len() > 1 && file.variables.iter().any(|v| v.name == *name);
        let steps = file.times.iter().enumerate().filter(|_| is_known);
        Ok(steps.map(|(step, &time)| (format!("{name}:t{step}"), time)).collect())
    }

    fn times(&self, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        let file = &self.file.0;
        let name =
            |(field, place): (&CellField, &ValuePlace)| (field.name.clone(), file.times[place.step as usize]);
        Ok(known_times(file.info.fields.iter().zip(&file.places).map(name).collect()))
    }
}

/// Most fields: steps of all variables.
const MOST_FIELDS: u64 = 1 << 20;
/// Most steps.
const MOST_STEPS: u64 = 1 << 20;

/// What a file has.
struct Shared {
    info: CellsInfo,
    arrays: Arc<dyn Arrays>,
    blocks: Vec<Block>,
    variables: Vec<Variable>,
    /// The time of each step, where that is a number.
    times: Vec<Option<f64>>,
    /// Where each field is.
    places: Vec<ValuePlace>,
}

/// A variable on nodes or elements.
struct Variable {
    name: String,
    center: Center,
    /// Its number among those, from 1 on.
    number: u64,
}

struct ValuePlace {
    variable: usize,
    step: u64,
}

impl Shared {
    fn of(path: &Path, arrays: Arc<dyn Arrays>) -> Result<Self> {
        let wrong = |at: &str, expected: &str, got: String| Error::bad_input(path, at, expected, got);
        if let Some(parts) = arrays.dimension("num_procs").filter(|&n| n > 1) {
            return Err(wrong(
                "num_procs",
                "a whole mesh",
                format!("a part of one that {parts} processes wrote"),
            )
            .with_help("join the parts with epu of SEACAS"));
        }
        let points = arrays.dimension("num_nodes");
        let points = points.ok_or_else(|| wrong("num_nodes", "a number of nodes", "none".into()))?;
        let has_three = match arrays.array("coord")? {
            Some(array) => array.shape == [3, points],
            None => {
                let all = ["coordx", "coordy", "coordz"].map(|name| arrays.array(name));
                let [x, y, z] = all;
                [x?, y?, z?].iter().all(|a| a.as_ref().is_some_and(|a| a.shape == [points]))
            }
        };
        if !has_three {
            let dims = arrays.dimension("num_dim").map_or("others".into(), |n| format!("a mesh of {n} axes"));
            return Err(wrong("coordinates", &format!("x, y and z of {points} nodes"), dims));
        }
        let blocks = blocks_of(path, &*arrays)?;
        let info = CellsInfo {
            path: path.to_path_buf(),
            format: format!("Exodus II in {}", arrays.format()),
            points,
            cells: blocks.iter().map(|b| b.elements).sum(),
            fields: vec![],
            active: None,
            data_files: vec![],
        };
        let mut file = Self { info, arrays, blocks, variables: vec![], times: vec![], places: vec![] };
        for (name, center) in [("name_nod_var", Center::Point), ("name_elem_var", Center::Cell)] {
            let names = file.arrays.texts(name)?.unwrap_or_default();
            let variable = |(i, name)| Variable { name, center, number: i as u64 + 1 };
            file.variables.extend(names.into_iter().enumerate().map(variable));
        }
        file.find_steps()?;
        file.find_fields()?;
        Ok(file)
    }

    fn wrong(&self, at: &str, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(&self.info.path, at, expected, got)
    }

    /// The times of all steps.
    fn find_steps(&mut self) -> Result<()> {
        let at = "time_whole";
        let Some(array) = self.arrays.array(at)? else { return Ok(()) };
        let steps = array.shape.first().copied().unwrap_or(0);
        if array.shape.len() != 1 || steps > MOST_STEPS {
            let got = format!("{:?} of them", array.shape);
            return Err(self.wrong(at, "a time for each of at most 2^20 steps", got));
        }
        for step in 0..steps {
            // Those of records are apart.
            let mut time = [0.0];
            self.arrays.numbers(at, &[step])?.fill(&mut time)?;
            self.times.push(Some(time[0]).filter(|t| t.is_finite()));
        }
        Ok(())
    }

    /// The steps of all variables, one step after another.
    fn find_fields(&mut self) -> Result<()> {
        let (steps, variables) = (self.times.len() as u64, self.variables.len() as u64);
        if steps * variables > MOST_FIELDS {
            let got = format!("{steps} of {variables} variables");
            return Err(self.wrong("time_whole", format!("at most {MOST_FIELDS} steps of variables"), got));
        }
        let mut scalars = vec![];
        for variable in &self.variables {
            scalars.push(self.scalar(variable)?);
        }
        for step in 0..steps {
            for (number, (variable, &scalar)) in self.variables.iter().zip(&scalars).enumerate() {
                // A variable of no block has no numbers.
                let Some(scalar) = scalar else { continue };
                let name = match steps {
                    1 => variable.name.clone(),
                    _ => format!("{}:t{step}", variable.name),
                };
                let field = CellField { name, scalar, components: 1, center: variable.center };
                self.info.fields.push(field);
                self.places.push(ValuePlace { variable: number, step });
            }
        }
        Ok(())
    }

    /// The type of a variable's numbers; `None` where the file has none.
    fn scalar(&self, variable: &Variable) -> Result<Option<crate::volume::ScalarType>> {
        let steps = self.times.len() as u64;
        let check = |name: &str, expected: &[u64]| {
            let Some(array) = self.arrays.array(name)? else { return Ok(None) };
            if array.shape != expected {
                let got = format!("{:?}", array.shape);
                return Err(self.wrong(name, format!("{expected:?} numbers"), got));
            }
            Ok(Some(array.scalar))
        };
        let n = variable.number;
        if variable.center == Center::Cell {
            for block in &self.blocks {
                let name = format!("vals_elem_var{n}eb{}", block.number);
                if let Some(scalar) = check(&name, &[steps, block.elements])? {
                    return Ok(Some(scalar));
                }
            }
            return Ok(None);
        }
        let (own, all) = (format!("vals_nod_var{n}"), self.variables.iter());
        if let Some(scalar) = check(&own, &[steps, self.info.points])? {
            return Ok(Some(scalar));
        }
        let on_nodes = all.filter(|v| v.center == Center::Point).count() as u64;
        match check("vals_nod_var", &[steps, on_nodes, self.info.points])? {
            Some(scalar) => Ok(Some(scalar)),
            None => Err(self.wrong(&own, format!("the numbers of '{}'", variable.name), "none")),
        }
    }

    /// The numbers of a variable on nodes.
    fn on_nodes(&self, variable: &Variable, step: u64) -> Result<Box<dyn NumberStream>> {
        let own = format!("vals_nod_var{}", variable.number);
        match self.arrays.array(&own)? {
            Some(_) => self.arrays.numbers(&own, &[step]),
            None => self.arrays.numbers("vals_nod_var", &[step, variable.number - 1]),
        }
    }

    /// The positions along an axis.
    fn along(&self, axis: usize) -> Result<Box<dyn NumberStream>> {
        match self.arrays.array("coord")? {
            Some(_) => self.arrays.numbers("coord", &[axis as u64]),
            None => self.arrays.numbers(["coordx", "coordy", "coordz"][axis], &[]),
        }
    }
}

struct Mesh(Arc<Shared>);

impl CellFile for Mesh {
    fn info(&self) -> &CellsInfo {
        &self.0.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        let [x, y, z] = [0, 1, 2].map(|axis| self.0.along(axis));
        Ok(Box::new(Positions { axes: [x?, y?, z?], numbers: vec![] }))
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        Ok(Box::new(Elements::new(&self.0)))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        let ValuePlace { variable, step } = self.0.places[field];
        let variable = &self.0.variables[variable];
        let numbers = match variable.center {
            Center::Point => self.0.on_nodes(variable, step)?,
            Center::Cell => {
                let (shared, variable) = (Arc::clone(&self.0), variable.number);
                Box::new(OnElements { shared, variable, step, begun: 0, open: None, left: 0 })
            }
        };
        Ok(match netcdf_fill(self.0.info.fields[field].scalar) {
            Some(fill) => Box::new(Written { numbers, fill }),
            None => numbers,
        })
    }
}

/// The coordinates of points from one stream for each axis.
struct Positions {
    axes: [Box<dyn NumberStream>; 3],
    numbers: Vec<f64>,
}

impl NumberStream for Positions {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        self.numbers.resize(out.len() / 3, 0.0);
        for (axis, stream) in self.axes.iter_mut().enumerate() {
            stream.fill(&mut self.numbers)?;
            out.iter_mut().skip(axis).step_by(3).zip(&self.numbers).for_each(|(slot, &x)| *slot = x);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.axes.iter_mut().try_for_each(|stream| stream.finish())
    }
}

/// Numbers of which some were never written: those have none.
struct Written {
    numbers: Box<dyn NumberStream>,
    fill: f64,
}

impl NumberStream for Written {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        self.numbers.fill(out)?;
        out.iter_mut().filter(|v| **v == self.fill).for_each(|v| *v = f64::NAN);
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.numbers.finish()
    }
}

/// The numbers of a variable on the elements of all blocks, one after another.
struct OnElements {
    shared: Arc<Shared>,
    variable: u64,
    step: u64,
    /// Blocks begun.
    begun: usize,
    /// The numbers of this block; `None` where it has none.
    open: Option<Box<dyn NumberStream>>,
    /// Elements of this block not read yet.
    left: u64,
}

impl NumberStream for OnElements {
    fn fill(&mut self, mut out: &mut [f64]) -> Result<()> {
        while !out.is_empty() {
            if self.left == 0 {
                self.finish()?;
                let block =
                    self.shared.blocks.get(self.begun).expect("as many are asked for as were counted");
                self.begun += 1;
                self.left = block.elements;
                let name = format!("vals_elem_var{}eb{}", self.variable, block.number);
                let array = self.shared.arrays.array(&name)?;
                if let Some(found) = array.as_ref().filter(|a| a.shape.get(1) != Some(&block.elements)) {
                    let expected = format!("numbers of {} elements", block.elements);
                    return Err(self.shared.wrong(&name, expected, format!("{:?}", found.shape)));
                }
                self.open = array.map(|_| self.shared.arrays.numbers(&name, &[self.step])).transpose()?;
            }
            let n = self.left.min(out.len() as u64) as usize;
            let (now, later) = out.split_at_mut(n);
            match &mut self.open {
                Some(open) => open.fill(now)?,
                None => now.fill(f64::NAN),
            }
            self.left -= n as u64;
            out = later;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.open.take().map_or(Ok(()), |mut open| open.finish())
    }
}

#[cfg(test)]
mod tests;
