#!/usr/bin/env python3
"""Reads an archive of a lattice as src/archive/FORMAT.md describes it, without isospan. Slow; to check the description.

    read_archive.py ARCHIVE [--step N] [-o FILE.npz]

Prints the number of points, the range of values, and the largest difference between the ranges that are stored of blocks
and those of their values. FILE.npz has `positions` (n x 3, lattice steps), `values` (n, NaN where void). With nodes at
samples they are those of all points, else those of bricks: values at the ends of the domain are a pcodec file, left out.

Other point sets, several chunks, and values that are not rounded are refused by name. Needs Python 3.9 and NumPy.
"""
import argparse
import functools
import json
import pathlib
import re
import struct
import sys

import numpy as np

MAGIC, END = b"\x89ISO\r\n\x1a\n", b"ISOEND\r\n"
VALUES, VOID = 2, -(2**31)
DOCUMENT = (pathlib.Path(__file__).resolve().parents[1] / "src/archive/FORMAT.md").read_text()


def refuse(what):
    sys.exit(f"read_archive.py: {what}")


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def expect(path, what, expected, got):
    if expected != got:
        refuse(f"{path}: {what}: expected {expected}, got {got}")


def varints(data):
    numbers, shift = [0], 0
    for byte in data:
        numbers[-1] |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            numbers, shift = numbers + [0], 0
    return numbers[:-1]


def value_blocks(archive, number):
    """The blocks of a step's values: all but the last one of the segment, which tells that they are those of one chunk."""
    path = archive / f"steps/{number:06}-values-000000.seg"
    blocks = segment_blocks(path, VALUES)
    expect(path, "chunk table", [0, 1, len(blocks) - 1], varints(blocks.pop()))
    return blocks


def segment_blocks(path, of_kind):
    """All blocks of a segment of that kind."""
    data = path.read_bytes()
    header, footer = data[:40], data[-48:]
    expect(path, "magic", MAGIC, header[:8])
    version, oldest, kind = struct.unpack("<HHI", header[8:16])
    expect(path, "kind", of_kind, kind)
    if oldest > 5 or version < 5:
        refuse(f"{path}: format {version}, readable by {oldest} and later; this reads 5")
    expect(path, "checksum of the header", crc32c(header[:36]), struct.unpack("<I", header[36:])[0])
    expect(path, "end", END, footer[36:44])
    expect(path, "checksum of the footer", crc32c(footer[:44]), struct.unpack("<I", footer[44:])[0])
    (count, at, length), blocks = struct.unpack("<QQQ", footer[:24]), []
    expect(path, "length", length, len(data))
    while len(blocks) < count:
        n = min(16, count - len(blocks))
        page = data[at : at + 12 + 8 * n]
        expect(path, "checksum of a page", crc32c(page[:-4]), struct.unpack("<I", page[-4:])[0])
        offset = struct.unpack("<Q", page[:8])[0]
        for k in range(n):
            size, crc = struct.unpack("<II", page[8 + 8 * k : 16 + 8 * k])
            blocks.append(data[offset : offset + size])
            expect(path, "checksum of a block", crc, crc32c(blocks[-1]))
            offset += size
        at += len(page)
    expect(path, "end of the directory", len(data) - 48, at)
    return blocks


class Lattice:
    """The points of the one chunk of a lattice, in the order of their numbers, in half cells."""

    def __init__(self, cells, brick):
        self.cells, self.bricks, self.places = cells, [], []
        for low in boxes([-(-c // b) for c, b in zip(cells, brick)]):
            low = [l * b for l, b in zip(low, brick)]
            size = [min(b, c - l) for l, b, c in zip(low, brick, cells)]
            self.bricks.append((low, size))
            self.places += [tuple(2 * l + p for l, p in zip(low, place)) for place in brick_places(size)]
        self.ends()

    def ends(self):
        """The points that no block of cells has: nodes at high ends, face centres above and below."""
        for piece in range(1, 8):
            for at in boxes([1 if piece >> a & 1 else c for a, c in enumerate(self.cells)]):
                self.places.append(tuple(2 * c if piece >> a & 1 else 2 * at[a] for a, c in enumerate(self.cells)))
        for high in (True, False):
            for axis in range(3):
                end = 2 * self.cells[axis] if high else 0
                for at in boxes([1 if a == axis else c for a, c in enumerate(self.cells)]):
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


def first_odds():
    """By table, class and length the four tables of FORMAT.md, by length those of second bits; in 65536ths."""
    rows = [[int(n) for n in line.split()] for line in DOCUMENT.splitlines() if re.fullmatch(r"    (\d+ ){19}\d+", line)]
    assert len(rows) == 80
    odds = {(k // 20, k % 20, l): 256 * n for k, row in enumerate(rows) for l, n in enumerate(row)}
    return odds | {l: 256 * 96 for l in range(2, 21)}


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


@functools.lru_cache(maxsize=None)
class Brick:
    """How values at nodes and centres of a brick of so many cells, or of so many nodes alone, are predicted."""

    def __init__(self, size, centres):
        nodes = boxes(size)
        places = brick_places(size) if centres else [tuple(2 * c for c in cell) for cell in nodes]
        numbers = {place: n for n, place in enumerate(places)}
        order = [((0, 0, 0), 0, 8)]
        for s, k in [(s, k) for s in (8, 4, 2, 1) for k in (3, 2, 1)]:
            for cell in nodes:
                if all(c % s == 0 for c in cell) and sum(c // s % 2 for c in cell) == k:
                    order.append((tuple(2 * c for c in cell), 0 if s > 1 else 1, 2 * s))
        if centres:
            order += [(tuple(2 * c + 1 for c in cell), 2, 2) for cell in nodes]
        done, self.steps = set(), []
        for place, kind, t in order:
            near, span = [], range(-t, t + 1, 1 if t == 2 else t)
            for d in [(x, y, z) for z in span for y in span for x in span]:
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

    @functools.cached_property
    def smooth_steps(self):
        """The same for smooth bricks: numbers, table and neighbours."""
        steps, weights = [], {}
        for i, number in enumerate(self.numbers):
            apart = self.places[:i] - self.places[i]
            nearest = np.argsort((apart * apart).sum(axis=1), kind="stable")[:32]
            if (key := apart[nearest].tobytes()) not in weights:
                weights[key] = smooth_weights(apart[nearest]) if i else []
            steps.append((number, 3, [(self.numbers[k], w) for k, w in zip(nearest, weights[key])]))
        return steps

    def decode(self, coder, odds, parts=1, most=None):
        """Numbers in order, of nodes in so many parts of a step and from 0 to `most`; the odds learn."""
        smooth = coder.number(1) == 1
        values, apart = [0] * len(self.steps), [0] * len(self.steps)
        for number, table, near in self.smooth_steps if smooth else self.steps:
            mean = signed((sum(w * values[n] for n, w in near) + 2**13) >> 14)
            if smooth:
                spread = sum(abs(w) * apart[n] for n, w in near[:8]) >> 12
            else:
                spread = sum(w * abs(values[n] - mean) for n, w in near) // (parts << 12)
            log = spread.bit_length() - 1
            second = spread >> (log - 1) & 1 if log > 0 else 0
            of_spread = 0 if spread == 0 else min(2 * log + second + 1, 19)
            bits = 0
            while bits < 32 and coder.bit(odds, (table, of_spread, min(bits, 19))):
                bits += 1
            difference = 0
            if bits > 0:
                size = 2 | coder.bit(odds, min(bits, 20)) if bits > 1 else 1
                if (left := max(bits - 2, 0)) > 15:
                    left, size = left - 15, size << 15 | coder.number(15)
                low = coder.number(left + 1)
                size = size << left | low >> 1
                difference = -size if low & 1 else size
            value, apart[number] = signed(mean + parts * difference), abs(difference)
            values[number] = value if most is None else min(max(value, 0), most)
        return values


def read(archive, number):
    """Positions in lattice steps, the values of the first ones or of all, and the largest error of stored ranges."""
    manifest = json.loads((archive / "manifest.json").read_text())
    plan, steps = manifest["plan"], {s["number"]: s for s in manifest["steps"] + manifest.get("bases", [])}
    dims, log2 = plan["lattice"]["dims"], plan["lattice"]["log2_steps"]
    asked = [s["number"] for s in manifest["steps"] if s.get("place", s["number"]) == number]
    if len(asked) != 1:
        refuse(f"{archive}: {len(asked)} steps of number {number}")
    number = asked[0]
    at_samples, quantiser = steps[number].get("vertex_values") == "nodes", steps[number].get("quantiser")
    edge = 16 if at_samples else 8
    if plan["points"].get("set") != "lattice" or plan.get("explicit") or plan["brick_edge"] != [edge] * 3:
        refuse(f"{archive}: its points are no lattice in bricks of {edge}^3 cells")
    if not quantiser:
        refuse(f"{archive}: its values are not rounded")
    expect(archive, "chunks", 1, manifest["counts"].get("chunks", 1))
    lattice = Lattice(plan["points"]["cells"], plan["brick_edge"])
    expect(archive, "points", len(lattice.places), manifest["counts"]["points"])
    if at_samples:
        expect(archive, "cells between the samples", [d - 1 for d in dims], lattice.cells)
        numbers = of_nodes(archive, number, lattice, quantiser.get("parts", 1), quantiser["bits"])
    else:
        numbers = integers(archive, steps, number, lattice)
    values = floats(numbers, quantiser)
    positions = lattice.positions([(d - 1) << s for d, s in zip(dims, log2 if isinstance(log2, list) else 3 * [log2])])
    return positions, values, range_error(bricks_of(archive, number, lattice, at_samples)[1], lattice, values)


def bricks_of(archive, number, lattice, at_samples=False):
    """The bytes of each brick, and of the ranges. Behind the groups of bricks are 1024 values a block, without nodes."""
    blocks, bricks = value_blocks(archive, number), lattice.bricks
    others = len(lattice.places) - sum(2 * a * b * c for _, (a, b, c) in bricks)
    groups = len(blocks) - 2 - (0 if at_samples else -(-others // 1024))
    size, found = next(2**k for k in range(7) if -(-len(bricks) // 2**k) == groups), []
    for first, block in zip(range(0, len(bricks), size), blocks):
        last = min(size, len(bricks) - first) - 1
        lengths = varints(block)[:last]
        at = sum(max(1, -(-n.bit_length() // 7)) for n in lengths)
        for length in lengths + [len(block)]:
            found.append(block[at : at + length])
            at += length
    return found, blocks[-2]


def floats(numbers, q):
    return np.where(np.equal(numbers, VOID), np.nan, q["origin"] + np.multiply(numbers, q["step"])).astype(np.float32)


def integers(archive, steps, number, lattice):
    """The rounded values of a step, of its base where they refer to it."""
    odds, found, base = first_odds(), [], None
    for block, (_, size) in zip(bricks_of(archive, number, lattice)[0], lattice.bricks):
        if block[0] not in (48, 49):
            refuse(f"{archive}: step {number}: values of codec {block[0]}, which is not of bricks")
        values = Brick(tuple(size), True).decode(RangeCoder(block[1:]), dict(odds))
        if block[0] == 49:
            if base is None:
                before, q = steps[number]["base"]["number"], steps[number]["quantiser"]
                base = floats(integers(archive, steps, before, lattice), steps[before]["quantiser"]).astype(float)
                base = ((base - q["origin"]) / q["step"]).clip(-(2**30), 2**30)
                base = np.where(np.isnan(base), VOID, base + np.copysign(np.nextafter(0.5, 0), base)).astype(int).tolist()
            values = [signed(v + b) for v, b in zip(values, base[len(found) :])]
        found += values
    return found


def of_nodes(archive, number, lattice, parts, bits):
    """The values of all points in steps, not rounded: means of the nodes around, which are stored in parts of a step."""
    nodes, first = np.zeros([c + 1 for c in lattice.cells], int), first_odds()
    for block, (low, size) in zip(bricks_of(archive, number, lattice, True)[0], lattice.bricks):
        if block[0] != 50:
            refuse(f"{archive}: step {number}: nodes of codec {block[0]}, which is not of bricks without void")
        coder, odds, spans = RangeCoder(block[1:]), dict(first), []
        for l, s, c in zip(low, size, lattice.cells):
            end = l + s + (l + s == c)
            spans.append([slice(l, l + 8), slice(l + 8, end)] if end - l > 9 else [slice(l, end)])
        for part in [(x, y, z) for z in spans[2] for y in spans[1] for x in spans[0]]:
            part_size = tuple(s.stop - s.start for s in part)
            values = Brick(part_size, False).decode(coder, odds, parts, int((2**bits - 1) * parts))
            nodes[part] = np.reshape(values, part_size, order="F")
    # All eight are one node at a node, and in pairs one at a face centre.
    low, high = np.array(lattice.places).T // 2, (np.array(lattice.places).T + 1) // 2
    corners = [nodes[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    return sum(corners) / (8 * parts)


def ranges_of(data, count):
    """The bounds, and ranges within them, each with its number of tetrahedra."""
    (low, high), (least, most), coder = np.frombuffer(data[:8], "<f4"), struct.unpack("<II", data[8:16]), RangeCoder(data[16:])
    odds = {"constant": 6000, "again": 60000, "short": 60000, "same": 20000, "larger": 32768} | dict.fromkeys(range(1, 5), 25000)
    number = lambda bits: sum(coder.number(min(16, bits - k)) << k for k in range(0, bits, 16))
    single = lambda bits: np.frombuffer(struct.pack("<I", bits), "<f4")[0]
    found, constant, exponent = [], 0, 0
    for _ in range(count):
        if (tetrahedra := least + number((most - least).bit_length())) == 0:
            found.append((np.inf, -np.inf, 0))
        elif coder.bit(odds, "constant"):
            constant = constant if coder.bit(odds, "again") else number(32)
            found.append((single(constant), single(constant), tetrahedra))
        elif not coder.bit(odds, "short"):
            found.append((single(number(32)), single(number(32)), tetrahedra))
        else:
            if not coder.bit(odds, "same"):
                sign, apart = 1 if coder.bit(odds, "larger") else -1, 1
                while coder.bit(odds, min(apart, 4)):
                    apart += 1
                exponent += sign * apart
            first, last = (int(float(end) // 2.0**exponent) for end in (low, high))
            first += number((last - first).bit_length())
            ends = [n * 2.0**exponent for n in (first, first + number(5) + 16)]
            found.append((max(ends[0], low), min(ends[1], high), tetrahedra))
    return low, high, found


def range_error(block, lattice, values):
    """The largest difference of the stored ranges of bricks from those of their values, rounded outwards."""
    lengths, worst = [2 * a * b * c for _, (a, b, c) in lattice.bricks], 0.0
    low, high, stored = ranges_of(block, len(lengths))
    for ends, part in zip(stored, np.split(values, np.cumsum(lengths))):
        if not np.isnan(part).all():
            lo, hi = float(np.nanmin(part)), float(np.nanmax(part))
            unit = 2.0 ** (np.frexp(hi - lo)[1] - 5)
            lo, hi = (lo, hi) if hi == lo else (max(lo // unit * unit, low), min(-(-hi // unit) * unit, high))
            worst = max(worst, abs(lo - ends[0]), abs(hi - ends[1]))
    return worst


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive", type=pathlib.Path)
    parser.add_argument("--step", type=int, default=0)
    parser.add_argument("-o", "--output", type=pathlib.Path)
    arguments = parser.parse_args()
    positions, values, worst = read(arguments.archive, arguments.step)
    print(f"{len(values)} of {len(positions)} points, values {np.nanmin(values):g} .. {np.nanmax(values):g}, ranges off by {worst:g}")
    if arguments.output:
        np.savez(arguments.output, positions=positions[: len(values)], values=values)
