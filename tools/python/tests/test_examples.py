"""The notebooks run, and print what is shown in them."""

from ctypes.util import find_library

import nbformat
import pytest
from conftest import ROOT
from nbclient import NotebookClient

HERE = "tools/python/examples"


def printed(notebook):
    """What each cell prints, and whether it ends with a picture."""
    shown = []
    for cell in notebook.cells:
        outputs = cell.get("outputs", [])
        text = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")
        shown.append((text, any("image/jpeg" in o.get("data", {}) for o in outputs)))
    return shown


@pytest.mark.parametrize("name", sorted(p.name for p in (ROOT / HERE).glob("*.ipynb")))
def test_a_notebook_prints_what_is_shown_in_it(name, tmp_path):
    if not (find_library("EGL") or find_library("OSMesa")):
        pytest.skip("VTK draws with EGL or OSMesa, and there is neither (Debian: libegl1)")
    # Its own place, from which the data sets are found as from the checkout.
    folder = tmp_path / HERE
    folder.mkdir(parents=True)
    (tmp_path / "datasets").symlink_to(ROOT / "datasets")
    notebook = nbformat.read(ROOT / HERE / name, as_version=4)
    expected = printed(notebook)
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}})
    client.execute()
    assert printed(notebook) == expected
    assert any(picture for _, picture in expected)


def test_there_are_notebooks():
    assert len(list((ROOT / HERE).glob("*.ipynb"))) == 3
