"""Samples of HDF5 files are those that h5py gives, which reads with the C library of the format's
makers: the files of the tests of our reader, and files of random samples in every layout and filter
that h5py writes. The reader is pinned to the version that passed (hdf5-reader, Cargo.toml).
"""

import itertools
import re

import h5py
import numpy as np
import pytest
from conftest import ROOT
from test_arrays import made

# Every sample a point, with its own value.
EXACT = {"fraction": 1, "points": "regular", "values": "sample"}
CORPUS = ["types_earliest", "types_latest", "layouts_earliest", "layouts_latest", "chunks"]


def samples(path):
    """All datasets of a file that are fields: three axes of numbers, without a meaning of their
    own."""
    found = {}

    def look(name, item):
        if isinstance(item, h5py.Dataset) and item.ndim == 3 and not item.attrs:
            if item.dtype.kind in "iu" or item.dtype.str[1:] in ("f4", "f8"):
                found[name] = item[...]

    with h5py.File(path) as file:
        file.visititems(look)
    return found


def points(archive, folder):
    """All points, values and tetrahedra, without the names of source and field."""
    archive.save_tetrahedra(folder / "all.vtu")
    rest = (folder / "all.vtu").read_bytes().partition(b"-->")[2]
    (folder / "all.vtu").unlink()
    head, mark, data = rest.partition(b"<AppendedData")
    return re.sub(rb'(Name|Scalars)="[^"]*"', b"", head) + mark + data


def compare(path, folder):
    fields = samples(path)
    for name, array in fields.items():
        file = points(made(path, folder, "file", field=name, **EXACT), folder)
        assert file == points(made(array, folder, "array", **EXACT), folder) != b"", name
    return len(fields)


@pytest.mark.parametrize("name", CORPUS)
def test_files_of_our_tests(tmp_path, name):
    found = compare(ROOT / f"tests/data/{name}.h5", tmp_path)
    assert found == {"types": 28, "layouts": 8, "chunks": 1}[name.partition("_")[0]]


FILTERS = {
    "none": {},
    "gzip": {"compression": "gzip", "compression_opts": 1},
    "shuffled": {"compression": "gzip", "compression_opts": 9, "shuffle": True},
    "checked": {"compression": "gzip", "shuffle": True, "fletcher32": True},
    "scaled": {"scaleoffset": 0},
}
CHUNKS = [(1, 9, 11), (3, 4, 5), (7, 9, 11), (7, 2, 6)]


@pytest.mark.parametrize("version", ["earliest", "latest"])
def test_random_samples(tmp_path, version):
    random = np.random.default_rng(7)
    with h5py.File(tmp_path / "a.h5", "w", libver=version) as file:
        cases = itertools.product(CHUNKS, FILTERS.items(), ("<i2", ">u4", "<f4", ">f8"))
        for number, (chunks, (name, filters), kind) in enumerate(cases):
            if name == "scaled" and kind != "<i2":
                continue
            values = random.integers(0, 20_000, (7, 9, 11)).astype(kind)
            grows = {"maxshape": (None, 9, 11)} if number % 2 else {}
            file.create_dataset(f"{name}/{number}", data=values, chunks=chunks, **filters, **grows)
    assert compare(tmp_path / "a.h5", tmp_path) == 68
