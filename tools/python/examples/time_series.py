"""A field that changes with time: an archive of all steps, and its surface between two of them."""

import numpy as np

import isospan

z, y, x = np.mgrid[-1:1:48j, -1:1:48j, -1:1:48j]
times = np.linspace(0, 2, 9)
# Two drops that meet.
steps = [
    np.exp(-8 * ((x - 0.7 + t / 3) ** 2 + y**2 + z**2))
    + np.exp(-8 * ((x + 0.7 - t / 3) ** 2 + y**2 + z**2))
    for t in times
]
archive = isospan.reduce(
    [step.astype(np.float32) for step in steps],
    "drops.isospan",
    times=times,
    fraction="1/4",
    spacing=[2 / 47] * 3,
    origin=[-1, -1, -1],
)
for at in archive:
    print(
        f"step {at.info['step']}: {len(at.surface(0.5))} triangles,",
        f"{len(at.surface(0.5, largest=1))} in one drop",
    )
between = archive.surface(0.5, time=1.1)
print("between two steps:", between)
archive.save_surface("drops_%04d.vtp", 0.5, steps=True)
