"""Scalar volumes larger than memory, reduced to small archives from which any isosurface is
extracted.

    import isospan

    archive = isospan.reduce("scan.nrrd", "scan.isospan", target_rms="1%")
    surface = archive.surface(1000.5)
    surface.vertices, surface.faces, surface.normals    # NumPy arrays
    surface.save("scan.ply")

Arrays of volumes are indexed ``[z, y, x]``: x is the axis whose samples lie next to each other in a
C-ordered array. Positions, spacings and dimensions are in the order x, y, z, in world units.
"""

from ._archive import Archive, Spectrum, open
from ._errors import (
    BadInputError,
    BudgetError,
    BusyError,
    Error,
    FileError,
    IncompleteError,
    NoSuchError,
    Notice,
    TargetNotMet,
    UsageError,
)
from ._isospan import __version__
from ._labels import Label, LabelSurface
from ._reduce import append, plan, reduce
from ._surface import Surface, save_surfaces

__all__ = [
    "Archive",
    "BadInputError",
    "BudgetError",
    "BusyError",
    "Error",
    "FileError",
    "IncompleteError",
    "Label",
    "LabelSurface",
    "NoSuchError",
    "Notice",
    "Spectrum",
    "Surface",
    "TargetNotMet",
    "UsageError",
    "__version__",
    "append",
    "open",
    "plan",
    "reduce",
    "save_surfaces",
]
