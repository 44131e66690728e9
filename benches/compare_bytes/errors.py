"""Bytes at an error: settings of a coder between which the error lies, and what is between them."""
import math
import sys
from dataclasses import dataclass

import numpy as np

from coders import CoderFailed


def rms(samples, back):
    """The root mean square error, and the largest."""
    difference = back.astype(np.float64) - samples
    return math.sqrt(np.mean(difference**2)), float(np.abs(difference).max())


@dataclass
class Point:
    """What a coder reached with a setting.

    Of a point between two, the error is the target, and `reached` that of the one below.
    """

    error: float
    reached: float
    largest: float
    size: float
    write: float
    read: float


class Curve:
    """What a coder reaches for a volume, by its settings."""

    def __init__(self, name, coder, volume, scratch):
        self.name, self.coder, self.volume, self.scratch = name, coder, volume, scratch
        self.points = {}
        self.latest = None

    def ask(self, setting):
        if setting not in self.points:
            answer = self.coder(self.volume, setting, self.scratch)
            self.latest = (setting, answer)
            error, largest = rms(self.volume.samples, answer.samples)
            point = Point(error, error, largest, answer.size, answer.write, answer.read)
            self.points[setting] = point
        return self.points[setting]

    def meets(self, target):
        """The setting of the largest error that is not above the target."""
        kept = [s for s, p in self.points.items() if p.error <= 1.001 * target]
        return max(kept, key=lambda s: (self.points[s].error, -self.points[s].size), default=None)

    def answer(self, target):
        """What the coder makes with that setting; None where there is none."""
        setting = self.meets(target)
        if setting is None:
            return None
        if self.latest[0] != setting:
            self.latest = (setting, self.coder(self.volume, setting, self.scratch))
        return self.latest[1]

    def between(self, target):
        """The point at the target; None where no two points enclose it.

        The bytes are interpolated; the rest is of the setting that meets the target.
        """
        above = [p for p in self.points.values() if p.error >= target]
        below = self.points.get(self.meets(target))
        if below is None or not above:
            return None
        above = min(above, key=lambda p: (p.error, p.size))
        part = 0.0
        if below.error > 0 and above.error > below.error:
            part = math.log(target / below.error) / math.log(above.error / below.error)
        size = math.exp((1 - part) * math.log(below.size) + part * math.log(above.size))
        return Point(target, below.error, below.largest, size, below.write, below.read)


# How a setting is found. Each is called with a curve and a target, and gives a point or None.


def by_target(curve, target):
    """The coder takes the target itself, in percent, and meets it."""
    percent = 100 * target / curve.volume.extent
    point = curve.ask(f"{percent:.10g}%")
    return point if point.error <= 1.001 * target else None


def by_halves(first):
    """Errors rise with the setting: until two within 3 % enclose the target."""

    def find(curve, target):
        setting, low, high = first(target), None, None
        for _ in range(20):
            error = curve.ask(setting).error
            if error <= target:
                low = setting
            if error >= target:
                high = setting
            if low is None or high is None:
                setting = low * 2 if high is None else high / 2
                continue
            above, below = curve.ask(high).error, curve.ask(low).error
            if above < 1.03 * max(below, 1e-300) or high < 1.001 * low:
                break
            setting = math.sqrt(low * high)
        return curve.between(target)

    return find


def by_steps(settings):
    """All settings, in the order of their errors, until one is above the target."""

    def find(curve, target):
        for setting in settings(curve.volume):
            if curve.ask(setting).error > target:
                break
        return curve.between(target)

    return find


def tried(curve, work):
    """What the work gives; None, with a line that says why, where the coder fails."""
    try:
        return work()
    except CoderFailed as failure:
        print(f"{curve.volume.name}, {curve.name}: {failure}", file=sys.stderr)
        return None
