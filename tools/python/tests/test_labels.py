"""Labels of an image from Python: which there are, their surfaces, and the files of the program."""

import pickle

import numpy as np
import pytest
import trimesh

import isospan

SPACING = (0.5, 1.0, 2.0)
NAMES = {3: ("liver", (200, 60, 50)), 7: "kidney"}


@pytest.fixture(scope="module")
def image():
    """Two halves of a ball of different sizes, a box and a single voxel, in a background."""
    z, y, x = np.mgrid[:40, :44, :48]
    ball = (x - 20) ** 2 + (y - 21) ** 2 + (z - 19) ** 2 < 16**2
    labels = np.where(ball, np.where(x < 24, 3, 7), 0).astype(np.int16)
    labels[2:12, 2:12, 40:48] = -5
    labels[39, 43, 0] = 100
    return labels


@pytest.fixture(scope="module")
def archive(image, tmp_path_factory):
    path = tmp_path_factory.mktemp("labels") / "labels.isospan"
    return isospan.reduce(image, path, labels=True, spacing=SPACING)


def test_each_label_is_listed(image, archive):
    found = archive.labels(label_table=NAMES)
    numbers, counts = np.unique(image[image != 0], return_counts=True)
    assert [one.label for one in found] == numbers.tolist() == [-5, 3, 7, 100]
    assert [one.voxels for one in found] == counts.tolist()
    np.testing.assert_allclose([one.volume for one in found], counts * np.prod(SPACING))
    assert [one.name for one in found] == ["", "liver", "kidney", ""]
    assert found[1].colour == (200, 60, 50, 255) != found[2].colour
    whole = archive.labels(background=True)
    assert whole[1].label == 0 and sum(one.voxels for one in whole) == image.size


def test_surfaces_are_closed_and_have_their_volume(image, archive):
    for smooth in (0, True, 20):
        for surface in archive.label_surface([7, 3], smooth=smooth):
            mesh = surface.to_trimesh()
            volume = np.count_nonzero(image == surface.label) * np.prod(SPACING)
            assert mesh.is_watertight and mesh.is_winding_consistent and surface.is_closed
            assert mesh.volume == pytest.approx(volume, rel=0.01 if smooth else 1e-5)
            assert surface.volume == pytest.approx(mesh.volume, rel=1e-4)
    assert isinstance(mesh, trimesh.Trimesh) and mesh.metadata["label"] == 3


def test_neighbours_share_their_walls(archive):
    for smooth in (0, 10):
        a, b = archive.label_surface([3, 7], smooth=smooth)
        # Triangles as sets of places; those of the wall are in both.
        walls = [{tuple(sorted(map(tuple, t))) for t in s.vertices[s.faces].tolist()} for s in (a, b)]
        wall = walls[0] & walls[1]
        assert len(wall) > 1000
        one = archive.label_surface(3, smooth=smooth)
        np.testing.assert_array_equal(one.vertices, a.vertices)


def test_order_names_and_pickles(archive, tmp_path):
    kidney, liver = archive.label_surface(np.array([7, 3]), label_table=NAMES)
    assert (liver.label, liver.name, kidney.name) == (3, "liver", "kidney")
    assert [s.label for s in archive.label_surface()] == [-5, 3, 7, 100]
    again = pickle.loads(pickle.dumps(liver))
    assert isinstance(again, isospan.LabelSurface) and again.colour == liver.colour
    np.testing.assert_array_equal(again.faces, liver.faces)
    assert repr(liver).startswith("<isospan.LabelSurface of 3 'liver': ")
    assert "liver" in liver._repr_html_()
    mesh = liver.to_pyvista()
    assert mesh.field_data["label"][0] == 3 and mesh.n_open_edges == 0
    assert all(isinstance(piece, isospan.LabelSurface) for piece in liver.components())
    (tmp_path / "names.csv").write_text("label,name,r,g,b\n3,liver,200,60,50\n")
    assert archive.label_surface(3, label_table=tmp_path / "names.csv").name == "liver"


@pytest.mark.parametrize("end", ["glb", "ply", "obj", "vtp"])
def test_files_are_those_of_the_program(archive, program, tmp_path, end):
    (tmp_path / "names.csv").write_text("label,name,r,g,b\n3,liver,200,60,50\n7,kidney,1,2,3\n")
    flags = ("--smooth", "--label-table", tmp_path / "names.csv")
    program("surface", archive.path, "--labels", "3,7", "-o", tmp_path / f"p.{end}", *flags)
    names = {3: ("liver", (200, 60, 50)), 7: ("kidney", (1, 2, 3, 255))}
    choices = {"smooth": True, "label_table": names}
    report = archive.save_label_surface(tmp_path / f"w.{end}", [3, 7], **choices)
    expected = (tmp_path / f"p.{end}").read_bytes()
    assert (tmp_path / f"w.{end}").read_bytes() == expected
    assert report["file_bytes"] == len(expected)
    isospan.save_surfaces(archive.label_surface([3, 7], **choices), tmp_path / f"s.{end}")
    assert (tmp_path / f"s.{end}").read_bytes() == expected
    archive.save_label_surface(tmp_path / f"one_{{}}.{end}", "all", **choices)
    archive.label_surface(7, **choices).save(tmp_path / f"seven.{end}")
    seven = (tmp_path / f"one_7.{end}").read_bytes()
    assert (tmp_path / f"seven.{end}").read_bytes() == seven
    assert len(list(tmp_path.glob(f"one_*.{end}"))) == 4


def test_what_makes_no_sense_is_refused(archive, tmp_path):
    field = isospan.reduce(np.random.default_rng(0).random((9, 9, 9)), tmp_path / "f.isospan")
    with pytest.raises(isospan.UsageError, match="label"):
        field.label_surface(3)
    with pytest.raises(isospan.UsageError, match="label"):
        archive.surface(3)
    with pytest.warns(isospan.Notice, match="no voxel has the label 9"):
        assert len(archive.label_surface(9)) == 0
    for bad, says in [(1.5, "whole number"), ("liver", "'all'"), ([3, 3], "twice"), ([], "at least")]:
        with pytest.raises(isospan.UsageError, match=says):
            archive.label_surface(bad)
    with pytest.raises(isospan.UsageError, match="64"):
        archive.label_surface(3, smooth=65)
    with pytest.raises(isospan.UsageError, match="background"):
        archive.label_surface(3, background=True)
    with pytest.raises(isospan.UsageError, match="colour"):
        archive.labels(label_table={3: ("liver", (1, 2))})
    with pytest.raises(isospan.BadInputError, match="names.csv"):
        (tmp_path / "names.csv").write_text("a,b\n1,2\n")
        archive.labels(label_table=tmp_path / "names.csv")


def test_a_compression_is_taken_by_its_name(archive, tmp_path):
    sizes = {}
    for compress in (False, True, "quantized", "meshopt"):
        path = tmp_path / f"{compress}.glb"
        archive.save_label_surface(path, [3, 7], compress=compress)
        sizes[compress] = path.stat().st_size
    assert sizes[False] > sizes[True] == sizes["quantized"] > 1.5 * sizes["meshopt"]
    with pytest.raises(isospan.UsageError, match="'zip'"):
        archive.save_label_surface(tmp_path / "z.glb", 3, compress="zip")
