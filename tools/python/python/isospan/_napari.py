"""The napari plugin: archives open as surfaces, and a widget drags their isovalue."""

from __future__ import annotations

import os
from typing import Any, Callable

import numpy as np

from . import _isospan
from ._archive import Archive, Spectrum
from ._pyvista import default_isovalue
from ._surface import Surface

#: Key of a layer's metadata under which the archive is.
KEY = "isospan"
#: Places of the slider.
STEPS = 1000


def layer_data(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces as napari has them: axes z, y, x. Faces turn round, for the axes are
    mirrored."""
    vertices = np.ascontiguousarray(surface.vertices[:, ::-1])
    faces = np.ascontiguousarray(surface.faces[:, ::-1]).astype(np.int64)
    if len(faces) == 0:
        # napari has no empty surfaces: a triangle without an area is not seen.
        return np.zeros((3, 3), np.float32), np.array([[0, 1, 2]])
    return vertices, faces


def isovalue_at(place: int, ends: tuple[float, float]) -> float:
    """The isovalue of a place of the slider."""
    return ends[0] + (ends[1] - ends[0]) * place / STEPS


def place_of(isovalue: float, ends: tuple[float, float]) -> int:
    """The place of the slider that is nearest to an isovalue."""
    width = ends[1] - ends[0]
    return 0 if width <= 0 else int(np.clip(round((isovalue - ends[0]) / width * STEPS), 0, STEPS))


def curve(spectrum: Spectrum, ends: tuple[float, float], width: int, height: int) -> np.ndarray:
    """The area over the isovalue in pixels of a picture: shape (n, 2), x and y from the upper left
    corner."""
    span = max(ends[1] - ends[0], np.finfo(float).tiny)
    most = max(float(spectrum.area.max(initial=0.0)), np.finfo(float).tiny)
    x = (spectrum.isovalues - ends[0]) / span * (width - 1)
    y = (1 - spectrum.area / most) * (height - 1)
    return np.column_stack([x, y])


def read(path: str) -> list[tuple[Any, dict[str, Any], str]]:
    """An archive as a layer: the isosurface that the spectrum marks most."""
    archive = Archive(path)
    isovalue = default_isovalue(archive)
    name = os.path.splitext(os.path.basename(os.path.normpath(path)))[0]
    about = {
        "name": name,
        "shading": "smooth",
        "metadata": {KEY: {"path": archive.path, "isovalue": isovalue}},
    }
    return [(layer_data(archive.surface(isovalue)), about, "surface")]


def get_reader(path: Any) -> Callable[[Any], list[tuple[Any, dict[str, Any], str]]] | None:
    """The reader of an archive; None for anything else."""
    paths = [path] if isinstance(path, (str, os.PathLike)) else list(path)
    if not paths or not all(_isospan.is_archive(p) for p in paths):
        return None
    return lambda _paths: [layer for p in paths for layer in read(os.fspath(p))]


def __getattr__(name: str) -> Any:
    """The widget, which needs Qt, is made when it is asked for."""
    if name == "Isosurface":
        from ._napari_widget import Isosurface

        return Isosurface
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
