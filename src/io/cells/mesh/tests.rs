use super::*;
use crate::cells::{CellBlock, CellKind, CellStream, NumberStream};

/// A mesh in memory.
pub(crate) struct Memory {
    pub(crate) info: CellsInfo,
    pub(crate) points: Vec<f64>,
    pub(crate) cells: Vec<(CellKind, Vec<u64>)>,
    pub(crate) data: Vec<Vec<f64>>,
}

struct Numbers(std::vec::IntoIter<f64>);

impl NumberStream for Numbers {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        out.iter_mut().for_each(|x| *x = self.0.next().expect("enough numbers"));
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        assert!(self.0.next().is_none());
        Ok(())
    }
}

struct Cells(std::vec::IntoIter<(CellKind, Vec<u64>)>);

impl CellStream for Cells {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        self.0.by_ref().take(2).for_each(|(kind, vertices)| out.push(kind, &vertices));
        Ok(!out.is_empty())
    }
}

impl CellFile for Memory {
    fn info(&self) -> &CellsInfo {
        &self.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        Ok(Box::new(Numbers(self.points.clone().into_iter())))
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        Ok(Box::new(Cells(self.cells.clone().into_iter())))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        Ok(Box::new(Numbers(self.data[field].clone().into_iter())))
    }
}

fn field(name: &str, components: u32, center: Center) -> CellField {
    CellField { name: name.into(), scalar: ScalarType::F32, components, center }
}

/// Two tetrahedra on a triangle, and a triangle between them.
pub(crate) fn two() -> Memory {
    let info = CellsInfo {
        path: "two.vtu".into(),
        format: "memory".into(),
        points: 6,
        cells: 3,
        fields: vec![field("p", 1, Center::Point), field("v", 3, Center::Point), field("c", 1, Center::Cell)],
        active: None,
        data_files: vec![],
    };
    let points =
        [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [0., 0., -1.], [9., 9., 9.]].concat();
    let cells = vec![
        (CellKind::Tetrahedron, vec![0, 1, 2, 3]),
        (CellKind::Flat, vec![]),
        (CellKind::Tetrahedron, vec![0, 2, 1, 4]),
    ];
    let data =
        vec![(0..6).map(f64::from).collect(), (0..18).map(f64::from).collect(), vec![10.0, 1000.0, 20.0]];
    Memory { info, points, cells, data }
}

fn all(mesh: &CellMesh, memory: u64) -> Vec<f32> {
    let (mut values, mut block, mut out) = (mesh.values(memory, |_| false).unwrap(), vec![], vec![]);
    while values.next_block(&mut block).unwrap() {
        out.extend(block.iter().map(|&v| v as f32));
    }
    out
}

#[test]
fn fields_are_components_magnitudes_averages_and_coordinates() {
    let file: Arc<dyn CellFile> = Arc::new(two());
    let values = |name: &str| all(&CellMesh::new(Arc::clone(&file), Some(name)).unwrap(), 1);
    assert_eq!(values("p"), [0., 1., 2., 3., 4., 5.]);
    assert_eq!(values("v.y"), [1., 4., 7., 10., 13., 16.]);
    assert_eq!(values("v.2")[5], 17.0);
    assert_eq!(values("v.magnitude")[1], 50f32.sqrt());
    assert_eq!(values("z"), [0., 0., 0., 1., -1., 9.]);
    let averaged = values("c");
    assert_eq!(averaged[..5], [15., 15., 15., 10., 20.]);
    assert!(averaged[5].is_nan(), "a point without a cell");
    // A cell without a value is no part of a mean.
    let mesh = CellMesh::new(Arc::clone(&file), Some("c")).unwrap();
    let (mut blocks, mut block) = (mesh.values(1, |v| v == 20.0).unwrap(), vec![]);
    assert!(blocks.next_block(&mut block).unwrap());
    assert!([0, 1, 2, 4].iter().all(|&n| block[n].is_nan()) && block[3] == 10.0, "{block:?}");
    let default = CellMesh::new(Arc::clone(&file), None).unwrap();
    assert_eq!(default.field().unwrap().name, "p");
    for wanted in ["v", "v.3", "w", "v.w", "p.magnitudes"] {
        let error = default.with_field(wanted).err().expect(wanted);
        assert_eq!(error.exit_code(), 2);
        let list = "p (float32), v.x .y .z .magnitude (3 x float32), c (float32, on cells)";
        assert!(error.to_string().contains(list), "{error}");
    }
    let mut none = two();
    none.info.fields.truncate(2);
    none.info.fields.swap_remove(0);
    let mesh = CellMesh::new(Arc::new(none), None).unwrap();
    assert!(mesh.values(1, |_| false).err().expect("no field").to_string().contains("`field=NAME`"));
}

/// Windows of 4096 points must not show in the averages.
#[test]
fn averages_do_not_depend_on_memory() {
    let mut mesh = two();
    let n = 20_000;
    mesh.info.points = n;
    mesh.points = vec![0.5; 3 * n as usize];
    mesh.cells = (0..30_000u64)
        .map(|i| (CellKind::Tetrahedron, (0..4).map(|k| (i * 7919 + k * 104_729) % n).collect()))
        .collect();
    mesh.info.cells = 30_000;
    mesh.data[2] = (0..30_000).map(|i| f64::from(i) * 0.1).collect();
    let mesh = CellMesh::new(Arc::new(mesh), Some("c")).unwrap();
    let whole = all(&mesh, 1 << 30);
    assert_eq!(whole.len(), n as usize);
    let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&whole), bits(&all(&mesh, 1)));
}

#[test]
fn bad_numbers_are_refused() {
    let mut mesh = two();
    mesh.cells[2].1[3] = 6;
    let error = CellMesh::new(Arc::new(mesh), None).unwrap().cells().err().expect("refused").to_string();
    assert_eq!(
        error,
        "two.vtu: cell 2 (counted from 0): expected vertices among 6 points, got point 6 (counted from 0)"
    );
    let mut mesh = two();
    mesh.points[7] = f64::NAN;
    let error = CellMesh::new(Arc::new(mesh), None).unwrap().points().unwrap().next_block(&mut vec![]);
    assert!(error.unwrap_err().to_string().contains("point 2: expected finite coordinates"));
}

#[test]
fn a_field_of_very_many_components_is_refused() {
    let mut mesh = two();
    mesh.info.fields[0].components = 2_000_000_000;
    let line = CellMesh::new(Arc::new(mesh), None).err().expect("refused").to_string();
    assert!(line.contains("expected at most 65536 components, got 2000000000"), "{line}");
}
