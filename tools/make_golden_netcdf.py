#!/usr/bin/env python3
"""Writes tests/data/netcdf3_*.nc, small NetCDF-3 files for the tests of src/io/formats/volume/netcdf.

Needs netCDF4, scipy and numpy. Sample (z, y, x) of each variable is its index in C order, unless said otherwise.
Usage: tools/make_golden_netcdf.py
"""
from pathlib import Path

import netCDF4
import numpy as np
from scipy.io import netcdf_file

OUT = Path(__file__).resolve().parent.parent / "tests" / "data"
SHAPE = (4, 3, 5)
RAMP = np.arange(60).reshape(SHAPE)


def variables(name, version, types):
    """Each type with and without records, coordinates, packing, ranges, and what is refused."""
    with netCDF4.Dataset(OUT / name, "w", format=version) as f:
        f.title = "odd"
        for axis, count in (("runs", None), ("lev", 4), ("lat", 3), ("lon", 5), ("bare", 3)):
            f.createDimension(axis, count)
        for axis, values in (("lev", [1000, 925, 700, 500]), ("lat", [30, 20, 10]), ("lon", range(5))):
            f.createVariable(axis, "f4", (axis,))[:] = list(values)
        f["lat"].units, f["lon"].units = "degrees_north", "degrees_east"
        runs = f.createVariable("runs", "f8", ("runs",))
        runs.units = "hours of the whole run"
        for kind in types:
            f.createVariable("fixed_" + kind, kind, ("lev", "lat", "lon"))
            f.createVariable("record_" + kind, kind, ("runs", "lat", "lon"))
        packed = f.createVariable("packed", "i2", ("runs", "lev", "lat", "lon"), fill_value=-999)
        packed.scale_factor, packed.add_offset = 0.5, 10.0
        ranged = f.createVariable("ranged", "i2", ("bare", "lat", "lon"))
        ranged.scale_factor, ranged.valid_range = 2.0, np.array([3, 40], "i2")
        f.createVariable("unwritten", "f4", ("runs", "lat", "lon"))
        f.createVariable("even", "f8", ("bare", "lat", "lon"))
        f.createVariable("text", "S1", ("bare", "lat", "lon"))
        f.createVariable("unsigned", "i1", ("bare", "lat", "lon"))._Unsigned = "true"
        f.set_auto_maskandscale(False)
        for kind in types:
            f["fixed_" + kind][:] = RAMP
            f["record_" + kind][:] = RAMP
        runs[:] = [0, 6, 18, 24]
        packed[:] = np.stack([RAMP + 100 * t for t in range(4)])
        packed[1, 0, 0, 0] = -999
        ranged[:] = np.arange(45).reshape(3, 3, 5)
        f["even"][:] = np.arange(45).reshape(3, 3, 5)
        # Records 0 and 2 to 3 are left as they are.
        f["unwritten"][1] = np.arange(15).reshape(3, 5)


def one_variable():
    """The parts of a single variable with records follow each other: 15 bytes each, not 16."""
    with netcdf_file(OUT / "netcdf3_single.nc", "w", version=1) as f:
        for axis, count in (("z", None), ("y", 3), ("x", 5)):
            f.createDimension(axis, count)
        f.createVariable("v", "i1", ("z", "y", "x"))[:] = RAMP.astype("i1")



def small():
    """One field, so that it is read without a choice: what tools/dev/fuzz damages."""
    with netCDF4.Dataset(OUT / "netcdf3_small.nc", "w", format="NETCDF3_64BIT_DATA") as f:
        for axis, count in (("runs", None), ("y", 3), ("x", 5)):
            f.createDimension(axis, count)
        for axis, values in (("runs", [0, 1, 2, 4]), ("y", [0.0, 0.5, 1.0])):
            f.createVariable(axis, "f8", (axis,))[:] = values
        v = f.createVariable("v", "i2", ("runs", "y", "x"), fill_value=-1)
        v.set_auto_maskandscale(False)
        v.scale_factor, v.valid_range = 0.5, np.array([0, 50], "i2")
        v[:] = RAMP


def units():
    """Units of values, coordinates and times; and a name that would colour a terminal."""
    with netCDF4.Dataset(OUT / "netcdf3_units.nc", "w", format="NETCDF3_CLASSIC") as f:
        for axis, values in (("time", [0, 6]), ("z", [0, 10, 20, 30]), ("y", [0, 1, 2]), ("x", [0, 2, 4, 6, 8]), ("lat", [0, 1, 2])):
            f.createDimension(axis, len(values))
            f.createVariable(axis, "f4", (axis,))[:] = values
        f["time"].units, f["lat"].units = "hours since 2000-01-01", "degrees_north"
        f["x"].units, f["y"].units, f["z"].units = "m", "meters", "metre"
        temp = f.createVariable("temp", "f4", ("time", "z", "y", "x"))
        temp.units = "K"
        temp[:] = np.stack([RAMP, RAMP + 100])
        odd = f.createVariable("odd", "f4", ("z", "lat", "x"))
        odd.units = "\x1b[31m kg  m-3"
        odd[:] = RAMP
        f.createVariable("share", "f4", ("z", "y", "x")).units = "1"
        f["share"][:] = RAMP


if __name__ == "__main__":
    classic = ("i1", "i2", "i4", "f4", "f8")
    variables("netcdf3_classic.nc", "NETCDF3_CLASSIC", classic)
    variables("netcdf3_offset.nc", "NETCDF3_64BIT_OFFSET", classic)
    variables("netcdf3_cdf5.nc", "NETCDF3_64BIT_DATA", classic + ("u1", "u2", "u4", "i8", "u8"))
    one_variable()
    small()
    units()
