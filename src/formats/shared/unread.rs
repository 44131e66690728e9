//! Kinds of files that are not read, by their first bytes or their names, and what converts them.

use super::format::Head;
use super::has_suffix;

/// A kind of file that is not read.
pub(in crate::formats) struct Unread {
    pub(in crate::formats) name: &'static str,
    /// How to get a file that is read.
    pub(in crate::formats) help: &'static str,
}

const TO_TIFF: &str = "convert it to OME-TIFF or OME-Zarr, e.g. with bfconvert or bioformats2raw";
const TO_VTK: &str = "convert it to .vtu or .vti, e.g. with ParaView";

/// Magic bytes, where they are, and what has them.
#[rustfmt::skip]
const BY_BYTES: [(usize, &[u8], &str, &str); 14] = [
    (0, b"ZISRAWFILE", "a Zeiss CZI file", TO_TIFF),
    (0, b"\xda\xce\xbe\x0a", "a Nikon ND2 file", TO_TIFF),
    (0, b"\x70\0\0\0", "a Leica LIF file", TO_TIFF),
    (0, b"\0\0\0\x0cjP  \r\n\x87\n", "a JPEG 2000 or old ND2 file", TO_TIFF),
    (0, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a compound document (OIB, ZVI, VSI, TXM)", TO_TIFF),
    (0, b"GRIB", "a GRIB file", "convert it to NetCDF-4, e.g. with cdo -f nc4 copy"),
    (0, b"SIMPLE  =", "a FITS file", "save its array as .npy, with astropy and NumPy"),
    (0, b" BDV", "an OpenVDB file", "sample it on a grid, and save that as .npy"),
    (0, b"MATLAB 5.0 MAT-file", "a MATLAB file before version 7.3", "save it with the option '-v7.3', which writes HDF5"),
    (0, b"@(#)ADF", "a CGNS file", TO_VTK),
    (0, b"#!TDV", "a Tecplot file", TO_VTK),
    (0, b"\x89PNG", "a PNG picture", "give a folder of TIFF slices"),
    (0, b"\xff\xd8\xff", "a JPEG picture", "give a folder of TIFF slices"),
    (0, b"11111\n", "a file of Vol_Tk (.slc)", "save it as NRRD or .vti, with VTK"),
];

/// Ends of names, and what has them.
#[rustfmt::skip]
const BY_NAME: [(&[&str], &str, &str); 3] = [
    (&[".vgi", ".vgl", ".vol"], "a file of VGStudio, or a raw volume", "its samples are raw: give --dims and --type"),
    (&[".foam"], "an OpenFOAM case", "convert it with foamToVTK"),
    (&[".bz2", ".xz", ".zst", ".7z", ".tar"], "a packed file", "unpack it first"),
];

impl Unread {
    /// What a file is that no reader took.
    pub(in crate::formats) fn of(head: &Head<'_>) -> Option<Self> {
        let has = |at: usize, magic: &[u8]| head.bytes.get(at..at + magic.len()) == Some(magic);
        let by_bytes = BY_BYTES.iter().find(|(at, magic, ..)| has(*at, magic));
        if let Some(&(.., name, help)) = by_bytes {
            return Some(Self { name, help });
        }
        if head.text().starts_with(b"FoamFile") {
            return Some(Self { name: "an OpenFOAM file", help: "convert the case with foamToVTK" });
        }
        let by_name = BY_NAME.iter().find(|(suffixes, ..)| has_suffix(head.path, suffixes));
        by_name.map(|&(_, name, help)| Self { name, help })
    }
}
