#!/usr/bin/env python3
"""Writes tests/data/points_scipy.json: Halton and Hammersley points computed by SciPy's qmc, which the tests of
src/points compare with. Run again only to extend it: python3 tools/make_golden_points.py (needs SciPy 1.15 or later).

Halton points are scipy.stats.qmc.Halton(d=3, scramble=False), whose point of index k is (Phi_2(k), Phi_3(k), Phi_5(k));
far along the sequence SciPy's own van der Corput routine is asked directly, as the engine would generate all points
before. Hammersley points are assembled from the same values: ((k + t) / n, Phi_2(k), Phi_3(k)).
"""

import json
import pathlib

import scipy
from scipy.stats import qmc
from scipy.stats._qmc import van_der_corput


def halton(first, count):
    if first < 1_000_000:
        engine = qmc.Halton(d=3, scramble=False)
        engine.fast_forward(first) if first else None
        return engine.random(count).tolist()
    columns = [van_der_corput(count, base, start_index=first, scramble=False).tolist() for base in (2, 3, 5)]
    return [list(row) for row in zip(*columns)]


def hammersley(n, shift):
    return [[(k + shift) / n, phi2, phi3] for k, (phi2, phi3, _) in enumerate(halton(0, n))]


golden = {
    "made by": f"tools/make_golden_points.py with SciPy {scipy.__version__}",
    "halton": [
        {"first": first, "points": halton(first, count)}
        for first, count in ((0, 150), (59_040, 20), (2_000_000, 20), (10**9 - 3, 20), (10**12, 20))
    ],
    "hammersley": [
        {"n": n, "shift": shift, "points": hammersley(n, shift)} for n, shift in ((100, 0.5), (64, 0.0), (37, 0.25))
    ],
}
path = pathlib.Path(__file__).resolve().parent.parent / "tests" / "data" / "points_scipy.json"
rows = json.dumps(golden).replace("[[", "[\n[").replace("], [", "],\n[").replace("}, {", "},\n{")
path.write_text(rows + "\n")
print(f"{path}: {path.stat().st_size} bytes")
