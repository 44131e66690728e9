"""Reads the files of an archive: its manifest, segments and tables of ranges. Written from src/archive/FORMAT.md alone."""
import struct
import sys
from pathlib import Path

import numpy as np
import zstandard

MAGIC, END = b"\x89ISO\r\n\x1a\n", b"ISOEND\r\n"
MANIFEST = Path(__file__).resolve().parents[2] / "src/archive/manifest"


def refuse(what):
    sys.exit(f"read_pyramid.py: {what}")


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


def segment_blocks(path, of_kind):
    """All blocks of a segment of that kind."""
    data = path.read_bytes()
    header, footer = data[:40], data[-48:]
    expect(path, "magic", MAGIC, header[:8])
    version, oldest, kind = struct.unpack("<HHI", header[8:16])
    expect(path, "kind", of_kind, kind)
    if oldest > 7 or version < 7:
        refuse(f"{path}: format {version}, readable by {oldest} and later; this reads 7")
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


def manifest_text(archive):
    """The manifest of an archive: JSON."""
    words = (MANIFEST / "dictionary.txt").read_bytes()
    words = zstandard.ZstdCompressionDict(words, zstandard.DICT_TYPE_RAWCONTENT)
    packed = (Path(archive) / "manifest.zst").read_bytes()
    return zstandard.ZstdDecompressor(words).decompressobj().decompress(packed).decode()
