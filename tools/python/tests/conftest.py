"""What the tests share: the program, data sets, archives that it has made."""

import json
import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

import isospan

ROOT = Path(__file__).resolve().parents[3]
TOOTH = ROOT / "datasets/tooth/tooth.nhdr"


#: A program that asks an archive, and lets forked children ask it too.
FORKED = """
import multiprocessing, os, sys
import isospan

def ask(_=None):
    found = archive.surface(1000.5), archive.surface(1000.5, decimate=0.5)
    values = archive.probe([[1.0, 2.0, 3.0]]), archive.sample((4, 4, 4))
    counts = archive.count(1000.5), len(archive.spectrum().isovalues)
    archive.check()
    return [f.faces.tobytes() for f in found], [v.tobytes() for v in values], counts

archive = isospan.open(sys.argv[1])
expected = ask()
with multiprocessing.get_context("fork").Pool(2) as pool:
    assert all(found == expected for found in pool.map(ask, range(4)))
child = os.fork()
if child == 0:
    # Without a question, and down to the end of the interpreter.
    sys.exit(0)
assert os.waitpid(child, 0)[1] == 0
assert ask() == expected
"""


@pytest.fixture
def ctrl_c():
    """Ctrl-C raises KeyboardInterrupt, also where a shell runs the tests in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def _report(text):
    """What the program printed as JSON, as the package gives it."""
    report = json.loads(text)
    assert report.pop("schema").startswith("isospan.") and report.pop("version") == 1
    return report


@pytest.fixture(scope="session")
def program():
    """Runs the program that cargo has built; gives what it prints."""
    path = os.environ["ISOSPAN_PROGRAM"]

    def run(*arguments, code=0):
        done = subprocess.run([path, "-q", *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode == code, done.stderr
        return _report(done.stdout) if "--json" in arguments else done.stdout + done.stderr

    return run


def field(shape=(18, 24, 20), time=0.0):
    """A smooth field, indexed [z, y, x]."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return (np.sin(3 * x + time) + y * y - 0.5 * z + 0.1 * np.cos(9 * y * z)).astype(np.float32)


def same_files(a, b, but=("manifest.zst",)):
    """Whether two archives have the same files with the same bytes, but for those that tell the
    source."""
    names = [sorted(p.relative_to(f) for p in Path(f).rglob("*") if p.is_file()) for f in (a, b)]
    assert names[0] == names[1] and names[0]
    return all(
        Path(a, n).read_bytes() == Path(b, n).read_bytes() for n in names[0] if n.name not in but
    )


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("archives")


@pytest.fixture(scope="session")
def tooth(folder, program):
    """An archive of the tooth, made by the program."""
    path = folder / "tooth.isospan"
    program("reduce", TOOTH, "-o", path, "--points", "regular", "--fraction", "1/64")
    return isospan.open(path)


@pytest.fixture(scope="session")
def series(folder, program):
    """An archive of three steps."""
    for n in range(3):
        np.save(folder / f"step_{n}.npy", field(time=n / 4))
    path = folder / "series.isospan"
    steps = [folder / f"step_{n}.npy" for n in range(3)]
    program("reduce", *steps, "-o", path, "--points", "regular", "--fraction", "1/2", "--times", "0,0.5,2")
    return isospan.open(path)
