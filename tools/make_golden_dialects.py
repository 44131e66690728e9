#!/usr/bin/env python3
"""Writes tests/data/dialects, small files of programs with rules of their own inside NetCDF-3 and HDF5.

Each FILE has a FILE.txt beside it: the world coordinates and the values of its samples, as the program's own reader
(nibabel, rosettasciio, emdfile, xarray) has them. Samples without a value are "nan".
Needs emdfile, h5py, netCDF4, nibabel, numpy, rosettasciio, scipy, xarray.
Usage: tools/make_golden_dialects.py
"""
from pathlib import Path

import emdfile
import h5py
import netCDF4
import nibabel
import numpy as np
import xarray
from rsciio.emd import file_reader as read_emd, file_writer as write_emd
from rsciio.hspy import file_reader as read_hspy, file_writer as write_hspy
from scipy.io import netcdf_file

OUT = Path(__file__).resolve().parent.parent / "tests" / "data" / "dialects"
SHAPE = (3, 4, 5)
RAMP = np.arange(60).reshape(SHAPE)


def oracle(name, world, values):
    """`world`: x, y, z of each sample."""
    rows = np.column_stack([np.reshape(world, (-1, 3)), np.ravel(values)])
    (OUT / f"{name}.txt").write_text("".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in rows))


def along(axes):
    """World coordinates from those along the axes of an array: x, y, z for each of them."""
    grids = np.meshgrid(*[axis for axis, _ in axes], indexing="ij")
    world = np.zeros((*grids[0].shape, 3))
    for grid, (_, to) in zip(grids, axes):
        world[..., to] = grid
    return world


def minc(name, order, kind, sign, image, scaled, valid=None, **axes):
    """MINC 1: `scaled` axes of `image-min` and `image-max`."""
    with netcdf_file(OUT / name, "w", version=1) as f:
        for axis, count in zip(order, SHAPE):
            f.createDimension(axis, count)
        for axis in order:
            v = f.createVariable(axis, "i4", ())
            v.varid, v.vartype, v.spacing, v.units = "MINC standard variable", "dimension____", "regular__", "mm"
            for key, value in axes.get(axis, {}).items():
                setattr(v, key, np.array(value, ">f8"))
        f.createVariable("rootvariable", "i4", ()).varid = "MINC standard variable"
        shape = SHAPE[:scaled]
        for end, value in (("min", -10.0), ("max", 90.0)):
            v = f.createVariable(f"image-{end}", "f8", tuple(order[:scaled]))
            v._FillValue = 0.0 if end == "min" else 1.0
            v[...] = value + np.arange(int(np.prod(shape))).reshape(shape) * 7.0
        v = f.createVariable("image", kind, tuple(order))
        v.varid, v.signtype = "MINC standard variable", sign
        if valid:
            v.valid_range = np.array(valid, ">f8")
        v[:] = image
    found = nibabel.load(OUT / name)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in SHAPE], indexing="ij"), -1)
    oracle(name, nibabel.affines.apply_affine(found.affine, index), found.get_fdata())


def mincs():
    turned = np.cos(0.3), np.sin(0.3)
    minc(
        "minc1_bytes.mnc", ["yspace", "zspace", "xspace"], "i1", "unsigned", (RAMP * 4).astype("u1").view("i1"), 1, [0, 240],
        xspace=dict(start=-20, step=2, direction_cosines=[turned[0], turned[1], 0]),
        yspace=dict(start=30, step=-3, direction_cosines=[-turned[1], turned[0], 0]),
        zspace=dict(start=5, step=4.5, direction_cosines=[0, 0, 1]),
    )  # fmt: skip
    minc("minc1_shorts.mnc", ["zspace", "yspace", "xspace"], "i2", "signed__", RAMP * 500 - 15000, 2, xspace=dict(step=0.5))


def minc_times():
    """MINC 1 and 2 with an axis of time, and ends of the valid range of each slice of each volume."""
    order, shape = ["time", "zspace", "yspace", "xspace"], (2, *SHAPE)
    steps = dict(time=(10.0, 2.5), zspace=(5.0, 4.5), yspace=(30.0, -3.0), xspace=(-20.0, 2.0))
    image = (np.arange(120).reshape(shape) * 200).astype("i2")
    ends = np.arange(6.0).reshape(2, 3) * 7, np.arange(6.0).reshape(2, 3) ** 2 + 100
    with netcdf_file(OUT / "minc1_times.mnc", "w", version=1) as f:
        for axis, count in zip(order, shape):
            f.createDimension(axis, count)
        for axis in order:
            v = f.createVariable(axis, "i4", ())
            v.varid, v.vartype, v.spacing = "MINC standard variable", "dimension____", "regular__"
            v.units = "s" if axis == "time" else "mm"
            v.start, v.step = (np.array(x, ">f8") for x in steps[axis])
        f.createVariable("rootvariable", "i4", ()).varid = "MINC standard variable"
        for end, values in zip(("min", "max"), ends):
            f.createVariable(f"image-{end}", "f8", ("time", "zspace"))[...] = values
        v = f.createVariable("image", "i2", tuple(order))
        v.varid, v.signtype, v.valid_range = "MINC standard variable", "signed__", np.array([0, 30000], ">f8")
        v[:] = image
    with h5py.File(OUT / "minc2_times.mnc", "w", libver="latest") as f:
        for axis, count in zip(order, shape):
            # Times that are listed, not even.
            data = np.array([10.0, 12.5]) if axis == "time" else np.int32(0)
            d = f.create_dataset(f"minc-2.0/dimensions/{axis}", data=data)
            d.attrs["spacing"] = np.bytes_("irregular" if axis == "time" else "regular__")
            d.attrs["start"], d.attrs["step"], d.attrs["length"] = *steps[axis], np.int32(count)
            d.attrs["units"] = np.bytes_("s" if axis == "time" else "mm")
        d = f.create_dataset("minc-2.0/image/0/image", data=image, chunks=(1, 3, 4, 5), compression="gzip")
        d.attrs["dimorder"], d.attrs["valid_range"] = np.bytes_(",".join(order)), np.array([0.0, 30000.0])
        for end, values in zip(("min", "max"), ends):
            f[f"minc-2.0/image/0/image-{end}"] = values
            f[f"minc-2.0/image/0/image-{end}"].attrs["dimorder"] = np.bytes_("time,zspace")
    index = np.stack(np.meshgrid(*[np.arange(n) for n in SHAPE], indexing="ij"), -1)
    # nibabel reads no irregular axis, even of time. The samples of both files are the same.
    found = nibabel.load(OUT / "minc1_times.mnc")
    for t, values in enumerate(found.get_fdata()):
        oracle(f"minc_times.t{t}", nibabel.affines.apply_affine(found.affine, index), values)


def emd():
    axis = lambda name, scale, offset, size: dict(
        _type="UniformDataAxis", name=name, scale=scale, offset=offset, size=size, units="nm", navigate=False
    )
    axes = [axis("z", 3.0, 5.0, 3), axis("y", 2.0, -4.0, 4), axis("x", 0.5, 1.0, 5)]
    signal = dict(data=RAMP.astype("u2"), axes=axes, metadata=dict(General=dict(title="it"), Signal={}), original_metadata={}, tmp_parameters={}, learning_results={}, attributes=dict(_lazy=False), package_info={}, models={})
    for name, write, read in (("ncem.emd", write_emd, read_emd), ("hyperspy.hspy", write_hspy, read_hspy)):
        (OUT / name).unlink(missing_ok=True)
        write(str(OUT / name), signal)
        (found,) = read(str(OUT / name))
        lines = {a["name"]: a["offset"] + a["scale"] * np.arange(a["size"]) for a in found["axes"]}
        order = [a["name"] for a in found["axes"]]
        oracle(name, along([(lines[n], "xyz".index(n)) for n in order]), found["data"])
    # Energies are no places.
    (OUT / "spectra.hspy").unlink(missing_ok=True)
    axes = [axis("y", 2.0, 0.0, 3), axis("x", 2.0, 0.0, 4), dict(axis("Energy", 0.1, 0.0, 5), units="eV")]
    write_hspy(str(OUT / "spectra.hspy"), dict(signal, axes=axes))
    (OUT / "py4dstem.h5").unlink(missing_ok=True)
    array = emdfile.Array(RAMP.astype("f4"), name="it", units="counts", dims=[2.0, 0.5, 0.25], dim_names=["z", "y", "x"], dim_units=["A"] * 3)
    emdfile.save(str(OUT / "py4dstem.h5"), array)
    found = emdfile.read(str(OUT / "py4dstem.h5"))
    found = found if isinstance(found, emdfile.Array) else found.tree("it")
    oracle("py4dstem.h5", along([(np.asarray(d), 2 - n) for n, d in enumerate(found.dims)]), found.data)


def tomviz():
    """As tomviz writes: dim1 is x, and slowest."""
    axes = [("x", 0.5, 3), ("y", 1.0, 4), ("z", 1.5, 5)]
    with h5py.File(OUT / "tomviz.emd", "w") as f:
        f.attrs["version_major"], f.attrs["version_minor"] = np.uint32(0), np.uint32(2)
        group = f.create_group("data/tomography")
        group.attrs["emd_group_type"] = np.uint32(1)
        group["data"] = RAMP.astype("f4")
        for n, (name, step, count) in enumerate(axes):
            line = group.create_dataset(f"dim{n + 1}", data=(step * np.arange(count)).astype("f4"))
            line.attrs["name"], line.attrs["units"] = np.bytes_(name), np.bytes_("[n_m]")
    oracle("tomviz.emd", along([(step * np.arange(count), n) for n, (_, step, count) in enumerate(axes)]), RAMP)


def velox():
    with h5py.File(OUT / "velox.emd", "w") as f:
        f["Version"] = np.array([b'{"format":"Velox","version":"1.0"}'])
        f["Data/Image/0123456789abcdef/Data"] = RAMP.astype("u2")


def cf(name, model):
    """What CF says of missing values and signs, of times, and of what is no volume."""
    with netCDF4.Dataset(OUT / name, "w", format=model) as f:
        f.set_fill_off()
        for axis, count in (("time", 1), ("z", 3), ("y", 4), ("x", 5), ("t", 3)):
            f.createDimension(axis, count)
        for axis, values in (("time", [7.5]), ("z", [0, 2, 4]), ("y", [0, 1, 2, 3]), ("x", range(5)), ("t", [0, 1, 2])):
            f.createVariable(axis, "f8", (axis,))[:] = list(values)
        f["time"].units = f["t"].units = "hours since 2000-01-01"
        space = ("z", "y", "x")
        two = f.createVariable("two", "i2", space, fill_value=-32767)
        two.scale_factor, two.add_offset, two.missing_value = 0.5, 10.0, np.array([-999, -998], "i2")
        wide = f.createVariable("wide", "i1", space, fill_value=-1)
        wide._Unsigned = "true"
        ranged = f.createVariable("ranged", "i2", space)
        ranged._Unsigned, ranged.scale_factor, ranged.valid_range = "true", 2.0, np.array([0, -2], "i2")
        record = f.createVariable("record", "f4", ("time", *space))
        scalar = f.createVariable("scalar", "f4", space)
        scalar.coordinates = "moment"
        moment = f.createVariable("moment", "f8", ())
        moment.units = "hours since 2000-01-01"
        moment[...] = 9.25
        times = f.createVariable("times", "f4", ("t", "y", "x"))
        faces = f.createVariable("faces", "f4", space)
        faces.mesh, faces.location = "mesh", "face"
        f.set_auto_maskandscale(False)
        stored = RAMP.astype("i2")
        stored[0, 0, :3] = -32767, -999, -998
        two[:] = stored
        wide[:] = (255 - 3 * RAMP).astype("u1").view("i1")
        ranged[:] = (65535 - 1000 * RAMP).astype("u2").view("i2")
        for v in (record, scalar, times, faces):
            v[:] = RAMP.reshape(v.shape)
    with xarray.open_dataset(OUT / name, decode_times=False) as found:
        world = along([(found[axis].values, 2 - n) for n, axis in enumerate(space)])
        for field in ("two", "wide"):
            oracle(f"{name}.{field}", world, found[field].values)
    with netCDF4.Dataset(OUT / name) as found:
        oracle(f"{name}.ranged", world, np.ma.filled(found["ranged"][:].astype("f8"), np.nan))


if __name__ == "__main__":
    OUT.mkdir(exist_ok=True)
    mincs()
    minc_times()
    emd()
    tomviz()
    velox()
    cf("cf3.nc", "NETCDF3_CLASSIC")
    cf("cf4.nc", "NETCDF4")
