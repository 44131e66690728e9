#!/usr/bin/env python3
"""Writes tests/data/*.h5, *.hdf, *.mat, *.mnc, *.ims and *.nc, small HDF5 and NetCDF-4 files for the tests of src/io/formats/volume/hdf5.

Needs h5py, hdf5plugin, netCDF4 and numpy. Sample (z, y, x) of each dataset is its index in C order, unless said otherwise.
Usage: tools/make_golden_hdf5.py
"""
from pathlib import Path

import h5py
import hdf5plugin as plugin
import netCDF4
import numpy as np

OUT = Path(__file__).resolve().parent.parent / "tests" / "data"
RAMP = np.arange(3 * 4 * 5).reshape(3, 4, 5)
FILTERS = dict(chunks=(2, 3, 2), compression="gzip", shuffle=True, fletcher32=True)


def types(version):
    with h5py.File(OUT / f"types_{version}.h5", "w", libver=version) as f:
        g = f.create_group("group")
        for t in ("<f4", "<f8", "<i2", "|u1", "<u2", "|i1", "<i4", "<u4", "<i8", "<u8", ">f4", ">f8", ">i2", ">u4"):
            name = t.replace("<", "").replace("|", "").replace(">", "big_")
            g.create_dataset(name, data=RAMP.astype(t))
            g.create_dataset(name + "_chunks", data=RAMP.astype(t), **FILTERS)
        f["again"] = h5py.SoftLink("/group/i2")
        f["root"] = h5py.SoftLink("/")


def user_block():
    with h5py.File(OUT / "user_block.mat", "w", userblock_size=512) as f:
        f.create_dataset("mapped", data=RAMP.astype("<i2"))
        f.create_dataset("chunks", data=RAMP.astype(">i2"), **FILTERS)
    with open(OUT / "user_block.mat", "r+b") as f:
        f.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + bytes(4))


def virtual():
    layout = h5py.VirtualLayout(RAMP.shape, "<i2")
    layout[:] = h5py.VirtualSource("parts.h5", "ramp", RAMP.shape)
    with h5py.File(OUT / "virtual.h5", "w", libver="latest") as f:
        f.create_virtual_dataset("entry/data", layout)
        f["entry/own"] = RAMP.astype("<i2")


def layouts(version):
    with h5py.File(OUT / f"layouts_{version}.h5", "w", libver=version) as f:
        i2 = RAMP.astype("<i2")
        f.create_dataset("unlimited", data=i2, maxshape=(None, 4, 5), chunks=(2, 3, 5))
        f.create_dataset("unlimited2", data=i2, maxshape=(None, None, 5), chunks=(2, 3, 5))
        f.create_dataset("one", data=i2, chunks=(3, 4, 5))
        f.create_dataset("lzf", data=i2, chunks=(3, 4, 5), compression="lzf")
        f.create_dataset("scaleoffset", data=i2, chunks=(2, 3, 4), scaleoffset=0)
        f.create_dataset("four", data=i2.reshape(1, 3, 4, 5))
        f.create_dataset("frames", data=np.stack([i2 - 7, i2]))
        f.create_dataset("frames_chunks", data=np.stack([i2 - 7, i2]), chunks=(1, 2, 3, 5))
        # Never written: -5. Written in part: 1 in the first chunk, then -5.
        f.create_dataset("empty", shape=(3, 4, 5), dtype="<f4", fillvalue=-5)
        part = f.create_dataset("part", shape=(3, 4, 5), dtype="<f4", chunks=(2, 2, 2), fillvalue=-5)
        part[0:2, 0:2, 0:2] = 1
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_layout(h5py.h5d.COMPACT)
        space = h5py.h5s.create_simple(RAMP.shape)
        compact = h5py.h5d.create(f.id, b"compact", h5py.h5t.STD_I16LE, space, plist)
        compact.write(h5py.h5s.ALL, h5py.h5s.ALL, i2)
        # Not read, each for its reason.
        f.create_dataset("complex", data=RAMP.astype("c8"))
        f.create_dataset("text", data=np.full((2, 2, 2), b"abc"))
        f.create_dataset("boolean", data=RAMP % 2 == 0)
        f.create_dataset("five", data=i2.reshape(3, 1, 4, 5, 1))
        two = f.create_dataset("two_missing", data=i2)
        two.attrs["_FillValue"] = np.int16(1)
        two.attrs["missing_value"] = np.int16(2)


def filters():
    """Each filter that is a plugin: sample (z, y, x) is 1000 + 20 x + 7 z + (13 y + 5 x) mod 17, or an eighth of it."""
    z, y, x = np.indices((9, 10, 13))
    u2 = (1000 + 20 * x + 7 * z + (13 * y + 5 * x) % 17).astype("<u2")
    f4 = (u2 / 8).astype("<f4")
    with h5py.File(OUT / "filters.h5", "w", libver="latest") as f:

        def put(name, data, chunks=(5, 10, 13), **how):
            f.create_dataset(name, data=data, chunks=chunks, **how)

        put("lzf", u2, compression="lzf")
        put("lzf_all", u2, compression="lzf", shuffle=True, fletcher32=True)
        put("lz4", u2, **plugin.LZ4())
        put("lz4_blocks", f4, **plugin.LZ4(nbytes=512))
        put("zstd", f4, **plugin.Zstd())
        put("zstd_shuffle", u2, shuffle=True, **plugin.Zstd())
        for name in ("none", "lz4", "zstd"):
            put("bitshuffle_" + name, u2, **plugin.Bitshuffle(cname=name))
            put("bitshuffle_f4_" + name, f4, **plugin.Bitshuffle(nelems=64, cname=name))
        for name in ("blosclz", "lz4", "lz4hc", "zlib", "zstd"):
            for shuffle in (0, 1, 2):
                put(f"blosc_{name}_{shuffle}", u2, **plugin.Blosc(cname=name, shuffle=shuffle))
                put(f"blosc2_{name}_{shuffle}", u2, **plugin.Blosc2(cname=name, filters=shuffle))
        put("blosc2_f4", f4, **plugin.Blosc2())
        put("blosc2_delta", u2, **plugin.Blosc2(cname="zstd", filters=plugin.Blosc2.DELTA))
        # Blocks that are boxes, the last ones padded.
        put("blosc2_boxes", np.tile(f4, (4, 4, 4)), (36, 40, 52), **plugin.Blosc2(cname="zstd"))
        zeros = np.zeros((9, 10, 13), "<f4")
        put("blosc2_zeros", zeros, **plugin.Blosc2())
        zeros[:] = np.nan
        put("blosc2_nan", zeros, **plugin.Blosc2())
        zeros[:] = 3
        put("blosc2_same", zeros, **plugin.Blosc2())
        # Not read, and named.
        put("zfp", f4, **plugin.Zfp())
    # Seeds of the fuzzer.
    small = u2[:4, :5, :7]
    for name, how in (
        ("lzf", dict(chunks=small.shape, compression="lzf")),
        ("lz4", plugin.LZ4()),
        ("bits", plugin.Bitshuffle(nelems=64)),
        ("blosc", plugin.Blosc()),
        ("blosc2", plugin.Blosc2(cname="zstd")),
    ):
        with h5py.File(OUT / f"filter_{name}.h5", "w", libver="latest") as f:
            f.create_dataset(name, data=small, **how)


def chunks():
    """(z, y, x) of 48 x 52 x 56 in chunks of 16, of which one was never written: 7. See src/pipeline/reduce/cached/tests.rs."""
    z, y, x = np.ogrid[0:48, 0:52, 0:56]
    values = (x * (55 - x) + 2 * y * (51 - y) + 3 * z * (47 - z)) // 64 * 64
    with h5py.File(OUT / "chunks.h5", "w", libver="latest") as f:
        filters = dict(chunks=(16, 16, 16), compression="gzip", compression_opts=9, shuffle=True, fillvalue=7)
        data = f.create_dataset("data", shape=values.shape, dtype="<u2", **filters)
        for chunk in data.iter_chunks():
            if tuple(s.start for s in chunk) != (16, 32, 16):
                data[chunk] = values[chunk]


def netcdf():
    with netCDF4.Dataset(OUT / "grid.nc", "w") as f:
        for name, count, start, step in (("lev", 3, 100, 10), ("lat", 4, 5, -2.5), ("lon", 5, 0, 0.5)):
            f.createDimension(name, count)
            f.createVariable(name, "f4", (name,))[:] = start + step * np.arange(count)
        f["lev"][2] = 150  # not regular
        v = f.createVariable("temp", "i2", ("lev", "lat", "lon"), zlib=True, fill_value=-999, chunksizes=(2, 3, 5))
        v.set_auto_maskandscale(False)
        v.scale_factor, v.add_offset = 0.5, 10.0
        v[:] = RAMP
        v[0, 0, 1] = -999
        f.createDimension("bare", 5)
        f.createVariable("plain", "f4", ("lev", "lat", "bare"))[:] = RAMP


def fills():
    # Samples that were never written, of variables that name no fill value of their own.
    with netCDF4.Dataset(OUT / "netcdf4_fill.h5", "w") as f:
        for name, size in (("z", 4), ("y", 3), ("x", 2)):
            f.createDimension(name, size)
        for name, kind in (("single", "f4"), ("short", "i2"), ("byte", "i1")):
            f.createVariable(name, kind, ("z", "y", "x"))[:2] = np.arange(12).reshape(2, 3, 2)


def small():
    """One field, so that it is read without a choice: what tools/dev/fuzz damages."""
    with h5py.File(OUT / "hdf5_small.h5", "w", libver="latest") as f:
        f.create_dataset("v", data=RAMP.astype("<i2"), **FILTERS)


def dialects():
    """Conventions of other programs, as they write them."""
    ramp = RAMP.astype("<u2")
    with h5py.File(OUT / "vtkhdf.hdf", "w", libver="latest") as f:
        g = f.create_group("VTKHDF")
        g.attrs.create("Type", b"ImageData", dtype="S9")
        g.attrs["Version"] = np.array([2, 3])
        g.attrs["WholeExtent"] = np.array([2, 6, 0, 3, 0, 2])
        g.attrs["Origin"] = np.array([10.0, 20.0, 30.0])
        g.attrs["Spacing"] = np.array([0.5, 0.25, 2.0])
        g.attrs["Direction"] = np.array([0.0, -1, 0, 1, 0, 0, 0, 0, 1])
        g.create_dataset("PointData/heat", data=ramp)
        g.create_dataset("PointData/flow", data=np.zeros((3, 4, 5, 3), "<f4"))
        g.create_dataset("CellData/mass", data=np.arange(24, dtype="<f4").reshape(2, 3, 4))
    with h5py.File(OUT / "vtkhdf_mesh.hdf", "w", libver="latest") as f:
        g = f.create_group("VTKHDF")
        g.attrs.create("Type", b"UnstructuredGrid", dtype="S16")
        g.attrs["Version"] = np.array([2, 6])
        g["NumberOfPoints"], g["NumberOfCells"], g["NumberOfConnectivityIds"] = [4, 5], [1, 2], [4, 8]
        tetrahedron = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
        pyramid = [[2, 0, 0], [3, 0, 0], [3, 1, 0], [2, 1, 0], [2, 0, 1]]
        g.create_dataset("Points", data=np.array(tetrahedron + pyramid, "<f4"), chunks=(4, 3), compression="gzip")
        g["Connectivity"] = [0, 1, 2, 3] + [0, 1, 2, 0, 1, 2, 3, 4]
        g["Offsets"], g["Types"] = [0, 4] + [0, 3, 8], np.array([10, 5, 14], "u1")
        g["PointData/flow"] = np.arange(27, dtype="<f4").reshape(9, 3)
        heat = g.create_dataset("PointData/heat", data=np.arange(9.0))
        heat.attrs.create("Attribute", b"Scalars", dtype="S7")
        g["PointData/label"] = np.array([b"a"] * 9)
        g["CellData/mass"] = np.array([1, 2, 3], "<i4")
    with h5py.File(OUT / "imaris.ims", "w", libver="latest") as f:
        f.attrs["ImarisDataSet"] = np.bytes_("ImarisDataSet")
        f.create_dataset("DataSet/ResolutionLevel 0/TimePoint 0/Channel 0/Data", data=ramp)
    with h5py.File(OUT / "minc.mnc", "w", libver="latest") as f:
        for name, start, step, cosines in (
            ("xspace", -10, 7, (0, 1, 0)), ("yspace", 20, -8, (-1, 0, 0)), ("zspace", 30, 9, (0, 0, 1)),
        ):
            d = f.create_dataset(f"minc-2.0/dimensions/{name}", data=np.int32(0))
            d.attrs["start"], d.attrs["step"], d.attrs["direction_cosines"] = float(start), float(step), np.array(cosines, float)
            d.attrs["spacing"] = np.bytes_("regular__")
        image = f.create_dataset("minc-2.0/image/0/image", data=ramp, chunks=(2, 3, 5), compression="gzip")
        image.attrs["dimorder"] = np.bytes_("yspace,zspace,xspace")
        image.attrs["valid_range"] = np.array([0.0, 50.0])
        f["minc-2.0/image/0/image-min"] = np.array([0.0, 100.0, 200.0])
        f["minc-2.0/image/0/image-max"] = np.array([50.0, 200.0, 300.0])
    with h5py.File(OUT / "itk.h5", "w", libver="latest") as f:
        f["ITKImage/0/VoxelData"] = ramp
        f["ITKImage/0/Origin"] = np.array([1.0, 2.0, 3.0])
        f["ITKImage/0/Spacing"] = np.array([0.5, 0.25, 2.0])
        f["ITKImage/0/Directions"] = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    with h5py.File(OUT / "axes.h5", "w", libver="latest") as f:
        f.create_dataset("sized", data=ramp).attrs["element_size_um"] = np.array([2.0, 0.5, 0.25])
        f["vectors"] = np.zeros((6, 6, 6, 3), "<f4")
        f.create_dataset("fortran", data=ramp)
        for axis, label in enumerate("xyz"):
            f["fortran"].dims[axis].label = label
        f.create_dataset("channels", data=np.stack([RAMP, RAMP + 100]).astype("<u2"))
        for axis, label in enumerate("czyx"):
            f["channels"].dims[axis].label = label
        g = f.create_group("entry")
        g.attrs["NX_class"] = "NXdata"
        g.attrs["signal"] = "counts"
        g.attrs["axes"] = ["z", "y", "x"]
        g["counts"], g["z"] = ramp, np.arange(3) * 2.0 + 1
        g["y"], g["x"] = np.arange(4) * 0.5, np.arange(5) * 0.25
    with netCDF4.Dataset(OUT / "levels.nc", "w") as f:
        for name, values in (("time", [0, 6, 18]), ("lev", [1000, 925, 700]), ("lat", [30, 20, 10, 0]), ("lon", range(5))):
            f.createDimension(name, len(values))
            f.createVariable(name, "f4", (name,))[:] = list(values)
        f["time"].units = "hours since 2000-01-01"
        v = f.createVariable("temp", "i2", ("time", "lev", "lat", "lon"), fill_value=-999)
        v.set_auto_maskandscale(False)
        v.scale_factor, v.valid_range = 0.5, np.array([0, 1000], "i2")
        v[:] = np.stack([RAMP, RAMP + 100, RAMP + 200])
        v[1, 0, 0, 0] = 2000
        w = f.createVariable("wind", "f4", ("lev", "lat", "lon"))
        w[:] = RAMP


def units():
    """Units of values, coordinates and times; and a name that would colour a terminal."""
    with netCDF4.Dataset(OUT / "units.nc", "w") as f:
        for axis, values in (("time", [0, 6]), ("z", [0, 10, 20]), ("y", [0, 1, 2, 3]), ("x", [0, 2, 4, 6, 8]), ("lat", [0, 1, 2, 3])):
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
    with h5py.File(OUT / "units.h5", "w", libver="latest") as f:
        f.create_dataset("sized", data=RAMP.astype("<i2")).attrs["element_size_um"] = np.array([2.0, 0.5, 0.25])
        g = f.create_group("entry")
        g.attrs["NX_class"], g.attrs["signal"], g.attrs["axes"] = "NXdata", "counts", ["z", "y", "x"]
        g["counts"], g["z"] = RAMP.astype("<i2"), np.arange(3) * 2.0 + 1
        g["y"], g["x"] = np.arange(4) * 0.5, np.arange(5) * 0.25
        g["counts"].attrs["units"] = "counts"
        for axis in "xyz":
            g[axis].attrs["units"] = "um"


if __name__ == "__main__":
    OUT.mkdir(parents=True, exist_ok=True)
    for version in ("earliest", "latest"):
        types(version)
        layouts(version)
    chunks()
    filters()
    netcdf()
    fills()
    small()
    dialects()
    units()
    user_block()
    virtual()
