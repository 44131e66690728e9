"""Archives, and what can be asked of them."""

from __future__ import annotations

import os
import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterator, Sequence, SupportsIndex, overload

import numpy as np

from . import _isospan
from ._labels import Label, LabelSurface, LabelTable, label_of, wanted_labels, warn_of_empty
from ._meshes import plain
from ._progress import Progress, Reporter
from ._sources import volume_or_path
from ._surface import Surface
from ._words import Number, Share, Which, Whole, isovalue as _isovalue, length, moment, number, share, whole

if TYPE_CHECKING:
    import numpy.typing as npt
    import pyvista
    from ._viewer import Viewer
    from typing_extensions import TypedDict, Unpack

    PathLike = os.PathLike[str] | str
    Size = Whole | str
    #: A text as the program takes it, or for x, y, z a pair of ends in numbers of samples (None:
    #: open).
    Roi = str | Sequence[Sequence[Number | None]]

    class SurfaceChoices(TypedDict, total=False):
        roi: Roi | None
        bounds: Sequence[Number | None] | None
        cap: bool
        largest: Whole | None
        min_triangles: Whole | None
        min_volume: Number | None
        decimate: Share | None
        decimate_error: Share | None
        smooth: Whole | None
        smooth_limit: Share | None
        level: Whole | None
        triangles: Whole | None
        error: Share | None
        step: Which | None
        time: Number | None
        threads: int
        memory: Size | None


@dataclass(frozen=True, repr=False)
class Spectrum:
    """How isosurfaces change with the isovalue: arrays of one length, a row for each isovalue.

    Area and volume are in world units. They are those of the archive's tetrahedra.
    """

    #: Isovalues, ascending: shape (n,), float64.
    isovalues: npt.NDArray[np.float64]
    #: Tetrahedra that the isosurface crosses: shape (n,), uint64.
    active: npt.NDArray[np.uint64]
    #: Area of the isosurface: shape (n,), float64.
    area: npt.NDArray[np.float64]
    #: Volume in which values are not below the isovalue: shape (n,), float64.
    volume: npt.NDArray[np.float64]
    #: Mean of the gradient's length on the isosurface, 0 where there is none: shape (n,), float64.
    mean_gradient: npt.NDArray[np.float64]
    #: Isovalues that are worth a look, the most marked one first.
    suggestions: list[float]
    #: Least and largest value; None when no point has one.
    range: tuple[float, float] | None
    #: The report of the program, as ``isospan spectrum --json`` prints it.
    report: dict[str, Any]

    def __repr__(self) -> str:
        return f"<isospan.Spectrum of {len(self.isovalues)} isovalues, range {self.range}>"


def _spectrum(report: dict[str, Any]) -> Spectrum:
    knots = report["knots"]

    def column(name: str, dtype: type = np.float64) -> Any:
        return np.array([knot[name] for knot in knots], dtype=dtype)

    area, gradient = column("area"), column("gradient")
    mean = np.divide(gradient, area, out=np.zeros_like(area), where=area > 0)
    return Spectrum(
        isovalues=column("isovalue"),
        active=column("active_cells", np.uint64),
        area=area,
        volume=column("volume"),
        mean_gradient=mean,
        suggestions=[s["isovalue"] for s in report["suggestions"]],
        range=tuple(report["range"]) if report["range"] else None,
        report=report,
    )


def _number(value: Number | None) -> str:
    return "" if value is None else repr(number(value, "an end"))


def _box(roi: Roi | None, bounds: Sequence[Number | None] | None) -> str | None:
    """A region as the program takes it."""
    from ._errors import UsageError

    if roi is not None and bounds is not None:
        raise UsageError("give a region by roi or by bounds, not by both")
    if bounds is not None:
        if len(bounds) != 6:
            raise UsageError("bounds are six numbers: x0, x1, y0, y1, z0, z1")
        pairs = [bounds[0:2], bounds[2:4], bounds[4:6]]
        return "world:" + ",".join(f"{_number(lo)}:{_number(hi)}" for lo, hi in pairs)
    if roi is None or isinstance(roi, str):
        return roi
    if len(roi) != 3 or any(len(pair) != 2 for pair in roi):
        raise UsageError("a region is three pairs of ends, for x, y and z")
    return ",".join(f"{_number(lo)}:{_number(hi)}" for lo, hi in roi)


#: How often a surface is smoothed without a number, as the program does.
_SMOOTHED = 20


def _smooth(value: Whole | None) -> int | None:
    """Rounds of smoothing: a number, or True for the usual one."""
    if value is None or value is False:
        return None
    return _SMOOTHED if value is True else whole(value, "smooth")


def _machine(threads: int, memory: Size | None, scratch: PathLike | None = None) -> dict[str, Any]:
    return {
        "threads": whole(threads, "threads"),
        "memory": None if memory is None else str(memory),
        "scratch": None if scratch is None else os.fspath(scratch),
    }


def _level(
    level: Whole | None, triangles: Whole | None, error: Share | None
) -> tuple[int | None, int | None, str | None]:
    bound = error if error is None or isinstance(error, str) else repr(number(error, "error"))
    return _whole(level, "level"), _whole(triangles, "triangles"), bound


def _whole(value: Whole | None, name: str) -> int | None:
    return None if value is None else whole(value, name)


def place(path: PathLike) -> str:
    """A path that stays right in another folder or process; an address as it is."""
    text = os.fsdecode(path)
    return text if "://" in text else os.path.abspath(text)


class Archive:
    """An archive, opened at one of its steps: all questions are about that, unless they name
    another.

    Questions may be asked from several threads at one time. Blocks that a surface needed stay in
    memory, up to 256 MiB, so that the next one is faster. An archive is a context manager, and is
    pickled by its absolute path. A process that was forked opens it anew.
    """

    #: The report of the reduction that made it, as ``isospan reduce --json`` prints it; else None.
    report: dict[str, Any] | None

    def __init__(
        self, path: PathLike, *, step: Which | None = None, time: Number | None = None
    ) -> None:
        self._path, self._when = place(path), moment(step, time)
        self.report = None
        # Shown as closed where it cannot be opened.
        self._open: _isospan.Archive | None = None
        self._is_copy = False
        self._open = _isospan.Archive(self._path, self._when)
        _OPENED.add(self)

    @property
    def _core(self) -> _isospan.Archive:
        if self._open is None:
            raise ValueError(f"the archive {self._path} is closed")
        if self._is_copy:
            self._open = _isospan.Archive(self._path, self._when)
            self._is_copy = False
        return self._open

    @property
    def path(self) -> str:
        """Absolute path, or address, of the archive."""
        return self._path

    @property
    def _shown(self) -> str:
        """The path from the current folder, where the archive lies in it."""
        here = os.path.join(os.getcwd(), "")
        return self._path.removeprefix(here)

    @property
    def target_met(self) -> bool | None:
        """Whether the target was met that :func:`isospan.reduce` was asked for; None where there was
        none, and of an archive that was opened."""
        target = (self.report or {}).get("target")
        return None if target is None else target["met"]

    def close(self) -> None:
        """Gives back memory and files. Surfaces that were made stay."""
        self._open = None

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __reduce__(self) -> Any:
        return _again, (self._path, *self._when)

    def __repr__(self) -> str:
        if self._open is None:
            return f"<isospan.Archive {self._shown!r}, closed>"
        dims, steps = "x".join(map(str, self.dims)), len(self.steps)
        series = f", {steps} steps" if steps > 1 else ""
        return f"<isospan.Archive {self._shown!r} of {dims} samples{series}>"

    def _repr_html_(self) -> str:
        from ._surface import _table

        if self._open is None:
            return _table("isospan.Archive", {"path": self._shown, "state": "closed"})
        ends, unit = self.range, self.unit
        rows = {
            "path": self._shown,
            "samples": " x ".join(map(str, self.dims)),
            "spacing": " x ".join(f"{v:g}" for v in self.spacing),
            "steps": str(len(self.steps)),
            "range": "none" if ends is None else f"{ends[0]:g} to {ends[1]:g} {unit or ''}".rstrip(),
            "length unit": self.length_unit or "none",
        }
        return _table("isospan.Archive", rows)

    def at(self, *, step: Which | None = None, time: Number | None = None) -> Archive:
        """The same archive at a step, by its number, or at a time: between steps values are
        linear."""
        return Archive(self._path, step=step, time=time)

    @property
    def info(self) -> dict[str, Any]:
        """What the archive holds, as ``isospan info --json`` prints it."""
        return self._core.info((None, None))

    @property
    def steps(self) -> list[dict[str, Any]]:
        """A dictionary for each step, with at least ``number``, ``time``, ``field`` and
        ``range``."""
        return self.info["steps"]

    @property
    def dims(self) -> tuple[int, int, int]:
        """Samples of the source along x, y, z."""
        nx, ny, nz = self._core.dims
        return nx, ny, nz

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Distance of samples of the source along its axes, in world units."""
        return tuple(self._core.geometry["spacing"])

    @property
    def origin(self) -> tuple[float, float, float]:
        """Place of the first sample of the source, x, y, z, in world units."""
        return tuple(self._core.geometry["origin"])

    @property
    def direction(self) -> npt.NDArray[np.float64]:
        """Directions of the source's axes, as columns of a matrix: shape (3, 3), float64."""
        return np.array(self._core.geometry["direction"], dtype=np.float64).reshape(3, 3).T

    @property
    def unit(self) -> str | None:
        """Unit of the values, as the source or the user named it; None if neither did."""
        return self._core.units.get("value")

    @property
    def length_unit(self) -> str | None:
        """Unit of lengths in the world; None if neither the source nor the user named one."""
        return self._core.units.get("length")

    @property
    def time_unit(self) -> str | None:
        """Unit of the times of steps; None if neither the source nor the user named one."""
        return self._core.units.get("time")

    @property
    def range(self) -> tuple[float, float] | None:
        """Least and largest value of the step; None when no point has one."""
        found = self._core.value_range((None, None))
        return None if found is None else (found[0], found[1])

    def spectrum(self, *, step: Which | None = None, time: Number | None = None) -> Spectrum:
        """How large isosurfaces are, over the isovalue, and which are worth a look."""
        return _spectrum(self._core.spectrum(moment(step, time)))

    @overload
    def count(  # type: ignore[overload-overlap]
        self,
        isovalue: Share,
        *,
        level: Whole | None = ...,
        triangles: Whole | None = ...,
        error: Share | None = ...,
        step: Which | None = ...,
        time: Number | None = ...,
    ) -> int: ...
    @overload
    def count(
        self,
        isovalue: Sequence[Share],
        *,
        level: Whole | None = ...,
        triangles: Whole | None = ...,
        error: Share | None = ...,
        step: Which | None = ...,
        time: Number | None = ...,
    ) -> npt.NDArray[np.uint64]: ...
    def count(
        self, isovalue, *, level=None, triangles=None, error=None, step=None, time=None
    ):
        """How many tetrahedra an isosurface crosses, or cells of a pyramid, exactly; an array for
        several isovalues.

        level, triangles, error: which level of a pyramid, as for :meth:`surface`; triangles are
            those of each isovalue.
        """
        chosen = _level(level, triangles, error)
        when = moment(step, time)
        counts = [self._core.count(v, chosen, when) for v in self._isovalues(isovalue, when)]
        return counts[0] if np.ndim(isovalue) == 0 else np.array(counts, dtype=np.uint64)

    def numbers(
        self,
        isovalue: Share,
        *,
        level: Whole | None = None,
        error: Share | None = None,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
        scratch: PathLike | None = None,
    ) -> dict[str, Any]:
        """Numbers at an isovalue, as ``isospan count --numbers --json`` prints them: the area and
        the pieces of the surface, in world units, and of what is above and below it the volume, the
        number of pieces, whether it percolates along x, y and z, and the largest inscribed ball.

        level, error: which level of a pyramid, as for :meth:`surface`. scratch: a folder for what
            memory does not hold.

        >>> numbers = archive.numbers(20)
        >>> numbers["pieces"], numbers["above"]["volume"] < numbers["volume"]
        (1, True)
        """
        when = moment(step, time)
        (value,) = self._isovalues(isovalue, when)
        machine = _machine(threads, memory, scratch)
        return self._core.numbers(value, _level(level, None, error), machine, when)

    def _isovalues(self, isovalue, when, steps=None):
        """Isovalues as numbers; "50%" is of the range of the step, or of all steps together."""

        def range():
            if steps is None:
                return self._core.value_range(when)
            return self._core.range_of_steps(None if steps is True else steps)

        return [_isovalue(v, range) for v in np.atleast_1d(np.asarray(isovalue, dtype=object))]

    def _diagonal(self):
        """The diagonal of the domain, in world units."""
        from ._errors import UsageError

        if self.info.get("grid_cells") is not None:
            raise UsageError(
                "lengths in % are not possible on a grid with coordinates: give a length in world "
                "units"
            )
        sides = np.multiply(self.spacing, np.subtract(self.dims, 1))
        return float(np.sqrt(np.sum(sides**2)))

    @overload
    def surface(  # type: ignore[overload-overlap]
        self, isovalue: Share, **choices: Unpack[SurfaceChoices]
    ) -> Surface: ...
    @overload
    def surface(
        self, isovalue: Sequence[Share], **choices: Unpack[SurfaceChoices]
    ) -> list[Surface]: ...
    def surface(
        self,
        isovalue: Share | Sequence[Share],
        *,
        roi: Roi | None = None,
        bounds: Sequence[Number | None] | None = None,
        cap: bool = False,
        largest: Whole | None = None,
        min_triangles: Whole | None = None,
        min_volume: Number | None = None,
        decimate: Share | None = None,
        decimate_error: Share | None = None,
        smooth: Whole | None = None,
        smooth_limit: Share | None = None,
        level: Whole | None = None,
        triangles: Whole | None = None,
        error: Share | None = None,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
    ) -> Surface | list[Surface]:
        """The isosurface of an isovalue; a list of surfaces for several, which are made in one
        pass. "50%" is half-way from the least value of the step to its largest.

        roi: cut at a box, ``"I0:I1,J0:J1,K0:K1"`` in numbers of samples or
            ``"world:X0:X1,Y0:Y1,Z0:Z1"``, or three pairs of numbers of samples for x, y, z; an end
            that is left out (None) is open.
        bounds: cut at a box in world units: x0, x1, y0, y1, z0, z1.
        cap: close the surface where the domain ends; not with a box.
        largest, min_triangles, min_volume: keep so many connected components, or those that are so
            large.
        decimate: keep this part of the triangles, 0.1, "10%" or "1/10"; decimate_error: as far as
            the surface moves by no more, in world units or "0.1%" of the domain's diagonal.
        smooth: how often each vertex moves towards its neighbours and back (Taubin); True for 20.
            smooth_limit: how far it may move at most, in world units or "0.1%" of the diagonal; half
            of a voxel's shortest edge if not given.
        level, triangles, error: which level of a pyramid; at most one of them is given. level: its
            number, 0 is the finest. triangles: the finest whose surfaces have at most so many
            triangles together, before components are chosen and triangles decimated. error: the
            coarsest whose RMS error is at most so much, in units of the field, or a text such as
            "1%", of the range of the samples.
        step, time: of a series, which step, by its number or the name of its field, or which time.
        threads: 0 for as many as the process may use. memory: bytes, or a text such as "4GiB" or
            "50%"; half of what the process may use if not given.

        >>> smooth = archive.surface(20, smooth=10, smooth_limit=0.2)
        >>> moved = np.linalg.norm(smooth.vertices - archive.surface(20).vertices, axis=1)
        >>> bool(0 < moved.max() < 0.2001)
        True
        """
        several = np.ndim(np.asarray(isovalue, dtype=object)) > 0
        wanted = self._wanted(
            self._isovalues(isovalue, moment(step, time)),
            roi,
            bounds,
            cap,
            largest,
            min_triangles,
            min_volume,
            decimate,
            decimate_error,
            (smooth, smooth_limit),
            _level(level, triangles, error),
        )
        cores = self._core.surfaces(wanted, _machine(threads, memory), moment(step, time))
        surfaces = [Surface(core) for core in cores]
        return surfaces if several else surfaces[0]

    def _wanted(
        self,
        isovalues,
        roi,
        bounds,
        cap,
        largest,
        min_triangles,
        min_volume,
        decimate,
        far,
        smoothing,
        level,
    ):
        from ._errors import UsageError

        smooth, limit = smoothing
        if limit is not None and _smooth(smooth) is None:
            raise UsageError("smooth_limit needs smooth")
        return {
            "isovalues": isovalues,
            "roi": _box(roi, bounds),
            "cap": bool(cap),
            "largest": _whole(largest, "largest"),
            "min_triangles": _whole(min_triangles, "min_triangles"),
            "min_volume": None if min_volume is None else number(min_volume, "min_volume"),
            "decimate": share(decimate, "decimate"),
            "decimate_error": length(far, "decimate_error", self._diagonal),
            "smooth": _smooth(smooth),
            "smooth_limit": length(limit, "smooth_limit", self._diagonal),
            "level": level,
        }

    def save_surface(
        self,
        path: PathLike,
        isovalue: Share | Sequence[Share],
        *,
        roi: Roi | None = None,
        bounds: Sequence[Number | None] | None = None,
        cap: bool = False,
        largest: Whole | None = None,
        min_triangles: Whole | None = None,
        min_volume: Number | None = None,
        decimate: Share | None = None,
        decimate_error: Share | None = None,
        smooth: Whole | None = None,
        smooth_limit: Share | None = None,
        level: Whole | None = None,
        triangles: Whole | None = None,
        error: Share | None = None,
        step: Which | None = None,
        time: Number | None = None,
        steps: str | bool | None = None,
        threads: int = 0,
        memory: Size | None = None,
        scratch: PathLike | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """Writes isosurfaces to a file, in bounded memory, as ``isospan surface`` does; returns its
        report.

        steps: of a series, surfaces of these steps, ``"FIRST:LAST"`` or True for all, a file each:
            "%04d" in the path stands for the step's number. All else is as for :meth:`surface`.
        """
        wanted = self._wanted(
            self._isovalues(isovalue, moment(step, time), None if steps is False else steps),
            roi,
            bounds,
            cap,
            largest,
            min_triangles,
            min_volume,
            decimate,
            decimate_error,
            (smooth, smooth_limit),
            _level(level, triangles, error),
        )
        machine, out = _machine(threads, memory, scratch), os.fspath(path)
        with Reporter(progress) as callback:
            if steps is None or steps is False:
                return self._core.save_surfaces(out, wanted, machine, moment(step, time), callback)
            if (step, time) != (None, None):
                from ._errors import UsageError

                raise UsageError("give one step or time, or steps, not both")
            return self._core.save_series(
                out, wanted, machine, None if steps is True else steps, callback
            )

    def labels(
        self,
        *,
        label_table: LabelTable | None = None,
        background: bool = False,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
    ) -> list[Label]:
        """The labels of a label image, ascending, each with its voxels, volume and area: all but 0,
        with ``background=True`` that too.

        The archive is one that ``isospan.reduce(image, path, labels=True)`` made. label_table: names
        and colours, as for :meth:`label_surface`.

        >>> [(one.label, one.name, one.voxels) for one in organs.labels(label_table={3: "liver"})]
        [(3, 'liver', 1000), (7, '', 500)]
        """
        wanted = wanted_labels(None, background, 0, label_table)
        found = _isospan.label_sizes(
            self._core, wanted, _machine(threads, memory), moment(step, time)
        )
        return [label_of(one) for one in found]

    @overload
    def label_surface(  # type: ignore[overload-overlap]
        self,
        labels: SupportsIndex,
        *,
        smooth: Whole = ...,
        label_table: LabelTable | None = ...,
        background: bool = ...,
        step: Which | None = ...,
        time: Number | None = ...,
        threads: int = ...,
        memory: Size | None = ...,
    ) -> LabelSurface: ...
    @overload
    def label_surface(
        self,
        labels: Sequence[Whole] | npt.NDArray[np.integer] | str = ...,
        *,
        smooth: Whole = ...,
        label_table: LabelTable | None = ...,
        background: bool = ...,
        step: Which | None = ...,
        time: Number | None = ...,
        threads: int = ...,
        memory: Size | None = ...,
    ) -> list[LabelSurface]: ...
    def label_surface(
        self,
        labels="all",
        *,
        smooth=False,
        label_table=None,
        background=False,
        step=None,
        time=None,
        threads=0,
        memory=None,
    ):
        """The surface of a label of a label image, closed; a list of them for several labels, in
        their order, or for "all", ascending.

        labels: numbers; "all" is all but 0, with ``background=True`` that too.
        smooth: steps of smoothing, at most 64; True for 10. Vertices stay in their cells and walls
            common; volumes change by less than 1 % for compact labels of a thousand voxels and
            more. Without it these are the faces of the voxels, with exactly their volume.
        label_table: names and colours: a CSV, a label description of ITK-SNAP or a colour table of
            3D Slicer or FreeSurfer; or ``{3: "liver", 7: ("bone", (240, 230, 200))}``.
        step, time, threads, memory: as for :meth:`surface`.

        >>> names = {3: ("liver", (200, 60, 50)), 7: "kidney"}
        >>> liver, kidney = organs.label_surface([3, 7], label_table=names)
        >>> liver.name, liver.is_closed, round(liver.volume)
        ('liver', True, 1000)
        """
        wanted = wanted_labels(labels, background, smooth, label_table)
        cores = _isospan.label_surfaces(
            self._core, wanted, _machine(threads, memory), moment(step, time)
        )
        found = {surface.label: surface for surface in map(LabelSurface, cores)}
        if wanted["labels"] is None:
            return list(found.values())
        warn_of_empty([(one.label, one.voxels) for one in found.values()])
        surfaces = [found[label] for label in wanted["labels"]]
        return surfaces[0] if np.ndim(np.asarray(labels, dtype=object)) == 0 else surfaces

    def save_label_surface(
        self,
        path: PathLike,
        labels: SupportsIndex | Sequence[Whole] | npt.NDArray[np.integer] | str = "all",
        *,
        smooth: Whole = False,
        label_table: LabelTable | None = None,
        background: bool = False,
        compress: bool | str = False,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
        scratch: PathLike | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """Writes surfaces of labels to a file, in bounded memory, as ``isospan surface --labels``
        does; returns its report. With "{}" in the path each label has a file, with its number there.

        compress: a .glb of about half the bytes; 'meshopt' of a quarter. All else is as for
            :meth:`label_surface`.

        >>> report = organs.save_label_surface(folder / "organs.glb", smooth=True)
        >>> [one["label"] for one in report["labels"]]
        [3, 7]
        """
        wanted = wanted_labels(labels, background, smooth, label_table, compress)
        machine, out = _machine(threads, memory, scratch), os.fspath(path)
        with Reporter(progress) as callback:
            report = _isospan.save_labels(
                self._core, out, wanted, machine, moment(step, time), callback
            )
        warn_of_empty([(one["label"], one["voxels"]) for one in report["labels"]])
        return report

    def probe(
        self,
        points: npt.ArrayLike,
        *,
        level: Whole | None = None,
        error: Share | None = None,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
    ) -> npt.NDArray[np.float64]:
        """The field at points in world units: shape (n,), float64. It is linear in each tetrahedron,
        and that of a pyramid is trilinear between nodes.

        points: shape (n, 3), x, y, z; or one point of shape (3,), for an array of one value.
        level, error: which level of a pyramid, as for :meth:`surface`.
        NaN outside of the domain, beyond the last nodes of the level, and where the source has no
        data.
        """
        rows = np.ascontiguousarray(points, dtype="<f8")
        if rows.ndim == 1 and rows.shape == (3,):
            rows = rows[None]
        if rows.ndim != 2 or rows.shape[1] != 3:
            from ._errors import UsageError

            raise UsageError(f"points have the shape (n, 3), not {rows.shape}")
        found = self._core.probe(
            rows.tobytes(), _level(level, None, error), _machine(threads, memory), moment(step, time)
        )
        return np.asarray(found)

    def sample(
        self,
        dims: Sequence[int] | None = None,
        *,
        level: Whole | None = None,
        error: Share | None = None,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
    ) -> npt.NDArray[np.float64]:
        """The field on a grid that spans the domain: shape (nz, ny, nx), float64, indexed [z, y,
        x].

        dims: samples along x, y, z, in this order; those of the source if not given.
        level, error: which level of a pyramid, as for :meth:`surface`.
        The first and last sample of an axis lie on the domain's faces. NaN where the source has no
        data, and beyond the last nodes of the level.
        """
        nx, ny, nz = (int(n) for n in (self.dims if dims is None else dims))
        chosen = _level(level, None, error)
        found = self._core.sample([nx, ny, nz], chosen, _machine(threads, memory), moment(step, time))
        return np.asarray(found).reshape(nz, ny, nx)

    def save_samples(
        self,
        path: PathLike,
        dims: Sequence[int] | None = None,
        *,
        level: Whole | None = None,
        error: Share | None = None,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """Writes :meth:`sample` to a .vti or .npy file (float32), in bounded memory; returns the
        report."""
        grid = [int(n) for n in (self.dims if dims is None else dims)]
        with Reporter(progress) as callback:
            machine = _machine(threads, memory)
            chosen = _level(level, None, error)
            return self._core.save_samples(
                os.fspath(path), grid, chosen, machine, moment(step, time), callback
            )

    def save_tetrahedra(
        self,
        path: PathLike,
        *,
        range: Sequence[float | None] | None = None,
        any_corner: bool = False,
        roi: Roi | None = None,
        bounds: Sequence[Number | None] | None = None,
        every: int = 1,
        compress: bool = False,
        fields: Sequence[str] = (),
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
        scratch: PathLike | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """Writes tetrahedra to a .vtu or .vtkhdf file, in bounded memory, as ``isospan export`` does.

        range: only tetrahedra whose corners all (with any_corner: at least one) have values in it;
            an end that is None is open. roi, bounds: only those that touch the box. every: each
            so-manyth of them. fields: names of the fields whose values are written, of those that
            the archive has at the step; range is of the first. By default that of the step.
        """
        from ._errors import UsageError

        if any_corner and range is None:
            raise UsageError("any_corner needs a range")
        if isinstance(fields, str):
            raise UsageError("fields is a list of names")
        ends = (-np.inf, np.inf)
        part = {
            "range": None
            if range is None
            else [o if v is None else float(v) for v, o in zip(range, ends)],
            "any_corner": any_corner,
            "roi": _box(roi, bounds),
            "every": every,
            "compress": compress,
            "fields": list(fields),
        }
        with Reporter(progress) as callback:
            machine = _machine(threads, memory, scratch)
            return self._core.save_tetrahedra(
                os.fspath(path), part, machine, moment(step, time), callback
            )

    def save_grid(
        self,
        path: PathLike,
        *,
        level: int = 0,
        roi: Roi | None = None,
        bounds: Sequence[Number | None] | None = None,
        compress: bool = False,
        fields: Sequence[str] = (),
        replace: bool = False,
        step: Which | None = None,
        time: Number | None = None,
        threads: int = 0,
        memory: Size | None = None,
        scratch: PathLike | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """Writes the samples of a level of a pyramid, in bounded memory, as ``isospan export`` does.

        path: .vti, .vtr, .vts, .nrrd, .nii, .nii.gz, .mha, .mhd or .npy; or a folder .zarr, which
            becomes an OME-Zarr image of the level and all coarser ones, and is always compressed.
        level: 0 is the finest. roi, bounds: only samples in the box. fields: names of the fields
            that are written, of those that the archive has at the step; by default that of the
            step. replace: an image .zarr that is there is replaced.
        """
        from ._errors import UsageError

        if isinstance(fields, str):
            raise UsageError("fields is a list of names")
        if compress and os.fspath(path).endswith(".zarr"):
            raise UsageError("an image .zarr is always compressed: leave out compress")
        grid = {
            "level": level,
            "roi": _box(roi, bounds),
            "compress": compress,
            "fields": list(fields),
            "replace": replace,
        }
        with Reporter(progress) as callback:
            machine = _machine(threads, memory, scratch)
            return self._core.save_grid(os.fspath(path), grid, machine, moment(step, time), callback)

    def to_unstructured_grid(self, **choices: Any) -> pyvista.UnstructuredGrid:
        """The tetrahedra as a grid of PyVista, with the values at the points.

        choices: as for :meth:`save_tetrahedra`, but for compress. They go through a temporary file,
            in
        ``scratch`` where that is given.
        """
        import pyvista

        choices = {**choices, "compress": False}
        with tempfile.TemporaryDirectory(prefix="isospan-", dir=choices.get("scratch")) as folder:
            file = Path(folder, "tetrahedra.vtu")
            self.save_tetrahedra(file, **choices)
            return pyvista.read(file)

    def measure(
        self,
        against: Any,
        *,
        isovalue: Share | Sequence[Share] | None = None,
        field: str | None = None,
        step: int | None = None,
        map: PathLike | None = None,
        level: Whole | None = None,
        error: Share | None = None,
        threads: int = 0,
        memory: Size | None = None,
        scratch: PathLike | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """The error at every sample of a source, in units of the field, as ``isospan measure
        --json`` prints it.

        against: the volume or mesh that the archive was made from, a path or an array, as for
            :func:`isospan.reduce`. isovalue: also measure the surfaces of these isovalues, which are
            ``["surfaces"]``. map: also write errors of bricks, .vti. level, error: which level
            of a pyramid, as for :meth:`surface`; samples beyond its last nodes are outside.
        The error that was measured when the archive was made is ``archive.info["error"]``.
        """
        with Reporter(progress) as callback:
            machine = _machine(threads, memory, scratch)
            place = None if map is None else os.fspath(map)
            with plain(against, field, scratch) as found:
                source = volume_or_path(found)
                chosen = _level(level, None, error)
                asked = [] if isovalue is None else isovalue
                isovalues = self._isovalues(asked, moment(step, None))
                return self._core.measure(
                    source, isovalues, found.field, step, place, chosen, machine, callback
                )

    def render(
        self,
        path: PathLike,
        isovalue: Share | Sequence[Share] | None = None,
        *,
        progress: Progress = None,
        **choices: Any,
    ) -> dict[str, Any]:
        """Draws surfaces or slices to a picture, .png, .gif or .apng; returns the report of
        ``isospan render --json``.

        isovalue: one or several; without any, a slice. choices: the flags of ``isospan render``, as
            in ``size=(1024, 768)``, ``turntable=36``, ``opacity=(0.3, 1)``, ``slice="y=50%"``. An
            existing file is replaced with ``force=True`` alone.
        """
        from ._reduce import flags

        step, time = self._when
        if not {"step", "time", "steps", "all_steps"} & set(choices):
            field = step[1] if isinstance(step, tuple) else None
            number = step[0] if isinstance(step, tuple) else step
            choices = {"step": number, "field": field, "time": time, **choices}
        arguments = flags({"output": os.fspath(path), "isovalue": isovalue, **choices})
        with Reporter(progress) as callback:
            return _isospan.render(["render", *arguments, "--", self._path], callback)

    def publish(self, folder: PathLike, *, force: bool = False) -> dict[str, Any]:
        """Writes a folder that shows the archive on any web server, as ``isospan publish`` does;
        returns its report.

        force: replace what was published in the folder before.
        """
        from ._reduce import flags

        arguments = flags({"output": os.fspath(folder), "force": force})
        return _isospan.publish(["publish", *arguments, "--", self._path])

    def view(self, *, port: Whole = 0, open: bool = False) -> Viewer:
        """Serves the archive to a browser on this machine, as ``isospan view`` does, until the
        viewer is closed or the process ends. A notebook shows it.

        port: 0 for any that is free. open: start a browser.
        """
        from ._viewer import Viewer

        return Viewer(self._path, port=whole(port, "port"), browser=open)

    def check(self) -> None:
        """Verifies the whole archive; raises BadInputError that names the first thing that is
        wrong."""
        self._core.check()

    def __iter__(self) -> Iterator[Archive]:
        """The archive at each of its steps, of each field where they have several."""
        numbers = [step["number"] for step in self.steps]
        if len(set(numbers)) == len(numbers):
            return (self.at(step=number) for number in numbers)
        return (self.at(step=(step["number"], step["field"])) for step in self.steps)


#: Archives of this process that were opened.
_OPENED: weakref.WeakSet[Archive] = weakref.WeakSet()


def _forked() -> None:
    """The threads of the parent are not there, and its locks may be held: archives are opened anew
    when they are asked."""
    for archive in list(_OPENED):
        if archive._open is not None and not archive._is_copy:
            _isospan.keep(archive._open)
            archive._is_copy = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def _again(path: str, step: Which | None, time: float | None) -> Archive:
    return Archive(path, step=step, time=time)


def open(path: PathLike, *, step: Which | None = None, time: Number | None = None) -> Archive:
    """Opens an archive, at a step, by its number or the name of its field, or at a time; at its
    first step if none is given.

    path: the folder of an archive, or its address (``s3://…``, ``https://…``).
    """
    return Archive(path, step=step, time=time)
