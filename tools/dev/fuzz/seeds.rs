//! Good inputs to damage: small files of every format and of every encoding, made here, and those
//! of the shared data.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use isospan::formats::surface::{SurfaceFormat, SurfaceMeta, write_surface};
use isospan::formats::{OpenOptions, open_volume};
use isospan::surface::{TriMesh, Vertex};
use isospan::volume::bricked::BrickedVolume;
use isospan::{Error, Resources, Result};
use isospan_wavelet::{Accuracy, Settings, compress};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Good inputs of one format.
pub(crate) struct FormatSeeds {
    /// What the file's name ends in, without the first dot.
    pub(crate) extension: &'static str,
    pub(crate) inputs: Vec<Vec<u8>>,
}

/// The largest file of the shared data that is taken: damage should hit headers more often than
/// samples.
const LARGEST: u64 = 40_000;

/// Formats of volumes, of meshes, then of surfaces, each with at least one input.
pub(crate) fn all(folder: &Path) -> Result<[Vec<FormatSeeds>; 3]> {
    let (mut volumes, mut meshes) = (volumes(folder)?, meshes());
    let mut surfaces = vec![];
    for format in SurfaceFormat::ALL.into_iter().filter(|format| format.is_read()) {
        surfaces.push(of(format.extension(), vec![surface(folder, format)?]));
    }
    surfaces[0].inputs.push(PLY_TEXT.into());
    surfaces[1].inputs.push(STL_TEXT.into());
    if let Some(shared) = std::env::var_os("ISOSPAN_SHARED_DATA") {
        add_shared(&Path::new(&shared).join("variants"), &mut [&mut volumes, &mut meshes, &mut surfaces]);
    }
    Ok([volumes, meshes, surfaces])
}

fn of(extension: &'static str, inputs: Vec<Vec<u8>>) -> FormatSeeds {
    FormatSeeds { extension, inputs }
}

fn volumes(folder: &Path) -> Result<Vec<FormatSeeds>> {
    Ok(vec![
        of("nrrd", nrrd()),
        of("nhdr", vec![b"NRRD0004\ntype: short\ndimension: 3\nsizes: 4 3 2\nendian: little\nencoding: raw\ndata file: x%d.raw 1 2 1\n".to_vec()]),
        of("mha", metaimage("LOCAL")),
        of("mhd", metaimage("samples.raw")),
        of("npy", vec![npy("<f4", 4), npy(">i2", 2), npy("|u1", 1)]),
        of("npz", vec![zip(&[("a.npy", npy("<f4", 4))])]),
        of("zarr.zip", vec![zarr_zip()]),
        of("nii", vec![nifti(16, 4), nifti(4, 2)]),
        of("nii.gz", vec![gzip(&nifti(4, 2))]),
        of("hdr", vec![nifti(4, 2)]),
        of("mrc", vec![mrc(1, 2), mrc(12, 2), mrc(2, 4)]),
        of("map.gz", vec![gzip(&mrc(6, 2))]),
        of("am", amira()),
        of("vti", vti()),
        of("vtk", legacy()),
        of("tif", vec![tiff(1, 2), tiff(8, 2)]),
        of(
            "h5",
            vec![
                include_bytes!("../../../tests/data/hdf5_small.h5").to_vec(),
                include_bytes!("../../../tests/data/filter_bits.h5").to_vec(),
                include_bytes!("../../../tests/data/filter_blosc.h5").to_vec(),
                include_bytes!("../../../tests/data/filter_blosc2.h5").to_vec(),
                include_bytes!("../../../tests/data/filter_lz4.h5").to_vec(),
                include_bytes!("../../../tests/data/filter_lzf.h5").to_vec(),
                include_bytes!("../../../tests/data/dialects/tomviz.emd").to_vec(),
            ],
        ),
        of(
            "nc",
            vec![
                include_bytes!("../../../tests/data/netcdf3_single.nc").to_vec(),
                include_bytes!("../../../tests/data/netcdf3_small.nc").to_vec(),
                include_bytes!("../../../tests/data/dialects/minc1_shorts.mnc").to_vec(),
            ],
        ),
        of(
            "dcm",
            vec![
                include_bytes!("../../../tests/data/dicom/enhanced.dcm").to_vec(),
                include_bytes!("../../../tests/data/dicom/slopes.dcm").to_vec(),
            ],
        ),
        // The first bytes choose the layout too: zeros stand for 4 x 4 x 4 bytes.
        of("raw", vec![[vec![0; 8], samples(1, 56)].concat()]),
        of("bricks", vec![bricks(folder)?]),
    ])
}

fn meshes() -> Vec<FormatSeeds> {
    vec![
        of("vtu", vec![VTU.into(), POLYHEDRA.into(), POLYHEDRA_OLD.into()]),
        of("vtm", vec![LIST.into()]),
        of("vtkhdf", vec![include_bytes!("../../../tests/data/vtkhdf_mesh.hdf").to_vec()]),
        of(
            "exo",
            vec![
                include_bytes!("../../../tests/data/exodus/row.exo").to_vec(),
                include_bytes!("../../../tests/data/exodus/row_old.e").to_vec(),
                include_bytes!("../../../tests/data/exodus/meshio.e").to_vec(),
            ],
        ),
        of("case", vec![CASE.into()]),
        of(
            "geo",
            vec![
                GEOMETRY.into(),
                include_bytes!("../../../tests/data/ensight/little.geo").to_vec(),
                include_bytes!("../../../tests/data/ensight/big.geo").to_vec(),
            ],
        ),
        of("vtk", vec![LEGACY_GRID.into(), LEGACY_GRID_5.into()]),
        of("msh", gmsh()),
        of("node", vec![NODES.into()]),
        of("ele", vec![CELLS.into()]),
        of("pts", vec!["0 0 0\n1 0 0\n0 1 0\n0 0 1\n".into()]),
        of("tet", vec!["1 2 3 4\n".into()]),
    ]
}

/// Adds the small files below a folder to their formats, in the order of their names.
fn add_shared(folder: &Path, formats: &mut [&mut Vec<FormatSeeds>]) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut paths: Vec<_> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            add_shared(&path, formats);
            continue;
        }
        let name = path.to_string_lossy().into_owned();
        let small = path.metadata().is_ok_and(|m| m.len() <= LARGEST);
        for format in formats.iter_mut().flat_map(|list| list.iter_mut()) {
            if small && name.ends_with(&format!(".{}", format.extension)) {
                format.inputs.extend(fs::read(&path).ok().filter(|b| !b.is_empty()));
            }
        }
    }
}

/// `n` little-endian samples of `size` bytes.
pub(crate) fn samples(size: usize, n: usize) -> Vec<u8> {
    (0..n as u64).flat_map(|i| (i * 37 % 251).to_le_bytes()[..size].to_vec()).collect()
}

pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut gz = GzEncoder::new(vec![], Compression::fast());
    gz.write_all(bytes).expect("writing to memory");
    gz.finish().expect("writing to memory")
}

pub(crate) fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut z = ZlibEncoder::new(vec![], Compression::fast());
    z.write_all(bytes).expect("writing to memory");
    z.finish().expect("writing to memory")
}

fn nrrd() -> Vec<Vec<u8>> {
    let head = |encoding: &str| {
        format!(
            "NRRD0005\n# a comment\ntype: unsigned short\ndimension: 3\nspace: left-posterior-superior\n\
             sizes: 4 3 2\nspace directions: (1,0,0) (0,2,0) (0,0,3)\nspace origin: (1,2,3)\nkinds: domain domain domain\n\
             key:=value\nendian: little\nline skip: 0\nbyte skip: 0\nencoding: {encoding}\n\n"
        )
        .into_bytes()
    };
    let data = samples(2, 24);
    let text: Vec<String> = (0..24).map(|i| i.to_string()).collect();
    vec![
        [head("raw"), data.clone()].concat(),
        [head("gzip"), gzip(&data)].concat(),
        [head("ascii"), text.join(" ").into_bytes()].concat(),
    ]
}

fn metaimage(data: &str) -> Vec<Vec<u8>> {
    let head = |extra: &str| {
        format!(
            "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n{extra}\
             TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 1 2 3\nElementSpacing = 1 2 3\nDimSize = 4 3 2\n\
             ElementType = MET_USHORT\nElementDataFile = {data}\n"
        )
        .into_bytes()
    };
    let packed = zlib(&samples(2, 24));
    let size = format!("CompressedData = True\nCompressedDataSize = {}\n", packed.len());
    vec![[head(""), samples(2, 24)].concat(), [head(&size), packed].concat()]
}

fn npy(descr: &str, size: usize) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2, 3, 4), }}");
    header.extend(std::iter::repeat_n(' ', 117 - header.len()));
    header.push('\n');
    let start = [&b"\x93NUMPY\x01\x00"[..], &118u16.to_le_bytes()].concat();
    [start, header.into_bytes(), samples(size, 24)].concat()
}

/// A zip archive of one deflated member.
/// A zip archive of members, deflated or stored in turn.
fn zip(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let (mut file, mut directory) = (vec![], vec![]);
    for (number, (name, bytes)) in members.iter().enumerate() {
        // zlib without its two bytes at the start and four at the end is plain deflate.
        let packed = zlib(bytes);
        let deflated = number % 2 == 0;
        let stored = if deflated { &packed[2..packed.len() - 4] } else { &bytes[..] };
        let mut crc = flate2::Crc::new();
        crc.update(bytes);
        let sizes = [crc.sum(), stored.len() as u32, bytes.len() as u32].map(u32::to_le_bytes).concat();
        let method = [0u16, if deflated { 8 } else { 0 }, 0, 0].map(u16::to_le_bytes).concat();
        let common = [method, sizes, [name.len() as u16, 0].map(u16::to_le_bytes).concat()].concat();
        let at = (file.len() as u32).to_le_bytes();
        directory.extend([b"PK\x01\x02\x14\0\x14\0", &common[..], &[0; 10], &at, name.as_bytes()].concat());
        file.extend([b"PK\x03\x04\x14\0", &common[..], name.as_bytes(), stored].concat());
    }
    let count = (members.len() as u16).to_le_bytes();
    let places = [directory.len() as u32, file.len() as u32].map(u32::to_le_bytes).concat();
    [file, directory, [b"PK\x05\x06\0\0\0\0", &count[..], &count, &places, b"\0\0"].concat()].concat()
}

fn zarr_zip() -> Vec<u8> {
    let about = br#"{"zarr_format":2,"shape":[2,3,4],"chunks":[1,3,4],"dtype":"<u2","compressor":null,
        "fill_value":0,"order":"C","filters":null}"#;
    let chunk = |first: u8| samples(2, 12).iter().map(|b| b ^ first).collect();
    zip(&[(".zarray", about.to_vec()), ("0.0.0", chunk(0)), ("1.0.0", chunk(1))])
}

fn amira() -> Vec<Vec<u8>> {
    let file = |lattice: &str, stored: &[u8]| {
        let head = format!(
            "# AmiraMesh BINARY-LITTLE-ENDIAN 2.1\ndefine Lattice 4 3 2\ndefine Coordinates 9\nParameters {{\n    \
             BoundingBox 0 3 0 2 0 1,\n    CoordType \"uniform\"\n}}\nLattice {{ {lattice}\nCoordinates {{ float \
             xyz }} @2\n# Data section follows\n@1\n"
        );
        [head.as_bytes(), stored, b"\n@2\n", &samples(4, 9), b"\n"].concat()
    };
    let packed = zlib(&samples(2, 24));
    vec![
        file("short Data } @1", &samples(2, 24)),
        file(&format!("short Data }} @1(HxZip,{})", packed.len()), &packed),
        file("byte Labels } @1(HxByteRLE,4)", &[20, 1, 4, 2]),
    ]
}

fn mrc(mode: i32, size: usize) -> Vec<u8> {
    let mut h = vec![0u8; 1024];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &[4, 3, 2, mode, 5, 6, 7, 4, 3, 2].map(i32::to_le_bytes).concat());
    put(40, &[4f32, 6.0, 6.0, 90.0, 90.0, 120.0].map(f32::to_le_bytes).concat());
    put(64, &[1i32, 2, 3].map(i32::to_le_bytes).concat());
    put(88, &1i32.to_le_bytes());
    put(208, b"MAP DD\0\0");
    [h, samples(size, 24)].concat()
}

fn nifti(datatype: i16, size: usize) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    put(40, &[3i16, 4, 3, 2, 1, 1, 1, 1].map(i16::to_le_bytes).concat());
    put(70, &datatype.to_le_bytes());
    put(72, &(8 * size as i16).to_le_bytes());
    put(76, &[1f32, 1.0, 2.0, 3.0].map(f32::to_le_bytes).concat());
    put(108, &352f32.to_le_bytes());
    put(112, &2f32.to_le_bytes());
    put(254, &1i16.to_le_bytes());
    put(280, &[1f32, 0.0, 0.0, 5.0, 0.0, 1.0, 0.0, 6.0, 0.0, 0.0, 1.0, 7.0].map(f32::to_le_bytes).concat());
    put(344, b"n+1\0");
    [h, samples(size, 24)].concat()
}

/// Two pages of 4 x 3 samples in one strip each, plain (compression 1) or deflated (8).
pub(crate) fn tiff(compression: u32, pages: u32) -> Vec<u8> {
    let strip = if compression == 8 { zlib(&samples(2, 12)) } else { samples(2, 12) };
    let mut file = b"II*\0".to_vec();
    // The first directory follows the strip.
    file.extend((8 + strip.len() as u32).to_le_bytes());
    file.extend(&strip);
    let tags = [
        (256u16, 4),
        (257, 3),
        (258, 16),
        (259, compression),
        (262, 1),
        (273, 8),
        (277, 1),
        (278, 3),
        (279, strip.len() as u32),
        (339, 1),
    ];
    for page in 0..pages {
        file.extend((tags.len() as u16).to_le_bytes());
        for (tag, value) in tags {
            file.extend([tag, 4].map(u16::to_le_bytes).concat());
            file.extend([1, value].map(u32::to_le_bytes).concat());
        }
        let next = if page + 1 < pages { file.len() as u32 + 4 } else { 0 };
        file.extend(next.to_le_bytes());
    }
    file
}

fn vti() -> Vec<Vec<u8>> {
    let file = |attributes: &str, array: &str, data: &str, appended: &[u8]| {
        let text = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt32\"{attributes}>\n\
             <ImageData WholeExtent=\"0 3 0 2 0 1\" Origin=\"1 2 3\" Spacing=\"1 2 3\">\n<Piece Extent=\"0 3 0 2 0 1\">\n\
             <PointData Scalars=\"b\">\n<DataArray type=\"Int16\" Name=\"b\" NumberOfComponents=\"1\" format=\"{array}>{data}</DataArray>\n\
             </PointData>\n</Piece>\n</ImageData>\n"
        );
        let end = if appended.is_empty() {
            b"</VTKFile>\n".to_vec()
        } else {
            [b"<AppendedData encoding=\"raw\">\n_", appended, b"\n</AppendedData>\n</VTKFile>\n"].concat()
        };
        [text.into_bytes(), end].concat()
    };
    let data = samples(2, 24);
    let stored = [&48u32.to_le_bytes()[..], &data].concat();
    let packed = zlib(&data);
    let header = [1u32, 48, 0, packed.len() as u32].map(u32::to_le_bytes).concat();
    let inline = BASE64_STANDARD.encode(header) + &BASE64_STANDARD.encode(&packed);
    // Three blocks, which lie in the file as they are.
    let blocks = |compress: fn(&[u8]) -> Vec<u8>| {
        let blocks: Vec<Vec<u8>> = data.chunks(20).map(compress).collect();
        let head = [3, 20, 8].into_iter().chain(blocks.iter().map(|b| b.len() as u32));
        [head.flat_map(u32::to_le_bytes).collect(), blocks.concat()].concat()
    };
    let text: Vec<String> = (0..24).map(|i| i.to_string()).collect();
    vec![
        file("", "ascii\"", &text.join(" "), b""),
        file("", "appended\" offset=\"0\"", "", &stored),
        file(" compressor=\"vtkZLibDataCompressor\"", "binary\"", &inline, b""),
        file(" compressor=\"vtkZLibDataCompressor\"", "appended\" offset=\"0\"", "", &blocks(zlib)),
        file(
            " compressor=\"vtkLZ4DataCompressor\"",
            "appended\" offset=\"0\"",
            "",
            &blocks(lz4_flex::block::compress),
        ),
    ]
}

fn legacy() -> Vec<Vec<u8>> {
    let head = |kind: &str| {
        format!(
            "# vtk DataFile Version 3.0\na title\n{kind}\nDATASET STRUCTURED_POINTS\nDIMENSIONS 4 3 2\nORIGIN 0 0 0\n\
             SPACING 1 2 3\nPOINT_DATA 24\nSCALARS b short 1\nLOOKUP_TABLE default\n"
        )
        .into_bytes()
    };
    let text: Vec<String> = (0..24).map(|i| i.to_string()).collect();
    vec![
        [head("BINARY"), samples(2, 24)].concat(),
        [head("ASCII"), (text.join(" ") + "\n").into_bytes()].concat(),
    ]
}

fn bricks(folder: &Path) -> Result<Vec<u8>> {
    let (input, out) = (folder.join("seed.npy"), folder.join("seed.bricks"));
    put(&input, &npy("<f4", 4))?;
    let source = open_volume(&input, &OpenOptions::default())?;
    BrickedVolume::build(source.into_stream(), &out, 1 << 16, &mut |_| {})?;
    get(&out)
}

/// Files that Gmsh wrote.
fn gmsh() -> Vec<Vec<u8>> {
    vec![
        include_bytes!("../../../tests/data/gmsh/tet_22_ascii.msh").to_vec(),
        include_bytes!("../../../tests/data/gmsh/tet_22_bin.msh").to_vec(),
        include_bytes!("../../../tests/data/gmsh/tet_41_ascii.msh").to_vec(),
        include_bytes!("../../../tests/data/gmsh/tet_41_bin.msh").to_vec(),
    ]
}

/// The other files of a mesh in several: those of the fuzzer always have the same points and cells.
/// The first of them is the one to open where the damaged file is not.
pub(crate) fn partners(path: &Path) -> Vec<(PathBuf, String)> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    let beside = |name: &str, text: &str| (path.with_file_name(name), text.to_string());
    let values = [
        beside("of_case.a0", "a\npart\n1\ncoordinates\n1\n2\n3\n4\n"),
        beside("of_case.a1", "a\npart\n1\ncoordinates undef\n2\n1\n2\n3\n4\n"),
        beside("of_case.b", "b\npart\n1\ntetra4\n1\n2\n3\n"),
    ];
    let (other, text) = match &*extension {
        "node" => ("ele", CELLS),
        "ele" => ("node", NODES),
        "pts" => ("tet", "0 1 2 3\n"),
        "tet" => ("pts", "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"),
        "case" => return [&[beside("of_case.geo", GEOMETRY)], &values[..]].concat(),
        "geo" => {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            return [&[beside("of_geo.case", &CASE.replace("of_case.geo", &name))], &values[..]].concat();
        }
        "vtm" => return vec![beside("of_list.vtu", VTU)],
        _ => return vec![],
    };
    vec![(path.with_extension(other), text.into())]
}

const CASE: &str = "FORMAT\ntype: ensight gold\nGEOMETRY\nmodel: of_case.geo\nVARIABLE\n\
    scalar per node: 1 a of_case.a*\nvector per element: b of_case.b\nTIME\ntime set: 1\nnumber of steps: 2\n\
    filename start number: 0\nfilename increment: 1\ntime values: 0 1\n";

const GEOMETRY: &str = "a\n\nnode id off\nelement id given\nextents\n0 1\n0 1\n0 1\npart\n1\na\ncoordinates\n4\n\
    0\n1\n0\n0\n0\n0\n1\n0\n0\n0\n0\n1\ntetra4\n1\n7\n1 2 3 4\nnsided\n1\n8\n3\n1 2 3\n";

const LIST: &str = "<VTKFile type=\"vtkMultiBlockDataSet\"><vtkMultiBlockDataSet><Block index=\"0\">\n\
    <DataSet index=\"0\" file=\"of_list.vtu\"/></Block><DataSet index=\"1\" file=\"of_list.vtu\"/>\n\
    </vtkMultiBlockDataSet></VTKFile>\n";

/// A tetrahedron's surface.
fn surface(folder: &Path, format: SurfaceFormat) -> Result<Vec<u8>> {
    let position = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let vertices = position.map(|position| Vertex { position, normal: [0.0, 0.6, 0.8] }).to_vec();
    let mesh = TriMesh {
        vertices,
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        ..TriMesh::default()
    };
    let out = folder.join(format!("seed.{}", format.extension()));
    let meta =
        SurfaceMeta { isovalue: Some(1.5), comments: vec!["a comment".into()], ..SurfaceMeta::default() };
    write_surface(&mesh, &out, format, &meta, &Resources::default())?;
    get(&out)
}

/// Writes a file that is not there yet.
pub(crate) fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    let _ = fs::remove_file(path);
    fs::write(path, bytes).map_err(|e| isospan::Error::io("write", path, e))
}

pub(crate) fn get(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|e| isospan::Error::io("read", path, e))
}

const NODES: &str = "# points\n5 3 2 1\n1 0 0 0 0.5 7 0\n2 1 0 0 1.5 8 1\n3 0 1 0 2.5 9 0\n4 0 0 1 3.5 9 0\n5 0 0 -1 4.5 9 0\n";

const CELLS: &str = "2 4 1\n1 1 2 3 4 10\n2 1 3 2 5 20\n";

const VTU: &str = "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\n<Piece NumberOfPoints=\"5\" NumberOfCells=\"2\">\n\
    <PointData Scalars=\"b\"><DataArray type=\"Float32\" Name=\"b\" format=\"ascii\">1 2 3 4 5</DataArray></PointData>\n\
    <CellData><DataArray type=\"UInt8\" Name=\"c\" format=\"ascii\">1 2</DataArray></CellData>\n\
    <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 1 1 0 0 1 0 .5 .5 1\
    </DataArray></Points>\n<Cells><DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">0 1 2 4 0 1 2 3 4\
    </DataArray>\n<DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">4 9</DataArray>\n\
    <DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">10 14</DataArray>\n</Cells></Piece></UnstructuredGrid></VTKFile>\n";

/// A pyramid and a tetrahedron, told by their faces as VTK 9.4 does.
const POLYHEDRA: &str = "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\n<Piece NumberOfPoints=\"5\" NumberOfCells=\"2\">\n\
    <PointData Scalars=\"b\"><DataArray type=\"Float32\" Name=\"b\" format=\"ascii\">1 2 3 4 5</DataArray></PointData>\n\
    <CellData><DataArray type=\"UInt8\" Name=\"c\" format=\"ascii\">1 2</DataArray></CellData>\n\
    <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 1 1 0 0 1 0 .5 .5 1\
    </DataArray></Points>\n<Cells><DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">0 1 2 3 4 0 1 2 4\
    </DataArray>\n<DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">5 9</DataArray>\n\
    <DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">42 42</DataArray>\n\
    <DataArray type=\"Int64\" Name=\"face_connectivity\" format=\"ascii\">0 3 2 1 0 1 4 1 2 4 2 3 4 3 0 4\
     0 2 1 0 1 4 1 2 4 0 4 2</DataArray>\n\
    <DataArray type=\"Int64\" Name=\"face_offsets\" format=\"ascii\">4 7 10 13 16 19 22 25 28</DataArray>\n\
    <DataArray type=\"Int64\" Name=\"polyhedron_to_faces\" format=\"ascii\">0 1 2 3 4 5 6 7 8</DataArray>\n\
    <DataArray type=\"Int64\" Name=\"polyhedron_offsets\" format=\"ascii\">5 9</DataArray>\n\
    </Cells></Piece></UnstructuredGrid></VTKFile>\n";

/// The pyramid, and a tetrahedron that has none, as VTK did before.
const POLYHEDRA_OLD: &str = "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\n<Piece NumberOfPoints=\"5\" NumberOfCells=\"2\">\n\
    <PointData Scalars=\"b\"><DataArray type=\"Float32\" Name=\"b\" format=\"ascii\">1 2 3 4 5</DataArray></PointData>\n\
    <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 1 1 0 0 1 0 .5 .5 1\
    </DataArray></Points>\n<Cells><DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">0 1 2 3 4 0 1 2 4\
    </DataArray>\n<DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">5 9</DataArray>\n\
    <DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">42 10</DataArray>\n\
    <DataArray type=\"Int64\" Name=\"faces\" format=\"ascii\">5 4 0 3 2 1 3 0 1 4 3 1 2 4 3 2 3 4 3 3 0 4</DataArray>\n\
    <DataArray type=\"Int64\" Name=\"faceoffsets\" format=\"ascii\">22 -1</DataArray>\n\
    </Cells></Piece></UnstructuredGrid></VTKFile>\n";

const LEGACY_GRID: &str = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n\
    0 0 0 1 0 0 1 1 0 0 1 0 .5 .5 1\nCELLS 2 11\n4 0 1 2 4\n5 0 1 2 3 4\nCELL_TYPES 2\n10 14\n\
    POINT_DATA 5\nSCALARS b float\nLOOKUP_TABLE default\n1 2 3 4 5\nCELL_DATA 2\nSCALARS c int\nLOOKUP_TABLE default\n1 2\n";

const LEGACY_GRID_5: &str = "# vtk DataFile Version 5.1\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n\
    0 0 0 1 0 0 1 1 0 0 1 0 .5 .5 1\nCELLS 3 9\nOFFSETS vtktypeint64\n0 4 9\nCONNECTIVITY vtktypeint64\n\
    0 1 2 4 0 1 2 3 4\nCELL_TYPES 2\n10 14\n\
    POINT_DATA 5\nSCALARS b float\nLOOKUP_TABLE default\n1 2 3 4 5\nMETADATA\nINFORMATION 0\n\n";

const PLY_TEXT: &str = "ply\nformat ascii 1.0\ncomment a\nelement vertex 4\nproperty float x\nproperty float y\n\
    property float z\nproperty uchar red\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 0 1\n1 0 0 2\n0 1 0 3\n0 0 1 4\n3 0 1 2\n4 0 1 2 3\n";

const STL_TEXT: &str = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n\
    endfacet\nendsolid a\n";

/// Compressed arrays: of several sizes and delays, smooth and noisy.
pub(crate) fn arrays() -> Result<Vec<Vec<u8>>> {
    let make = |dims: [usize; 3], step: f64, delay| {
        let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) as f32 / 4e9;
        let sample = |i: usize| (i % dims[0]) as f32 * 0.3 + noise(i);
        let samples: Vec<f32> = (0..dims.iter().product()).map(sample).collect();
        let settings = Settings { accuracy: Accuracy::Step(step), delay: Some(delay) };
        compress(&samples, dims, &settings).map_err(|e| Error::usage(e.to_string()))
    };
    vec![
        make([40, 20, 34], 1.0, [0; 3]),
        make([16, 16, 16], 0.1, [0, 0, 1]),
        make([33, 9, 7], 0.01, [1, 0, 0]),
        make([3, 2, 5], 0.1, [0; 3]),
    ]
    .into_iter()
    .collect()
}
