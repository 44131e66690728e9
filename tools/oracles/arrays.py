"""Arrays with coordinates: HDF5 by h5py, NetCDF by netCDF4, SciPy and xarray, Zarr by zarr and tensorstore, NPY by NumPy."""

import h5py
import netCDF4
import numcodecs
import numpy as np
import scipy.io
import tensorstore
import xarray
import zarr
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec, GzipCodec, TransposeCodec, ZstdCodec

from placing import SHAPE, Case, Refused, along, grid, numbers, program

PLAIN = grid()
TYPES = "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8"
# Coordinates of x, y and z: regular, one of them falling, and uneven ones.
EVEN = -3.5 + 0.5 * np.arange(7), 10 - 1.25 * np.arange(6), 7 + 2.5 * np.arange(5)
UNEVEN = np.array([0, 0.5, 1.5, 3, 5, 7.5, 10.5]), EVEN[1], EVEN[2]


@program("numpy")
def npy(at):
    for n, dtype in enumerate((*TYPES, "f2")):
        for order in "<>":
            path, values = at / f"{dtype}{'lb'[order == '>']}.npy", numbers(order + dtype)
            np.save(path, np.asfortranarray(values) if n % 2 else values)
            yield Case(path, values, grid((0.5, 2, 3), (-1, -2, 10)), ("--spacing", "0.5,2,3", "--origin", "-1,-2,10"))
    a, b = numbers("f4"), numbers("i2")
    np.savez(at / "plain.npz", a=a, b=b)
    np.savez_compressed(at / "packed.npz", a=a, b=b)
    for name in "plain.npz", "packed.npz":
        yield Case(at / name, b, PLAIN, ("--field", "b"))
    a.tofile(at / "a.raw")
    yield Case(at / "a.raw", a, PLAIN, ("--dims", "7,6,5", "--type", "float32"))
    np.save(at / "complex.npy", a.astype("c8"))
    yield Refused(at / "complex.npy", "complex|c8")
    np.save(at / "object.npy", np.array([None] * 8).reshape(2, 2, 2), allow_pickle=True)
    yield Refused(at / "object.npy", "object|O")


@program("h5py")
def hdf5(at):
    ways = [
        {}, {"chunks": (2, 3, 4)}, {"compression": "gzip", "shuffle": True}, {"compression": "lzf", "fletcher32": True},
        {"compression": "szip"}, {"scaleoffset": 0},
    ]  # fmt: skip
    for n, dtype in enumerate((*TYPES, "f2")):
        for m, order in enumerate("<>"):
            for lib in "earliest", "latest":
                way = dict(ways[(n + 2 * m + (lib == "latest")) % len(ways)])
                if "scaleoffset" in way and (dtype[0] == "f" or order == ">"):
                    continue
                way |= {"chunks": (2, 3, 4)} if way else {}
                values = numbers(order + dtype)
                path = at / f"{dtype}{'lb'[m]}_{lib}.h5"
                with h5py.File(path, "w", libver=lib) as file:
                    file.create_group("a/b").create_dataset("v", data=values, **way)
                yield Case(path, values, PLAIN)
    with h5py.File(at / "scales.h5", "w") as file:
        v = file.create_dataset("v", data=numbers("f4"))
        for axis, (name, values) in enumerate(zip("zyx", EVEN[::-1])):
            file[name] = values
            file[name].make_scale(name)
            file[name].attrs["units"] = "mm"
            v.dims[axis].attach_scale(file[name])
    yield Case(at / "scales.h5", numbers("f4"), along(*EVEN), length="mm")
    with h5py.File(at / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout(SHAPE, "f4")
        layout[:] = h5py.VirtualSource(str(at / "scales.h5"), "v", SHAPE)
        file.create_virtual_dataset("v", layout)
    # Named by the number of its layout.
    yield Refused(at / "virtual.h5", "layout class 3|virtual")
    with h5py.File(at / "outside.h5", "w") as file:
        file.create_dataset("v", data=numbers("f4"), external=[("outside.bin", 0, h5py.h5f.UNLIMITED)])
    yield Refused(at / "outside.h5", "external|outside")
    with h5py.File(at / "compound.h5", "w") as file:
        file["v"] = np.zeros(SHAPE, [("a", "f4"), ("b", "f4")])
    yield Refused(at / "compound.h5", "compound|no dataset|number")
    with h5py.File(at / "empty.h5", "w") as file:
        part = file.create_dataset("v", SHAPE, "i2", chunks=(2, 3, 4), fillvalue=-7)
        part[:2] = numbers("i2")[:2]
        expected = part[:]
    yield Case(at / "empty.h5", expected, PLAIN)


KINDS = "NETCDF4", "NETCDF4_CLASSIC", "NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"


def dataset(path, kind, coordinates=EVEN, units="mm", order="zyx", names="zyx"):
    """A file with axes x, y and z, in an order."""
    file = netCDF4.Dataset(path, "w", format=kind)
    for axis in order:
        values = coordinates["xyz".index(axis)]
        name = names["zyx".index(axis)]
        file.createDimension(name, len(values))
        one = file.createVariable(name, "f8", (name,))
        one[:], one.units = values, units if isinstance(units, str) else units["xyz".index(axis)]
    return file


def as_read(path, name="v"):
    """Values as netCDF4 reads them: scaled, missing ones as NaN."""
    with netCDF4.Dataset(path) as file:
        return np.ma.filled(file[name][:].astype("f8"), np.nan)


@program("netcdf4")
def netcdf(at):
    for n, kind in enumerate(KINDS):
        short = f"{kind.lower()}"
        types = TYPES if "NETCDF4" == kind or "DATA" in kind else ("i1", "i2", "i4", "f4", "f8")
        for m, dtype in enumerate(types):
            path = at / f"{short}_{dtype}.nc"
            more = [{}, {"zlib": True, "shuffle": True}, {"compression": "zstd"}, {"fletcher32": True}][(n + m) % 4]
            with dataset(path, kind, UNEVEN if m % 2 else EVEN) as file:
                more = {} if "NETCDF4" not in kind else more
                v = file.createVariable(
                    "v", dtype, ("z", "y", "x"), fill_value=False if m % 3 or dtype in ("u1", "i1") else None, **more
                )
                v[:], v.units = numbers(dtype)[:], "K"
            # Bytes have no value that is missing, unless one is named; the package says otherwise.
            expected = numbers(dtype) if dtype in ("u1", "i1") else as_read(path)
            yield Case(path, expected, along(*(UNEVEN if m % 2 else EVEN)), unit="K", length="mm")
        path = at / f"{short}_packed.nc"
        with dataset(path, kind) as file:
            v = file.createVariable("v", "i2", ("z", "y", "x"), fill_value=-32768)
            v.scale_factor, v.add_offset, v.missing_value = 0.01, 273.15, np.int16(-32767)
            v.set_auto_maskandscale(False)
            v[:] = numbers("i2")
            v[1, 2, 3], v[4, 0, 0] = -32768, -32767
        yield Case(path, as_read(path), along(*EVEN))
        path = at / f"{short}_valid.nc"
        with dataset(path, kind) as file:
            v = file.createVariable("v", "f4", ("z", "y", "x"))
            v.valid_min, v.valid_max = np.float32(-2), np.float32(10)
            v[:] = numbers("f4")
        yield Case(path, as_read(path), along(*EVEN))
        path = at / f"{short}_unsigned.nc"
        with dataset(path, kind) as file:
            v = file.createVariable("v", "i1", ("z", "y", "x"), fill_value=False)
            v.setncattr("_Unsigned", "true")
            v.set_auto_maskandscale(False)
            v[:] = numbers("i1")
        yield Case(path, as_read(path), along(*EVEN))
        # The axes in another order: x slowest.
        path = at / f"{short}_turned.nc"
        with dataset(path, kind) as file:
            v = file.createVariable("v", "f4", ("x", "z", "y"))
            v[:] = numbers("f4", (7, 5, 6))
        yield Case(path, as_read(path).transpose(1, 2, 0), along(*EVEN))
        path = at / f"{short}_mixed.nc"
        with dataset(path, kind, units=("m", "km", "cm")) as file:
            file.createVariable("v", "f4", ("z", "y", "x"))[:] = numbers("f4")
        x, y, z = EVEN
        yield Case(path, as_read(path), along(x, 1000 * y, 0.01 * z), length="m")
        path = at / f"{short}_time.nc"
        with dataset(path, kind) as file:
            file.createDimension("time", None)
            time = file.createVariable("time", "f8", ("time",))
            time.units = "hours since 2020-01-01"
            v = file.createVariable("v", "f4", ("time", "z", "y", "x"))
            v[:] = numbers("f4", (3, *SHAPE))
            time[:] = [0, 1.5, 6]
            w = file.createVariable("w", "i2", ("time", "y", "x"))
            w[:] = numbers("i2", (3, 6, 7))
        yield Case(path, as_read(path), along(*EVEN), ("--field", "v"), (0, 1.5, 6), length="mm")
        path = at / f"{short}_one.nc"
        with dataset(path, kind) as file:
            file.createDimension("time", None)
            time = file.createVariable("time", "f8", ("time",))
            time.units = "hours since 2020-01-01"
            v = file.createVariable("v", "f4", ("time", "z", "y", "x"))
            v[:], time[:] = numbers("f4", (1, *SHAPE)), [3]
        yield Case(path, as_read(path), along(*EVEN), ("--field", "v"), (3,), length="mm")


@program("scipy")
def scipy_files(at):
    for version in 1, 2:
        for m, dtype in enumerate(("i1", "i2", "i4", "f4", "f8")):
            path = at / f"v{version}_{dtype}.nc"
            coordinates = UNEVEN if m % 2 else EVEN
            with scipy.io.netcdf_file(path, "w", version=version) as file:
                for name, values in zip("xyz", coordinates):
                    file.createDimension(name, len(values))
                    one = file.createVariable(name, "f8", (name,))
                    one[:], one.units = values, "m"
                v = file.createVariable("v", dtype, ("z", "y", "x"))
                # -127, -32767 and such are what the library writes where nothing was written.
                v[:], v.units = numbers(dtype) // 2 if dtype[0] == "i" else numbers(dtype), "K"
                expected = v[:].copy()
            yield Case(path, expected, along(*coordinates), unit="K", length="m")
    scipy.io.savemat(at / "old.mat", {"v": numbers("f4")})
    yield Refused(at / "old.mat", "MATLAB")


@program("xarray", "h5netcdf")
def xarray_files(at):
    x, y, z = EVEN
    values = numbers("f8")
    one = xarray.DataArray(values, {"z": z, "y": y, "x": x}, ("z", "y", "x"), "v", {"units": "K"})
    for axis in "xyz":
        one[axis].attrs["units"] = "um"
    packed = {"v": {"dtype": "i2", "scale_factor": 0.001, "add_offset": 4.0, "_FillValue": -32768}}
    holes = one.where(one < 10).to_dataset()
    for engine in "scipy", "netcdf4", "h5netcdf":
        one.to_netcdf(at / f"{engine}.nc", engine=engine)
        yield Case(at / f"{engine}.nc", values, along(*EVEN), unit="K", length="um")
        path = at / f"{engine}_packed.nc"
        holes.to_netcdf(path, engine=engine, encoding=packed)
        yield Case(path, xarray.load_dataset(path, engine=engine).v.values, along(*EVEN), unit="K", length="um")
    for version in 2, 3:
        one.to_dataset().to_zarr(at / f"v{version}.zarr", zarr_format=version)
        yield Case(at / f"v{version}.zarr", values, along(*EVEN), unit="K", length="um")
        path = at / f"packed{version}.zarr"
        holes.to_zarr(path, encoding=packed, zarr_format=version)
        yield Case(path, xarray.open_zarr(path).v.values, along(*EVEN), unit="K", length="um")
    moments = np.array(["2020-01-01", "2020-01-01T06:00", "2020-01-02"], "datetime64[ns]")
    series = xarray.concat([one, one + 1, one * 2], xarray.DataArray(moments, dims="time", name="time"))
    series = series.transpose("z", "time", "y", "x")
    hours = {"time": {"units": "hours since 2020-01-01", "dtype": "f8"}}
    expected = series.transpose("time", "z", "y", "x").values
    for name in "netcdf4", "h5netcdf":
        series.to_dataset(name="v").to_netcdf(at / f"{name}_time.nc", engine=name, encoding=hours)
        yield Case(at / f"{name}_time.nc", expected, along(*EVEN), ("--field", "v"), (0, 6, 24))
    series.to_dataset(name="v").to_zarr(at / "time.zarr", encoding=hours, zarr_format=2)
    yield Case(at / "time.zarr", expected, along(*EVEN), ("--field", "v"), (0, 6, 24))


@program("zarr", "numcodecs")
def zarr_files(at):
    old = [
        None, numcodecs.Zlib(5), numcodecs.GZip(), numcodecs.Zstd(), numcodecs.LZ4(), numcodecs.Blosc("lz4", shuffle=1),
        numcodecs.Blosc("zstd", shuffle=2), numcodecs.Blosc("blosclz", shuffle=0), numcodecs.Blosc("zlib"), numcodecs.Blosc("lz4hc"),
    ]  # fmt: skip
    for n, dtype in enumerate((*TYPES, "f2")):
        for m, order in enumerate("<>"):
            path, values = at / f"v2_{dtype}{'lb'[m]}.zarr", numbers(order + dtype)
            one = zarr.create_array(
                path, shape=SHAPE, dtype=order + dtype, chunks=(2, 3, 4), compressors=old[(2 * n + m) % len(old)],
                zarr_format=2, order="CF"[(n + m) % 2],
                chunk_key_encoding={"name": "v2", "separator": "./"[n % 2]},
            )  # fmt: skip
            one[:] = values
            yield Case(path, one[:], PLAIN)
    new = [
        [BytesCodec(endian="big")], [BytesCodec(), GzipCodec()], [BytesCodec(), ZstdCodec(checksum=True), Crc32cCodec()],
        [BytesCodec(), BloscCodec(cname="zstd", shuffle="bitshuffle")], [TransposeCodec(order=(2, 0, 1)), BytesCodec(), ZstdCodec()],
    ]  # fmt: skip
    for n, dtype in enumerate((*TYPES, "f2")):
        path, values = at / f"v3_{dtype}.zarr", numbers(dtype)
        codecs = new[n % len(new)]
        shards = n % 2
        filters = [c for c in codecs if isinstance(c, TransposeCodec)]
        serial = next(c for c in codecs if isinstance(c, BytesCodec))
        rest = [c for c in codecs if c not in filters and c is not serial]
        one = zarr.create_array(
            path, shape=SHAPE, dtype=dtype, chunks=(2, 3, 4), shards=(4, 6, 8) if shards else None, filters=filters,
            serializer=serial, compressors=rest, zarr_format=3, dimension_names=("z", "y", "x"),
        )  # fmt: skip
        one[:] = values
        yield Case(path, one[:], PLAIN)
    part = zarr.create_array(at / "part.zarr", shape=SHAPE, dtype="i2", chunks=(2, 3, 4), fill_value=-7, zarr_format=3)
    part[:2] = numbers("i2")[:2]
    yield Case(at / "part.zarr", part[:], PLAIN)
    with zarr.storage.ZipStore(at / "a.zarr.zip", mode="w") as store:
        zarr.create_array(store, data=numbers("u2"), chunks=(2, 3, 4))
    yield Case(at / "a.zarr.zip", numbers("u2"), PLAIN)
    for name, codec in ("bz2", numcodecs.BZ2()), ("lzma", numcodecs.LZMA()):
        zarr.create_array(at / f"{name}.zarr", data=numbers("u2"), compressors=codec, zarr_format=2)
        yield Refused(at / f"{name}.zarr", name)
    for name, codec in ("delta", numcodecs.Delta("<u2")), ("fixedscaleoffset", numcodecs.FixedScaleOffset(0, 1, "<u2")):
        zarr.create_array(at / f"{name}.zarr", data=numbers("u2"), filters=codec, zarr_format=2)
        yield Refused(at / f"{name}.zarr", name)


@program("tensorstore")
def tensorstores(at):
    base = {"driver": "file"}
    for order in "<", ">":
        path = at / f"zarr{'lb'[order == '>']}"
        spec = {
            "driver": "zarr", "kvstore": {**base, "path": str(path)},
            "metadata": {"shape": SHAPE, "chunks": [2, 4, 3], "dtype": order + "i2", "compressor": {"id": "zstd", "level": 3}},
        }  # fmt: skip
        tensorstore.open(spec, create=True).result()[:] = numbers("i2")
        yield Case(path, numbers("i2"), PLAIN)
    inner = [
        {"name": "transpose", "configuration": {"order": [2, 1, 0]}}, {"name": "bytes", "configuration": {"endian": "little"}},
        {"name": "blosc", "configuration": {"cname": "lz4", "clevel": 5, "shuffle": "shuffle", "typesize": 4, "blocksize": 0}},
    ]  # fmt: skip
    for place in "start", "end":
        shard = {"chunk_shape": [2, 3, 4], "codecs": inner, "index_location": place}
        spec = {
            "driver": "zarr3", "kvstore": {**base, "path": str(at / place)},
            "metadata": {
                "shape": SHAPE, "data_type": "float32",
                "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [4, 6, 8]}},
                "codecs": [{"name": "sharding_indexed", "configuration": shard}],
            },
        }  # fmt: skip
        tensorstore.open(spec, create=True).result()[:] = numbers("f4")
        yield Case(at / place, numbers("f4"), PLAIN)
    spec = {
        "driver": "n5", "kvstore": {**base, "path": str(at / "n5")},
        "metadata": {"dimensions": [7, 6, 5], "blockSize": [4, 3, 2], "dataType": "uint16", "compression": {"type": "gzip"}},
    }  # fmt: skip
    tensorstore.open(spec, create=True).result()[:] = numbers("u2").T
    yield Refused(at / "n5", "N5")
    spec = {
        "driver": "neuroglancer_precomputed", "kvstore": {**base, "path": str(at / "precomputed")},
        "multiscale_metadata": {"type": "image", "data_type": "uint16", "num_channels": 1},
        "scale_metadata": {"size": [7, 6, 5], "resolution": [4, 4, 40], "encoding": "raw", "chunk_size": [4, 3, 2]},
    }  # fmt: skip
    tensorstore.open(spec, create=True).result()[..., 0] = numbers("u2").T
    yield Refused(at / "precomputed", "neuroglancer|precomputed")
