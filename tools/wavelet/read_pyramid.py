"""Reads the samples of a pyramid archive. It is written from the two FORMAT.md alone.

Usage: read_pyramid.py ARCHIVE [--step N] [-o OUT.npy]. Says the range and the number of bricks.
Corrections of samples are applied, and missing ones are NaN; the offset of the source, where it has
one, is not added.
"""
import argparse
import itertools
import json
import struct
from pathlib import Path

import numpy as np
from files import expect, manifest_text, ranges_of, refuse, segment_blocks, varints
from read_array import (
    Array, RangeDecoder, boxes_of, even_odds, fail_unless, read_coarsest, records,
)
from read_labels import Tile

VALUES, COARSE, RANGES = 2, 13, 14
CHUNK, BLOCK, FINE_LEVELS = 256, 4, 3
KINDS = {"none": 0, "max": 1, "lossless": 2, "labels": 0}
NEIGHBOURS = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (-1, 1, 0), (-1, 0, 1), (0, -1, 1)]
FIRST_ODDS = [400, 6000, 16000, 26000, 39000, 49000, 59000, 65000]


def exponent_of(least, largest):
    """The least exponent of which the power of two is above half of the range."""
    half = largest / 2 - least / 2
    return max(-1000, int(np.frexp(half)[1])) if half else 0


def chunk_starts(n):
    """The first sample of each chunk along an axis, and the end."""
    return [*range(0, CHUNK * max(1, -(-(n - 1) // CHUNK)), CHUNK), n]


def blocks_along(tiles):
    """The tiles of each block along an axis."""
    starts = list(range(0, len(tiles), BLOCK))
    if len(starts) > 1 and len(tiles) % BLOCK == 1:
        starts.pop()
    return [tiles[a:b] for a, b in zip(starts, [*starts[1:], len(tiles)])]


def over_axes(axes):
    """All triples (x, y, z) of what each axis, in the order x, y, z, has; x is the fastest."""
    return [at[::-1] for at in itertools.product(*reversed(axes))]


def read_bits(data, shape):
    """Which samples of a box (z, y, x) are missing, where some are."""
    decoder = RangeDecoder(data)
    odds = [2 * [FIRST_ODDS[n.bit_count()]] for n in range(128)]
    bits = np.zeros([n + 2 for n in shape], bool)
    for z, y, x in np.ndindex(*shape):
        known = (bits[z + 1 - k, y + 1 - j, x + 1 - i] for i, j, k in NEIGHBOURS)
        number = sum(int(b) << n for n, b in enumerate(known))
        bits[z + 1, y + 1, x + 1] = decoder.bit(odds[number])
    decoder.end()
    return bits[1:-1, 1:-1, 1:-1]


def read_mask(region, data):
    """Which samples are missing in a region, of which the ends (z, y, x) are given."""
    at = 4 + struct.unpack_from("<I", data)[0]
    directory, kinds, lengths = RangeDecoder(data[4:at]), even_odds(3, 2), even_odds(2, 33)
    missing = np.zeros([end - first for first, end in region], bool)
    kind = length = 0
    for box in boxes_of(region):
        odds = kinds[kind]
        kind = directory.bit(odds[0]) and (2 if directory.bit(odds[1]) else 1)
        here = tuple(slice(a - first, b - first) for (a, b), (first, _) in zip(box, region))
        if kind == 1:
            length = directory.below_highest(directory.count(lengths[length != 0]))
            missing[here] = read_bits(data[at : at + length], missing[here].shape)
            at += length
        elif kind:
            missing[here] = True
    directory.end()
    fail_unless(at == len(data), "a mask is not as long as its directory says")
    return missing


class Pyramid:
    """A step of a pyramid archive."""

    def __init__(self, archive, asked=0, files=None):
        self.archive = Path(archive)
        manifest = json.loads(manifest_text(self.archive))
        points, lattice = manifest["plan"]["points"], manifest["plan"]["lattice"]
        self.labels = None
        if points.get("set") not in ("pyramid", "labels"):
            refuse(f"{archive}: its points are {points.get('set')}, not a pyramid")
        steps = [s for s in manifest["steps"] if s.get("place", s["number"]) == asked]
        if files is not None:
            steps = [s for s in manifest["steps"] + manifest.get("bases", []) if s["number"] == files]
        if len(steps) != 1:
            refuse(f"{archive}: {len(steps)} steps of number {asked}")
        self.step, self.number = steps[0], steps[0]["number"]
        expect(archive, "edge of bricks", 3 * [CHUNK], manifest["plan"]["brick_edge"])
        expect(archive, "samples along the axes", lattice["dims"], points["dims"])
        self.chunks = self._chunks(points["dims"])
        expect(archive, "chunks", len(self.chunks), manifest["counts"].get("chunks", 1))
        self.ranges = self._segments("ranges", RANGES)
        self.array = self._array(points["dims"], points.get("delay", 3 * [0]))
        if points["set"] == "labels":
            self.labels = np.zeros(points["dims"][::-1], np.float32)
            fail_unless("coarse" not in self.step and "base" not in self.step, "labels have neither")
            expect(archive, "correction", "labels", self.step["wavelet"]["correction"])
        if base := self.step.get("base"):
            before = Pyramid(archive, files=base["number"])
            expect(archive, "step of coefficients", before.step["wavelet"]["step"], self.step["wavelet"]["step"])
            before.array.level(0)
            self.array.numbers_before = before.array.numbers
        self.missing = np.zeros(points["dims"][::-1], bool)
        if self.labels is None:
            self._read_coarse()
        for chunk, blocks in zip(self.chunks, self._segments("values", VALUES)):
            self._read_tiles(chunk, blocks)
        for chunk, (corrections, _) in zip(self.chunks, self.ranges):
            self._read_corrections(chunk, corrections)

    def _chunks(self, dims):
        """The samples of each chunk, as ranges along x, y, z."""
        starts = [chunk_starts(n) for n in dims]
        return over_axes([[range(*ends) for ends in zip(s, s[1:])] for s in starts])

    def _segments(self, name, kind):
        """The blocks of each chunk."""
        found = []
        for number, segment in enumerate(self.step[name]):
            first = segment.get("first_chunk", 0)
            path = self.archive / f"steps/{self.number:06}-{name}-{number:06}.seg"
            expect(path, "first chunk", len(found), first)
            *blocks, table = segment_blocks(path, kind)
            first, count, *sizes = varints(table)
            expect(path, "chunk table", [len(found), len(sizes)], [first, count])
            expect(path, "blocks", sum(sizes), len(blocks))
            blocks = iter(blocks)
            found += [list(itertools.islice(blocks, size)) for size in sizes]
        expect(self.archive, f"chunks of {name}", len(self.chunks), len(found))
        return found

    def _array(self, dims, delay):
        """The array, without what is stored of it."""
        wavelet = self.step["wavelet"]
        least, largest = wavelet["range"]
        exponent = exponent_of(least, largest)
        correction, quantum = wavelet.get("correction", "none"), 0
        if isinstance(correction, dict):
            bound = correction["max"]
            most = max(abs(least), abs(largest))
            fail_unless((most + bound) / 2**23 < bound < np.inf, "the bound is none")
            correction, quantum = "max", 2 * (bound - (most + bound) / 2**24)
        if correction == "labels":
            return Array(dims, delay, (least, largest), (exponent, 1), (0, 0))
        step = min(wavelet["step"] * 2.0**-exponent, 2.0**60) if least < largest else 1
        fail_unless(step >= 2.0**-22, "the step is too small")
        return Array(dims, delay, (least, largest), (exponent, step), (KINDS[correction], quantum))

    def _fine(self):
        """The largest level of which the chunks have the tiles."""
        return min(FINE_LEVELS, len(self.array.levels) - 1) if self.labels is None else 0

    def _read_coarse(self):
        """Reads the coarsest level, and the tiles that no chunk has."""
        path = self.archive / f"steps/{self.number:06}-coarse.seg"
        blocks = segment_blocks(path, COARSE)
        expect(path, "blocks", 1, min(len(blocks), 1))
        expect(path, "masks", 0, max(len(blocks) - 2, 0))
        self.coarse_mask = blocks[1:]
        array, data = self.array, blocks[0]
        coarsest, lengths = struct.unpack_from("<2I", data)
        at = 8 + coarsest
        array.coarsest = read_coarsest(data[8:at], array.levels[-1])
        levels = range(len(array.levels) - 1, self._fine(), -1)
        tiles = [(m, tile) for m in levels for tile in array.tiles_of(m)]
        array.tiles |= records(tiles, data[at : at + lengths], data[at + lengths :])

    def _tiles_in(self, chunk, m):
        """The numbers of the tiles of level m that a chunk has along each axis."""
        for axis, samples in enumerate(chunk):
            if self.labels is not None:
                # The last chunk along an axis may have a sample of one more tile.
                yield [t for t in range(-(-self.labels.shape[2 - axis] // 32)) if 32 * t in samples]
                continue
            stride = 2 ** sum(split[axis] for split in self.array.splits[1:m])
            count = -(-self.array.levels[m - 1][axis] // 32)
            yield [t for t in range(count) if 32 * t * stride in samples]

    def _read_tiles(self, chunk, blocks):
        """Reads the tiles of a chunk."""
        blocks = iter(blocks)
        for block in [] if self.labels is None else over_axes(list(map(blocks_along, self._tiles_in(chunk, 0)))):
            tiles = over_axes(block)
            for tile, data in block_records(tiles, next(blocks)).items():
                here = self.labels[tuple(slice(32 * n, 32 * n + 32) for n in tile[::-1])]
                here[:] = Tile(data, here.shape).labels
        for m in range(self._fine(), 0, -1):
            for block in over_axes(list(map(blocks_along, self._tiles_in(chunk, m)))):
                tiles = [(m, tile) for tile in over_axes(block)]
                self.array.tiles |= block_records(tiles, next(blocks))
        if (mask := next(blocks, None)) is not None:
            region = [(s.start, s.stop) for s in reversed(chunk)]
            self.missing[tuple(slice(*ends) for ends in region)] = read_mask(region, mask)
        fail_unless(next(blocks, None) is None, "a chunk has too many blocks")

    def missing_nodes(self):
        """Which nodes of the level above those of chunks are missing, as is told with it."""
        nodes = self.array.levels[self._fine()][::-1]
        if not self._fine():
            return self.missing
        if not self.coarse_mask:
            return np.zeros(nodes, bool)
        return read_mask([(0, n) for n in nodes], self.coarse_mask[0])

    def strides(self, level=None):
        """The samples from a node of a level to the next, (z, y, x); without a level, of these."""
        splits = self.array.splits[1 : (self._fine() if level is None else level) + 1]
        return [2 ** sum(split[axis] for split in splits) for axis in (2, 1, 0)]

    def _read_corrections(self, chunk, data):
        """Reads the corrections of a chunk."""
        boxes = boxes_of([(s.start, s.stop) for s in reversed(chunk)])
        fail_unless(self.array.kind or not data, "there are corrections of none")
        self.array.boxes |= block_records(boxes, data)

    def nodes(self, level):
        """The nodes of a level, (z, y, x), less the offset of the source; NaN where one is missing."""
        missing = self.missing[tuple(slice(None, None, s) for s in self.strides(level))]
        known = self.array.level(level) if self.labels is None else self.labels
        return np.where(missing, np.float32(np.nan), known)

    def bricks(self):
        """Of each chunk the ends of its range, told twice, and its bricks.

        A brick is a level and the nodes of its cells, slices (z, y, x), with their least and largest
        value and the number of cells, as the archive tells them.
        """
        for chunk, (_, summary) in zip(self.chunks, self.ranges):
            bricks = [brick for level in range(self._fine() + 1) for brick in self._bricks(chunk, level)]
            void, least, largest, count = struct.unpack_from("<I2fI", summary)
            here = self.missing[tuple(slice(s.start, s.stop) for s in reversed(chunk))]
            expect(self.archive, "void samples", int(here.sum()), void)
            expect(self.archive, "bricks", len(bricks), count)
            low, high, ranges = ranges_of(summary[16:], count)
            yield (least, largest, low, high), list(zip(bricks, ranges))

    def _bricks(self, chunk, level):
        """The bricks of a level of a chunk."""
        axes, levels = [], self.array.levels
        for samples, ends, n, stride in zip(chunk, levels[0], levels[level], self.strides(level)[::-1]):
            start = samples.start // stride
            end = n - 1 if samples.stop == ends else samples.stop // stride
            axes.append([slice(i, min(i + 32, end) + 1) for i in range(start, end, 32)])
        return [(level, brick[::-1]) for brick in over_axes(axes)]


def block_records(keys, data):
    """The bytes of the tiles or boxes of a block; nothing where the block has no bytes."""
    if not data:
        return dict.fromkeys(keys, b"")
    end = 4 + struct.unpack_from("<I", data)[0]
    return records(keys, data[4:end], data[end:])


def main():
    """Reads an archive, says what is in it, and writes it if asked to."""
    arguments = argparse.ArgumentParser(description="Reads the samples of a pyramid archive.")
    arguments.add_argument("archive", type=Path)
    arguments.add_argument("--step", type=int, default=0)
    arguments.add_argument("-o", dest="out", type=Path, help="OUT.npy")
    given = arguments.parse_args()
    pyramid = Pyramid(given.archive, given.step)
    samples, bricks = pyramid.nodes(0), sum(len(bricks) for _, bricks in pyramid.bricks())
    size = "x".join(map(str, samples.shape[::-1]))
    print(f"{size} samples, from {np.nanmin(samples):g} to {np.nanmax(samples):g}, in {bricks} bricks")
    if given.out:
        np.save(given.out, samples)


if __name__ == "__main__":
    main()
