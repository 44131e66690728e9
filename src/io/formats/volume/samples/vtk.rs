//! VTK's XML files of grids: ImageData, RectilinearGrid, StructuredGrid; one piece, appended raw.

use super::heads::{no_type, numbers};
use super::pack::{BLOCK, Packed};
use super::{FileLayout, GridMeta, GridPlace, SampleField};
use crate::error::Result;
use crate::formats::shared::text::xml_attribute;
use crate::volume::ScalarType;

fn type_name(scalar: ScalarType) -> Result<String> {
    let (kind, bits) = (&scalar.name()[..1], 8 * scalar.bytes());
    match (kind, scalar) {
        (_, ScalarType::F16) => Err(no_type("VTK", scalar)),
        ("u", _) => Ok(format!("UInt{bits}")),
        ("i", _) => Ok(format!("Int{bits}")),
        _ => Ok(format!("Float{bits}")),
    }
}

/// What stands before an array: its length, or those of its blocks.
fn table(stored: &Packed) -> Vec<u8> {
    if !stored.is_packed() {
        return stored.plain.to_le_bytes().to_vec();
    }
    let head = [stored.blocks.len() as u64, BLOCK as u64, stored.plain % BLOCK as u64];
    head.iter().chain(&stored.blocks).flat_map(|n| n.to_le_bytes()).collect()
}

pub(super) fn layout(meta: &GridMeta, stored: &[Packed]) -> Result<FileLayout> {
    let before: Vec<Vec<u8>> = stored.iter().map(table).collect();
    let (mut at, mut offsets) = (0, vec![]);
    for (table, array) in before.iter().zip(stored) {
        offsets.push(at);
        at += table.len() as u64 + array.bytes();
    }
    let mut offsets = offsets.into_iter();
    let mut array = |kind: &str, name: &str, components: u32| {
        let offset = offsets.next().expect("an offset of each array");
        format!(
            "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
             format=\"appended\" offset=\"{offset}\"/>\n"
        )
    };
    let of_field = |array: &mut dyn FnMut(&str, &str, u32) -> String, field: &SampleField| {
        Ok(array(&type_name(field.scalar)?, &xml_attribute(&field.name), 1))
    };
    let fields = meta
        .fields
        .iter()
        .map(|field| of_field(&mut array, field))
        .collect::<Result<Vec<String>>>()?
        .concat();
    let [x, y, z] = meta.dims.map(|n| n - 1);
    let extent = format!("0 {x} 0 {y} 0 {z}");
    let (kind, place, coordinates) = match &meta.place {
        GridPlace::Even(g) => {
            // A matrix, row by row, whose columns are the axes.
            let direction: Vec<f64> = (0..9).map(|i| g.direction[i % 3][i / 3]).collect();
            let [origin, spacing, direction] = [&g.origin[..], &g.spacing, &direction].map(numbers);
            let place = format!(" Origin=\"{origin}\" Spacing=\"{spacing}\" Direction=\"{direction}\"");
            ("ImageData", place, String::new())
        }
        GridPlace::Axes(_) => {
            let axes = ["x", "y", "z"].map(|name| array("Float64", name, 1)).concat();
            let text = format!("      <Coordinates>\n{axes}      </Coordinates>\n");
            ("RectilinearGrid", String::new(), text)
        }
        GridPlace::Points => {
            let points = array("Float64", "Points", 3);
            ("StructuredGrid", String::new(), format!("      <Points>\n{points}      </Points>\n"))
        }
    };
    let is_packed = stored.iter().any(Packed::is_packed);
    let compressor = if is_packed { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
    let scalars = xml_attribute(&meta.field().name);
    let head = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\"{compressor}>\n  <{kind} WholeExtent=\"{extent}\"{place}>\n    \
         <Piece Extent=\"{extent}\">\n      <PointData Scalars=\"{scalars}\">\n{fields}      </PointData>\n\
         {coordinates}    </Piece>\n  </{kind}>\n  <AppendedData encoding=\"raw\">\n   _"
    );
    Ok(FileLayout {
        head: head.into_bytes(),
        before,
        tail: b"\n  </AppendedData>\n</VTKFile>\n".to_vec(),
        header: None,
    })
}
