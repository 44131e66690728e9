//! Kinds of files and folders that are not read, by their first bytes, their names or what is in
//! them, and what converts them.

use super::format::Head;
use super::has_suffix;
use crate::bytes::publish::folder_of;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A kind of file that is not read.
pub(in crate::formats) struct Unread {
    pub(in crate::formats) name: &'static str,
    /// How to get a file that is read.
    pub(in crate::formats) help: &'static str,
}

const TO_TIFF: &str = "convert it to OME-TIFF or OME-Zarr, e.g. with bfconvert or bioformats2raw";
const TO_VTK: &str = "convert it to .vtu or .vti, e.g. with ParaView";
const TO_ZARR: &str = "convert it to OME-Zarr, or save the part that is wanted as .npy";
const TO_NIFTI: &str = "convert it to NIfTI";
const TO_NPY: &str = "save its array as .npy, with Python";
const TO_SLICES: &str = "give a folder of TIFF slices";
const FROM_FOAM: &str = "convert the case with foamToVTK";

/// Magic bytes, where they are, and what has them.
#[rustfmt::skip]
const BY_BYTES: [(usize, &[u8], &str, &str); 25] = [
    (0, b"ZISRAWFILE", "a Zeiss CZI file", TO_TIFF),
    (0, b"\xda\xce\xbe\x0a", "a Nikon ND2 file", TO_TIFF),
    (0, b"\x70\0\0\0", "a Leica LIF file", TO_TIFF),
    (0, b"\0\0\0\x0cjP  \r\n\x87\n", "a JPEG 2000 or old ND2 file", TO_TIFF),
    (0, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a compound document (OIB, ZVI, VSI, TXM)", TO_TIFF),
    (0, b"OLYMPUSRAWFORMAT", "an Olympus OIR file", TO_TIFF),
    (0, b"GRIB", "a GRIB file", "convert it to NetCDF-4, e.g. with cdo -f nc4 copy"),
    (0, b"SIMPLE  =", "a FITS file", "save its array as .npy, with astropy and NumPy"),
    (0, b"\x0e\x03\x13\x01", "an HDF4 file", "convert it to HDF5, with h4toh5"),
    (0, b"\xcd\xf3\x00\x01", "a CDF file of NASA", "convert it to NetCDF-4, with cdflib"),
    (0, b" BDV", "an OpenVDB file", "sample it on a grid, and save that as .npy"),
    (0, b"MATLAB 5.0 MAT-file", "a MATLAB file before version 7.3", "save it with the option '-v7.3', which writes HDF5"),
    (0, b"PAR1", "a Parquet file", TO_NPY),
    (0, b"\x80\x04\x95", "a Python pickle", TO_NPY),
    (0, b"MATRIX7", "an ECAT file", TO_NIFTI),
    (0, b"@(#)ADF", "a CGNS file", TO_VTK),
    (0, b"#!TDV", "a Tecplot file", TO_VTK),
    (0, b"\x89PNG", "a PNG picture", TO_SLICES),
    (0, b"\xff\xd8\xff", "a JPEG picture", TO_SLICES),
    (0, b"GIF8", "a GIF picture", TO_SLICES),
    (0, b"P5\n", "a PGM picture", TO_SLICES),
    (0, b"v/1\x01", "an OpenEXR picture", TO_SLICES),
    (8, b"WEBP", "a WebP picture", TO_SLICES),
    // "BM", four bytes of the length, and zeros.
    (6, b"\0\0\0\0", "a BMP picture", TO_SLICES),
    (0, b"11111\n", "a file of Vol_Tk (.slc)", "save it as NRRD or .vti, with VTK"),
];

/// Beginnings of texts, and what has them.
#[rustfmt::skip]
const BY_TEXT: [(&[u8], &str, &str); 4] = [
    (b"FoamFile", "an OpenFOAM file", FROM_FOAM),
    (b"<Xdmf", "an XDMF file", "name the HDF5 file of its arrays with `field`, or convert it to .vtu with ParaView"),
    (b"<SpimData", "a BigDataViewer project", "name its .h5 file"),
    (b"object 1 class gridpositions", "an OpenDX grid", TO_NPY),
];

/// Ends of names, and what has them.
#[rustfmt::skip]
const BY_NAME: [(&[&str], &str, &str); 15] = [
    (&[".vgi", ".vgl", ".vol"], "a file of VGStudio, or a raw volume", "its samples are raw: give `dims` and `type`"),
    (&[".foam", ".openfoam"], "an OpenFOAM case", FROM_FOAM),
    (&[".bz2", ".xz", ".zst", ".7z", ".tar", ".tgz", ".lz4", ".rar"], "a packed file", "unpack it first"),
    (&[".mgz", ".mgh"], "a FreeSurfer volume", "convert it to NIfTI, with mri_convert"),
    (&[".rpl"], "the description of a Ripple file", "its samples are in a raw file beside it: name that, with `dims` and `type`"),
    (&[".head", ".brik", ".brik.gz"], "an AFNI volume", "convert it to NIfTI, with 3dAFNItoNIFTI"),
    (&[".par", "2dseq", ".fdf", ".gipl"], "a volume of a scanner's own format", TO_NIFTI),
    (&[".dm3", ".dm4", ".ser", ".mib", ".blo"], "a file of an electron microscope", "convert it to MRC or TIFF, e.g. with rosettasciio"),
    (&[".dv", ".r3d", ".klb", ".stk", ".svs", ".ndpi", ".scn"], "a microscope's own format", TO_TIFF),
    (&[".sgy", ".segy", ".vds"], "a seismic volume (SEG-Y)", "save it as NetCDF or .npy, e.g. with segyio"),
    (&[".cube", ".cub", ".xsf", ".dx"], "a grid of a chemistry program", TO_NPY),
    (&[".cas", ".inp", ".odb", ".bdf", ".cdb", ".unv", ".med"], "a mesh of a simulation program", "convert it to .vtu, e.g. with meshio"),
    (&[".silo", ".bp", ".pvd", ".xmf", ".xdmf"], "a list of a simulation's files", TO_VTK),
    (&[".las", ".laz", ".e57", ".pcd"], "a cloud of points", "isospan reads volumes and meshes: sample it on a grid"),
    (&[".bmp"], "a BMP picture", TO_SLICES),
];

/// Files that a folder has, what one of them has in it, and what such a folder is.
#[rustfmt::skip]
const BY_FOLDER: [(&str, &[&str], &str, &str); 6] = [
    ("attributes.json", &["\"n5\""], "an N5 container", TO_ZARR),
    ("attributes.json", &["\"blockSize\"", "\"dataType\""], "an array of N5", TO_ZARR),
    ("info", &["\"scales\"", "\"data_type\""], "a precomputed volume of neuroglancer", TO_ZARR),
    ("info", &["neuroglancer_"], "precomputed data of neuroglancer", TO_ZARR),
    ("system/controlDict", &[], "an OpenFOAM case", FROM_FOAM),
    ("md.idx", &[], "a folder of ADIOS2 (.bp)", TO_VTK),
];

/// Bytes of a file that are looked at for what a folder is.
const LOOKED_AT: u64 = 1 << 16;

impl Unread {
    /// What a file is that no reader took.
    pub(in crate::formats) fn of(head: &Head<'_>) -> Option<Self> {
        let has = |at: usize, magic: &[u8]| head.bytes.get(at..at + magic.len()) == Some(magic);
        let is = |at: usize, magic: &[u8], name: &str| {
            has(at, magic) && (name != "a BMP picture" || has(0, b"BM")) && (at != 8 || has(0, b"RIFF"))
        };
        let by_bytes = BY_BYTES.iter().find(|(at, magic, name, _)| is(*at, magic, name));
        if let Some(&(.., name, help)) = by_bytes {
            return Some(Self { name, help });
        }
        let text = head.text();
        // After the declaration of XML.
        let root = text.windows(2).position(|w| w[0] == b'<' && w[1].is_ascii_alphabetic());
        let root = root.filter(|_| text.starts_with(b"<")).map_or(text, |at| &text[at..]);
        if let Some(&(_, name, help)) = BY_TEXT.iter().find(|(start, ..)| root.starts_with(start)) {
            return Some(Self { name, help });
        }
        Self::of_name(head.path).or_else(|| {
            // The description of a folder, named by itself.
            let is_described = text.starts_with(b"{")
                && matches!(head.path.file_name()?.to_str()?, "info" | "attributes.json");
            is_described.then(|| Self::of_folder(folder_of(head.path)))?
        })
    }

    /// What a file is by its name.
    pub(in crate::formats) fn of_name(path: &Path) -> Option<Self> {
        let by_name = BY_NAME.iter().find(|(suffixes, ..)| has_suffix(path, suffixes));
        by_name.map(|&(_, name, help)| Self { name, help })
    }

    /// Refuses an empty file whose name says enough: a case of OpenFOAM is named by one.
    ///
    /// # Errors
    /// [`Error::BadInput`].
    pub(in crate::formats) fn refuse_empty(path: &Path) -> Result<()> {
        let is_empty = std::fs::metadata(path).is_ok_and(|m| m.is_file() && m.len() == 0);
        match Self::of_name(path).filter(|_| is_empty) {
            Some(unread) => Err(unread.error(path, "kind of file", "a volume or a mesh")),
            None => Ok(()),
        }
    }

    /// What a folder is that no reader took.
    pub(in crate::formats) fn of_folder(folder: &Path) -> Option<Self> {
        let text_of = |file: &str| {
            let mut text = vec![];
            let file = Some(folder.join(file)).filter(|file| file.is_file())?;
            File::open(file).ok()?.take(LOOKED_AT).read_to_end(&mut text).ok()?;
            Some(String::from_utf8_lossy(&text).into_owned())
        };
        let is = |file: &str, words: &[&str]| {
            text_of(file).is_some_and(|text| words.iter().all(|word| text.contains(word)))
        };
        let found = BY_FOLDER.iter().find(|(file, words, ..)| is(file, words));
        found.map(|&(.., name, help)| Self { name, help })
    }

    /// The error for a file or a folder of this kind.
    pub(in crate::formats) fn error(&self, path: &Path, at: &str, expected: &str) -> Error {
        let got = format!("{}, which isospan does not read", self.name);
        Error::bad_input(path, at, expected, got).with_help(self.help)
    }
}
