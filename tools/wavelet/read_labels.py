"""Reads tiles of labels. It is written from FORMAT.md of src/wavelet alone."""
import numpy as np
from read_array import RangeDecoder, fail_unless, table_of

WEIGHTS = [2, 2, 2, 1, 1, 1, 1, 1, 1]
REMEMBERED, LARGEST = 1024, 2**24


def odds_of(numbers):
    """Odds that begin with these numbers."""
    return [[n, n] for n in numbers]


class Tile:
    """The labels of a tile, which are read."""

    def __init__(self, data, shape):
        self.labels = np.zeros(shape, np.int64)
        if not data:
            return
        self.decoder = RangeDecoder(data)
        weight = [sum(w for n, w in enumerate(WEIGHTS) if s >> n & 1) for s in range(512)]
        self.tried = [odds_of([0, *(line[w - 1] for w in weight[1:])]) for line in table_of(2)]
        self.alike, self.new = odds_of([60000, 63500]), [32768, 32768]
        self.place, self.bits, self.sign = odds_of(11 * [32768]), odds_of(26 * [32768]), [32768, 32768]
        self.palette, self.last = [], 0
        if self.decoder.even():
            self.labels[:] = self._new_label()
        else:
            for z, y in np.ndindex(*shape[:2]):
                self._read_row(z, y)
        self.decoder.end()

    def _more(self, odds):
        """How many of some bits are 1 before one is 0, or all are read."""
        return next((n for n, one in enumerate(odds) if not self.decoder.bit(one)), len(odds))

    def _new_label(self):
        size = self.decoder.below_highest(self._more(self.bits))
        self.last += -size if size and self.decoder.bit(self.sign) else size
        fail_unless(abs(self.last) <= LARGEST, "a label is too large")
        return self.last

    def _other(self):
        """A label that no neighbour has."""
        if not self.palette or self.decoder.bit(self.new):
            self.palette = self.palette[: REMEMBERED - 1]
            label = self._new_label()
        else:
            place = self.decoder.below_highest(1 + self._more(self.place)) - 1
            fail_unless(place < len(self.palette), "a label is not in the palette")
            label = self.palette.pop(place)
        self.palette.insert(0, label)
        return label

    def _label(self, neighbours):
        sets = {label: sum(1 << n for n, other in enumerate(neighbours) if other == label) for label in neighbours}
        weigh = lambda label: sum(w for n, w in enumerate(WEIGHTS) if sets[label] >> n & 1)
        # The sort keeps the order of those that are equal.
        for k, label in enumerate(sorted(sets, key=weigh, reverse=True)):
            if self.decoder.bit(self.tried[min(k, 2)][sets[label]]):
                return label
        return self._other()

    def _read_row(self, z, y):
        labels, row = self.labels, self.labels[z, y]
        if y == z == 0:
            for x in range(len(row)):
                row[x] = self._label(9 * [row[x - 1]]) if x else self._other()
            return
        if z == 0:
            before = beside = low = high = labels[0, y - 1]
        else:
            beside, low, high = (labels[z - 1, min(max(n, 0), len(labels[z]) - 1)] for n in (y, y - 1, y + 1))
            before = labels[z, y - 1] if y else beside
        around = np.stack([before, beside, low, high])
        if (around == before[0]).all() and self.decoder.bit(self.alike[int(y > 0 and z > 0)]):
            row[:] = before[0]
            return
        for x in range(len(row)):
            left, right = max(x - 1, 0), min(x + 1, len(row) - 1)
            row[x] = self._label([
                row[x - 1] if x else before[0], before[x], beside[x], before[left], before[right],
                beside[left], beside[right], low[x], high[x],
            ])
