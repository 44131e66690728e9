#!/usr/bin/env python3
"""Writes tests/data/axes_named.h5 and axes_units.nc: arrays with axes in other places than the usual ones,
and coordinates in several units.

    python3 -m pip install h5py netCDF4 numpy
    python3 tools/make_golden_axes.py
"""

import json
from pathlib import Path

import h5py
import netCDF4
import numpy as np

DATA = Path(__file__).parent.parent / "tests" / "data"
SIZES = {"t": 2, "z": 5, "y": 6, "x": 7, "c": 3}


def value(axes, shape):
    """1000 t + 500 c + x + 7 y + 42 z at each sample, whatever the order of the axes is."""
    at = dict(zip(axes, np.indices(shape)))
    weights = {"t": 1000, "c": 500, "x": 1, "y": 7, "z": 42}
    return sum(weights[a] * at[a] for a in axes).astype("<u2")


def tags(axes):
    """The attribute that vigra and ilastik write."""
    return json.dumps({"axes": [{"key": a, "typeFlags": 2, "resolution": 0, "description": ""} for a in axes]})


with h5py.File(DATA / "axes_named.h5", "w", libver="earliest") as file:
    for name, axes, single, chunk in [
        ("one_channel", "zyxc", "c", None),
        ("one_channel_in_chunks", "zyxc", "c", (2, 3, 4, 1)),
        ("probabilities", "zyxc", "", None),
        ("probabilities_in_chunks", "zyxc", "", (2, 4, 3, 2)),
        ("channels_inside", "zcyx", "", (2, 2, 4, 3)),
        ("one_time", "tzyxc", "t", (1, 2, 3, 4, 2)),
        ("movie", "tzyxc", "", (1, 2, 3, 4, 2)),
        ("time_last", "yxzt", "", None),
    ]:
        shape = tuple(1 if a in single else SIZES[a] for a in axes)
        more = {} if chunk is None else {"chunks": chunk, "compression": "gzip"}
        dataset = file.create_dataset(name, data=value(axes, shape), **more)
        dataset.attrs["axistags"] = tags(axes)

with netCDF4.Dataset(DATA / "axes_units.nc", "w", format="NETCDF3_CLASSIC") as file:
    for name, size, first, step, unit in [
        ("x", 7, 10, 2, "m"),
        ("y", 6, 1, 0.5, "km"),
        ("z", 5, 100, 50, "m"),
        ("lat", 6, 40, 1, "degrees_north"),
        ("lon", 7, 5, 1, "degrees_east"),
        ("time", 2, 3, 1, "hours since 2000-01-01"),
    ]:
        file.createDimension(name, size)
        line = file.createVariable(name, "f8", (name,))
        line.units = unit
        line[:] = first + step * np.arange(size)
    uneven = file.createDimension("depth", 5)
    line = file.createVariable("depth", "f8", ("depth",))
    line.units = "km"
    line[:] = [0, 1, 3, 6, 10]
    for name, dims in [
        ("mixed", ("z", "y", "x")),
        ("uneven", ("depth", "y", "x")),
        ("geographic", ("z", "lat", "lon")),
        ("time_last", ("y", "x", "z", "time")),
    ]:
        shape = tuple(len(file.dimensions[d]) for d in dims)
        axes = "".join({"lat": "y", "lon": "x", "depth": "z", "time": "t"}.get(d, d) for d in dims)
        file.createVariable(name, "i4", dims)[:] = value(axes, shape)
