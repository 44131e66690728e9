"""Reads an array that isospan-wavelet compressed. It is written from FORMAT.md alone.

Usage: read_array.py FILE [LEVEL] [-o OUT.npy|OUT.f32]. Names are those of FORMAT.md.
The odds to begin with are taken from FORMAT.md itself.
"""
import argparse
import itertools
import struct
from pathlib import Path

import numpy as np

FORMAT = Path(__file__).resolve().parents[2] / "src/wavelet/FORMAT.md"
HEADER = struct.Struct("<8s3I3BB2dif2I")
F = np.float32
ALPHA, BETA, GAMMA, DELTA = F(-1.5861343), F(-0.052980117), F(0.8829111), F(0.44350687)
SCALE_LOW, SCALE_HIGH = F(0.86986446), F(1.1496044)
TAPS = np.array([
    (1.146337, -0.0575435, -0.015625, 0),
    (1.241616, -0.111747, -0.008649, -0.000412),
    (1.280196, -0.136096, -0.002927, -0.001075),
    (1.292542, -0.144179, -0.000754, -0.001338),
    (1.296106, -0.146554, -0.000076, -0.001423),
    (1.297398, -0.147427, 0.000183, -0.001455),
], F)
BANDS = [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)]
ROWS = [0, 1, 2, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 5]
# The known neighbours of a coefficient, as steps along x, y, z, by their weight.
KNOWN = {
    13: [(-1, 0, 0), (0, -1, 0), (0, 0, -1)],
    5: [(-1, -1, 0), (1, -1, 0), (-1, 0, -1), (1, 0, -1), (0, -1, -1), (0, 1, -1)],
    4: [(-2, 0, 0), (0, -2, 0), (0, 0, -2)],
}


def fail_unless(holds, what):
    """Raises an error if a file is not as it must be."""
    if not holds:
        raise ValueError(what)


class RangeDecoder:
    """Takes bits from bytes. Odds are lists of two numbers, which it changes."""

    def __init__(self, data):
        self.data, self.at = data, 4
        self.r, self.x = 2**32 - 1, int.from_bytes(data[:4].ljust(4, b"\0"), "big")

    def _fill(self):
        while self.r < 1 << 24:
            byte = self.data[self.at] if self.at < len(self.data) else 0
            self.r, self.x, self.at = self.r << 8, self.x << 8 | byte, self.at + 1

    def bit(self, odds):
        """The next bit, which has these odds."""
        f, s = odds
        b = (self.r >> 16) * ((f + s) >> 1)
        one = self.x < b
        if one:
            self.r = b
            odds[:] = f + ((65536 - f) >> 4), s + ((65536 - s) >> 7)
        else:
            self.r, self.x = self.r - b, self.x - b
            odds[:] = f - (f >> 4), s - (s >> 7)
        self._fill()
        return one

    def even(self):
        """The next even bit."""
        self.r >>= 1
        one = self.x < self.r
        if not one:
            self.x -= self.r
        self._fill()
        return one

    def below_highest(self, bits):
        """A number of so many bits, of which those below the highest are even bits."""
        number = 1
        for _ in range(bits - 1):
            number = number << 1 | self.even()
        return number if bits else 0

    def count(self, row):
        """How many times in a row there is a 1, each with its own odds."""
        for count, odds in enumerate(row):
            if not self.bit(odds):
                return count
        raise ValueError("a number has too many bits")

    def end(self):
        """Fails if there are bytes that were not read."""
        fail_unless(self.at >= len(self.data), "there are bytes that nothing reads")


def even_odds(rows, columns):
    """A table of odds that begin with 32768."""
    return [[[32768, 32768] for _ in range(columns)] for _ in range(rows)]


def table_of(number):
    """The lines of numbers of a table of FORMAT.md."""
    table = FORMAT.read_text(encoding="utf-8").split("```text\n")[number].split("```")[0]
    return [[int(n) for n in row.split()] for row in table.split("\n") if row]


def first_odds():
    """The ten sets that FORMAT.md lists, each as ten lines of numbers."""
    lines = table_of(1)
    return [lines[i : i + 10] for i in range(0, len(lines), 10)]


def levels_of(sizes, delays):
    """The sizes of each level, and whether each axis was split to make it."""
    levels, splits = [tuple(sizes)], [(False, False, False)]
    t = 0
    while max(levels[-1]) >= 8:
        split = tuple(n >= 8 and t >= d for n, d in zip(levels[-1], delays))
        if any(split):
            levels.append(tuple((n + 1) // 2 if s else n for n, s in zip(levels[-1], split)))
            splits.append(split)
        t += 1
    return levels, splits


def read_coarsest(data, size):
    """The numbers of the coarsest level, (z, y, x)."""
    decoder, odds, bits = RangeDecoder(data), even_odds(3, 34), 0
    numbers = np.zeros([n + 1 for n in reversed(size)], np.int64)
    signs = 1 - 2 * (np.indices((2, 2, 2)).sum(0) % 2)
    for z, y, x in itertools.product(*(range(1, n) for n in numbers.shape)):
        around = numbers[z - 1 : z + 1, y - 1 : y + 1, x - 1 : x + 1] * signs
        bits = decoder.count(odds[min(2, bits // 3)])
        difference = decoder.below_highest(bits)
        if difference and decoder.even():
            difference = -difference
        numbers[z, y, x] = number = difference + around.sum()
        fail_unless(-(2**31) <= number < 2**31, "a number is too large")
    decoder.end()
    return numbers[1:, 1:, 1:]


def read_lengths(data, count):
    """The bytes of each tile."""
    decoder, odds, lengths = RangeDecoder(data), even_odds(2, 33), [0]
    for _ in range(count):
        lengths.append(decoder.below_highest(decoder.count(odds[lengths[-1] != 0])))
    decoder.end()
    return lengths[1:]


def part_of(tile, split, shape):
    """The slices, (z, y, x), of a tile's part of a band of this shape, (z, y, x)."""
    steps = [16 if s else 32 for s in reversed(split)]
    starts = [min(h * i, n) for h, i, n in zip(steps, reversed(tile), shape)]
    return tuple(slice(i, min(i + h, n)) for i, h, n in zip(starts, steps, shape))


def parent_energy(parent, split, part, place):
    """P of each coefficient in `part`, of the parent band.

    `split` are the axes that are split at its level, `place` the parent tile's part of it.
    """
    magnitudes = np.minimum(np.abs(parent[place]), 15)
    if magnitudes.size == 0:
        return np.zeros([s.stop - s.start for s in part], np.int64)
    n = np.pad(magnitudes, 1)
    energy = 2 * magnitudes + n[2:, 1:-1, 1:-1] + n[:-2, 1:-1, 1:-1]
    energy += n[1:-1, 2:, 1:-1] + n[1:-1, :-2, 1:-1] + n[1:-1, 1:-1, 2:] + n[1:-1, 1:-1, :-2]
    at = [
        np.minimum((np.arange(s.start, s.stop) >> half) - p.start, p.stop - p.start - 1)
        for s, p, half in zip(part, place, map(int, reversed(split)))
    ]
    return energy[np.ix_(*at)]


class BandOfTile:
    """The numbers of a tile's part of a band, in lists with a margin of zeros."""

    def __init__(self, shape, parent, before):
        self.shape, self.parent = shape, parent
        z, y, x = shape
        self.padded = (z + 2, y + 3, x + 3)
        self.strides = (1, x + 3, (x + 3) * (y + 3))
        self.magnitudes = [0] * int(np.prod(self.padded))
        self.numbers = list(self.magnitudes)
        self.before, self.groups = before, set()
        self.known = [
            (weight, [sum(a * b for a, b in zip(to, self.strides)) for to in steps])
            for weight, steps in KNOWN.items()
        ]
        self.energy = self._energy_of_others()

    def array(self):
        """The numbers, (z, y, x)."""
        return np.array(self.numbers, np.int64).reshape(self.padded)[2:, 2:-1, 2:-1]

    def _energy_of_others(self):
        """P + B of each coefficient, as a list with the margin."""
        energy = np.zeros(self.padded, np.int64)
        inner = energy[2:, 2:-1, 2:-1]
        inner += self.parent
        for band in self.before:
            both = tuple(slice(min(a, b)) for a, b in zip(self.shape, band.shape))
            inner[both] += 3 * np.minimum(np.abs(band.array()[both]), 15)
        return energy.ravel().tolist()

    def _class(self, at):
        """The class of the number at a place in the lists."""
        energy, m = self.energy[at], self.magnitudes
        for weight, steps in self.known:
            energy += weight * sum([m[at + step] for step in steps])
        if energy < 4:
            return energy
        log = energy.bit_length() - 1
        return min(19, 2 * log + (energy >> log - 1 & 1))

    def _number(self, decoder, kind, odds, at):
        """Reads the number at a place in the lists; says whether it is not 0."""
        column = self._class(at)
        if not decoder.bit(odds.other[kind][column]):
            return False
        negative = decoder.even()
        magnitude = 1
        while magnitude < 15 and decoder.bit(odds.larger[ROWS[magnitude - 1]][column]):
            magnitude += 1
        if magnitude == 15:
            j = 0
            while decoder.even():
                j += 1
                fail_unless(j < 30, "a number is too large")
            magnitude = 14 + decoder.below_highest(j + 1)
        self.numbers[at] = -magnitude if negative else magnitude
        self.magnitudes[at] = min(magnitude, 15)
        return True

    def _group(self, decoder, odds, first):
        """Reads the group that has its first coefficient there, (z, y, x)."""
        z, y, x = first
        parents = int(self.parent[z : z + 4 : 2, y : y + 4 : 2, x : x + 4 : 2].sum())
        beside = {(z - 4, y, x), (z, y - 4, x), (z, y, x - 4)}
        busy = parents > 24 or not self.groups.isdisjoint(beside)
        if not busy:
            u = any(first in band.groups for band in self.before)
            if not decoder.bit(odds.group[2 * u + (parents != 0)]):
                return
        kind = 2 if busy else 1
        for at in itertools.product(*(range(i, min(i + 4, n)) for i, n in zip(first, self.shape))):
            place = sum((i + 2) * s for i, s in zip(at, reversed(self.strides)))
            if self._number(decoder, kind, odds, place):
                self.groups.add(first)
                kind = 2 if busy else 0

    def read(self, decoder, odds, has_parent):
        """Reads the band's bit, and its groups if it has any."""
        if decoder.bit(odds.band[has_parent]):
            for first in itertools.product(*(range(0, n, 4) for n in self.shape)):
                self._group(decoder, odds, first)


class Odds:
    """One set of odds of a tile."""

    def __init__(self, lines):
        pairs = [[[n, n] for n in line] for line in lines]
        self.band, self.group = pairs[0][:2], pairs[0][2:]
        self.other, self.larger = pairs[1:4], pairs[4:]


def records(keys, lengths, data):
    """The bytes of each record, by its key; nothing may be left."""
    keys, found, at = list(keys), {}, 0
    for key, length in zip(keys, read_lengths(lengths, len(keys))):
        found[key], at = data[at : at + length], at + length
    fail_unless(at == len(data), "the records are not as long as the lengths say")
    return found


class Array:
    """A compressed array, wherever its bytes are. What has them sets the coarsest level.

    It sets the tiles, by level and place (x, y, z), and the boxes of corrections, by the first and
    the end of their samples (z, y, x).
    """

    def __init__(self, sizes, delays, bounds, scale, corrections):
        (self.least, self.largest), (self.exponent, step) = bounds, scale
        self.kind, self.quantum = corrections
        most = float(np.finfo(F).max)
        fail_unless(min(sizes) > 0, "an array without samples")
        fail_unless(-most <= self.least <= self.largest <= most, "the range is none")
        fail_unless(abs(self.exponent) <= 1000 and 2**-22 <= step <= 2**60, "the step is none")
        fail_unless(self.kind != 1 or 0 < self.quantum < np.inf, "the quantum is none")
        self.step = F(step)
        self.levels, self.splits = levels_of(sizes, delays)
        self.odds = first_odds()
        self.coarsest, self.tiles, self.boxes = None, {}, {}
        # Of the step of a series to which tiles refer, if there is one; and of this, once read.
        self.numbers_before, self.numbers = {}, {}

    def tiles_of(self, m):
        """The place, (x, y, z), of each tile of level m, in their order."""
        x, y, z = (range(-(-n // 32)) for n in self.levels[m - 1])
        return [(i, j, k) for k, j, i in itertools.product(z, y, x)]

    def _corrected(self, samples):
        """The samples of level 0, corrected."""
        numbers = np.zeros(samples.shape, np.int64)
        for ends, data in self.boxes.items():
            box = tuple(slice(*axis) for axis in ends)
            if data:
                shape = samples[box].shape
                decoder, band = RangeDecoder(data), BandOfTile(shape, np.zeros(shape, np.int64), [])
                band.read(decoder, Odds(self.odds[9]), False)
                decoder.end()
                numbers[box] = band.array()
        exact = samples.astype(np.float64)
        if self.kind == 1:
            exact = np.where(numbers == 0, exact, exact + self.quantum * numbers)
        elif self.kind == 2:
            exact = np.floor(exact + 0.5) + numbers
        with np.errstate(over="ignore"):
            corrected = exact.astype(F)
        fail_unless(np.isfinite(corrected).all(), "a corrected sample is infinite")
        return corrected

    def _shape(self, m, high):
        """The shape, (z, y, x), of a band of level m."""
        sizes = zip(self.levels[m], self.levels[m - 1])
        return tuple(n - a if axis in high else a for axis, (a, n) in enumerate(sizes))[::-1]

    def _parent(self, m, high, tile, part, bands):
        """P of the coefficients in `part`, or None if the band has no parent."""
        if m % 3 == 0 or m == len(self.levels) - 1 or not all(self.splits[m + 1][a] for a in high):
            return None
        over = tuple(i // 2 if s else i for i, s in zip(tile, self.splits[m]))
        place = part_of(over, self.splits[m + 1], bands[m + 1][high].shape)
        return parent_energy(bands[m + 1][high], self.splits[m + 1], part, place)

    def _read_tile(self, m, tile, bands):
        """Reads one tile into the bands of its level."""
        data, old = self.tiles[m, tile], {}
        for high, whole in self.numbers_before.get(m, {}).items():
            old[high] = whole[part_of(tile, self.splits[m], whole.shape)]
        refers = any(numbers.any() for numbers in old.values())
        if not data:
            for high, numbers in old.items():
                bands[m][high][part_of(tile, self.splits[m], bands[m][high].shape)] = numbers
            return
        decoder, before = RangeDecoder(data), []
        changes = refers and decoder.even()
        first = 3 * ((m - 1) % 3)
        odds = [Odds(lines) for lines in self.odds[first : first + 3]]
        for high, whole in bands[m].items():
            part = part_of(tile, self.splits[m], whole.shape)
            shape = whole[part].shape
            if 0 in shape:
                continue
            parent = self._parent(m, high, tile, part, bands)
            energy = np.zeros(shape, np.int64) if parent is None or changes else parent
            band = BandOfTile(shape, energy, list(before))
            band.read(decoder, odds[len(high) - 1], parent is not None)
            whole[part] = band.array() + (old[high] if changes else 0)
            before.append(band)
        decoder.end()

    def _coefficients(self, numbers):
        """What numbers stand for."""
        magnitudes = (np.abs(numbers).astype(F) + F(0.04)) * self.step
        return np.where(numbers == 0, F(0), np.where(numbers < 0, -magnitudes, magnitudes))

    def level(self, level):
        """The nodes of a level, (z, y, x)."""
        fail_unless(0 <= level < len(self.levels), "there is no such level")
        values, bands = self._coefficients(self.coarsest), {}
        for m in range(len(self.levels) - 1, level, -1):
            split = self.splits[m]
            names = [high for high in BANDS if all(split[axis] for axis in high)]
            bands[m] = {high: np.zeros(self._shape(m, high), np.int64) for high in names}
            for of, tile in self.tiles:
                if of == m:
                    self._read_tile(m, tile, bands)
            values = self._joined(m, values, bands[m])
        self.numbers = bands
        samples = self._samples(self._filtered(level, values))
        return samples if level else self._corrected(samples)

    def _joined(self, m, low, bands):
        """The values of level m - 1, of the low ones and the bands of level m."""
        values = np.empty(self.levels[m - 1][::-1], F)
        a = self.levels[m]
        values[tuple(slice(n) for n in reversed(a))] = low
        for high, numbers in bands.items():
            place = (slice(a[i], None) if i in high else slice(a[i]) for i in (2, 1, 0))
            values[tuple(place)] = self._coefficients(numbers)
        for axis in (2, 1, 0):
            if self.splits[m][axis]:
                inverse(np.moveaxis(values, 2 - axis, -1), a[axis])
        return values

    def _filtered(self, level, values):
        """The nodes of a level, of its low coefficients."""
        for axis in range(3):
            splits = [m for m in range(1, level + 1) if self.splits[m][axis]]
            if splits:
                even = self.levels[splits[-1] - 1][axis] % 2 == 0
                line = np.moveaxis(values, 2 - axis, -1)
                values = np.moveaxis(smoothed(line, len(splits), even), -1, 2 - axis)
        return values

    def _samples(self, values):
        """Samples, of what comes out of the inverse transform."""
        centre = self.least / 2 + self.largest / 2
        samples = values.astype(np.float64) * 2.0**self.exponent + centre
        samples = np.where(samples < self.least, self.least, samples)
        return np.where(samples > self.largest, self.largest, samples).astype(F)


class Reader(Array):
    """A file of a compressed array."""

    def __init__(self, data):
        fail_unless(len(data) >= HEADER.size, "the file is too short")
        magic, *rest = HEADER.unpack_from(data)
        sizes, delays, kind = rest[:3], rest[3:6], rest[6]
        *bounds, exponent, step, coarsest, lengths = rest[7:]
        fail_unless(magic == b"isowave1" and kind <= 2, "not a compressed array")
        start = HEADER.size + 8 * (kind == 1)
        fail_unless(len(data) >= start, "the file is too short")
        quantum = struct.unpack_from("<d", data, start - 8)[0] if kind == 1 else 0
        super().__init__(sizes, delays, bounds, (exponent, step), (kind, quantum))
        at = start + coarsest
        self.coarsest = read_coarsest(data[start:at], self.levels[-1])
        tiles = [(m, t) for m in range(len(self.levels) - 1, 0, -1) for t in self.tiles_of(m)]
        boxes = boxes_of([(0, n) for n in reversed(sizes)]) if kind else []
        found = records([*tiles, *boxes], data[at : at + lengths], data[at + lengths :])
        self.tiles, self.boxes = ({key: found[key] for key in keys} for keys in (tiles, boxes))


def boxes_of(region):
    """The boxes of corrections of a region of samples, as first and end (z, y, x)."""
    axes = [[(i, min(i + 32, end)) for i in range(first, end, 32)] for first, end in region]
    return list(itertools.product(*axes))


def lift(to, of, constant, before):
    """Adds to each value a multiple of its two neighbours of the other kind.

    They are at i and i + 1, or at i - 1 and i if `before` is 1.
    """
    i = np.arange(to.shape[-1])
    left, right = np.maximum(i - before, 0), np.minimum(i + 1 - before, of.shape[-1] - 1)
    to += constant * (of[..., left] + of[..., right])


def inverse(lines, a):
    """Undoes a split along the last axis, in place; the first a values are low ones."""
    e, o = lines[..., :a] * SCALE_LOW, lines[..., a:] * SCALE_HIGH
    lift(e, o, -DELTA, 1)
    lift(o, e, -GAMMA, 0)
    lift(e, o, -BETA, 1)
    lift(o, e, -ALPHA, 0)
    lines[..., 0::2], lines[..., 1::2] = e, o


def smoothed(c, s, even):
    """The filter of nodes along the last axis, which was split s times."""
    g, m = F(1), c.shape[-1] - 1
    for _ in range(s):
        g *= F(0.70710677)

    def at(step):
        i = np.abs(np.arange(m + 1) + step)
        return c[..., np.clip(np.where(i > m, 2 * m - i + even, i), 0, m)]

    t0, t1, t2, t3 = TAPS[min(s, len(TAPS)) - 1]
    near, far, farthest = (at(-step) + at(step) for step in (1, 2, 3))
    return (t0 * c + t1 * near + t2 * far + t3 * farthest) * g


def read(data, level=0):
    """The nodes of a level of a compressed array, (z, y, x) of float32."""
    return Reader(bytes(data)).level(level)


def main():
    """Reads a file, says what is in it, and writes it if asked to."""
    arguments = argparse.ArgumentParser(description="Reads a compressed array.")
    arguments.add_argument("file", type=Path)
    arguments.add_argument("level", type=int, nargs="?", default=0)
    arguments.add_argument("-o", dest="out", type=Path, help="OUT.npy, or OUT.f32 for bytes alone")
    given = arguments.parse_args()
    nodes = read(given.file.read_bytes(), given.level)
    print("x".join(map(str, nodes.shape[::-1])), "nodes, from", nodes.min(), "to", nodes.max())
    if given.out and given.out.suffix == ".npy":
        np.save(given.out, nodes)
    elif given.out:
        given.out.write_bytes(nodes.astype("<f4").tobytes())


if __name__ == "__main__":
    main()
