"""What volumes are made of: arrays of NumPy, Zarr, h5py, dask and xarray, each read box by box.

An array has three dimensions and is indexed [z, y, x]. One in memory, or in a file that the library
reads itself, is read in place. Of any other, boxes are read one after another, once, each a group of
whole chunks.
"""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass
from typing import Any, Iterable, Iterator, Sequence

import numpy as np

from . import _isospan
from ._errors import NoSuchError, UsageError
from ._files import place_of, volumes_of
from ._meshes import Image, Plain

#: Names of the types of samples that the library has, by kind and bytes of a NumPy type.
_SCALARS = {
    code: np.dtype(code).name
    for code in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")
}
#: Bytes of a box that is read at a time, unless one chunk has more.
_BOX_BYTES = 32 << 20


@dataclass
class Given:
    """Volumes, a name for each, and their times and units where the source tells them."""

    volumes: list[_isospan.Volume]
    names: list[str]
    times: list[float] | None = None
    unit: str | None = None
    length_unit: str | None = None
    time_unit: str | None = None


def sources(
    source: Any,
    *,
    spacing: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    name: str | None = None,
    channel: Any = None,
) -> Given:
    """The volumes of an array, or of a list of arrays, which are the steps of a series."""
    places = {"spacing": _triple(spacing, "spacing"), "origin": _triple(origin, "origin")}
    return _given(source, places, name, None if channel is None else str(channel))


#: Spacing and origin, as far as the user gives them.
_Places = dict[str, "list[float] | None"]


def _given(source: Any, places: _Places, name: str | None, channel: str | None) -> Given:
    listed = list(source) if isinstance(source, (list, tuple)) else [source]
    listed = [_ordered(array) if _is_xarray(array) else array for array in listed]
    if not listed:
        raise UsageError("there is no volume to reduce")
    if len(listed) == 1 and _is_series(listed[0]):
        if channel is not None:
            raise UsageError("channel is for files, not for arrays")
        return _series(listed[0], places, name)
    given = Given([], [])
    for number, array in enumerate(listed):
        called = name or _name_of(array)
        called = called if len(listed) == 1 else f"{called}_{number}"
        volumes = _in_file(array, places, name, channel)
        if volumes is None and channel is not None:
            raise UsageError("channel is for files, not for arrays")
        given.volumes += [_volume(array, places, called)] if volumes is None else volumes
        given.names.append(called)
    given.unit = _common(_unit_of(array) for array in listed)
    given.length_unit = _common(_length_unit_of(array) for array in listed)
    return given


def _in_file(
    array: Any, places: _Places, name: str | None, channel: str | None
) -> list[_isospan.Volume] | None:
    """The volumes of an array that is read in its file."""
    place = place_of(array)
    if place is None:
        return None
    if name is not None:
        raise UsageError(f"name is for arrays in memory; this one is in {place.path}")
    return volumes_of(array, place, places["spacing"], places["origin"], channel)


def _common(units: Iterable[str | None]) -> str | None:
    """The unit that all have, if all have one and the same."""
    found = set(units)
    return found.pop() if len(found) == 1 else None


def _unit_of(array: Any) -> str | None:
    """The unit that the attributes of an xarray name; "1" says that there is none."""
    unit = array.attrs.get("units") if _is_xarray(array) else None
    if not isinstance(unit, str) or unit.strip() == "1":
        return None
    return unit if any(c.isprintable() and not c.isspace() for c in unit) else None


def _length_unit_of(array: Any) -> str | None:
    """The unit of the coordinates of an xarray, where all have the same; degrees are no lengths."""
    if not _is_xarray(array) or not all(along in array.coords for along in array.dims):
        return None
    unit = _common(_unit_of(array.coords[along]) for along in array.dims)
    return None if unit is None or unit.startswith("degree") else unit


def volume_or_path(found: Plain) -> _isospan.Volume | str:
    """A source that is one volume, or one file."""
    source = found.source
    if isinstance(source, list) and len(source) == 1:
        [source] = source
    if isinstance(source, (str, os.PathLike)):
        return os.fspath(source)
    if isinstance(source, list):
        raise UsageError("a step is measured against one volume, not against several")
    if found.field is not None:
        raise UsageError("field is for files, not for arrays")
    volumes = sources(source).volumes
    if len(volumes) > 1:
        raise UsageError("a step is measured against one volume, not against a series")
    return volumes[0]


def _is_xarray(array: Any) -> bool:
    return hasattr(array, "coords") and hasattr(array, "dims") and hasattr(array, "variable")


def _ordered(array: Any) -> Any:
    """An xarray in the order time, z, y, x where its dimensions say which they are; else as it
    is."""
    named = {_axis_of(array, along): along for along in array.dims}
    if not {"X", "Y", "Z"} <= set(named):
        return array
    last = [named[letter] for letter in "ZYX"]
    first = [along for along in array.dims if along not in last]
    return array.transpose(*first, *last)


#: What names of dimensions, and standard names and units of coordinates, say of an axis (CF 1.11,
#: chapter 4).
_AXES = {
    "X": {"x", "lon", "longitude", "projection_x_coordinate", "grid_longitude", "degrees_east"},
    "Y": {"y", "lat", "latitude", "projection_y_coordinate", "grid_latitude", "degrees_north"},
    "Z": {
        "z", "lev", "level", "depth", "height", "altitude", "air_pressure",
        "model_level_number", "plev",
    },
    "T": {"t", "time"},
}  # fmt: skip


def _axis_of(array: Any, along: Any) -> str:
    """X, Y, Z or T, where the coordinate of a dimension or its name says so; else its name."""
    attributes = array.coords[along].attrs if along in array.coords else {}
    told = str(attributes.get("axis", "")).upper()
    if told in _AXES:
        return told
    said = [attributes.get("standard_name"), attributes.get("units"), along]
    for word in said:
        for axis, words in _AXES.items():
            if str(word).lower() in words:
                return axis
    return str(along)


def variable_of(source: Any, field: str | None) -> Any:
    """The variable of an xarray Dataset that is named, or its only one of three dimensions or
    more."""
    if field is not None:
        if field not in source.data_vars:
            raise NoSuchError(f"no field {field}; the dataset has {_listed(source.data_vars)}")
        return source[field]
    volumes = [name for name, array in source.data_vars.items() if array.ndim >= 3]
    if len(volumes) != 1:
        raise UsageError(
            f"the dataset has the fields {_listed(volumes)}: choose one with field"
            if volumes
            else "the dataset has no field of three dimensions"
        )
    return source[volumes[0]]


def _listed(names: Iterable[Any]) -> str:
    return ", ".join(map(str, names))


def is_dataset(source: Any) -> bool:
    """Whether it is a Dataset of xarray."""
    return hasattr(source, "data_vars") and hasattr(source, "coords")


def _is_series(array: Any) -> bool:
    return _is_xarray(array) and array.ndim == 4


def _series(array: Any, places: _Places, name: str | None) -> Given:
    """The steps along the first dimension of an xarray of four."""
    along = array.dims[0]
    times = None
    time_unit = None
    if along in array.coords:
        times = _times(array.coords[along].values, along)
        # Dates and spans of time become seconds.
        in_seconds = array.coords[along].dtype.kind in "mM"
        time_unit = "s" if in_seconds else _unit_of(array.coords[along])
    steps = [array.isel({along: n}) for n in range(array.shape[0])]
    given = _given(steps, places, name, None)
    given.times, given.time_unit = times, time_unit
    return given


def _times(values: np.ndarray, along: str) -> list[float]:
    if np.issubdtype(values.dtype, np.datetime64) or np.issubdtype(values.dtype, np.timedelta64):
        return [float(t) for t in (values - values[0]) / np.timedelta64(1, "s")]
    try:
        return [float(t) for t in values]
    except (TypeError, ValueError) as error:
        raise UsageError(f"the coordinate {along} tells no times: {error}") from error


def _name_of(array: Any) -> str:
    for found in (getattr(array, "name", None), getattr(array, "path", None)):
        if isinstance(found, str) and found.strip("/"):
            return found.strip("/")
    return "array"


def _place(places: _Places) -> dict[str, Any]:
    """Where samples lie: as the user says, else at whole numbers."""
    return {
        "spacing": places["spacing"] or [1.0] * 3,
        "origin": places["origin"] or [0.0] * 3,
        "direction": None,
        "axes": None,
    }


def _volume(array: Any, places: _Places, name: str) -> _isospan.Volume:
    is_given = any(given is not None for given in places.values())
    place = _place(places)
    if isinstance(array, Image):
        if is_given:
            raise UsageError("an image tells spacing and origin itself: give neither")
        place.update(spacing=array.spacing, origin=array.origin, direction=array.direction)
        array = array.array
    if _is_xarray(array):
        if is_given:
            raise UsageError("the coordinates of an xarray tell spacing and origin: give neither")
        place.update(_geometry_of(array))
        # One of a file is read box by box, through xarray.
        if array.chunks is not None or "source" not in array.encoding:
            array = array.data
    dtype, shape = getattr(array, "dtype", None), getattr(array, "shape", None)
    if dtype is None or shape is None:
        raise UsageError(
            "a volume is a path, an array (NumPy, Zarr, h5py, dask, xarray) "
            f"or a mesh of PyVista, not a {type(array).__name__}"
        )
    if len(shape) != 3:
        raise UsageError(
            f"a volume has three dimensions, [z, y, x]; {name} has the shape {tuple(shape)}"
        )
    dtype = np.dtype(dtype)
    if isinstance(array, np.ma.MaskedArray):
        raise UsageError(
            "fill a masked array first: array.filled(value) with missing=value, or NaN"
        )
    if isinstance(array, np.ndarray) and any(s == 0 for s, n in zip(array.strides, shape) if n > 1):
        # Repeated samples have no places of their own.
        return _boxes(array, dtype, place, name)
    if isinstance(array, np.ndarray) and dtype == np.bool_:
        array, dtype = array.view(np.uint8), np.dtype(np.uint8)
    scalar = _scalar(dtype)
    if isinstance(array, np.ndarray) and scalar is not None:
        return _isospan.Volume.of_array(name, array, scalar, place)
    return _boxes(array, dtype, place, name)


def _scalar(dtype: np.dtype) -> str | None:
    return _SCALARS.get(f"{dtype.kind}{dtype.itemsize}")


def _triple(values: Any, what: str) -> list[float] | None:
    if values is None:
        return None
    try:
        found = [float(v) for v in (values.split(",") if isinstance(values, str) else values)]
    except (TypeError, ValueError):
        found = []
    if len(found) != 3:
        raise UsageError(f"{what} is three numbers, for x, y and z, not {values!r}")
    return found


def _geometry_of(array: Any) -> dict[str, Any]:
    """Spacing and origin along x, y, z that the coordinates tell; all coordinates where those of
    one of the axes are uneven."""
    if array.ndim != 3:
        raise UsageError(f"a volume has three dimensions, [z, y, x]; this array has {array.dims}")
    lines = [_line(array, along) for along in reversed(array.dims)]
    even = [found for found in map(_even, lines) if found is not None]
    if len(even) < len(lines):
        return {"axes": [line.astype(np.float64).tolist() for line in lines]}
    return {"spacing": [step for step, _ in even], "origin": [first for _, first in even]}


def _line(array: Any, along: Any) -> np.ndarray:
    """The coordinates along a dimension: numbers that rise or fall."""
    if along not in array.coords:
        return np.arange(array.sizes[along], dtype=np.float64)
    line = np.asarray(array.coords[along].values)
    if line.dtype.kind not in "iuf":
        raise UsageError(f"the coordinate {along} is of type {line.dtype}, not of numbers")
    steps = np.diff(line.astype(np.float64))
    if not np.isfinite(line).all() or not ((steps > 0).all() or (steps < 0).all()):
        raise UsageError(f"the coordinate {along} neither rises nor falls throughout")
    return line


def _even(line: np.ndarray) -> tuple[float, float] | None:
    """Step and start of coordinates that are even to a thousandth of a step or, in single
    precision, within their rounding, as the library has it; else None."""
    values = line.astype(np.float64)
    if len(values) < 2:
        return 1.0, float(values[0])
    step = (values[-1] - values[0]) / (len(values) - 1)
    rounding = 0.0
    if line.dtype.kind == "f" and line.dtype.itemsize <= 4:
        rounding = float(np.abs(values).max() * np.finfo(line.dtype).eps)
    near = max(1e-3 * abs(step), min(rounding, 0.05 * abs(step)))
    if (np.abs(values - (values[0] + step * np.arange(len(values)))) > near).any():
        return None
    return float(step), float(values[0])


def _boxes(
    array: Any, dtype: np.dtype, place: dict[str, Any], name: str
) -> _isospan.Volume:
    """A volume that is read in boxes of whole chunks."""
    scalar = _scalar(dtype)
    stored: np.dtype[Any]
    if dtype == np.bool_:
        stored = np.dtype(np.uint8)
    elif scalar is None:
        raise UsageError(
            f"samples are integers or floating-point numbers of 1 to 8 bytes, not {dtype}"
        )
    else:
        stored = dtype.newbyteorder("<")
    nz, ny, nx = (int(n) for n in array.shape)
    steps = _steps(array, stored.itemsize)

    def read() -> Iterator[tuple[list[int], list[int], bytes]]:
        for ends in itertools.product(*steps):
            box = tuple(slice(lo, hi) for lo, hi in ends)
            part = array[box]
            part = part.compute() if hasattr(part, "compute") else part
            part = np.asarray(part)
            expected = tuple(hi - lo for lo, hi in ends)
            if part.shape != expected:
                raise ValueError(f"{name}[{box}] has the shape {part.shape}, expected {expected}")
            lo, hi = [list(corner) for corner in zip(*reversed(ends))]
            yield lo, hi, np.ascontiguousarray(part, dtype=stored).tobytes()

    return _isospan.Volume.of_boxes(
        name, [nx, ny, nz], _SCALARS[stored.str[1:]], place, read
    )


def _steps(array: Any, item_bytes: int) -> list[list[tuple[int, int]]]:
    """Ends along z, y, x of the boxes: whole chunks, so many that a box has about 32 MiB."""
    edges = _chunk_edges(array)
    taken: list[list[int]] = [list(e) for e in edges]
    # Along x first: rows that are whole are written at once.
    whole = [max(b - a for a, b in zip(e, e[1:])) for e in edges]
    for axis in (2, 1, 0):
        others = math.prod(n for a, n in enumerate(whole) if a != axis) * item_bytes
        taken[axis] = _merged(edges[axis], max(1, _BOX_BYTES // max(1, others)))
        whole[axis] = max(b - a for a, b in zip(taken[axis], taken[axis][1:]))
    return [list(zip(e, e[1:])) for e in taken]


def _merged(edges: Sequence[int], most: int) -> list[int]:
    """Edges of runs of chunks, none longer than ``most`` where it is more than one chunk."""
    found = [edges[0]]
    for before, end in zip(edges[1:], edges[2:]):
        if end - found[-1] > most:
            found.append(before)
    return [*found, edges[-1]]


def _chunk_edges(array: Any) -> list[list[int]]:
    """Where chunks begin and end along each axis; one sample a chunk where there are none."""
    shape, chunks = array.shape, getattr(array, "chunks", None)
    if _is_xarray(array):
        # Of a step of a series, its own three.
        chunks = (array.encoding.get("chunksizes") or ())[-3:]
    # Of a Zarr array, the files: a shard is read as a whole.
    chunks = getattr(array, "shards", None) or chunks
    if not chunks:
        return [list(range(n + 1)) for n in shape]
    if isinstance(chunks[0], (tuple, list)):
        return [[0, *itertools.accumulate(sizes)] for sizes in chunks]
    return [[*range(0, n, max(1, c)), n] for n, c in zip(shape, chunks)]
