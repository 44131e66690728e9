"""Every question to an archive has the answer that the program gives."""

import _thread
import os
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path

import dask.array
import numpy as np
import pytest
from conftest import FORKED, field

import isospan

ISOVALUE = 1000.5


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "vtp", "vtkhdf", "glb"])
def test_surface_files_are_those_of_the_program(tooth, program, tmp_path, suffix):
    files = [tmp_path / f"{name}.{suffix}" for name in ("program", "saved", "written")]
    program("surface", tooth.path, "-i", ISOVALUE, "-o", files[0])
    written = tooth.surface(ISOVALUE).save(files[1])
    report = tooth.save_surface(files[2], ISOVALUE)
    expected = files[0].read_bytes()
    assert [f.read_bytes() for f in files[1:]] == [expected] * 2
    assert written == report["file_bytes"] == len(expected)


def test_several_surfaces_in_one_file(tooth, program, tmp_path):
    program("surface", tooth.path, "-i", "400,1000.5", "-o", tmp_path / "program.vtp")
    surfaces = tooth.surface([400, ISOVALUE])
    assert [s.isovalue for s in surfaces] == [400, ISOVALUE]
    isospan.save_surfaces(surfaces, tmp_path / "saved.vtp")
    assert (tmp_path / "saved.vtp").read_bytes() == (tmp_path / "program.vtp").read_bytes()


@pytest.mark.parametrize(
    "keywords, flags",
    [
        ({"roi": "10:60,:,5:"}, ["--roi", "10:60,:,5:"]),
        ({"roi": [(10, 60), (None, None), (5, None)]}, ["--roi", "10:60,:,5:"]),
        ({"bounds": (10, 60.5, None, None, 5, None)}, ["--roi", "world:10:60.5,:,5:"]),
        ({"cap": True}, ["--cap"]),
        ({"largest": 1}, ["--largest", "1"]),
        (
            {"min_triangles": 20, "min_volume": 1.5},
            ["--min-triangles", "20", "--min-volume", "1.5"],
        ),
        (
            {"decimate": 0.25, "decimate_error": 2.0},
            ["--decimate", "0.25", "--decimate-error", "2"],
        ),
        ({"smooth": True}, ["--smooth"]),
        ({"smooth": 5, "smooth_limit": 0.25}, ["--smooth", "5", "--smooth-limit", "0.25"]),
        (
            {"smooth": 3, "smooth_limit": "0.1%", "decimate": "50%"},
            ["--smooth", "3", "--smooth-limit", "0.1%", "--decimate", "50%"],
        ),
        ({"threads": 1, "memory": "64MiB"}, ["--threads", "1", "--memory", "64MiB"]),
    ],
)
def test_keywords_are_flags(tooth, program, tmp_path, keywords, flags):
    program("surface", tooth.path, "-i", ISOVALUE, "-o", tmp_path / "program.ply", *flags)
    tooth.surface(ISOVALUE, **keywords).save(tmp_path / "saved.ply")
    tooth.save_surface(tmp_path / "written.ply", ISOVALUE, **keywords)
    expected = (tmp_path / "program.ply").read_bytes()
    assert (tmp_path / "saved.ply").read_bytes() == expected
    assert (tmp_path / "written.ply").read_bytes() == expected


def test_arrays_are_what_the_file_has(tooth, tmp_path):
    surface = tooth.surface(ISOVALUE)
    surface.save(tmp_path / "s.ply")
    header, _, body = (tmp_path / "s.ply").read_bytes().partition(b"end_header\n")
    assert f"element vertex {len(surface.vertices)}\n".encode() in header
    rows = np.frombuffer(body, "<f4", 6 * len(surface.vertices)).reshape(-1, 6)
    np.testing.assert_array_equal(surface.vertices, rows[:, :3])
    np.testing.assert_array_equal(surface.normals, rows[:, 3:])
    triangle = np.dtype([("count", "u1"), ("corners", "<u4", 3)])
    found = np.frombuffer(body[rows.nbytes :], triangle)
    np.testing.assert_array_equal(surface.faces, found["corners"])
    assert surface.vertices.dtype == np.float32 and surface.faces.dtype == np.uint32
    assert len(surface) == len(surface.faces) and "isospan.Surface" in repr(surface)


def test_arrays_live_longer_than_the_surface_and_are_not_written_to(tooth):
    vertices = tooth.surface(ISOVALUE).vertices
    again = tooth.surface(ISOVALUE).vertices
    np.testing.assert_array_equal(vertices, again)
    with pytest.raises(ValueError, match="read-only"):
        vertices[0] = 0


def test_an_empty_surface(tooth, tmp_path):
    surface = tooth.surface(1e6)
    assert surface.vertices.shape == (0, 3) and surface.faces.shape == (0, 3)
    surface.save(tmp_path / "empty.ply")
    assert surface.to_pyvista().n_points == 0


def test_surfaces_are_pickled(tooth, tmp_path):
    surface = tooth.surface(ISOVALUE)
    again = pickle.loads(pickle.dumps(surface))
    np.testing.assert_array_equal(again.faces, surface.faces)
    surface.save(tmp_path / "a.ply")
    again.save(tmp_path / "b.ply")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_pyvista_meshes(tooth):
    surface = tooth.surface(ISOVALUE)
    mesh = surface.to_pyvista()
    assert mesh.n_points == len(surface.vertices) and mesh.n_cells == len(surface)
    np.testing.assert_array_equal(mesh.regular_faces, surface.faces)
    np.testing.assert_array_equal(mesh.point_data["Normals"], surface.normals)
    # Normals point to lower values, which are outside.
    turned = mesh.compute_normals(cell_normals=True, point_normals=False, consistent_normals=False)
    corners = surface.normals[surface.faces[:, 0]]
    agree = np.einsum("ij,ij->i", turned.cell_data["Normals"], corners) > 0
    assert agree.mean() > 0.95


def test_count_and_spectrum(tooth, program):
    expected = program("count", tooth.path, "-i", ISOVALUE, "--json")
    assert tooth.count(ISOVALUE) == expected["active_cells"]
    assert list(tooth.count([400, ISOVALUE])) == [tooth.count(400), tooth.count(ISOVALUE)]
    spectrum, expected = tooth.spectrum(), program("spectrum", tooth.path, "--json")
    # An archive that is open does not read its manifest again.
    assert spectrum.report == {**expected, "bytes_read": spectrum.report["bytes_read"]}
    assert list(spectrum.area) == [k["area"] for k in expected["knots"]]
    assert spectrum.suggestions == [s["isovalue"] for s in expected["suggestions"]]
    assert spectrum.range == tuple(expected["range"]) == tooth.range
    largest = int(np.argmax(spectrum.active))
    assert tooth.count(spectrum.isovalues[largest]) == spectrum.active[largest]


def test_what_is_known(tooth, program):
    expected = program("info", tooth.path, "--json")
    assert tooth.info == expected
    assert list(tooth.dims) == expected["dims"]
    assert list(tooth.spacing) == expected["geometry"]["spacing"]
    assert list(tooth.origin) == expected["geometry"]["origin"]
    np.testing.assert_array_equal(tooth.direction, np.eye(3))
    assert len(tooth.steps) == 1 and tooth.report is None
    assert "tooth.isospan" in repr(tooth)


def test_samples_and_points(tooth, program, tmp_path):
    program("probe", tooth.path, "--grid", "9,8,7", "-o", tmp_path / "grid.npy")
    grid = tooth.sample((9, 8, 7))
    np.testing.assert_array_equal(grid.astype(np.float32), np.load(tmp_path / "grid.npy"))
    assert grid.shape == (7, 8, 9)
    tooth.save_samples(tmp_path / "saved.npy", (9, 8, 7))
    assert (tmp_path / "saved.npy").read_bytes() == (tmp_path / "grid.npy").read_bytes()
    points = np.random.default_rng(1).uniform(-5, 100, (200, 3))
    np.savetxt(tmp_path / "points.csv", points, "%.17g", ",", header="x,y,z", comments="")
    program("probe", tooth.path, "--at", tmp_path / "points.csv", "-o", tmp_path / "points.npy")
    values = tooth.probe(points)
    np.testing.assert_array_equal(
        values.astype(np.float32), np.load(tmp_path / "points.npy").ravel()
    )
    assert np.isnan(values).any() and np.isfinite(values).any()
    assert tooth.probe(points[0]).shape == (1,)
    # Any layout, and the array is the caller's own.
    np.testing.assert_array_equal(tooth.probe(np.asfortranarray(points)[::-1]), values[::-1])
    values[0] = 1
    assert tooth.sample().shape == tooth.dims[::-1]


def test_levels_of_a_pyramid(program, tmp_path):
    np.save(tmp_path / "field.npy", field((50, 60, 64)))
    pyramid = isospan.reduce(tmp_path / "field.npy", tmp_path / "a.isospan", points="pyramid")
    levels = pyramid.info["pyramid"]
    rms = levels[2]["rms"]
    expected = pyramid.surface(0.2, level=2)
    most = len(expected.faces)
    for choice in ({"triangles": most}, {"error": rms}, {"error": str(rms)}):
        np.testing.assert_array_equal(pyramid.surface(0.2, **choice).faces, expected.faces)
        cells = program("count", pyramid.path, "-i", 0.2, "--level", 2, "--json")
        assert pyramid.count(0.2, **choice) == cells["active_cells"]
    assert pyramid.surface(0.2, triangles=most - 1).faces.shape[0] < most
    report = pyramid.save_surface(tmp_path / "a.ply", 0.2, error=rms)
    assert report["level"] == 2 and report["triangles"] == most
    program("probe", pyramid.path, "--grid", "9,8,7", "--level", 2, "-o", tmp_path / "grid.npy")
    grid = pyramid.sample((9, 8, 7), level=2)
    np.testing.assert_array_equal(grid.astype(np.float32), np.load(tmp_path / "grid.npy"))
    assert np.isnan(grid[-1]).all() and np.isfinite(grid[0, 0, 0])
    place = pyramid.origin
    assert pyramid.probe(place, error=rms)[0] == grid[0, 0, 0]
    report = pyramid.save_samples(tmp_path / "saved.npy", (9, 8, 7), level=2)
    assert (tmp_path / "saved.npy").read_bytes() == (tmp_path / "grid.npy").read_bytes()
    assert report["outside"] == np.isnan(grid).sum()
    for name, level in [("a.vti", 0), ("a.nrrd", 2), ("a.nii.gz", 1), ("a.npy", 3)]:
        program("export", pyramid.path, "-o", tmp_path / f"p{name}", "--level", level)
        report = pyramid.save_grid(tmp_path / f"s{name}", level=level)
        assert report["level"] == level
        assert (tmp_path / f"s{name}").read_bytes() == (tmp_path / f"p{name}").read_bytes()
    part = pyramid.save_grid(tmp_path / "part.npy", roi="1:5,2:6,3:7")
    assert np.load(tmp_path / "part.npy").shape == tuple(part["dims"][::-1]) == (5, 5, 5)
    assert pyramid.save_grid(tmp_path / "image.zarr", level=1)["levels"] > 1
    assert (tmp_path / "image.zarr/.zattrs").exists()
    with pytest.raises(isospan.UsageError, match="replace|--force|is there"):
        pyramid.save_grid(tmp_path / "image.zarr", level=1)
    pyramid.save_grid(tmp_path / "image.zarr", level=1, replace=True)
    with pytest.raises(isospan.UsageError, match="always compressed"):
        pyramid.save_grid(tmp_path / "b.zarr", compress=True)
    with pytest.raises(isospan.UsageError, match="level"):
        pyramid.save_grid(tmp_path / "n.npy", level=40)
    measured = pyramid.measure(tmp_path / "field.npy", level=2)
    assert measured["level"] == 2 and measured["rms"] <= rms <= 1.002 * measured["rms"]
    with pytest.raises(isospan.UsageError, match="one of level, triangles and error"):
        pyramid.surface(0.2, level=1, triangles=100)
    with pytest.raises(isospan.UsageError, match="no level 99"):
        pyramid.probe(place, level=99)
    with pytest.raises(isospan.UsageError, match="error"):
        pyramid.surface(0.2, error="much")


def test_a_level_is_for_pyramids(tooth):
    for choice in ({"level": 0}, {"triangles": 10}, {"error": 1.0}):
        with pytest.raises(isospan.UsageError, match="is no pyramid"):
            tooth.surface(ISOVALUE, **choice)


def test_tetrahedra(tooth, program, tmp_path):
    program(
        "export",
        tooth.path,
        "-o",
        tmp_path / "p.vtu",
        "--range",
        "900:",
        "--any-corner",
        "--every",
        "3",
    )
    report = tooth.save_tetrahedra(tmp_path / "s.vtu", range=(900, None), any_corner=True, every=3)
    assert (tmp_path / "s.vtu").read_bytes() == (tmp_path / "p.vtu").read_bytes()
    grid = tooth.to_unstructured_grid(range=(900, None), any_corner=True, every=3)
    assert grid.n_cells == report["tetrahedra"] and grid.n_points == report["points"]


def test_tetrahedra_of_several_fields(program, tmp_path):
    z, y, x = np.mgrid[-1:1:9j, -1:1:10j, -1:1:11j]
    for n in range(2):
        fields = {"T": (x * y + n).astype("f4"), "p": (z * x - n).astype("f4")}
        np.savez(tmp_path / f"s{n}.npz", **fields)
    inputs = [tmp_path / f"s{n}.npz" for n in range(2)]
    program("reduce", *inputs, "-o", tmp_path / "f.isospan", "--fields", "T,p", "--times", "0,1",
            "--points", "regular")
    archive = isospan.open(tmp_path / "f.isospan")
    for keywords, flags in [({"step": 1}, ["--step", 1]), ({"time": 0.25}, ["--time", 0.25])]:
        program("export", archive.path, "-o", tmp_path / "p.vtu", "--force", *flags)
        report = archive.save_tetrahedra(tmp_path / "s.vtu", fields=["T", "p"], **keywords)
        assert report["fields"] == ["T", "p"]
        assert (tmp_path / "s.vtu").read_bytes() == (tmp_path / "p.vtu").read_bytes()
    grid = archive.to_unstructured_grid(step=1, fields=["p", "T"])
    assert grid.point_data.keys() == ["p", "T"]
    assert archive.save_tetrahedra(tmp_path / "s.vtu", step=(1, "p"))["fields"] == ["p"]
    with pytest.raises(isospan.UsageError, match="no field q"):
        archive.save_tetrahedra(tmp_path / "n.vtu", step=1, fields=["q"])
    with pytest.raises(isospan.UsageError, match="list of names"):
        archive.save_tetrahedra(tmp_path / "n.vtu", step=1, fields="T")


def test_measure_and_check(tooth, program, tmp_path):
    from conftest import TOOTH

    expected = program("measure", tooth.path, "--against", TOOTH, "--json")
    found = tooth.measure(TOOTH, map=tmp_path / "map.vti")
    assert found["rms"] == expected["rms"] and found["max"] == expected["max"]
    assert (tmp_path / "map.vti").exists()
    tooth.check()


def test_numbers_and_wrong_surfaces_are_those_of_the_program(program, tmp_path):
    np.save(tmp_path / "field.npy", field())
    pyramid = isospan.reduce(tmp_path / "field.npy", tmp_path / "a.isospan", target_rms="2%")
    middle = program("count", pyramid.path, "-i", "50%", "--numbers", "--json")["numbers"]
    assert pyramid.numbers("50%") == middle and middle["pieces"] > 0
    coarse = pyramid.numbers(middle["isovalue"], level=1, memory="1GiB")
    assert coarse["area"] != middle["area"]
    source = tmp_path / "field.npy"
    flags = ["--against", source, "--isovalue=40%,50%", "--json"]
    expected = program("measure", pyramid.path, *flags)["surfaces"]
    assert pyramid.measure(source, isovalue=["40%", "50%"])["surfaces"] == expected
    assert len(expected) == 2
    assert not pyramid.measure(source).get("surfaces")


def test_steps_and_times(series, program, tmp_path):
    assert [s["time"] for s in series.steps] == [0, 0.5, 2]
    for keywords, flags in [({"step": 2}, ["--step", 2]), ({"time": 0.2}, ["--time", 0.2])]:
        program("surface", series.path, "-i", 0.25, "-o", tmp_path / "p.ply", "--force", *flags)
        series.surface(0.25, **keywords).save(tmp_path / "s.ply")
        series.at(**keywords).surface(0.25).save(tmp_path / "t.ply")
        expected = (tmp_path / "p.ply").read_bytes()
        assert (tmp_path / "s.ply").read_bytes() == (tmp_path / "t.ply").read_bytes() == expected
    assert series.count(0.25, step=1) == series.at(step=1).count(0.25) != series.count(0.25)
    assert series.spectrum(step=1).range == series.at(step=1).range
    assert len(list(series)) == 3
    report = series.save_surface(tmp_path / "all_%d.ply", 0.25, steps=True)
    assert len(report["steps"]) == 3 and (tmp_path / "all_2.ply").exists()
    program("surface", series.path, "-i", 0.25, "-o", tmp_path / "only_%d.ply", "--steps", "1:")
    series.save_surface(tmp_path / "some_%d.ply", 0.25, steps="1:")
    assert (tmp_path / "some_2.ply").read_bytes() == (tmp_path / "only_2.ply").read_bytes()
    with pytest.raises(isospan.UsageError):
        series.surface(0.25, step=1, time=0.5)


def test_archives_are_pickled_and_closed(series):
    again = pickle.loads(pickle.dumps(series.at(step=2)))
    assert again.count(0.25) == series.count(0.25, step=2)
    with again as archive:
        surface = archive.surface(0.25)
    assert len(surface) > 0 and "closed" in repr(again)
    with pytest.raises(ValueError, match="closed"):
        again.count(0.25)


def test_many_threads_ask_at_one_time(series):
    found = {}

    def ask(n):
        found[n] = series.surface(0.25, step=n % 3).faces

    threads = [threading.Thread(target=ask, args=(n,)) for n in range(9)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    for n, faces in found.items():
        np.testing.assert_array_equal(faces, series.surface(0.25, step=n % 3).faces)


@pytest.mark.usefixtures("ctrl_c")
def test_a_check_is_stopped_by_ctrl_c(tmp_path):
    n = 96
    z, y, x = np.meshgrid(*[np.linspace(-9, 9, n, dtype="f4")] * 3, indexing="ij")
    choices = {"points": "regular", "fraction": "1/4", "chunk_points": 2000, "measure": False}
    archive = isospan.reduce(np.sin(x) * np.cos(y) + z, tmp_path / "a.isospan", **choices)
    started = time.monotonic()
    archive.check()
    whole = time.monotonic() - started
    timer = threading.Timer(whole / 8, _thread.interrupt_main)
    timer.start()
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        archive.check()
    assert time.monotonic() - started < whole * 0.8


def test_measure_against_arrays(tmp_path):
    archive = isospan.reduce(field(), tmp_path / "a.isospan", points="regular", fraction="1/4")
    expected = archive.measure(field())
    assert expected["same_source"]
    assert {k: expected[k] for k in archive.info["error"]} == archive.info["error"]
    lazy = dask.array.from_array(field(), chunks=(5, 7, 20))
    found = archive.measure(lazy, scratch=tmp_path)
    assert found["rms"] == expected["rms"] and not list(tmp_path.glob("isospan-*"))
    other = archive.measure(field() + np.float32(1))
    assert not other["same_source"] and other["rms"] > 0.9
    with pytest.raises(isospan.BadInputError, match="19 x 24 x 18"):
        archive.measure(field()[:, :, 1:])
    with pytest.raises(isospan.UsageError, match="several"):
        archive.measure([field(), field()])
    with pytest.raises(isospan.UsageError, match="for files"):
        archive.measure(field(), field="density")


def test_measure_against_a_step(series, program, folder):
    expected = program(
        "measure", series.path, "--against", folder / "step_2.npy", "--step", 2, "--json"
    )
    found = series.measure(field(time=2 / 4), step=2)
    assert (found["rms"], found["max"]) == (expected["rms"], expected["max"])



@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks of POSIX")
def test_a_forked_child_answers(tooth):
    command = [sys.executable, "-W", "ignore", "-c", FORKED, tooth.path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_a_relative_path_stays_right(tooth, tmp_path, monkeypatch):
    monkeypatch.chdir(Path(tooth.path).parent)
    archive = isospan.open(Path(tooth.path).name)
    pickled = pickle.dumps(archive)
    monkeypatch.chdir(tmp_path)
    assert archive.path == os.path.realpath(tooth.path) or archive.path == tooth.path
    expected = tooth.count(ISOVALUE)
    assert pickle.loads(pickled).count(ISOVALUE) == archive.at(step=0).count(ISOVALUE) == expected
