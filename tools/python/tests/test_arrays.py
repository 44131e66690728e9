"""Arrays of any kind give the archive that their samples in a file give."""

import pickle
import re
import tempfile
from pathlib import Path

import dask.array
import h5py
import numpy as np
import pytest
import xarray
import zarr
from conftest import field
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import isospan

TYPES = ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8"]


def made(array, folder, called, **choices):
    choices = {"points": "regular", "fraction": "1/4", "force": True, **choices}
    return isospan.reduce(array, folder / f"{called}.isospan", **choices)


def expect_same(a, b):
    """The same points, tetrahedra, values and errors. Files differ: they have the hash of the
    source."""
    assert (a.range, a.dims, a.spacing, a.origin) == (b.range, b.dims, b.spacing, b.origin)
    assert a.info["error"] == b.info["error"]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder, name) for name in ("a.vtu", "b.vtu")]
        for archive, file in zip((a, b), files):
            archive.save_tetrahedra(file)
        # A comment names the source, and attributes the field.
        rest = [file.read_bytes().partition(b"-->")[2].partition(b"<AppendedData") for file in files]
        rest = [(re.sub(rb'(Name|Scalars)="[^"]*"', b"", r[0]), r[2]) for r in rest]
        assert rest[0] == rest[1] and rest[0][1]


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The archive of the field, from a file."""
    folder = tmp_path_factory.mktemp("expected")
    np.save(folder / "field.npy", field())
    return made(folder / "field.npy", folder, "expected")


def test_an_array_is_what_its_file_is(expected, tmp_path):
    expect_same(made(field(), tmp_path, "a"), expected)
    info = made(field(), tmp_path, "named", name="density").info
    assert info["source"] == "density" and info["dims"] == [20, 24, 18]


@pytest.mark.parametrize(
    "layout",
    [
        np.asfortranarray,
        lambda a: a[::-1, ::-1, ::-1].copy()[::-1, ::-1, ::-1],
        lambda a: np.repeat(np.repeat(a, 2, 0), 3, 2)[::2, :, ::3],
        lambda a: a.astype(">f4"),
        lambda a: a.transpose(1, 2, 0).copy().transpose(2, 0, 1),
    ],
    ids=["fortran", "flipped", "steps", "big-endian", "transposed"],
)
def test_layouts(expected, tmp_path, layout):
    expect_same(made(layout(field()), tmp_path, "a"), expected)


def test_memory_mapped_files(expected, tmp_path):
    np.save(tmp_path / "field.npy", field())
    expect_same(made(np.load(tmp_path / "field.npy", mmap_mode="r"), tmp_path, "a"), expected)


@settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_array(tmp_path, data):
    kind = np.dtype(data.draw(st.sampled_from(TYPES))).newbyteorder(
        data.draw(st.sampled_from("<>"))
    )
    shape = tuple(data.draw(st.integers(2, 9)) for _ in range(3))
    if kind.kind == "f":
        elements = st.floats(-1e6, 1e6, width=8 * kind.itemsize)
    else:
        reach = np.iinfo(kind)
        elements = st.integers(max(reach.min, -(2**20)), min(reach.max, 2**20))
    steps = [data.draw(st.sampled_from([1, 2, -1, -3])) for _ in range(3)]
    axes = data.draw(st.permutations(range(3)))
    whole = data.draw(
        arrays.arrays(
            kind, [shape[a] * abs(steps[a]) for a in axes], elements=elements, fill=elements
        )
    )
    array = whole.transpose(np.argsort(axes))[tuple(slice(None, None, s) for s in steps)]
    assert array.shape == shape
    np.save(tmp_path / "a.npy", np.ascontiguousarray(array))
    choices = {"fraction": 1, "points": "regular", "values": "sample"}
    with_file = _outcome(tmp_path / "a.npy", tmp_path, "file", choices)
    with_array = _outcome(array, tmp_path, "array", choices)
    if isinstance(with_file, str):
        assert isinstance(with_array, str)
        return
    expect_same(with_array, with_file)


def _outcome(source, folder, name, choices):
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return made(source, folder, name, **choices)
        except isospan.Error as error:
            return type(error).__name__


def test_zarr_h5py_and_dask(expected, tmp_path):
    stored = zarr.create_array(
        tmp_path / "f.zarr", shape=field().shape, chunks=(5, 7, 20), dtype="f4"
    )
    stored[:] = field()
    expect_same(made(stored, tmp_path, "zarr"), expected)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        packed = file.create_dataset("packed", data=field(), chunks=(4, 24, 9), compression="gzip")
        plain = file.create_dataset("plain", data=field())
        expect_same(made(packed, tmp_path, "h5py"), expected)
        expect_same(made(plain, tmp_path, "plain"), expected)
        assert made(packed, tmp_path, "h5py").steps[0]["field"] == "packed"
    lazy = dask.array.from_array(field(), chunks=((5, 13), (24,), (7, 7, 6)))
    expect_same(made(lazy, tmp_path, "dask", scratch=tmp_path), expected)
    assert not list(tmp_path.glob("isospan-array-*"))


def test_each_chunk_of_a_dask_array_is_computed_once(tmp_path):
    seen = []

    def block(block_info=None):
        seen.append(tuple(block_info[None]["chunk-location"]))
        return np.full((8, 8, 8), sum(block_info[None]["chunk-location"]), np.float32)

    lazy = dask.array.map_blocks(
        block, chunks=((8,) * 3,) * 3, dtype=np.float32, meta=np.array((), np.float32)
    )
    made(lazy, tmp_path, "a")
    assert sorted(seen) == sorted(set(seen)) and len(seen) == 27


def test_boxes_are_whole_chunks_of_bounded_size(monkeypatch):
    from isospan import _sources

    monkeypatch.setattr(_sources, "_BOX_BYTES", 4 * 10 * 22 * 40)
    lazy = dask.array.zeros((100, 50, 40), chunks=(10, 7, 20), dtype="f4")
    z, y, x = _sources._steps(lazy, 4)
    assert x == [(0, 40)]
    assert y == [(0, 21), (21, 42), (42, 50)]
    assert z == [(n, n + 10) for n in range(0, 100, 10)]


def test_other_types_of_samples(tmp_path):
    half = made(field().astype(np.float16), tmp_path, "half")
    np.save(tmp_path / "half.npy", field().astype(np.float16))
    expect_same(half, made(tmp_path / "half.npy", tmp_path, "file"))
    inside = field() > 0.25
    np.save(tmp_path / "inside.npy", inside.astype(np.uint8))
    expect_same(made(inside, tmp_path, "bool"), made(tmp_path / "inside.npy", tmp_path, "bytes"))
    for bad in (
        field().astype(complex),
        field().astype("O"),
        field()[0],
        np.ma.masked_less(field(), 0),
    ):
        with pytest.raises(isospan.UsageError):
            made(bad, tmp_path, "bad")
    with pytest.raises(isospan.UsageError, match="not a dict"):
        made({}, tmp_path, "bad")
    with pytest.raises(isospan.UsageError, match="for files"):
        made(field(), tmp_path, "bad", field="density")
    with pytest.raises(isospan.UsageError, match="for arrays"):
        made(tmp_path / "half.npy", tmp_path, "bad", name="density")


def test_places(tmp_path):
    archive = made(field(), tmp_path, "a", spacing=(0.5, 2, 1), origin=(10, 0, -5))
    assert archive.spacing == (0.5, 2, 1) and archive.origin == (10, 0, -5)
    z, y, x = (9, 12, 10)
    exact = made(
        field(), tmp_path, "b", spacing=(0.5, 2, 1), origin=(10, 0, -5), points="regular", fraction=1, values="sample"
    )
    found = exact.probe([10 + 0.5 * x, 2 * y, -5 + z])[0]
    assert abs(found - field()[z, y, x]) < 0.05


def test_a_surface_far_from_zero_has_doubles(tmp_path):
    places = {"near": (0, 0, 0), "far": (448_262.25, 5_411_932.5, 310)}
    surfaces = {}
    for name, origin in places.items():
        archive = made(field(), tmp_path, name, spacing=(0.01,) * 3, origin=origin, points="regular", fraction=1)
        surfaces[name] = archive.surface(sum(archive.range) / 2)
    near, far = surfaces["near"], surfaces["far"]
    assert (near.vertices.dtype, far.vertices.dtype) == (np.float32, np.float64)
    np.testing.assert_allclose(far.vertices - places["far"], near.vertices, atol=1e-7)
    again = pickle.loads(pickle.dumps(far))
    np.testing.assert_array_equal(again.vertices, far.vertices)
    far.save(tmp_path / "far.vtp")
    assert b'type="Float64" Name="Points"' in (tmp_path / "far.vtp").read_bytes()
    with pytest.raises(ValueError):
        far.vertices[0] = 0


def test_xarray(expected, tmp_path):
    nz, ny, nx = field().shape
    coords = {"z": 5.0 + 2 * np.arange(nz), "y": np.arange(ny), "x": np.linspace(-1, 1, nx)}
    data = xarray.DataArray(field(), dims=("z", "y", "x"), coords=coords, name="density")
    archive = made(data, tmp_path, "a")
    assert archive.origin == (-1, 0, 5) and archive.info["source"] == "density"
    np.testing.assert_allclose(archive.spacing, (2 / (nx - 1), 1, 2))
    # Names tell the axes, in whatever order they are.
    turned = made(data.transpose("x", "z", "y"), tmp_path, "turned")
    expect_same(turned, archive)
    lazy = made(data.chunk({"z": 5}), tmp_path, "lazy")
    np.testing.assert_array_equal(lazy.surface(0.25).vertices, archive.surface(0.25).vertices)
    # A coordinate that goes down: the same places have the same values.
    down = made(data[::-1], tmp_path, "down", points="regular", fraction=1, values="sample")
    up = made(data, tmp_path, "up", points="regular", fraction=1, values="sample")
    place = [(-1 + 2 * 6 / (nx - 1), 7, 5 + 2 * 4)]
    np.testing.assert_allclose(down.probe(place), up.probe(place), atol=0.05)
    # One of a file is read through xarray, box by box.
    data.to_netcdf(tmp_path / "f.nc", engine="h5netcdf")
    with xarray.open_dataarray(tmp_path / "f.nc", engine="h5netcdf") as stored:
        of_file = made(stored, tmp_path, "stored")
        assert not stored._in_memory
    np.testing.assert_array_equal(of_file.surface(0.25).vertices, archive.surface(0.25).vertices)
    for bad in (np.arange(ny) % 7, np.full(ny, 2.0), np.where(np.arange(ny) == 3, np.nan, 1.0)):
        with pytest.raises(isospan.UsageError, match="coordinate y neither rises nor falls"):
            made(data.assign_coords(y=bad), tmp_path, "bad")
    with pytest.raises(isospan.UsageError, match="tell spacing"):
        made(data, tmp_path, "bad", spacing=(1, 1, 1))
    expect_same(made(xarray.DataArray(field()), tmp_path, "none"), expected)


def test_a_channel_of_a_series_is_refused(tmp_path):
    frames = xarray.DataArray(np.stack([field(), field()]), dims=("t", "z", "y", "x"))
    with pytest.raises(isospan.UsageError, match="channel is for files"):
        isospan.reduce(frames, tmp_path / "c.isospan", channel=1)


@pytest.mark.parametrize("falls", [False, True])
def test_uneven_coordinates_of_an_xarray(tmp_path, falls):
    nz, ny, nx = field().shape
    levels = 1000.0 - 3 * np.arange(nz) ** 1.7
    latitudes = np.degrees(np.arcsin(np.linspace(-0.9, 0.9, ny)))
    coords = {
        "plev": ("plev", levels if falls else levels[::-1], {"units": "hPa", "axis": "Z"}),
        "lat": ("lat", latitudes, {"units": "degrees_north"}),
        "lon": ("lon", np.arange(nx) * 2.5, {"units": "degrees_east"}),
    }
    data = xarray.DataArray(field(), coords=coords, dims=("plev", "lat", "lon"), name="T")
    archive = isospan.reduce(data, tmp_path / "a.isospan")
    assert archive.info["grid_cells"] is not None
    # The library reads the same coordinates of a file.
    data.to_netcdf(tmp_path / "f.nc", engine="h5netcdf")
    of_file = isospan.reduce(tmp_path / "f.nc", tmp_path / "f.isospan", field="T")
    ours, theirs = archive.surface(0.25), of_file.surface(0.25)
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.faces, theirs.faces)
    x0, x1, y0, y1, z0, z1 = ours.bounds
    assert x1 <= 2.5 * (nx - 1) and y0 > latitudes[0] - 1e-4
    assert levels.min() - 1e-3 < z0 < 800 < z1 <= 1000
    # A dask array of it, and the steps of a series.
    lazy = isospan.reduce(data.chunk({"plev": 5}), tmp_path / "lazy.isospan")
    np.testing.assert_array_equal(lazy.surface(0.25).vertices, ours.vertices)
    steps = xarray.concat([data, data + 1], dim=xarray.Variable("time", [0.0, 6.0]))
    exact = isospan.reduce(data, tmp_path / "exact.isospan", target_max=1e-3).surface(0.25)
    series = isospan.reduce(steps, tmp_path / "series.isospan", target_max=1e-3)
    for step, isovalue in ((0, 0.25), (1, 1.25)):
        found = series.surface(isovalue, step=step)
        assert found.area == pytest.approx(exact.area, rel=0.01)
        assert found.bounds == pytest.approx(exact.bounds, abs=0.5)
    # Other coordinates are another archive.
    moved = data.assign_coords(lat=latitudes * 0.9)
    with pytest.raises(isospan.UsageError):
        isospan.reduce(moved, tmp_path / "a.isospan")
    # Even ones, in single precision too, are a spacing.
    even = data.assign_coords(plev=np.arange(nz), lat=np.arange(ny) * np.float32(0.1) + np.float32(47))
    even = isospan.reduce(even, tmp_path / "even.isospan")
    assert even.info.get("grid_cells") is None
    np.testing.assert_allclose(even.spacing, (2.5, 0.1, 1), rtol=1e-4)


def test_units(tmp_path):
    plain = made(field(), tmp_path, "plain")
    assert (plain.unit, plain.length_unit, plain.time_unit) == (None, None, None)
    named = made(field(), tmp_path, "named", unit="K", length_unit="micrometer")
    assert (named.unit, named.length_unit, named.time_unit) == ("K", "µm", None)
    assert named.info["units"] == {"value": "K", "length": "µm"}
    assert named.steps[0]["unit"] == "K"
    # An xarray tells them in its attributes, as CF has them; what is given counts in their place.
    coords = {
        along: (along, np.arange(n), {"units": "m"}) for along, n in zip("zyx", field().shape)
    }
    steps = np.stack([field(time=n / 4) for n in range(2)])
    coords["time"] = ("time", [0.0, 6.0], {"units": "hours since 2000-01-01"})
    data = xarray.DataArray(
        steps, dims=("time", "z", "y", "x"), coords=coords, attrs={"units": "kg m-3"}
    )
    of_array = made(data, tmp_path, "a")
    assert (of_array.unit, of_array.length_unit) == ("kg m-3", "m")
    assert of_array.time_unit == "hours since 2000-01-01"
    assert made(data[0], tmp_path, "b", unit="g/l").unit == "g/l"
    # Times that are given have no unit of the coordinate, and degrees are no lengths.
    assert made(data, tmp_path, "c", times=[1, 2]).time_unit is None
    data.x.attrs["units"] = data.y.attrs["units"] = data.z.attrs["units"] = "degrees"
    assert made(data[0], tmp_path, "d").length_unit is None
    with pytest.raises(isospan.UsageError, match="the unit of its values is Pa"):
        isospan.append(of_array, field(), times=[9], unit="Pa")
    longer = isospan.append(of_array, field(), times=[9])
    assert [step["unit"] for step in longer.steps] == ["kg m-3"] * 3


def test_series_of_arrays(series, tmp_path):
    steps = [field(time=n / 4) for n in range(3)]
    archive = made(steps, tmp_path, "a", points="regular", fraction="1/2", times=(0, 0.5, 2))
    assert [s["time"] for s in archive.steps] == [0, 0.5, 2]
    for n in range(3):
        np.testing.assert_array_equal(
            archive.surface(0.25, step=n).vertices, series.surface(0.25, step=n).vertices
        )
    data = xarray.DataArray(
        np.stack(steps), dims=("time", "z", "y", "x"), coords={"time": [0, 0.5, 2]}
    )
    timed = made(data, tmp_path, "b", points="regular", fraction="1/2")
    assert [s["time"] for s in timed.steps] == [0, 0.5, 2]
    longer = isospan.append(timed, field(time=1.0), times=[3])
    assert len(longer.steps) == 4


def test_exceptions_of_a_source_are_raised_as_they_are(tmp_path):
    class Broken(Exception):
        pass

    def block(block_info=None):
        if block_info[None]["chunk-location"][0] == 2:
            raise Broken("no such block")
        return np.zeros((8, 8, 8), np.float32)

    lazy = dask.array.map_blocks(
        block, chunks=((8,) * 3,) * 3, dtype=np.float32, meta=np.array((), np.float32)
    )
    with pytest.raises(Broken, match="no such block"):
        made(lazy, tmp_path, "a")
    assert (
        not (tmp_path / "a.isospan").exists() or not (tmp_path / "a.isospan/manifest.zst").exists()
    )
