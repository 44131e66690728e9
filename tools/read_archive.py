#!/usr/bin/env python3
"""Reads an archive of a lattice as src/archive/FORMAT.md describes it, without isospan. Slow; to check the description.

    read_archive.py ARCHIVE [--step N] [-o FILE.npz]

Prints the number of points, the range of values, and the largest difference between the ranges that are stored of blocks
and those of their values. FILE.npz has `positions` (n x 3, lattice steps), `values` (n, NaN where void): those of bricks.
Values at the ends of the domain are a pcodec file, which is left out.

Archives of other point sets, of several chunks, and of values that are not rounded are refused by name.
Needs Python 3.9, NumPy, and zstd: Python 3.14 has it, before that the library libzstd is looked for.
"""
import argparse
import ctypes
import ctypes.util
import json
import pathlib
import re
import struct
import sys

import numpy as np

MAGIC, END = b"\x89ISO\r\n\x1a\n", b"ISOEND\r\n"
MESH, VALUES = 1, 2
VOID = -(2**31)


def refuse(what):
    sys.exit(f"read_archive.py: {what}")


def unzstd(frame, most):
    """The content of a zstd frame, of at most so many bytes."""
    try:
        from compression import zstd
    except ImportError:
        library = ctypes.CDLL(ctypes.util.find_library("zstd") or "libzstd.so.1")
        library.ZSTD_decompress.restype = ctypes.c_size_t
        content = ctypes.create_string_buffer(most)
        size = library.ZSTD_decompress(content, ctypes.c_size_t(most), frame, ctypes.c_size_t(len(frame)))
        if library.ZSTD_isError(ctypes.c_size_t(size)):
            refuse("a damaged zstd frame")
        return content.raw[:size]
    return zstd.decompress(frame)


# ---------------------------------------------------------------- segments

TABLE = []
for n in range(256):
    for _ in range(8):
        n = n >> 1 ^ (0x82F63B78 if n & 1 else 0)
    TABLE.append(n)


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = TABLE[(crc ^ byte) & 255] ^ crc >> 8
    return crc ^ 0xFFFFFFFF


def expect(path, what, expected, got):
    if expected != got:
        refuse(f"{path}: {what}: expected {expected}, got {got}")


def varint(data, at):
    value, shift = 0, 0
    while True:
        byte = data[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at


class Segment:
    """A file of blocks with a directory; its last block tells which blocks a chunk has."""

    def __init__(self, path, kind):
        data = path.read_bytes()
        header, footer = data[:40], data[-48:]
        expect(path, "magic", MAGIC, header[:8])
        version, oldest, found = struct.unpack("<HHI", header[8:16])
        expect(path, "kind", kind, found)
        if oldest > 5 or version < 5:
            refuse(f"{path}: format {version}, readable by {oldest} and later; this reads 5")
        expect(path, "checksum of the header", crc32c(header[:36]), struct.unpack("<I", header[36:])[0])
        expect(path, "end", END, footer[36:44])
        expect(path, "checksum of the footer", crc32c(footer[:44]), struct.unpack("<I", footer[44:])[0])
        count, directory, length = struct.unpack("<QQQ", footer[:24])
        expect(path, "length", length, len(data))
        self.blocks, at = [], directory
        while len(self.blocks) < count:
            n = min(16, count - len(self.blocks))
            page = data[at : at + 12 + 8 * n]
            expect(path, "checksum of a page", crc32c(page[:-4]), struct.unpack("<I", page[-4:])[0])
            offset = struct.unpack("<Q", page[:8])[0]
            for k in range(n):
                size, crc = struct.unpack("<II", page[8 + 8 * k : 16 + 8 * k])
                block = data[offset : offset + size]
                expect(path, "checksum of a block", crc, crc32c(block))
                self.blocks.append(block)
                offset += size
            at += len(page)
        expect(path, "end of the directory", len(data) - 48, at)
        table = self.blocks.pop()
        _, at = varint(table, 0)
        self.chunks, at = varint(table, at)


# ---------------------------------------------------------------- points


class Lattice:
    """The points of the one chunk of a lattice, in the order of their numbers, in half cells."""

    def __init__(self, cells, brick):
        self.cells, self.brick = cells, brick
        self.bricks, self.places = [], []
        for low in boxes([-(-c // b) for c, b in zip(cells, brick)]):
            low = [l * b for l, b in zip(low, brick)]
            size = [min(b, c - l) for l, b, c in zip(low, brick, cells)]
            self.bricks.append(size)
            for place in brick_places(size):
                self.places.append(tuple(2 * l + p for l, p in zip(low, place)))
        self.ends()

    def ends(self):
        """The points that no block of cells has: nodes at high ends, face centres above and below."""
        for piece in range(1, 8):
            box = [1 if piece >> a & 1 else c for a, c in enumerate(self.cells)]
            for at in boxes(box):
                self.places.append(tuple(2 * c if piece >> a & 1 else 2 * at[a] for a, c in enumerate(self.cells)))
        for high in (True, False):
            for axis in range(3):
                box = [1 if a == axis else c for a, c in enumerate(self.cells)]
                end = 2 * self.cells[axis] if high else 0
                for at in boxes(box):
                    self.places.append(tuple(end if a == axis else 2 * at[a] + 1 for a in range(3)))

    def positions(self, steps):
        """Lattice steps: plane j of an axis of M steps and n cells is at floor((j M + n) / 2n)."""
        axes = [[(j * m + n) // (2 * n) for j in range(2 * n + 1)] for m, n in zip(steps, self.cells)]
        return np.array([[axes[a][p[a]] for a in range(3)] for p in self.places])


def boxes(size):
    """All triples below a size, x fastest."""
    return [(x, y, z) for z in range(size[2]) for y in range(size[1]) for x in range(size[0])]


def brick_places(size):
    """Places of a brick's values, in half cells, in the order of their numbers: by blocks of 4^3 cells, nodes, then centres."""
    places = []
    for low in boxes([-(-s // 4) for s in size]):
        block = boxes([min(4, s - 4 * l) for l, s in zip(low, size)])
        for half in (0, 1):
            places += [tuple(8 * l + 2 * c + half for l, c in zip(low, cell)) for cell in block]
    return places


# ---------------------------------------------------------------- values


class RangeCoder:
    def __init__(self, data):
        self.data, self.at, self.r = data + bytes(8), 4, 2**32 - 1
        self.x = int.from_bytes(self.data[:4], "big")

    def refill(self):
        while self.r < 2**24:
            self.r <<= 8
            self.x = (self.x << 8 | self.data[self.at]) & 0xFFFFFFFF
            self.at += 1

    def bit(self, odds, key):
        p = odds[key]
        b = (self.r >> 16) * p
        if self.x < b:
            self.r, odds[key], bit = b, p + ((65536 - p) >> 5), 1
        else:
            self.x, self.r, odds[key], bit = self.x - b, self.r - b, p - (p >> 5), 0
        self.refill()
        return bit

    def number(self, bits):
        if bits == 0:
            return 0
        self.r >>= bits
        number = min(self.x // self.r, 2**bits - 1)
        self.x -= self.r * number
        self.refill()
        return number


def first_odds(document):
    """The tables of FORMAT.md: four, of 20 classes, 20 lengths; in 65536ths."""
    rows = [[int(n) for n in line.split()] for line in document.splitlines() if re.fullmatch(r"    (\d+ ){19}\d+", line)]
    assert len(rows) == 80
    return {(k // 20, k % 20, l): 256 * n for k, row in enumerate(rows) for l, n in enumerate(row)}


def signed(n):
    return (n + 2**31) % 2**32 - 2**31


def variance(apart):
    """Of the difference of values so far apart."""
    squared = (apart * apart).sum(axis=-1).astype(float)
    return squared / np.sqrt(np.sqrt(np.sqrt(np.maximum(squared, 1.0))))


def smooth_weights(near):
    """The weights of neighbours at such offsets, the nearest one first."""
    rest, v, own = near[1:] - near[0], variance(near[1:] - near[0]), variance(near[0])
    matrix = (v[:, None] + v[None, :]) - variance(rest[:, None] - rest[None, :])
    matrix = np.column_stack([matrix, (v + own) - variance(near[1:])])
    for i in range(len(rest)):
        matrix[i] /= matrix[i, i]
        factors = matrix[:, i].copy()
        factors[i] = 0.0
        matrix -= factors[:, None] * matrix[i]
    weights = [int(w) for w in np.floor(2**14 * matrix[:, -1] + 0.5)]
    return [2**14 - sum(weights)] + weights


class Brick:
    """How values of a brick of so many cells are predicted."""

    known = {}

    def __init__(self, size):
        numbers = {place: n for n, place in enumerate(brick_places(size))}
        nodes = boxes(size)
        order = [((0, 0, 0), 0, 8)]
        for s in (4, 2, 1):
            for k in (3, 2, 1):
                for cell in nodes:
                    if all(c % s == 0 for c in cell) and sum(c // s % 2 for c in cell) == k:
                        order.append((tuple(2 * c for c in cell), 0 if s > 1 else 1, 2 * s))
        order += [(tuple(2 * c + 1 for c in cell), 2, 2) for cell in nodes]
        done, self.steps = set(), []
        for place, kind, t in order:
            by = 1 if t == 2 else t
            near = []
            for d in [(x, y, z) for z in range(-t, t + 1, by) for y in range(-t, t + 1, by) for x in range(-t, t + 1, by)]:
                other = tuple(p + q for p, q in zip(place, d))
                if other in done:
                    near.append((numbers[other], 3 * 2**20 // sum(c * c for c in d)))
            if near:
                whole = sum(part for _, part in near)
                near = [(n, 2**14 * part // whole) for n, part in near]
                near[-1] = (near[-1][0], 2**14 - sum(w for _, w in near[:-1]))
            self.steps.append((numbers[place], kind, near))
            done.add(place)
        assert len(self.steps) == len(numbers)
        self.places, self.numbers = np.array([place for place, _, _ in order]), [n for n, _, _ in self.steps]
        self.smooth, self.weights = None, {}

    def smooth_steps(self):
        """The same for smooth bricks: numbers, table and neighbours."""
        if self.smooth is None:
            self.smooth = []
            for i, number in enumerate(self.numbers):
                apart = self.places[:i] - self.places[i]
                nearest = np.argsort((apart * apart).sum(axis=1), kind="stable")[:32]
                near = apart[nearest]
                key = near.tobytes()
                if key not in self.weights:
                    self.weights[key] = smooth_weights(near) if i else []
                self.smooth.append((number, 3, [(self.numbers[k], w) for k, w in zip(nearest, self.weights[key])]))
        return self.smooth

    @classmethod
    def of(cls, size):
        size = tuple(size)
        if size not in cls.known:
            cls.known[size] = cls(size)
        return cls.known[size]

    def decode(self, data, odds):
        coder, odds, seconds = RangeCoder(data), dict(odds), {n: 96 * 256 for n in range(2, 21)}
        smooth = coder.number(1) == 1
        values, apart = [0] * len(self.steps), [0] * len(self.steps)
        for number, table, near in self.smooth_steps() if smooth else self.steps:
            mean = signed((sum(w * values[n] for n, w in near) + 2**13) >> 14)
            if smooth:
                spread = sum(abs(w) * apart[n] for n, w in near[:8]) >> 12
            else:
                spread = sum(w * abs(values[n] - mean) for n, w in near) >> 12
            log = spread.bit_length() - 1
            second = spread >> (log - 1) & 1 if log > 0 else 0
            of_spread = 0 if spread == 0 else min(2 * log + second + 1, 19)
            bits = 0
            while bits < 32 and coder.bit(odds, (table, of_spread, min(bits, 19))):
                bits += 1
            difference = 0
            if bits > 0:
                size = 1
                if bits > 1:
                    size = 2 | coder.bit(seconds, min(bits, 20))
                left = max(bits - 2, 0)
                if left > 15:
                    left -= 15
                    size = size << 15 | coder.number(15)
                low = coder.number(left + 1)
                size = size << left | low >> 1
                difference = -size if low & 1 else size
            values[number], apart[number] = signed(mean + difference), abs(difference)
        return values


# ---------------------------------------------------------------- archives


def read(archive, number):
    """Positions in lattice steps, values, and the largest error of stored ranges."""
    manifest = json.loads((archive / "manifest.json").read_text())
    plan, steps = manifest["plan"], {s["number"]: s for s in manifest["steps"]}
    if plan["points"].get("set") != "lattice" or plan.get("explicit") or plan["brick_edge"] != [8, 8, 8]:
        refuse(f"{archive}: its points are no lattice in bricks of 8^3 cells")
    if not all(s.get("quantiser") for s in manifest["steps"]):
        refuse(f"{archive}: its values are not rounded")
    if manifest["counts"]["chunks"] != 1:
        refuse(f"{archive}: it has several chunks")
    if number not in steps:
        refuse(f"{archive}: no step {number}")
    lattice = Lattice(plan["points"]["cells"], plan["brick_edge"])
    numbers = integers(archive, steps, number, lattice)
    quantiser = steps[number]["quantiser"]
    values = np.array([np.nan if n == VOID else quantiser["origin"] + n * quantiser["step"] for n in numbers])
    values = values.astype(np.float32)
    dims, log2 = plan["lattice"]["dims"], plan["lattice"]["log2_steps"]
    positions = lattice.positions([(d - 1) << log2 for d in dims])
    # Those in bricks come first.
    return positions[: len(values)], values, range_error(archive, number, lattice, values)


def blocks_of(archive, number):
    return Segment(archive / f"steps/{number:06}-values-000000.seg", VALUES).blocks


def lengths(lattice):
    """Values of each value block: bricks where they have 8 cells along each edge; then 1024 each."""
    total = len(lattice.places)
    bricks = [2 * a * b * c for a, b, c in lattice.bricks]
    rest = total - sum(bricks)
    return bricks, [min(1024, rest - k) for k in range(0, rest, 1024)]


def integers(archive, steps, number, lattice):
    """The rounded values of a step, of its base where they refer to it."""
    document = pathlib.Path(__file__).resolve().parents[1] / "src/archive/FORMAT.md"
    odds, found, base = first_odds(document.read_text()), [], None
    blocks = blocks_of(archive, number)
    for block, size in zip(blocks, lattice.bricks):
        codec, body = block[0], block[1:]
        if codec not in (48, 49):
            refuse(f"{archive}: step {number}: values of codec {codec}, which is not of bricks")
        values = Brick.of(size).decode(body, odds)
        if codec == 49:
            if base is None:
                base = integers(archive, steps, steps[number]["base"]["number"], lattice)
            at = len(found)
            values = [signed(v + b) for v, b in zip(values, base[at : at + len(values)])]
        found += values
    return found


def range_error(archive, number, lattice, values):
    bricks, rest = lengths(lattice)
    block = blocks_of(archive, number)[len(bricks) + len(rest)]
    stored = np.frombuffer(unzstd(block, 8 * (len(bricks) + len(rest))), "<f4").reshape(2, -1).T
    at, worst = 0, 0.0
    for (lo, hi), count in zip(stored, bricks):
        part = values[at : at + count]
        if len(part) and not np.isnan(part).all():
            worst = max(worst, abs(float(lo) - float(np.nanmin(part))), abs(float(hi) - float(np.nanmax(part))))
        at += count
    return worst


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive", type=pathlib.Path)
    parser.add_argument("--step", type=int, default=0)
    parser.add_argument("-o", "--output", type=pathlib.Path)
    arguments = parser.parse_args()
    positions, values, worst = read(arguments.archive, arguments.step)
    print(f"{len(values)} points in bricks, values {np.nanmin(values):g} .. {np.nanmax(values):g}, ranges off by {worst:g}")
    if arguments.output:
        np.savez(arguments.output, positions=positions, values=values)
