"""The examples run, small."""

import os
import subprocess
import sys
from ctypes.util import find_library

import pytest
from conftest import ROOT, TOOTH


@pytest.mark.parametrize(
    "script, arguments, made",
    [
        ("tooth.py", [TOOTH, "tooth.png"], ["tooth.png"]),
        ("time_series.py", [], ["drops_0008.vtp", "drops.pvd"]),
        ("larger_than_memory.py", ["96"], ["gyroid.isospan/manifest.json"]),
    ],
)
def test_example(script, arguments, made, tmp_path):
    if ".png" in str(made) and not (find_library("EGL") or find_library("OSMesa")):
        pytest.skip("VTK draws with EGL or OSMesa, and there is neither (Debian: libegl1)")
    path = ROOT / "tools/python/examples" / script
    command = [sys.executable, str(path), *map(str, arguments)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert "isospan.Archive" in done.stdout or "step" in done.stdout
    assert all((tmp_path / name).stat().st_size > 1000 for name in made if "pvd" not in name)
    assert all((tmp_path / name).exists() for name in made)
