"""What the package's page shows runs, and it shows all there is."""

import inspect
import re

import numpy as np
import pytest
import pyvista
from conftest import ROOT, field

import isospan

BLOCKS = re.findall(
    r"^```python\n(.*?)^```",
    (ROOT / "tools/python/PYTHON.md").read_text(),
    re.DOTALL | re.MULTILINE,
)


def test_the_examples_of_the_page_run(tmp_path, monkeypatch, capsys):
    from isospan import _pyvista

    samples = (500 * field() + 1000).astype("<f4")
    nz, ny, nx = samples.shape
    header = f"NRRD0004\ntype: float\ndimension: 3\nsizes: {nx} {ny} {nz}\nendian: little\n"
    (tmp_path / "scan.nrrd").write_bytes(f"{header}encoding: raw\n\n".encode() + samples.tobytes())
    # The entry points of the installed package do this.
    pyvista.register_reader(".isospan", _pyvista.read, override=True)
    pyvista.register_writer(".isospan", _pyvista.write, override=True)
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in BLOCKS:
        exec(compile(block, "PYTHON.md", "exec"), names)
    assert len(names["surface"]) == names["mesh"].n_cells > 0
    assert "memory" in capsys.readouterr().out
    assert {"scan.ply", "both.vtp", "ball_0002.ply", "ball.vti", "ball.vtu"} <= {
        p.name for p in tmp_path.iterdir()
    }
    assert isospan.open("image.isospan").dims == names["ball"].shape[::-1]
    assert np.isfinite(isospan.open("parts.isospan").range).all()


def public(kind):
    return [
        name for name in vars(kind) if not name.startswith("_") and name not in ("close", "path")
    ]


@pytest.mark.parametrize(
    "name",
    [
        *(n for n in isospan.__all__ if inspect.isfunction(getattr(isospan, n))),
        *(f"archive.{n}" for n in public(isospan.Archive) if n != "report"),
        *(f"surface.{n}" for n in public(isospan.Surface) if n != "isovalue"),
    ],
)
def test_the_page_has_an_example_of(name):
    called = name.rpartition(".")[2]
    assert any(re.search(rf"\b{called}\b", block) for block in BLOCKS)
