//! A tetrahedral mesh in memory, its parts, and the VTU file that keeps it.

use isospan::{Error, Result};
use rustc_hash::FxHashMap;
use std::fmt::Write as _;
use std::path::Path;

/// A mesh with a value for each vertex and the number of a region for each tetrahedron.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TetMesh {
    pub(crate) points: Vec<[f64; 3]>,
    /// Positively oriented: `det(b - a, c - a, d - a) > 0`.
    pub(crate) tets: Vec<[u32; 4]>,
    /// One for each tetrahedron.
    pub(crate) regions: Vec<u8>,
    /// One for each point; empty before a field is solved.
    pub(crate) values: Vec<f32>,
}

/// The three corners opposite of each corner.
pub(crate) const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

pub(crate) fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Six times the signed volume.
pub(crate) fn volume6([a, b, c, d]: [[f64; 3]; 4]) -> f64 {
    dot(cross(minus(b, a), minus(c, a)), minus(d, a))
}

impl TetMesh {
    pub(crate) fn corners(&self, tet: usize) -> [[f64; 3]; 4] {
        self.tets[tet].map(|v| self.points[v as usize])
    }

    pub(crate) fn centroid(&self, tet: usize) -> [f64; 3] {
        let corners = self.corners(tet);
        std::array::from_fn(|k| (corners[0][k] + corners[1][k] + corners[2][k] + corners[3][k]) / 4.0)
    }

    /// Least and largest coordinates.
    pub(crate) fn bounds(&self) -> [[f64; 3]; 2] {
        let first = self.points.first().copied().unwrap_or_default();
        self.points.iter().fold([first, first], |[lo, hi], p| {
            [std::array::from_fn(|k| lo[k].min(p[k])), std::array::from_fn(|k| hi[k].max(p[k]))]
        })
    }

    /// Keeps tetrahedra, and of the points those that they use, in order.
    pub(crate) fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        let kept: Vec<usize> = (0..self.tets.len()).filter(|&t| keep(t)).collect();
        let mut used = vec![false; self.points.len()];
        kept.iter().flat_map(|&t| self.tets[t]).for_each(|v| used[v as usize] = true);
        let (mut number, mut numbers) = (0, vec![0; self.points.len()]);
        for (v, _) in used.iter().enumerate().filter(|(_, used)| **used) {
            numbers[v] = number;
            number += 1;
        }
        self.regions = kept.iter().map(|&t| self.regions[t]).collect();
        self.tets = kept.iter().map(|&t| self.tets[t].map(|v| numbers[v as usize])).collect();
        let mut v = 0..used.len();
        self.points.retain(|_| v.next().is_some_and(|v| used[v]));
    }

    /// Keeps the largest part that hangs together by faces; of equal ones the first. A field cannot
    /// pass through a vertex.
    pub(crate) fn keep_largest_part(&mut self) {
        let part = self.parts();
        let mut sizes = vec![0usize; self.tets.len()];
        part.iter().for_each(|&p| sizes[p] += 1);
        let largest = (0..sizes.len()).rev().max_by_key(|&p| sizes[p]);
        self.retain(|t| Some(part[t]) == largest);
    }

    /// For each tetrahedron, the number of the first one of its part.
    fn parts(&self) -> Vec<usize> {
        let mut part: Vec<usize> = (0..self.tets.len()).collect();
        let mut faces = FxHashMap::default();
        for (t, tet) in self.tets.iter().enumerate() {
            for face in FACES {
                let mut key = face.map(|i| tet[i]);
                key.sort_unstable();
                if let Some(other) = faces.insert(key, t) {
                    let (a, b) = (root(&mut part, other), root(&mut part, t));
                    part[a.max(b)] = a.min(b);
                }
            }
        }
        (0..part.len()).map(|t| root(&mut part, t)).collect()
    }

    /// Writes a VTU file, its arrays appended raw: points as `f64`, the field `potential`, the
    /// cells' `region`.
    pub(crate) fn write(&self, path: &Path) -> Result<()> {
        let connectivity = self.tets.iter().flatten().flat_map(|&v| i64::from(v).to_le_bytes());
        let offsets = (1..=self.tets.len() as i64).flat_map(|n| (4 * n).to_le_bytes());
        let arrays: [Vec<u8>; 6] = [
            self.values.iter().flat_map(|v| v.to_le_bytes()).collect(),
            self.regions.clone(),
            self.points.iter().flatten().flat_map(|x| x.to_le_bytes()).collect(),
            connectivity.collect(),
            offsets.collect(),
            // VTK's number of a tetrahedron.
            vec![10; self.tets.len()],
        ];
        let mut bytes = self.head(&arrays.each_ref().map(Vec::len)).into_bytes();
        for array in &arrays {
            bytes.extend((array.len() as u64).to_le_bytes());
            bytes.extend(array);
        }
        bytes.extend(b"\n  </AppendedData>\n</VTKFile>\n");
        std::fs::write(path, bytes).map_err(|e| Error::io("write", path, e))
    }

    fn head(&self, lengths: &[usize; 6]) -> String {
        let (points, cells) = (self.points.len(), self.tets.len());
        let mut text =
            String::from("<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" ");
        text += "byte_order=\"LittleEndian\" header_type=\"UInt64\">\n  <UnstructuredGrid>\n";
        let _ = writeln!(text, "    <Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{cells}\">");
        let mut offset = 0;
        let mut array = |kind: &str, name: &str, components: u32, length: usize| {
            let at = offset;
            offset += 8 + length;
            format!(
                "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
                 format=\"appended\" offset=\"{at}\"/>\n"
            )
        };
        text += "      <PointData Scalars=\"potential\">\n";
        text += &array("Float32", "potential", 1, lengths[0]);
        text += "      </PointData>\n      <CellData>\n";
        text += &array("UInt8", "region", 1, lengths[1]);
        text += "      </CellData>\n      <Points>\n";
        text += &array("Float64", "Points", 3, lengths[2]);
        text += "      </Points>\n      <Cells>\n";
        text += &array("Int64", "connectivity", 1, lengths[3]);
        text += &array("Int64", "offsets", 1, lengths[4]);
        text += &array("UInt8", "types", 1, lengths[5]);
        text +=
            "      </Cells>\n    </Piece>\n  </UnstructuredGrid>\n  <AppendedData encoding=\"raw\">\n   _";
        text
    }
}

fn root(part: &mut [usize], mut t: usize) -> usize {
    while part[t] != t {
        part[t] = part[part[t]];
        t = part[t];
    }
    t
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The unit cube in six tetrahedra around its diagonal.
    pub(in crate::data) fn cube() -> TetMesh {
        let points = (0..8u8).map(|v| [v & 1, v >> 1 & 1, v >> 2].map(f64::from)).collect();
        let tets = vec![[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];
        TetMesh { points, regions: vec![0; tets.len()], tets, values: vec![] }
    }

    #[test]
    fn the_largest_part_is_kept() {
        let mut mesh = cube();
        assert!((0..6).all(|t| volume6(mesh.corners(t)) == 1.0));
        // One more tetrahedron that touches at a vertex only.
        let first = mesh.points.len() as u32;
        mesh.points.extend([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]);
        mesh.tets.insert(0, [0, first + 1, first, first + 2]);
        mesh.regions.insert(0, 9);
        mesh.keep_largest_part();
        assert_eq!(mesh, cube());
    }

    #[test]
    fn a_file_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cube.vtu");
        let mesh = TetMesh { values: (0..8u8).map(f32::from).collect(), ..cube() };
        mesh.write(&path).unwrap();
        let read = isospan::formats::open_mesh(&path, &Default::default()).unwrap();
        assert_eq!((read.info().points, read.info().cells), (8, 6));
        assert_eq!(read.field().unwrap().name, "potential");
        let (mut values, mut block) = (read.values(0, |_| false).unwrap(), vec![]);
        assert!(values.next_block(&mut block).unwrap());
        assert_eq!(block.iter().map(|&v| v as f32).collect::<Vec<_>>(), mesh.values);
    }
}
