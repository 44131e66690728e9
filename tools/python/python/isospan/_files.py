"""Arrays that lie in files which the library reads itself: of Zarr in a folder, of h5py in a file.

They are read where they lie, as by the path of their file: with the place, the units, the scale
factors and the missing values that the file tells.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Sequence

import numpy as np

from . import _isospan
from ._errors import Error, UsageError, _warn

#: Stores of Zarr 2 and 3 that are folders.
_FOLDERS = ("LocalStore", "DirectoryStore", "NestedDirectoryStore")
#: Ways in which h5py opens plain files.
_PLAIN = ("sec2", "stdio")


@dataclass
class Place:
    """A file, and the array in it; None where the path leads to the array itself."""

    path: str
    field: str | None


def place_of(array: Any) -> Place | None:
    """Where an array lies, if that is a file of this machine."""
    package = type(array).__module__.partition(".")[0]
    if package == "zarr" and hasattr(array, "store") and hasattr(array, "shape"):
        return _of_zarr(array)
    if package == "h5py" and hasattr(array, "file") and hasattr(array, "shape"):
        return _of_h5py(array)
    return None


def _of_zarr(array: Any) -> Place | None:
    store, kind = array.store, type(array.store).__name__
    if kind in _FOLDERS:
        folder = getattr(store, "root", None) or store.path
    elif kind == "ZipStore" and getattr(store, "read_only", False):
        folder = store.path
    else:
        return None
    path = os.path.join(os.fspath(folder), *filter(None, array.path.split("/")))
    return Place(path, None)


def _of_h5py(array: Any) -> Place | None:
    file = array.file
    if file.driver not in _PLAIN or array.name is None or array.is_virtual or array.external:
        return None
    if file.mode != "r":
        # What was written is in the file then.
        file.flush()
    return Place(os.fsdecode(file.filename), array.name.strip("/"))


def volumes_of(
    array: Any, place: Place, spacing: Sequence[float] | None, origin: Any, channel: str | None
) -> list[_isospan.Volume] | None:
    """The volumes of an array in a file, one for each of its steps; None where the library cannot
    read it: a warning says why."""
    given = {"spacing": spacing, "origin": origin, "channel": channel}
    try:
        if any(letter in place.path + (place.field or "") for letter in "*?["):
            raise UsageError(f"{place.path}: *, ? and [ in names are patterns")
        volumes, found = _isospan.Volume.of_file(
            {"path": place.path, "field": place.field, **given}
        )
        if not {n for n in found["dims"] if n > 1} <= set(array.shape):
            raise UsageError(f"{place.path}: the array there has {found['dims']} samples")
    except Error as error:
        is_asked = isinstance(error, UsageError) and any(v is not None for v in given.values())
        if is_asked or len(array.shape) != 3:
            raise
        package = type(array).__module__.partition(".")[0]
        where = "" if spacing is not None else " Its place is not known then: give spacing."
        _warn(f"an array is copied by {package}, for it is not read in its file: {error}.{where}")
        return None
    _tell_scale(array, place, found)
    return volumes


def _tell_scale(array: Any, place: Place, found: dict[str, Any]) -> None:
    """Warns where values are not those that the array itself gives."""
    slope, intercept = found["slope"], found["intercept"]
    is_changed = (slope, intercept) != (1.0, 0.0)
    own = np.dtype(array.dtype)
    if not is_changed and (own.kind == "b" or found["scalar"] in (own.name, "float64")):
        return
    how = f"{slope:g} * sample + {intercept:g}" if is_changed else f"of type {found['scalar']}"
    _warn(
        f"{place.path}: values are {how}, as the file says; array[...] gives samples as they are"
    )
