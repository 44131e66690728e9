"""A dask array that need not fit in memory: each of its chunks is computed once.

Usage: larger_than_memory.py [SAMPLES ALONG AN EDGE]; 2048 of them are 34 GB of float32, in memory
of 1 GiB.
"""

import sys

import dask.array as da
import numpy as np

import isospan

n = int(sys.argv[1]) if len(sys.argv) > 1 else 2048
axis = da.linspace(-3 * np.pi, 3 * np.pi, n, chunks=min(n, 128), dtype=np.float32)
z, y, x = da.meshgrid(axis, axis, axis, indexing="ij")
gyroid = da.sin(x) * da.cos(y) + da.sin(y) * da.cos(z) + da.sin(z) * da.cos(x)
print(gyroid, f"{gyroid.nbytes / 1e9:.3f} GB")

archive = isospan.reduce(
    gyroid.astype(np.float32),
    "gyroid.isospan",
    fraction=min(1, 2e6 / n**3),
    memory="1GiB",
    spacing=[6 * np.pi / (n - 1)] * 3,
    progress=sys.stderr.isatty(),
)
print(archive, f"{archive.info['bytes']} bytes")
print(archive.surface(0.0))
