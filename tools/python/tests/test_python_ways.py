"""What users of Python expect: exceptions that are caught, numbers of NumPy, methods of surfaces."""

import doctest
import errno
import pickle

import numpy as np
import pytest

import isospan
from isospan import _archive, _labels, _reduce, _surface


@pytest.fixture(scope="module")
def sphere_archive(tmp_path_factory):
    z, y, x = np.mgrid[:33, :33, :33].astype(np.float32)
    field = 30 - np.sqrt((x - 16) ** 2 + (y - 16) ** 2 + (z - 16) ** 2)
    path = tmp_path_factory.mktemp("ways") / "sphere.isospan"
    return isospan.reduce(field, path, target_max=0.001)


def test_missing_files_are_those_of_python(tmp_path):
    with pytest.raises(FileNotFoundError) as caught:
        isospan.open(tmp_path / "none.isospan")
    assert caught.value.filename == str(tmp_path / "none.isospan")
    assert caught.value.errno == errno.ENOENT
    with pytest.raises(FileNotFoundError) as caught:
        isospan.reduce(str(tmp_path / "none.nrrd"), tmp_path / "a.isospan")
    assert caught.value.filename == str(tmp_path / "none.nrrd")
    again = pickle.loads(pickle.dumps(caught.value))
    assert isinstance(again, FileNotFoundError) and again.filename == caught.value.filename
    assert isinstance(again, isospan.Error) and str(again) == str(caught.value)


def test_what_is_not_there_is_a_key_error(sphere_archive):
    with pytest.raises(KeyError, match="no step 7"):
        sphere_archive.at(step=7)
    with pytest.raises(KeyError, match="pressure"):
        sphere_archive.surface(20, step="pressure")
    with pytest.raises(isospan.UsageError, match="step is a number from 0"):
        sphere_archive.surface(20, step=-1)
    with pytest.raises(isospan.UsageError, match="step is a number from 0"):
        sphere_archive.surface(20, step=1.5)


def test_numbers_of_numpy_and_percent(sphere_archive):
    plain = sphere_archive.surface(20.0)
    assert np.array_equal(plain.vertices, sphere_archive.surface(np.float32(20)).vertices)
    lo, hi = sphere_archive.range
    half = sphere_archive.surface("50%")
    assert half.isovalue == pytest.approx((lo + hi) / 2)
    assert sphere_archive.count("50%") == sphere_archive.count(half.isovalue)
    few = sphere_archive.surface(20, decimate="25%", step=np.int64(0))
    assert len(few) == len(sphere_archive.surface(20, decimate=np.float64(0.25))) < len(plain)
    near = sphere_archive.surface(20, decimate_error="0.5%")
    length = 0.005 * 32 * np.sqrt(3)
    assert len(near) == len(sphere_archive.surface(20, decimate_error=length)) < len(plain)
    with pytest.raises(isospan.UsageError, match="decimate"):
        sphere_archive.surface(20, decimate="much")
    with pytest.raises(isospan.UsageError, match="isovalue"):
        sphere_archive.surface("half")


def test_a_surface_knows_its_numbers(sphere_archive):
    sphere = sphere_archive.surface(20)
    assert sphere.area == pytest.approx(4 * np.pi * 100, rel=0.01)
    assert sphere.volume == pytest.approx(4 / 3 * np.pi * 1000, rel=0.01)
    assert sphere.is_closed and len(sphere.components()) == 1
    low = sphere_archive.surface(8)
    assert low.volume is None and not low.is_closed
    pieces = low.components()
    assert sum(len(piece) for piece in pieces) == len(low)
    assert [len(p) for p in pieces] == sorted((len(p) for p in pieces), reverse=True)
    assert sphere.compare(low)["hausdorff"] > 5
    assert "<table>" in sphere._repr_html_() and "<table>" in sphere_archive._repr_html_()


@pytest.fixture(scope="module")
def organs(tmp_path_factory):
    """The archive of an image of two labels."""
    image = np.zeros((20, 24, 28), np.uint8)
    image[5:15, 4:14, 6:16] = 3
    image[5:15, 4:14, 16:21] = 7
    path = tmp_path_factory.mktemp("organs") / "organs.isospan"
    return isospan.reduce(image, path, labels=True)


#: What has examples, and how many at least.
DOCUMENTED = [(_surface.Surface, 5), (_labels.LabelSurface, 4), (_archive.Archive, 9), (_reduce, 4)]


@pytest.mark.parametrize("kind, least", DOCUMENTED, ids=lambda k: getattr(k, "__name__", ""))
def test_examples_of_docstrings(sphere_archive, organs, tmp_path, kind, least):
    z, y, x = np.mgrid[-1:1:20j, -1:1:24j, -1:1:28j]
    space = {
        **vars(kind if kind is _reduce else isospan),
        "np": np,
        "sphere": sphere_archive.surface(20),
        "archive": sphere_archive,
        "organs": organs,
        "liver": organs.label_surface(3, label_table={3: ("liver", (200, 60, 50))}),
        "ball": (x * x + y * y + z * z).astype(np.float32),
        "folder": tmp_path,
    }
    found = [t for t in doctest.DocTestFinder().find(kind, globs=space) if t.examples]
    assert sum(len(test.examples) for test in found) >= least
    runner = doctest.DocTestRunner()
    assert sum(runner.run(test).failed for test in found) == 0


def test_pictures_pages_and_the_viewer(sphere_archive, tmp_path):
    picture = tmp_path / "sphere.png"
    report = sphere_archive.render(picture, 20, size=(200, 100))
    assert picture.read_bytes().startswith(b"\x89PNG") and report["size"] == [200, 100]
    with pytest.raises(isospan.Error):
        sphere_archive.render(picture, 20)
    with pytest.raises(isospan.UsageError, match="turning"):
        sphere_archive.render(tmp_path / "b.png", 20, turning=3)
    with sphere_archive.view() as viewer:
        from urllib.request import urlopen

        assert b"<html" in urlopen(viewer.url).read().lower()
        assert viewer.url in viewer._repr_html_()


def test_datasets_and_axes_of_cf(tmp_path):
    xarray = pytest.importorskip("xarray")
    values = np.random.default_rng(0).random((6, 7, 8)).astype(np.float32)
    field = xarray.DataArray(
        values.transpose(2, 0, 1),
        dims=("lon", "lev", "lat"),
        coords={"lon": np.arange(8.0), "lat": np.arange(7.0), "lev": np.arange(6.0)},
    )
    archive = isospan.reduce(field, tmp_path / "a.isospan", target_max=1e-4)
    assert archive.dims == (8, 7, 6)
    assert archive.probe([3, 2, 1])[0] == pytest.approx(values[1, 2, 3], abs=2e-4)
    dataset = xarray.Dataset({"u": field, "v": field + 1})
    with pytest.raises(isospan.UsageError, match="u, v"):
        isospan.reduce(dataset, tmp_path / "b.isospan")
    with pytest.raises(KeyError, match="no field w"):
        isospan.reduce(dataset, tmp_path / "b.isospan", field="w")
    archive = isospan.reduce(dataset, tmp_path / "b.isospan", field="v", target_max=1e-4)
    assert archive.probe([3, 2, 1])[0] == pytest.approx(values[1, 2, 3] + 1, abs=2e-4)
