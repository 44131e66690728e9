"""Making archives. Keywords are the flags of the program: same names, same values, same
defaults."""

from __future__ import annotations

import numbers
import operator
import os
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Iterator, Sequence

import numpy as np

from . import _isospan
from ._archive import Archive
from ._errors import UsageError
from ._meshes import plain
from ._progress import Progress, Reporter
from ._sources import is_dataset, sources, variable_of

if TYPE_CHECKING:
    PathLike = os.PathLike[str] | str


def _text(value: Any, between: str = ",") -> str:
    """A value as the program takes it."""
    if isinstance(value, (str, os.PathLike)):
        return os.fspath(value)
    if isinstance(value, (bool, np.bool_)):
        raise UsageError(f"{value} is neither a number nor a text")
    if isinstance(value, numbers.Integral):
        return str(operator.index(value))
    if isinstance(value, numbers.Real):
        return repr(float(value))
    if isinstance(value, (Sequence, np.ndarray)):
        return between.join(_text(item) for item in value)
    raise UsageError(f"{value!r} is neither a number nor a text")


def flags(choices: dict[str, Any]) -> list[str]:
    """Flags of the program for keywords: None and False give none, True gives one without a
    value."""
    found = []
    for name, value in choices.items():
        flag = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            found.append(flag)
        else:
            found.append(f"{flag}={_text(value, ':' if name == 'focus' else ',')}")
    return found


def _positive(choices: dict[str, Any]) -> dict[str, Any]:
    """Keywords that say what is done, for flags that say what is not."""
    measure = choices.pop("measure")
    return {**choices, "no_measure": not measure}


def _arguments(
    command: str, before: list[str], inputs: list[str], choices: dict[str, Any]
) -> list[str]:
    return [command, *before, *flags(_positive(choices)), "--", *inputs]


def reduce(
    source: Any,
    out: PathLike,
    *,
    name: str | None = None,
    progress: Progress = None,
    # Flags of isospan reduce, by tools/python/keywords.
    times: Sequence[float] | str | None = None,
    fields: Sequence[str] | str | None = None,
    unit: str | None = None,
    length_unit: str | None = None,
    time_unit: str | None = None,
    keep_going: bool = False,
    points: str | None = None,
    fraction: float | str | None = None,
    count: int | str | None = None,
    adapt: bool = False,
    focus: Sequence[float] | str | None = None,
    shift: float | str | None = None,
    cross_m: int | str | None = None,
    cross_k: int | str | None = None,
    cross_r: Sequence[int] | str | None = None,
    interp: str | None = None,
    values: str | None = None,
    nan: float | str | None = None,
    missing: float | str | None = None,
    keyframes: int | str | None = None,
    chunk_points: int | str | None = None,
    value_bits: float | str | None = None,
    measure: bool = True,
    target_rms: float | str | None = None,
    target_max: float | str | None = None,
    size: int | str | None = None,
    ratio: float | str | None = None,
    lossless: bool = False,
    labels: bool = False,
    isovalue: float | Sequence[float] | str | None = None,
    target_surface: float | str | None = None,
    against: PathLike | None = None,
    threads: int = 0,
    memory: int | str | None = None,
    scratch: PathLike | None = None,
    force: bool = False,
    field: str | None = None,
    channel: int | str | None = None,
    scale: int | str | None = None,
    value_file: PathLike | None = None,
    jumps: bool = False,
    dims: Sequence[int] | str | None = None,
    type: str | None = None,
    endian: str | None = None,
    offset: int | str | None = None,
    spacing: Sequence[float] | str | None = None,
    origin: Sequence[float] | str | None = None,
    io: str | None = None,
    # End of flags.
) -> Archive:
    """Reduces a volume, or a series of volumes, to an archive, and returns it, opened.

    ``archive.report`` is the report of the run, as ``isospan reduce --json`` prints it.

    source: a path, or a volume's address (``s3://…``, ``https://…``), as the program takes it and as
        text, for ``Path`` joins its slashes; an array of three dimensions, indexed [z, y, x] (NumPy,
        also memory mapped, Zarr, h5py, dask, xarray); or a list of these, which are the steps of a
        series. An xarray whose coordinates say which axis they are, by CF's ``axis``,
        ``standard_name`` or ``units``, or by name, may have any order; of a Dataset, ``field`` names
        the variable.
        Coordinates of an xarray that are uneven, such as pressure levels, make a rectilinear grid.
        Arrays of NumPy are read in place, and must not change meanwhile. So are those of Zarr in a
        folder and of h5py in a file, as by the path of that: with the place, units, scale factors
        and missing values that the file tells. Others are read once, each of their chunks once,
        into a temporary file in ``scratch``.
    out: the archive to make, a folder NAME.isospan. Where this very archive is there already, or a
        part of it, nothing is made but what it lacks.
    target_rms, target_max: the error that is not to be exceeded, in units of the field or "1%" of
        its range.
    isovalue: also measure the surfaces of these isovalues against those of the samples:
        ``archive.report["surfaces"]`` says how far each is from them. target_surface: the distance
        that is not to be exceeded at one isovalue, "0.2mm" or a number of world units, for 99 % of
        the area of both surfaces.
    size, ratio: the bytes of the archive, "50MiB", or a share of those of the source, "5%" or
        "1/20"; ratio=20 is size="1/20".
    lossless: keep the whole numbers of a volume as they are. labels: the same of a label image,
        without coarser levels and in far fewer bytes.
        Without any of these targets, a volume has an RMS error of 1 % of its range, or is kept as labels
        where its file says that it has some. Where a target
        cannot be met, the archive is made all the same: the warning ``isospan.TargetNotMet`` says
        so, and ``archive.target_met`` is False.
    fraction, count: the number of points as a part of the samples (0.125, "1/8", "12.5%"), or
        itself; 1/8 if not given. They are for points of a volume, and for meshes.
    points: "pyramid", "hammersley", "halton", "hyperbolic-cross" or "regular"; a volume becomes a
        pyramid of all its samples, a mesh Hammersley points, if not given. adapt,
        focus=(lo, hi), shift, cross_m, cross_k, cross_r, interp, values, value_bits, nan, missing, keyframes,
        chunk_points, and for files field, channel, scale, value_file, jumps, dims, type, endian, offset,
        io: as the flags of ``isospan reduce``.
    measure: whether the error at all samples is measured in the end. against: a file whose error is
        measured besides, of an archive that is reduced again its source.
    times: of a series, the times of its steps. keep_going: leave out steps that cannot be used.
    spacing, origin: of an array, distance of its samples and place of the first one, x, y, z, in
        world units; of an array in a file those of the file, else 1 and 0 if not given. An xarray
        tells them itself. They are also those of a file without its own: raw, TIFF, NPY, NPZ.
    unit, length_unit, time_unit: units of the values, of lengths in the world and of times, as they
        are shown; those that a file, or the attributes of an xarray, name if not given.
    name: of an array in memory, what it is called in messages and in the archive. channel: also of
        an array of Zarr or h5py in a file.
    force: replace an archive that is there already.
    threads: 0 for as many as the process may use. memory: bytes, or a text such as "4GiB" or "50%";
        half of what the process may use if not given. scratch: folder for temporary files.
    progress: True for bars of tqdm, or a function that is called with the name of a stage, how much
        of it is done, how much it is in all, and the unit. An exception that it raises stops the
        run.

    Ctrl-C stops the run; the same call continues it, a search for a target at its try.

    >>> archive = reduce(ball, folder / "ball.isospan", target_max="1%", spacing=(0.5, 0.5, 1))
    >>> archive.dims, archive.spacing, archive.target_met
    ((28, 24, 20), (0.5, 0.5, 1.0), True)
    """
    choices = {k: v for k, v in locals().items() if k not in ("source", "out", "progress")}
    before = [f"--output={os.fspath(out)}"]
    with (
        Reporter(progress) as callback,
        _asked("reduce", before, [], source, choices) as (arguments, volumes),
    ):
        report = _isospan.reduce(arguments, volumes, callback)
    archive = Archive(out)
    archive.report = report
    return archive


def plan(
    source: Any,
    out: PathLike,
    *,
    name: str | None = None,
    progress: Progress = None,
    # Flags of isospan reduce, by tools/python/keywords.
    times: Sequence[float] | str | None = None,
    fields: Sequence[str] | str | None = None,
    unit: str | None = None,
    length_unit: str | None = None,
    time_unit: str | None = None,
    keep_going: bool = False,
    points: str | None = None,
    fraction: float | str | None = None,
    count: int | str | None = None,
    adapt: bool = False,
    focus: Sequence[float] | str | None = None,
    shift: float | str | None = None,
    cross_m: int | str | None = None,
    cross_k: int | str | None = None,
    cross_r: Sequence[int] | str | None = None,
    interp: str | None = None,
    values: str | None = None,
    nan: float | str | None = None,
    missing: float | str | None = None,
    keyframes: int | str | None = None,
    chunk_points: int | str | None = None,
    value_bits: float | str | None = None,
    measure: bool = True,
    target_rms: float | str | None = None,
    target_max: float | str | None = None,
    size: int | str | None = None,
    ratio: float | str | None = None,
    lossless: bool = False,
    labels: bool = False,
    isovalue: float | Sequence[float] | str | None = None,
    target_surface: float | str | None = None,
    against: PathLike | None = None,
    threads: int = 0,
    memory: int | str | None = None,
    scratch: PathLike | None = None,
    force: bool = False,
    field: str | None = None,
    channel: int | str | None = None,
    scale: int | str | None = None,
    value_file: PathLike | None = None,
    jumps: bool = False,
    dims: Sequence[int] | str | None = None,
    type: str | None = None,
    endian: str | None = None,
    offset: int | str | None = None,
    spacing: Sequence[float] | str | None = None,
    origin: Sequence[float] | str | None = None,
    io: str | None = None,
    # End of flags.
) -> dict[str, Any]:
    """What a reduction would need, as ``isospan reduce --dry-run --json`` prints it; nothing is
    made.

    Arguments are as for :func:`reduce`. Of the report, ``archive_bytes``, ``memory_least``,
    ``memory_comfortable`` and ``scratch_bytes`` are bytes, ``estimated_seconds`` is the time, and
    ``workers`` the chunks at work at one time. ``refused`` says why :func:`reduce` would refuse; None
    where it would not. An array that is copied first is copied for this, too.

    >>> found = plan(ball, folder / "none.isospan", target_rms="1%")
    >>> found["samples"], found["refused"], found["memory_least"] > 0
    (13440, None, True)
    """
    choices = {k: v for k, v in locals().items() if k not in ("source", "out", "progress")}
    before = [f"--output={os.fspath(out)}"]
    with (
        Reporter(progress) as callback,
        _asked("reduce", before, [], source, choices) as (arguments, volumes),
    ):
        return _isospan.estimate(arguments, volumes, callback)


def append(
    archive: Archive | PathLike,
    source: Any,
    *,
    name: str | None = None,
    progress: Progress = None,
    # Flags of isospan append, by tools/python/keywords.
    times: Sequence[float] | str | None = None,
    fields: Sequence[str] | str | None = None,
    unit: str | None = None,
    length_unit: str | None = None,
    time_unit: str | None = None,
    keep_going: bool = False,
    missing: float | str | None = None,
    keyframes: int | str | None = None,
    measure: bool = True,
    isovalue: float | Sequence[float] | str | None = None,
    replace: bool = False,
    threads: int = 0,
    memory: int | str | None = None,
    scratch: PathLike | None = None,
    field: str | None = None,
    channel: int | str | None = None,
    scale: int | str | None = None,
    value_file: PathLike | None = None,
    jumps: bool = False,
    dims: Sequence[int] | str | None = None,
    type: str | None = None,
    endian: str | None = None,
    offset: int | str | None = None,
    spacing: Sequence[float] | str | None = None,
    origin: Sequence[float] | str | None = None,
    io: str | None = None,
    # End of flags.
) -> Archive:
    """Adds steps to an archive and returns it, opened; as ``isospan append``.

    Arguments are as for :func:`reduce`; what is not given is as for the last step that is there. A
    step goes where its time lies; ``replace=True`` puts one in the place of that of the same time.
    """
    path = archive.path if isinstance(archive, Archive) else os.fspath(archive)
    choices = {k: v for k, v in locals().items()}
    for other in ("archive", "path", "source", "progress"):
        choices.pop(other)
    with (
        Reporter(progress) as callback,
        _asked("append", [], [path], source, choices) as (arguments, volumes),
    ):
        report = _isospan.append(arguments, volumes, callback)
    longer = Archive(path)
    longer.report = report
    return longer


@contextmanager
def _asked(
    command: str, before: list[str], inputs: list[str], source: Any, choices: dict[str, Any]
) -> Iterator[tuple[list[str], list[_isospan.Volume] | None]]:
    """Arguments of the program for a source, and the volumes where it is no file."""
    name = choices.pop("name")
    if is_dataset(source):
        source, choices["field"] = variable_of(source, choices["field"]), None
    with plain(source, choices["field"], choices["scratch"]) as found:
        choices["field"] = found.field
        if _is_path(found.source):
            _only_arrays(name=name)
            yield _arguments(command, before, [*inputs, *_paths(found.source)], choices), None
            return
        _only_files(choices)
        place = {key: choices.pop(key) for key in ("spacing", "origin", "channel")}
        given = sources(found.source, name=name, **place)
        if given.times is not None and choices["times"] is None:
            choices["times"] = given.times
            if choices["time_unit"] is None:
                choices["time_unit"] = given.time_unit
        for key, unit in (("unit", given.unit), ("length_unit", given.length_unit)):
            if choices[key] is None:
                choices[key] = unit
        yield _arguments(command, before, [*inputs, *given.names], choices), given.volumes


def _is_path(source: Any) -> bool:
    if isinstance(source, (str, os.PathLike)):
        return True
    listed = isinstance(source, (list, tuple)) and len(source) > 0
    return listed and all(isinstance(s, (str, os.PathLike)) for s in source)


def _paths(source: Any) -> list[str]:
    listed = [source] if isinstance(source, (str, os.PathLike)) else source
    return [os.fspath(path) for path in listed]


def _only_arrays(**given: Any) -> None:
    for name, value in given.items():
        if value is not None:
            raise UsageError(f"{name} is for arrays; files tell it themselves")


def _only_files(choices: dict[str, Any]) -> None:
    for name in ("field", "scale", "value_file", "dims", "type", "endian", "offset", "io"):
        if choices[name] is not None:
            raise UsageError(f"{name} is for files, not for arrays")
    if choices["jumps"]:
        raise UsageError("jumps is for cells of meshes, not for arrays")
