"""Compares what read_pyramid.py reads of pyramid archives with what isospan finds, bit by bit.

Usage: test_pyramid.py PROGRAM FOLDER. PROGRAM is isospan; FOLDER is for files.
Ranges of bricks and hashes are compared with those that FORMAT.md describes.
"""
import json
import re
import struct
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import xxhash
from files import manifest_text
from read_pyramid import Pyramid
from test import SEED, wave

HASHED = [
    "number", "time", "source", "interpolation", "vertex_values", "nan", "missing", "quantiser",
    "wavelet", "keyframes", "measured", "base",
]
RANDOM = np.random.default_rng(SEED)


def rough(size, noise=0.05):
    """A smooth field with some noise."""
    return (wave(size) + noise * RANDOM.normal(size=size[::-1])).astype("f4")


def label_images(size):
    """Names and label images: regions, grains of noise, numbers of all lengths."""
    regions = np.round(3 * wave(size)).astype("i4")
    yield "regions", regions
    noise = RANDOM.random(regions.shape)
    yield "grains", np.where(noise < 0.1, (1e5 * noise).astype("i4"), regions)
    yield "all lengths", ((2.0 ** (24 * noise)).astype("i4") * np.where(noise % 0.1 < 0.05, 1, -1)).astype("i4")
    yield "one label", np.full(regions.shape, 70_000, "i4")


def cases():
    """A name, samples (z, y, x) and what isospan is asked for, of each archive."""
    # One chunk and several along an axis; 257 samples are one chunk.
    for size in [(300, 9, 17), (257, 9, 8), (70, 20, 33), (258, 20, 17), (8, 269, 5), (2, 3, 771)]:
        yield f"{size}", rough(size), []
        yield f"{size}, within", rough(size), ["--target-max", "1%"]
        yield f"{size}, whole", np.round(50 * rough(size)).astype("i2"), ["--lossless"]
    for size in [(2, 2, 2), (2, 3, 5), (7, 7, 7), (8, 2, 2), (9, 17, 33)]:
        yield f"{size}", rough(size), ["--target-max", "1%"]
    # More than 16 chunks are several segments.
    yield "several segments", rough((3, 256 * 17, 2)), ["--target-max", "2%"]
    yield "an RMS error", rough((70, 40, 33)), ["--target-rms", "0.1%"]
    yield "fine", rough((40, 30, 20)), ["--target-max", "0.00001"]
    yield "smooth", wave((300, 20, 17)).astype("f4"), []
    yield "labels", np.round(2 * wave((300, 20, 17))).astype("i1"), ["--lossless"]
    high = np.round(50 * rough((70, 40, 33))).astype("i4") + 2**30
    yield "an offset", high, ["--lossless"]
    high = 5 * rough((70, 40, 33)).astype("f8") + 1e6
    yield "an offset, within", high, ["--target-max", "0.1%"]
    for scale in (1e30, 1e-30, 1e-40):
        yield f"times {scale}", (scale * rough((40, 33, 21)).astype("f8")).astype("f4"), []
    yield "constant", np.full((20, 21, 22), -3.7, "f4"), []
    yield "constant, whole", np.full((20, 21, 22), 7, "u1"), ["--lossless"]
    for size in [(70, 20, 33), (300, 9, 17), (257, 9, 8), (3, 2, 289), (2, 2, 2)]:
        for name, labels in label_images(size):
            yield f"{name}, {size}", labels, ["--labels"]
    missing = np.round(3 * rough((70, 40, 33)))
    missing[20:, :20, 5:] = np.nan
    yield "labels that are missing", missing, ["--labels", "--nan", "mask"]
    missing = rough((70, 40, 33))
    missing[20:, :20] = np.nan
    yield "a value for missing samples", missing, ["--nan", "100", "--target-max", "0.01"]
    for size in [(70, 40, 17), (300, 9, 17), (9, 8, 40), (5, 4, 3)]:
        missing = rough(size)
        missing[size[2] // 2 :, : size[1] // 2] = np.nan
        missing[RANDOM.random(missing.shape) < 0.01] = np.nan
        missing[:, :, 256:] = np.nan
        missing[0, 0, :2] = 0, 1
        for asked in (["--target-max", "1%"], ["--target-rms", "1%"]):
            yield f"missing samples, {size}", missing, ["--nan", "mask", *asked]
    high = np.round(50 * missing.astype("f8")) + 2**30
    declared = np.where(np.isnan(missing), -1e9, high).astype("i4")
    yield "declared samples", declared, ["--nan", "mask", "--missing=-1e9", "--lossless"]
    # Axes along which neighbours differ more than along the others are split later.
    z, _, x = np.meshgrid(*(np.arange(n) for n in (20, 18, 260)), indexing="ij")
    for name, field in [
        ("rough along x", np.sin(0.01 * z) + RANDOM.normal(size=(1, 1, 260))),
        ("rough along z", np.sin(0.02 * x) + RANDOM.normal(size=(20, 1, 1))),
        ("rough along y and z", np.sin(0.01 * x) + RANDOM.normal(size=(20, 18, 1))),
    ]:
        yield name, field.astype("f4"), ["--target-max", "5%"]


def series():
    """A name, the steps and what isospan is asked for, of archives of several steps."""
    yield "a series", [rough((40, 30, 20)) + t for t in range(3)], []
    first = rough((20, 12, 258), 0.1)
    change = first.copy()
    change[250:, 4:9, 10:] += 0.5
    moved, gone = np.roll(first, 1, axis=2), np.full(first.shape, first.mean(), "f4")
    steps = [first, first, change, moved, gone, first]
    for asked in ([], ["--keyframes", "4"], ["--target-max", "1%"]):
        yield f"a series that changes, {asked}", steps, asked
    yield "whole numbers that change", [np.round(50 * s).astype("i2") for s in steps], ["--lossless"]


class Program:
    """isospan."""

    def __init__(self, program, folder):
        self.program, self.folder = program, Path(folder)
        self.archive = self.folder / "pyramid.isospan"

    def _run(self, *words):
        done = subprocess.run([self.program, *map(str, words)], capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"tools/wavelet/test: isospan {words[0]} fails: {done.stderr}")

    def reduce(self, volumes, asked):
        """Makes an archive, a step of each volume."""
        files = [self.folder / f"{n}.npy" for n in range(len(volumes))]
        for file, samples in zip(files, volumes):
            np.save(file, samples)
        made = ["--points", "pyramid", "-o", self.archive, "--force", *asked]
        self._run("reduce", "-q", *files, *made)

    def samples(self, shape, step):
        """All samples of a step, (z, y, x)."""
        out = self.folder / "out.npy"
        grid = ",".join(map(str, shape[::-1]))
        self._run("probe", "-q", self.archive, "--step", step, "--grid", grid, "-o", out, "--force")
        return np.load(out)


def rounded(least, largest, bounds):
    """A range, rounded outwards."""
    if least == largest:
        return least, largest
    if least > largest:
        return least, largest
    unit = 2.0 ** (np.frexp(largest - least)[1] - 5)
    return max(least // unit * unit, bounds[0]), min(-(-largest // unit) * unit, bounds[1])


def live_cells(samples):
    """Which cells have no missing sample."""
    known = ~np.isnan(samples)
    for axis in range(3):
        n = known.shape[axis]
        known = known.take(range(n - 1), axis) & known.take(range(1, n), axis)
    return known


def live_nodes(samples):
    """The samples of such cells; NaN elsewhere."""
    live = np.pad(live_cells(samples), 1)
    for axis in range(3):
        n = live.shape[axis]
        live = live.take(range(n - 1), axis) | live.take(range(1, n), axis)
    return np.where(live, samples, np.nan)


def range_of(samples):
    """The least and the largest of samples, as far as they are known."""
    known = samples[~np.isnan(samples)]
    return (float(known.min()), float(known.max())) if known.size else (np.inf, -np.inf)


def bricks_that_differ(pyramid):
    """How many bricks have another range or number of cells than their nodes say."""
    differ, levels = 0, {}
    for told, bricks in pyramid.bricks():
        for level in {level for (level, _), _ in bricks} - levels.keys():
            levels[level] = pyramid.nodes(level)
        ranges = [range_of(live_nodes(levels[level][of])) for (level, of), _ in bricks]
        bounds = min(r[0] for r in ranges), max(r[1] for r in ranges)
        known = [range_of(levels[0][of]) for (level, of), _ in bricks if level == 0]
        known = min(r[0] for r in known), max(r[1] for r in known)
        differ += told != (*known, *bounds)
        for ((level, of), stored), (least, largest) in zip(bricks, ranges):
            count = int(live_cells(levels[level][of]).sum())
            differ += stored != (*rounded(least, largest, bounds), count)
    return differ


def hashes_that_differ(archive):
    """Names of files whose hashes are not those that FORMAT.md describes."""
    packed, text = (archive / "manifest.zst").read_bytes(), manifest_text(archive)
    if packed[-16:] != struct.pack("<IIQ", 0x184D2A50, 8, xxhash.xxh3_64_intdigest(packed[:-16])):
        yield "manifest.zst"
    # Numbers keep their form.
    manifest = json.loads(text, parse_float=lambda number: f"\t{number}\t")
    text_of = lambda part: json.dumps(part, separators=(",", ":"), ensure_ascii=False)
    written = lambda part: re.sub(r'"\\t(.*?)\\t"', r"\1", text_of(part))
    plan = xxhash.xxh3_128_hexdigest(written(manifest["plan"]).encode())
    for step in manifest["steps"]:
        part = {name: step[name] for name in HASHED if name in step}
        part["source"] = {k: v for k, v in part["source"].items() if k != "units"} | {"path": ""}
        of_step = xxhash.xxh3_128_intdigest((plan + written(part)).encode())
        lists = ("values", "ranges")
        files = {f"{name}-{n:06}": s for name in lists for n, s in enumerate(step[name])}
        files |= {name: step[name] for name in ("coarse", "index") if name in step}
        for name, record in files.items():
            data = (archive / f"steps/{step['number']:06}-{name}.seg").read_bytes()
            content = xxhash.xxh3_64_intdigest(data[:-48])
            of_file = int.from_bytes(data[16:32], "little"), int.from_bytes(data[-24:-16], "little")
            told = len(data), f"{content:016x}"
            if of_file != (of_step, content) or told != (record["bytes"], record["content_hash"]):
                yield name


def far_from_source(samples, source, step):
    """Whether the samples are further from those of the source than the step promises."""
    correction = step["wavelet"].get("correction", "none")
    if correction == "none":
        return False
    bound = correction["max"] if isinstance(correction, dict) else 0
    source = source.astype("f8")
    source[source == step.get("missing")] = np.nan
    if step.get("nan", "mask") != "mask":
        source = np.where(np.isnan(source), float(step["nan"]), source)
    if (np.isnan(source) != np.isnan(samples)).any():
        return True
    return np.nanmax(abs(samples - source)) > bound + step["source"].get("rounding", 0)


def differences(program, source, number):
    """What is not as it must be of a step, in words."""
    pyramid = Pyramid(program.archive, number)
    samples = pyramid.nodes(0)
    theirs = program.samples(source.shape, number)
    offset = pyramid.step["source"].get("offset", 0)
    # A probe gives no -0.
    added = np.float64(offset) if offset else np.float32(0)
    ours = (samples + added).astype(theirs.dtype)
    # A NaN has any bits.
    ours, theirs = (np.where(np.isnan(s), 7e30, s).astype(s.dtype) for s in (ours, theirs))
    if differ := np.flatnonzero(ours.view("u1") != theirs.view("u1")).size:
        yield f"{differ} bytes of samples"
    z, y, x = pyramid.strides()
    if (pyramid.missing_nodes() != pyramid.missing[::z, ::y, ::x]).any():
        yield "missing nodes"
    if differ := bricks_that_differ(pyramid):
        yield f"{differ} bricks"
    if far_from_source(samples + added, source, pyramid.step):
        yield "samples are too far from those of the source"


def faults_of(case):
    """What is not as it must be of an archive, in words; and whether it has delays."""
    _, volumes, asked = case
    with tempfile.TemporaryDirectory(dir=sys.argv[2]) as folder:
        program = Program(sys.argv[1], folder)
        program.reduce(volumes, asked)
        found = [what for n, v in enumerate(volumes) for what in differences(program, v, n)]
        found += [f"a hash of {file}" for file in hashes_that_differ(program.archive)]
        plan = json.loads(manifest_text(program.archive))["plan"]
    return found, any(plan["points"].get("delay", []))


def main():
    """Tries all archives; says which differ."""
    faults, archives, delayed = 0, 0, 0
    tried = [*series(), *((n, [v], a) for n, v, a in cases())]
    with ProcessPoolExecutor() as processes:
        for (name, *_), (found, delays) in zip(tried, processes.map(faults_of, tried)):
            for what in found:
                print(f"tools/wavelet/test: pyramid, {name}: {what}", file=sys.stderr)
            faults, archives, delayed = faults + len(found), archives + 1, delayed + delays
    if faults or not delayed:
        sys.exit(f"tools/wavelet/test: {faults} differ, {delayed} pyramids have delays")
    print(f"{archives} pyramids, {delayed} with delays")


if __name__ == "__main__":
    main()
