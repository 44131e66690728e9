"""Arrays of Zarr and h5py that lie in files are read there: the archive has the bytes of that of the
path, and the values and the place of the array."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
import zarr
from conftest import field, same_files

import isospan
from isospan import _sources

SPACING, ORIGIN = (0.5, 2.0, 1.5), (10.0, -4.0, 3.0)


@pytest.fixture
def without_copies(monkeypatch):
    """No array is read box by box."""

    def never(*arguments):
        raise AssertionError("the array is copied")

    monkeypatch.setattr(_sources, "_boxes", never)


def ome(folder, version, array, channels=0):
    """An OME-Zarr image of one level, at the place of the constants; with axes t and c where it has
    channels."""
    group = zarr.open_group(folder, mode="w", zarr_format=version)
    names = ["t", "c"] * (channels > 0) + ["z", "y", "x"]
    shape = (1, channels) * (channels > 0) + array.shape
    level = group.create_array("0", shape=shape, chunks=(1, 1) * (channels > 0) + (7, 11, 20), dtype="f4")
    for n in range(channels or 1):
        level[(0, n) if channels else ...] = array + n
    kinds = {"t": "time", "c": "channel"}
    axes = [
        {"name": n, "type": kinds[n]} if n in kinds else {"name": n, "type": "space", "unit": "micrometer"}
        for n in names
    ]
    one = [1.0] * (len(names) - 3)
    steps = [
        {"type": "scale", "scale": [*one, *SPACING[::-1]]},
        {"type": "translation", "translation": [*[0.0] * len(one), *ORIGIN[::-1]]},
    ]
    levels = [{"path": "0", "coordinateTransformations": steps}]
    scales = [{"version": "0.4", "name": "image", "axes": axes, "datasets": levels}]
    group.attrs.update({"multiscales": scales} if version == 2 else {"ome": {"version": "0.5", "multiscales": scales}})
    return zarr.open_group(folder, mode="r")["0"]


def cf(folder, version, z=None):
    """An array of Zarr with coordinates, as xarray writes it."""
    n = field().shape
    coords = {
        "z": ("z", np.arange(n[0]) * SPACING[2] + ORIGIN[2] if z is None else z, {"units": "m"}),
        "y": ("y", np.arange(n[1]) * SPACING[1] + ORIGIN[1], {"units": "m"}),
        "x": ("x", np.arange(n[2]) * SPACING[0] + ORIGIN[0], {"units": "m"}),
    }
    data = xarray.DataArray(field(), coords=coords, dims=("z", "y", "x"), attrs={"units": "K"})
    data.to_dataset(name="T").to_zarr(folder, zarr_format=version)
    return zarr.open_group(folder, mode="r")["T"]


def expect_copy(stored, archive, folder, monkeypatch, **place):
    """The archive is that of the copy that other arrays are, at a place that is given."""
    with monkeypatch.context() as patch:
        patch.setattr(_sources, "place_of", lambda array: None)
        copy = isospan.reduce(stored, folder / "copy.isospan", **place)
    assert (copy.dims, copy.range) == (archive.dims, archive.range)
    np.testing.assert_array_equal(copy.sample(), archive.sample())
    value = sum(copy.range) / 2
    ours, theirs = archive.surface(value), copy.surface(value)
    np.testing.assert_array_equal(ours.faces, theirs.faces)
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    # The source is in the manifest. Segments differ in its hash and in the checksum of that.
    names = sorted(p.relative_to(copy.path) for p in Path(copy.path).rglob("*.seg"))
    assert len(names) >= 3
    for name in names:
        a, b = (np.frombuffer(Path(at, name).read_bytes(), np.uint8) for at in (archive.path, copy.path))
        assert len(a) == len(b) and np.count_nonzero(a != b) <= 32


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("kind", ["plain", "ome", "cf"])
def test_zarr(tmp_path, monkeypatch, version, kind):
    place = {"spacing": SPACING, "origin": ORIGIN}
    if kind == "plain":
        path, place = tmp_path / "f.zarr", {}
        stored = zarr.create_array(
            path, shape=field().shape, chunks=(5, 7, 20), dtype="f4", zarr_format=version
        )
        stored[:] = field()
    elif kind == "ome":
        path, stored = tmp_path / "f.zarr" / "0", ome(tmp_path / "f.zarr", version, field())
    else:
        path, stored = tmp_path / "f.zarr" / "T", cf(tmp_path / "f.zarr", version)
    with monkeypatch.context() as patch:
        patch.setattr(_sources, "_boxes", None)
        archive = isospan.reduce(stored, tmp_path / "array.isospan")
    isospan.reduce(path, tmp_path / "path.isospan")
    assert same_files(tmp_path / "array.isospan", tmp_path / "path.isospan", but=())
    if place:
        assert (archive.spacing, archive.origin) == (SPACING, ORIGIN)
        assert archive.length_unit == {"ome": "µm", "cf": "m"}[kind]
    expect_copy(stored, archive, tmp_path, monkeypatch, **place)


HDF5 = {
    "plain": {},
    "packed": {"chunks": (4, 24, 9), "compression": "gzip", "shuffle": True},
    "lzf": {"chunks": (4, 24, 9), "compression": "lzf"},
}


@pytest.mark.parametrize("kind", HDF5)
@pytest.mark.parametrize("mode", ["r", "w"])
def test_h5py(tmp_path, monkeypatch, kind, mode):
    path = tmp_path / "f.h5"
    file = h5py.File(path, "w", libver="latest" if kind == "packed" else "earliest")
    stored = file.create_dataset("group/T", data=field(), **HDF5[kind])
    file.create_dataset("other", data=2 * field())
    stored.attrs["element_size_um"] = SPACING[::-1]
    # Of a file that is written to, this may be in memory alone.
    stored[3] = 5
    if mode == "r":
        file.close()
        file = h5py.File(path)
    with file:
        stored = file["group/T"]
        with monkeypatch.context() as patch:
            patch.setattr(_sources, "_boxes", None)
            archive = isospan.reduce(stored, tmp_path / "array.isospan")
        assert archive.spacing == SPACING and archive.range[1] == pytest.approx(5, rel=0.05)
        isospan.reduce(path, tmp_path / "path.isospan", field="group/T")
        assert same_files(tmp_path / "array.isospan", tmp_path / "path.isospan", but=())
        expect_copy(stored, archive, tmp_path, monkeypatch, spacing=SPACING)


def test_what_is_given_wins(tmp_path, without_copies):
    place = {"spacing": (3.0, 4.0, 5.0), "origin": (7.0, 8.0, 9.0)}
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["T"] = field()
        file["T"].attrs["element_size_um"] = SPACING
    arrays = {
        "ome": ome(tmp_path / "ome.zarr", 3, field()),
        "cf": cf(tmp_path / "cf.zarr", 2),
        "uneven": cf(tmp_path / "uneven.zarr", 3, z=np.arange(18.0) ** 2),
        "h5": h5py.File(tmp_path / "f.h5")["T"],
    }
    for name, stored in arrays.items():
        archive = isospan.reduce(stored, tmp_path / f"{name}.isospan", **place)
        assert (archive.spacing, archive.origin) == tuple(place.values()), name
        assert archive.info.get("grid_cells") is None
    half = isospan.reduce(arrays["cf"], tmp_path / "half.isospan", origin=(0, 0, 0))
    assert (half.spacing, half.origin) == (SPACING, (0, 0, 0))
    # Levels that fall keep doing so.
    falling = cf(tmp_path / "falling.zarr", 3, z=-2.0 * np.arange(18.0))
    fallen = isospan.reduce(falling, tmp_path / "falling.isospan", origin=(0, 0, 0))
    assert fallen.info["geometry"]["direction"][2] == [0, 0, -1]
    with pytest.raises(isospan.UsageError, match="uneven coordinates: give spacing"):
        isospan.reduce(arrays["uneven"], tmp_path / "bad.isospan", origin=(0, 0, 0))
    with pytest.raises(isospan.UsageError, match="positive"):
        isospan.reduce(arrays["h5"], tmp_path / "bad.isospan", spacing=(1, 1, 0))
    with pytest.raises(isospan.UsageError, match="name is for arrays in memory"):
        isospan.reduce(arrays["h5"], tmp_path / "bad.isospan", name="density")


def test_uneven_coordinates_of_a_file_are_kept(tmp_path, without_copies):
    stored = cf(tmp_path / "f.zarr", 3, z=np.arange(18.0) ** 2)
    archive = isospan.reduce(stored, tmp_path / "array.isospan")
    isospan.reduce(tmp_path / "f.zarr/T", tmp_path / "path.isospan")
    assert same_files(tmp_path / "array.isospan", tmp_path / "path.isospan", but=())
    assert archive.info["grid_cells"] is not None


def test_channels_and_steps(tmp_path, without_copies):
    stored = ome(tmp_path / "f.zarr", 3, field(), channels=2)
    assert stored.shape == (1, 2, 18, 24, 20)
    archive = isospan.reduce(stored, tmp_path / "one.isospan", channel=1, target_max=1e-4)
    np.testing.assert_allclose(archive.sample(), field() + 1, atol=2e-4)
    with pytest.raises(isospan.UsageError, match="channel"):
        isospan.reduce(stored, tmp_path / "bad.isospan", channel=5)
    with pytest.raises(isospan.UsageError, match="channel is for files"):
        isospan.reduce(field(), tmp_path / "bad.isospan", channel=1)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["a"], file["b"] = field(), 2 * field()
    with h5py.File(tmp_path / "f.h5") as file:
        steps = [file["a"], file["b"]]
        series = isospan.reduce(steps, tmp_path / "s.isospan", times=[1, 3], target_max=1e-4)
        assert series.measure(file["b"], step=1)["max"] < 2e-4
    assert [(s["field"], s["time"]) for s in series.steps] == [("a", 1), ("b", 3)]


def test_values_are_those_of_the_file(tmp_path, without_copies):
    packed = (1000 * field()).astype(np.int16)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["T"] = packed
        file["T"].attrs.update({"scale_factor": 0.01, "add_offset": 273.0})
    with h5py.File(tmp_path / "f.h5") as file:
        with pytest.warns(isospan.Notice, match=r"0\.01 \* sample \+ 273"):
            archive = isospan.reduce(file["T"], tmp_path / "array.isospan")
    isospan.reduce(tmp_path / "f.h5", tmp_path / "path.isospan")
    assert same_files(tmp_path / "array.isospan", tmp_path / "path.isospan", but=())
    assert archive.range[0] == pytest.approx(273 + 0.01 * packed.min(), abs=1)


def test_what_is_not_read_in_its_file_is_copied(tmp_path):
    from numcodecs import Delta

    # Differences of these are exact.
    whole = np.round(100 * field())
    stored = zarr.create_array(
        tmp_path / "f.zarr",
        shape=whole.shape,
        chunks=(5, 7, 20),
        dtype="f4",
        zarr_format=2,
        filters=[Delta(dtype="f4")],
    )
    stored[:] = whole
    with pytest.warns(isospan.Notice, match="copied by zarr.*give spacing"):
        archive = isospan.reduce(stored, tmp_path / "a.isospan")
    expected = isospan.reduce(whole, tmp_path / "expected.isospan").sample()
    np.testing.assert_array_equal(archive.sample(), expected)
    # In memory, without a file: no warning.
    held = zarr.create_array(zarr.storage.MemoryStore(), shape=whole.shape, chunks=(5, 7, 20), dtype="f4")
    held[:] = whole
    with h5py.File("held.h5", "w", driver="core", backing_store=False) as file:
        file["T"] = whole
        for number, array in enumerate((held, file["T"])):
            copy = isospan.reduce(array, tmp_path / f"{number}.isospan")
            np.testing.assert_array_equal(copy.sample(), expected)
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["T"] = whole
        layout = h5py.VirtualLayout(shape=whole.shape, dtype="f4")
        layout[:] = h5py.VirtualSource(file["T"])
        view = file.create_virtual_dataset("view", layout)
        copy = isospan.reduce(view, tmp_path / "v.isospan")
    np.testing.assert_array_equal(copy.sample(), expected)


def test_times_of_files_count_from_one_date(tmp_path, without_copies):
    paths, arrays = [], []
    for day in (1, 2):
        times = ("time", [0.0, 6.0], {"units": f"hours since 2000-01-0{day}"})
        values = np.stack([field(time=day), field(time=day + 0.5)])
        data = xarray.DataArray(values, coords={"time": times}, dims=("time", "z", "y", "x"), name="T")
        data.to_dataset().to_zarr(tmp_path / f"{day}.zarr", zarr_format=2)
        paths.append(tmp_path / f"{day}.zarr/T")
        arrays.append(zarr.open_group(tmp_path / f"{day}.zarr", mode="r")["T"])
    archive = isospan.reduce(arrays, tmp_path / "array.isospan")
    assert [step["time"] for step in archive.steps] == [0, 6, 24, 30]
    isospan.reduce(paths, tmp_path / "path.isospan")
    assert same_files(tmp_path / "array.isospan", tmp_path / "path.isospan", but=())
