"""The places of archives in PyVista, ParaView (with VTK alone), napari (without Qt) and Dask."""

import numpy as np
import pytest
import pyvista
from conftest import TOOTH, field, same_files

import isospan

ISOVALUE = 1000.5


def test_pyvista_reads_archives(tooth, series):
    import isospan._pyvista as reader

    # The entry point of the installed package does this.
    pyvista.register_reader(".isospan", reader.read, override=True)
    mesh = pyvista.read(tooth.path, isovalue=ISOVALUE)
    assert (
        mesh.n_cells == len(tooth.surface(ISOVALUE)) and mesh.field_data["isovalue"][0] == ISOVALUE
    )
    assert pyvista.read(tooth.path).field_data["isovalue"][0] == tooth.spectrum().suggestions[0]
    both = pyvista.read(tooth.path, isovalue=[400, ISOVALUE])
    assert both.keys() == ["400", "1000.5"] and both["1000.5"].n_cells == mesh.n_cells
    step = pyvista.read(series.path, isovalue=0.25, step=2)
    assert step.n_points == len(series.surface(0.25, step=2).vertices)
    grid = pyvista.read(series.path, tetrahedra=True)
    assert isinstance(grid, pyvista.UnstructuredGrid) and grid.n_cells == series.info["tetrahedra"]


def grids():
    """A grid of each kind with the same field at the same samples, but for those that bend."""
    nz, ny, nx = field().shape
    image = pyvista.ImageData(dimensions=(nx, ny, nz), spacing=(0.5, 2, 1), origin=(10, 0, -5))
    image.point_data["density"] = field().ravel()
    image.point_data["other"] = -field().ravel()
    image.set_active_scalars("density")
    uneven = pyvista.RectilinearGrid(np.arange(nx) ** 1.2, np.arange(ny), np.arange(nz) ** 1.5)
    uneven.point_data["density"] = field().ravel()
    return {
        "vti": image,
        "vtr": uneven,
        "vts": uneven.cast_to_structured_grid(),
        "vtu": uneven.cast_to_unstructured_grid(),
    }


def test_pyvista_writes_archives(tmp_path):
    import isospan._pyvista as writer

    # The entry point of the installed package does this.
    pyvista.register_writer(".isospan", writer.write, override=True)
    for suffix, grid in grids().items():
        names = grid.array_names
        grid.save(tmp_path / f"{suffix}.isospan", points="regular", fraction="1/4", scratch=tmp_path)
        given = isospan.reduce(grid, tmp_path / "given.isospan", points="regular", fraction="1/4", force=True)
        assert same_files(tmp_path / f"{suffix}.isospan", given.path)
        again = isospan.reduce(grid, given.path, points="regular", fraction="1/4")
        assert again.report["made_before"]
        # The file that PyVista itself writes gives the same field.
        grid.save(tmp_path / f"grid.{suffix}")
        source = tmp_path / f"grid.{suffix}"
        stored = isospan.reduce(
            source, tmp_path / "stored.isospan", points="regular", fraction="1/4", field="density", force=True
        )
        assert (given.dims, given.spacing, given.origin) == (
            stored.dims,
            stored.spacing,
            stored.origin,
        )
        assert given.info["error"] == stored.info["error"]
        surfaces = [archive.surface(0.25) for archive in (given, stored)]
        np.testing.assert_array_equal(surfaces[0].vertices, surfaces[1].vertices)
        np.testing.assert_array_equal(surfaces[0].faces, surfaces[1].faces)
        assert grid.array_names == names and len(surfaces[0]) > 0
        error = given.info["error"]["rms"]
        assert given.measure(grid)["rms"] == error == given.measure(source, field="density")["rms"]
    assert not list(tmp_path.glob("isospan-*"))


def test_images_of_pyvista_keep_their_place_and_their_fields(tmp_path):
    image = grids()["vti"]
    image.direction_matrix = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    archive = isospan.reduce(image, tmp_path / "turned.isospan", points="regular", fraction="1/4")
    np.testing.assert_array_equal(archive.direction, image.direction_matrix)
    assert archive.info["source"] == "density"
    for corner in (0, image.n_points - 1):
        assert np.isfinite(archive.probe(image.GetPoint(corner))).all()
    # An extent that begins elsewhere.
    part = grids()["vti"].extract_subset([2, 12, 1, 9, 0, 7], rebase_coordinates=False)
    archive = isospan.reduce(part, tmp_path / "part.isospan", points="regular", fraction="1/4")
    assert archive.origin == tuple(part.points[0]) == (11, 2, -5)
    other = isospan.reduce(image, tmp_path / "other.isospan", points="regular", fraction="1/4", field="other")
    low, high = isospan.open(tmp_path / "turned.isospan").range
    assert other.range == (-high, -low)
    steps = [image, image.copy()]
    steps[1].point_data["density"] = image.point_data["density"] + np.float32(1)
    series = isospan.reduce(steps, tmp_path / "series.isospan", points="regular", fraction="1/4", times=[0, 1])
    assert series.at(step=1).range[0] > series.range[0]
    assert len(isospan.append(series, image, times=[2]).steps) == 3


def test_values_of_cells_are_those_of_the_file(tmp_path):
    nz, ny, nx = field().shape
    image = pyvista.ImageData(dimensions=(nx + 1, ny + 1, nz + 1))
    image.cell_data["density"] = field().ravel()
    image.save(tmp_path / "cells.vti")
    stored = isospan.reduce(tmp_path / "cells.vti", tmp_path / "stored.isospan", points="regular", fraction="1/4")
    given = isospan.reduce(image, tmp_path / "given.isospan", points="regular", fraction="1/4")
    assert given.dims == stored.dims == (nx, ny, nz)
    assert given.info["error"] == stored.info["error"] and given.origin == (0.5, 0.5, 0.5)


def test_meshes_without_a_volume_are_refused(tmp_path, tooth):
    image = grids()["vti"]
    vectors = pyvista.ImageData(dimensions=(3, 3, 3))
    vectors.point_data["v"] = np.zeros((27, 3))
    for mesh, choices, message in [
        (tooth.surface(ISOVALUE).to_pyvista(), {}, "not PolyData"),
        (pyvista.ImageData(dimensions=(3, 3, 3)), {}, "active"),
        (image, {"field": "nothing"}, r"no scalars nothing; it has \['density', 'other'\]"),
        (vectors, {"field": "v"}, "3 values"),
        ([image, field()], {}, "several of these"),
        (image, {"spacing": (1, 1, 1)}, "give neither"),
        (image, {"dims": (1, 1, 1)}, "for files"),
        (grids()["vtu"], {"origin": (1, 1, 1)}, "leave out spacing and origin"),
    ]:
        with pytest.raises(isospan.UsageError, match=message):
            isospan.reduce(mesh, tmp_path / "bad.isospan", **choices)


def test_the_entry_points():
    import tomllib
    from conftest import ROOT

    project = tomllib.loads((ROOT / "tools/python/pyproject.toml").read_text())["project"]
    of_pyvista = [project["entry-points"][f"pyvista.{kind}"] for kind in ("readers", "writers")]
    points = [*project["scripts"].values(), *(p for group in of_pyvista for p in group.values())]
    for point in points:
        module, _, name = point.partition(":")
        assert callable(getattr(__import__(module, fromlist=[name]), name))


def test_paraview_with_vtk_alone(series, tooth):
    from isospan import paraview_plugin
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

    reader = paraview_plugin.IsospanReader()
    reader.SetFileName(f"{series.path}/manifest.zst")
    reader.AddIsovalue(0.25)
    reader.AddIsovalue(0.5)
    reader.UpdateInformation()
    info = reader.GetOutputInformation(0)
    assert list(info.Get(Pipeline.TIME_STEPS())) == [0, 0.5, 2]
    for n, time in enumerate([0, 0.5, 2]):
        reader.UpdateTimeStep(time)
        surfaces = series.surface([0.25, 0.5], step=n)
        found = pyvista.wrap(reader.GetOutputDataObject(0))
        np.testing.assert_array_equal(found.points, np.concatenate([s.vertices for s in surfaces]))
        assert found.n_cells == sum(map(len, surfaces))
        assert set(found.point_data["isovalue"]) == {0.25, 0.5}
        np.testing.assert_array_equal(
            found.point_data["Normals"][: len(surfaces[0].vertices)], surfaces[0].normals
        )
    assert reader.GetOutputDataObject(1).GetNumberOfCells() == 0
    reader.SetTetrahedra(1)
    reader.Update()
    assert reader.GetOutputDataObject(1).GetNumberOfCells() == series.info["tetrahedra"]
    reader.ClearIsovalues()
    reader.SetFileName(tooth.path)
    reader.SetTetrahedra(0)
    reader.SetRegion(10, 50, 10, 50, 10, 50)
    reader.SetCutAtRegion(1)
    reader.Update()
    cut = tooth.surface(tooth.spectrum().suggestions[0], bounds=(10, 50, 10, 50, 10, 50))
    assert reader.GetOutputDataObject(0).GetNumberOfPoints() == len(cut.vertices)


def test_napari_without_qt(tooth, tmp_path):
    from isospan import _napari

    assert _napari.get_reader(str(tmp_path)) is None and _napari.get_reader([]) is None
    [[data, about, kind]] = _napari.get_reader(tooth.path)(tooth.path)
    assert kind == "surface" and about["name"] == "tooth"
    surface = tooth.surface(about["metadata"]["isospan"]["isovalue"])
    np.testing.assert_array_equal(data[0], surface.vertices[:, ::-1])
    # Axes and corners are both turned round: what was seen from outside still is.
    volumes = []
    for vertices, faces in ((surface.vertices, surface.faces), data):
        a, b, c = (vertices[faces[:, k]].astype(float) - vertices.mean(0) for k in range(3))
        volumes.append(np.einsum("ij,ij->i", a, np.cross(b, c)).sum())
    np.testing.assert_allclose(volumes[0], volumes[1], rtol=1e-3)
    ends = tooth.range
    for place in (0, 1, 500, 1000):
        assert _napari.place_of(_napari.isovalue_at(place, ends), ends) == place
    points = _napari.curve(tooth.spectrum(), ends, 200, 80)
    assert points[:, 0].min() >= 0 and points[:, 0].max() <= 199 and points[:, 1].min() == 0
    vertices, faces = _napari.layer_data(tooth.surface(1e6))
    assert len(vertices) == 3 and len(faces) == 1


def test_the_manifest_of_napari():
    from pathlib import Path

    import yaml
    from isospan import _napari

    manifest = yaml.safe_load(Path(_napari.__file__).with_name("napari.yaml").read_text())
    commands = {c["id"]: c["python_name"] for c in manifest["contributions"]["commands"]}
    used = [
        r["command"]
        for r in manifest["contributions"]["readers"] + manifest["contributions"]["widgets"]
    ]
    assert sorted(used) == sorted(commands)
    assert commands["isospan.get_reader"] == "isospan._napari:get_reader" and callable(
        _napari.get_reader
    )


def test_dask_makes_the_bytes_of_reduce(tmp_path):
    from distributed import Client, LocalCluster

    import isospan.dask

    here = isospan.reduce(TOOTH, tmp_path / "here.isospan", points="regular", fraction="1/64", chunk_points=1000)
    heard = []
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        with Client(cluster) as client:
            there = isospan.dask.reduce(
                TOOTH,
                tmp_path / "there.isospan",
                shards=5,
                memory="256MiB",
                points="regular", fraction="1/64",
                chunk_points=1000,
                progress=lambda *told: heard.append(told),
            )
            # An archive goes to workers by its path.
            counts = client.map(lambda a, v: a.count(v), [there] * 2, [400, 1000.5])
            assert client.gather(counts) == [here.count(400), here.count(1000.5)]
    assert same_files(here.path, there.path, but=())
    shards = [told for told in heard if told[0] == "shards"]
    assert shards[0][1] == 0 and shards[-1][1] == shards[-1][2] > 1
    with pytest.raises(isospan.UsageError, match="file"):
        isospan.dask.reduce(field(), tmp_path / "x.isospan")
