//! The figures that the thesis prints: the only numbers of the report that were typed in.
//!
//! Times are seconds on an IBM RS6000 with 512 MB.

use crate::data::Dataset;

/// Rows of a table of times: linear interpolation, the other interpolation, mesh generation,
/// extraction.
pub(crate) type Times = [(&'static str, &'static [f64])];

/// Tables 3.1 and 4.1: samples or vertices, and cells.
pub(crate) fn sizes(dataset: Dataset) -> (f64, f64) {
    match dataset {
        Dataset::Sphere | Dataset::Seis => (125_000.0, 705_894.0),
        Dataset::Heart => (11_504.0, 72_641.0),
        Dataset::Torso => (34_937.0, 216_607.0),
        Dataset::Head => (137_923.0, 884_343.0),
    }
}

/// Table 3.2, SPHERE and SEIS at 1/4.
pub(crate) const TABLE_3_2: &Times = &[
    ("Linear interpolation", &[30.23, 30.98]),
    ("Cubic interpolation", &[40.14, 41.08]),
    ("Mesh generation", &[1833.3, 2029.26]),
    ("Isosurface extraction", &[25.67, 24.80]),
];

/// Table 3.3, at 1/8: interpolation, mesh generation and extraction, each of SPHERE and SEIS; NaN
/// where nothing is printed.
pub(crate) const TABLE_3_3: &Times = &[
    ("Hammersley", &[19.20, 20.14, 882.62, 910.81, 11.97, 11.18]),
    ("Halton", &[19.49, 20.95, 458.41, 505.45, 12.21, 11.74]),
    ("Hyperbolic", &[21.85, 28.91, 721.59, 730.20, 8.0, 10.32]),
    ("Regular", &[f64::NAN, f64::NAN, 1315.0, 676.72, 6.55, 9.34]),
    ("Original", &[f64::NAN, f64::NAN, f64::NAN, f64::NAN, 74.53, 104.27]),
];

/// Table 3.4, 10 660 points: as Table 3.3.
pub(crate) const TABLE_3_4: &Times = &[
    ("Hammersley", &[15.63, 16.75, 564.49, 585.1, 7.29, 6.82]),
    ("Halton", &[15.8, 16.78, 308.9, 326.0, 7.45, 7.18]),
    ("Hyperbolic", &[0.0, 0.0, 385.78, 641.18, 3.42, 4.50]),
];

/// The number of points of Table 3.4.
pub(crate) const SUBSAMPLED: u64 = 10_660;

/// Table 4.2, HEART, TORSO and HEAD at 1/2.
pub(crate) const TABLE_4_2: &Times = &[
    ("Linear interpolation", &[45.62, 195.81, 1270.59]),
    ("Quadratic interpolation", &[45.61, 196.01, 1273.01]),
    ("Mesh generation", &[287.87, 1056.38, 412.98]),
    ("Isosurface extraction", &[3.53, 12.14, 59.07]),
];

/// Table 4.3, at 1/8: for Hammersley, Halton, hyperbolic cross and regular points.
pub(crate) const TABLE_4_3: &Times = &[
    ("Interpolation, HEART", &[30.42, 30.52, 32.10, 30.42]),
    ("Interpolation, TORSO", &[114.47, 114.64, 119.11, 112.92]),
    ("Interpolation, HEAD", &[638.34, 639.71, 594.40, 633.05]),
    ("Mesh generation, HEART", &[64.64, 48.36, 60.41, 47.95]),
    ("Mesh generation, TORSO", &[213.65, 134.77, 203.59, 135.19]),
    ("Mesh generation, HEAD", &[999.18, 530.58, 714.19, 530.83]),
    ("Isosurface extraction, HEART", &[0.69, 0.70, 0.51, 0.70]),
    ("Isosurface extraction, TORSO", &[2.49, 2.55, 1.96, 2.54]),
    ("Isosurface extraction, HEAD", &[13.35, 13.33, 9.40, 13.31]),
];

/// A number of the thesis; `None` where it prints none.
pub(crate) fn printed(x: f64) -> Option<f64> {
    (!x.is_nan()).then_some(x)
}
