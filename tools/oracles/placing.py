"""Places files of other programs: an archive of each has the oracle's values at the oracle's places.

A module of cases has functions marked @program. Each writes files with a package, or finds those
that the package ships, and yields what the package says of them: a `Case`, or a `Refused`.
"""

import dataclasses
import importlib.metadata
import json
import re
import subprocess
import zlib
from pathlib import Path

import numpy as np

# Samples along the slowest axis first: no two alike, and the product is that of a probe's points.
SHAPE = (5, 6, 7)
POINTS = 210
# Places are moved inwards by this part, so as to be inside; for it and for f32 values may be off.
INWARDS, OF_RANGE, OF_VALUE = 1e-9, 1e-7, 1.2e-7
# Of a mesh, whose positions are rounded to 2^24 steps.
MESH_INWARDS, MESH_OF_RANGE = 1e-6, 2e-5
METRES = {"m": 1, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "Å": 1e-10, "pm": 1e-12}
METRES |= {"\u00b5m": 1e-6, "\u03bcm": 1e-6}
# A point at each sample, with its value.
EXACT = "--points regular --fraction 1 --values sample --no-measure".split()

PROGRAMS = []


def program(*packages):
    """Marks a function that yields cases of these packages."""

    def keep(function):
        PROGRAMS.append((packages, function))
        return function

    return keep


@dataclasses.dataclass
class Case:
    """A file, and what its own program finds in it."""

    path: Path
    values: np.ndarray
    # Where each sample is: an axis more than `values`, of x, y and z.
    places: np.ndarray
    # Arguments of `isospan reduce`.
    args: tuple = ()
    # Of a series: the time of each step, and its values as first axis. None as a time: not known.
    times: tuple | None = None
    # Units that the archive must tell; that of lengths is one of METRES, and may be another there.
    length: str | None = None
    unit: str | None = None
    time: str | None = None
    # Values at the vertices of a mesh, which is kept as it is.
    is_mesh: bool = False
    name: str = ""


@dataclasses.dataclass
class Refused:
    """A file that must be refused, in a line that has the words."""

    path: Path
    words: str
    args: tuple = ()
    name: str = ""


def numbers(dtype, shape=SHAPE):
    """Values from end to end of a type's range, in no order."""
    dtype = np.dtype(dtype)
    count = int(np.prod(shape))
    if dtype.kind in "iu":
        bits = min(8 * dtype.itemsize, 31)
        ends = (0, 2**bits - 1) if dtype.kind == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        values = np.linspace(*ends, count).round()
    else:
        values = np.linspace(-3.5, 11.25, count)
    order = np.random.default_rng(count).permutation(count)
    return values[order].reshape(shape).astype(dtype)


def affine(matrix, shape):
    """Places of an array whose axes are the columns of a 4 x 4 matrix."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    return index @ np.asarray(matrix, float)[:3, :3].T + np.asarray(matrix, float)[:3, 3]


def along(x, y, z):
    """Places of an array [z, y, x] by the coordinates of its axes."""
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    return np.stack([x, y, z], axis=-1)


def grid(spacing=(1, 1, 1), origin=(0, 0, 0), shape=SHAPE):
    """Places of an array [z, y, x] by spacing and origin of x, y and z."""
    return along(*(o + s * np.arange(n) for s, o, n in zip(spacing, origin, reversed(shape))))


def rotation(x, y, z):
    """A matrix that turns about x, then y, then z, in degrees."""
    turn = np.eye(3)
    for axis, degrees in enumerate((x, y, z)):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        a, b = [(1, 2), (2, 0), (0, 1)][axis]
        one = np.eye(3)
        one[[a, a, b, b], [a, b, a, b]] = c, -s, s, c
        turn = one @ turn
    return turn


class Wrong(Exception):
    """A file is not placed as its own program places it."""


class Placer:
    """Runs isospan on cases, in a folder."""

    def __init__(self, isospan, folder):
        self.isospan, self.folder = isospan, folder

    def run(self, *args):
        return subprocess.run([self.isospan, *map(str, args)], capture_output=True, encoding="utf-8", timeout=120)

    def try_case(self, case, number):
        """Raises `Wrong`, or gives the number of steps that were placed."""
        archive = self.folder / f"{number}.isospan"
        sentinel = lower(case.values) if isinstance(case, Case) else 0
        kept = ["--fraction", "1"] if getattr(case, "is_mesh", False) else [*EXACT, f"--nan={sentinel}"]
        made = self.run("reduce", "-q", "--json", case.path, "-o", archive, *kept, *case.args)
        if isinstance(case, Refused):
            refused(made, case, archive)
            return 0
        if made.returncode != 0:
            raise Wrong(f"exit {made.returncode}: {made.stderr.strip()}")
        report = json.loads(made.stdout)
        scale = 1
        if (case.length, case.unit, case.time) != (None, None, None):
            scale = units(case, json.loads(self.run("info", archive, "--json").stdout)["units"])
        steps = [None] if case.times is None else range(len(case.times))
        if case.times is not None:
            same_times(case.times, [step["time"] for step in report["steps"]])
        elif len(report["steps"]) != 1:
            raise Wrong(f"{len(report['steps'])} steps where there is one volume")
        for step in steps:
            expected = case.values if step is None else case.values[step]
            expected = np.where(np.isfinite(expected), expected, sentinel)
            self.compare(archive, step, expected, case.places * scale, case.is_mesh)
        return len(steps)

    def compare(self, archive, step, expected, places, is_mesh):
        if expected.shape != places.shape[:-1]:
            raise Wrong(f"the case is wrong: values {expected.shape}, places {places.shape}")
        expected, places = expected.reshape(-1).astype(float), places.reshape(-1, 3)
        chosen = samples(len(expected))
        middle = places.mean(axis=0)
        inwards, of_range = (MESH_INWARDS, MESH_OF_RANGE) if is_mesh else (INWARDS, OF_RANGE)
        at = middle + (places[chosen] - middle) * (1 - inwards)
        points, found = archive.with_suffix(".csv"), archive.with_suffix(".npy")
        points.write_text("x,y,z\n" + "".join("%.17g,%.17g,%.17g\n" % tuple(p) for p in at))
        which = [] if step is None else ["--step", step]
        probed = self.run("probe", "-q", archive, "--at", points, "-o", found, "--force", *which)
        if probed.returncode != 0:
            raise Wrong(f"probe, exit {probed.returncode}: {probed.stderr.strip()}")
        values = np.load(found).reshape(-1).astype(float)
        expected = expected[chosen]
        tolerance = of_range * np.ptp(expected) + OF_VALUE * abs(expected).max()
        bad = ~(abs(values - expected) <= tolerance)
        if bad.any():
            n = int(np.argmax(bad))
            raise Wrong(
                f"{'' if step is None else f'step {step}: '}{bad.sum()} of {len(bad)} samples; "
                f"at {at[n].tolist()} {values[n]:.9g}, expected {expected[n]:.9g}"
            )


def lower(values):
    """A number below all values: what missing ones become."""
    there = values[np.isfinite(values)].astype(float)
    return float(np.floor(there.min() - np.ptp(there) / 4 - 1))


def samples(count):
    """Numbers of the samples that are probed: the first, the last and others."""
    if count <= POINTS:
        return np.arange(count)
    return np.unique(np.append(np.random.default_rng(count).integers(0, count, POINTS), [0, count - 1]))


def refused(made, case, archive):
    line = made.stderr.strip().replace(str(case.path), case.path.suffix)
    # What an unknown kind of file is told has the names of all formats.
    is_named = re.search(case.words, line, re.IGNORECASE | re.DOTALL) and "got none of these" not in line
    if made.returncode not in (2, 5) or not is_named:
        raise Wrong(f"exit {made.returncode}, expected a refusal with '{case.words}': {line}")
    if archive.exists():
        raise Wrong("refused, and an archive is there")


def units(case, found):
    """What the case's lengths are in units of the archive."""
    for key in ("unit", "time"):
        expected, got = getattr(case, key), found.get("value" if key == "unit" else key)
        if expected is not None and expected != (got or ""):
            raise Wrong(f"{key}: {got}, expected {expected}")
    if case.length is None:
        return 1
    length = found.get("length")
    if length not in METRES:
        raise Wrong(f"unit of lengths: {length}, expected {case.length}")
    return METRES[case.length] / METRES[length]


def same_times(expected, found):
    same = len(expected) == len(found) and all(
        e is None or f is not None and abs(e - f) <= 1e-6 * max(1, abs(e)) for e, f in zip(expected, found)
    )
    if not same:
        raise Wrong(f"times {found}, expected {list(expected)}")


def versions(packages):
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)


def name_of(case, folder):
    path = case.path.relative_to(folder) if case.path.is_relative_to(folder) else case.path.name
    return case.name or " ".join(map(str, (path, *case.args)))


def unique(text):
    """A number for a text, that of the text alone."""
    return zlib.crc32(text.encode())
