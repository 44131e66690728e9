"""Compares what read_array.py reads with what isospan-wavelet decodes, bit by bit.

Usage: test.py PROGRAM FOLDER. PROGRAM is the crate's example `array`; FOLDER is for files.
"""
import struct
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import read_array

SEED = 20
# Sizes along x, y, z.
SIZES = [
    (1, 1, 1), (7, 3, 2), (8, 1, 1), (8, 8, 8), (9, 9, 9), (17, 1, 40), (5, 100, 3), (31, 33, 8),
    (128, 8, 8), (40, 33, 9), (130, 20, 9), (70, 10, 65),
]
DAMAGED = 60


def wave(size):
    """A smooth field."""
    z, y, x = np.meshgrid(*(np.arange(n) for n in reversed(size)), indexing="ij")
    return np.sin(0.21 * x + 0.5) * np.cos(0.13 * y) + np.sin(0.3 * z + 0.02 * x)


def cases():
    """A name, samples (z, y, x) and a step, or another accuracy, of each array."""
    random = np.random.default_rng(SEED)
    for size in SIZES:
        yield "smooth", wave(size), 0.01
    for size in SIZES[:10]:
        yield "noise", random.normal(size=size[::-1]), 0.3
        yield "constant", np.full(size[::-1], -3.7), 0.3
    field = wave((40, 17, 21))
    for step in (1e-6, 1e-4, 0.1, 1, 1e6):
        yield f"a step of {step}", field, step
    for scale in (1.5e38, 1e37, 1e-30, 1e-40, 1e-44):
        yield f"times {scale}", field * scale, 0.003 * scale
    yield "edges", np.sign(field) + 20 * (field > 0.5), 0.5
    yield "points", 1000 * (random.random(field.shape) < 0.002), 1
    for bound in (1e-5, 0.01, 0.3):
        yield f"within {bound}", field + 0.1 * random.normal(size=field.shape), f"max:{bound}"
        yield f"within {bound}", random.normal(size=(9, 1, 40)), f"max:{bound}"
    yield "whole numbers", np.round(200 * field), "lossless"
    yield "labels", np.round(2 * field), "lossless"
    yield "an RMS error", field, "rms:0.01"
    yield "zeros of both signs", np.where(field > 0, field, -0.0), 0.01
    # Axes along which neighbours differ more than along the others are split later.
    z, _, x = np.meshgrid(*(np.arange(n) for n in (20, 18, 48)), indexing="ij")
    yield "rough along x", np.sin(0.01 * z) + random.normal(size=(1, 1, 48)), 0.02
    yield "rough along z", np.sin(0.02 * x) + random.normal(size=(20, 1, 1)), 0.02
    yield "rough along y and z", np.sin(0.01 * x) + random.normal(size=(20, 18, 1)), 0.1


def turbulence(shape, random):
    """Noise of all directions, the coarser the stronger."""
    frequencies = np.meshgrid(*(np.fft.fftfreq(n) for n in shape), indexing="ij")
    k = np.sqrt(sum(f**2 for f in frequencies)) + 1 / max(shape)
    return np.fft.ifftn(np.fft.fftn(random.normal(size=shape)) * k**-2.5).real


def hats(n, stride):
    """What nodes at each `stride`-th of n samples give between them, linearly: a matrix."""
    nodes = (n - 1) // stride + 1
    made = np.zeros(((nodes - 1) * stride + 1, nodes))
    for i, row in enumerate(made):
        j = min(i // stride, nodes - 2)
        row[j : j + 2] = 1 - (i / stride - j), i / stride - j
    return made


def along_all(matrices, array):
    """The array (z, y, x) with a matrix applied along each axis."""
    return np.einsum("kz,jy,ix,zyx->kji", *matrices, array, optimize=True)


def far_from_best(samples, nodes, stride):
    """The RMS error of nodes over that of the best ones, with linear interpolation."""
    matrices = [hats(n, stride) for n in samples.shape]
    samples = samples[tuple(slice(len(m)) for m in matrices)]
    best = along_all([np.linalg.pinv(m) for m in matrices], samples)
    error = lambda nodes: np.sqrt(np.mean((along_all(matrices, nodes) - samples) ** 2))
    return error(nodes) / error(best)


class Program:
    """The crate's example."""

    def __init__(self, program, folder):
        self.program, self.folder = program, Path(folder)

    def _run(self, *words):
        return subprocess.run([self.program, *map(str, words)], capture_output=True, text=True)

    def compress(self, samples, accuracy):
        """The bytes of an array."""
        given, made = self.folder / "given.f32", self.folder / "made"
        given.write_bytes(samples.astype("<f4").tobytes())
        if not isinstance(accuracy, str):
            accuracy = f"{accuracy:.17g}"
        done = self._run("compress", given, *samples.shape[::-1], accuracy, made)
        if done.returncode:
            sys.exit(f"tools/wavelet/test: {done.stderr}")
        return made.read_bytes()

    def decode(self, data, level):
        """The bytes of the nodes of a level; None if they are refused, and why."""
        file, out = self.folder / "file", self.folder / "out.f32"
        file.write_bytes(data)
        done = self._run("decode", file, level, out)
        if done.returncode not in (0, 1):
            sys.exit(f"tools/wavelet/test: the program fails: {done.stderr}")
        return (None if done.returncode else out.read_bytes()), done.stderr


def read(data, level):
    """The bytes of the nodes of a level; None if they are refused, and why."""
    try:
        return read_array.read(data, level).astype("<f4").tobytes(), ""
    except ValueError as why:
        return None, str(why)


def differences(case):
    """What differs of an array at a level, in words; nothing if nothing does."""
    _, data, level = case
    with tempfile.TemporaryDirectory(dir=sys.argv[2]) as folder:
        (theirs, error), (ours, why) = Program(sys.argv[1], folder).decode(data, level), read(data, level)
    if theirs is None or ours is None:
        return "" if theirs is ours else f"one refuses it: {error or why}"
    theirs, ours = (np.frombuffer(b, "<u4") for b in (theirs, ours))
    if theirs.size != ours.size:
        return f"{ours.size} nodes, not {theirs.size}"
    differing = np.flatnonzero(ours != theirs)
    return f"{differing.size} nodes, the first is {differing[0]}" if differing.size else ""


def damaged(data, random):
    """The bytes with one or two others at places behind the sizes."""
    data = bytearray(data)
    for _ in range(random.integers(1, 3)):
        data[random.integers(20, len(data))] = random.integers(256)
    return bytes(data)


def wrong_headers(data):
    """The bytes with headers that are none: samples, a size, a step, a kind of corrections."""
    for at, kind, value in [
        (24, "<d", 1e9), (24, "<d", np.nan), (32, "<d", np.inf), (32, "<d", 1e300), (16, "<I", 0),
        (40, "<i", 1001), (23, "<B", 3), (44, "<f", 2.0**-23), (44, "<f", 2.0**61), (44, "<f", np.nan),
    ]:
        changed = bytearray(data)
        struct.pack_into(kind, changed, at, value)
        yield bytes(changed)


def main():
    """Tries all arrays; says which differ."""
    program, random, faults = Program(*sys.argv[1:]), np.random.default_rng(SEED), 0
    tried = []  # A name, bytes and a level each.
    small, arrays, delayed = [], 0, 0
    for name, samples, step in cases():
        name = f"{name}, {samples.shape[::-1]}"
        data = program.compress(samples, step)
        levels = len(read_array.Reader(data).levels)
        tried += [(name, data, level) for level in range(levels + 1)]
        arrays, delayed = arrays + 1, delayed + any(data[20:23])
        if samples.size < 60_000 and len(data) > 64:
            small.append((name, data))
    levels = len(tried) - arrays
    for i in range(DAMAGED):
        name, data = small[i % len(small)]
        tried.append((f"{name}, damaged", damaged(data, random), 0))
    tried += [(f"{small[0][0]}, a wrong header", data, 0) for data in wrong_headers(small[0][1])]
    with ProcessPoolExecutor() as processes:
        for (name, _, level), what in zip(tried, processes.map(differences, tried, chunksize=4)):
            if what:
                print(f"tools/wavelet/test: {name}, level {level}: {what}", file=sys.stderr)
                faults += 1
    rough = turbulence((61, 64, 70), random)
    data = program.compress(rough, 0.01 * rough.std())
    faults += any(data[20:23])  # Strides differ where an axis is split later.
    for level in (1, 2, 3):
        ratio = far_from_best(rough, read_array.read(data, level).astype(float), 2**level)
        if not 1 <= ratio < 1.05:
            print(f"tools/wavelet/test: level {level} is {ratio:.3f} times the best", file=sys.stderr)
            faults += 1
    if faults or not delayed:
        sys.exit(f"tools/wavelet/test: {faults} differ, {delayed} arrays have delays")
    print(f"{arrays} arrays, {delayed} with delays, of {levels} levels; and {DAMAGED} damaged ones")


if __name__ == "__main__":
    main()
