"""Meshes of PyVista as sources: images are read where they are, other grids through a file."""

from __future__ import annotations

import os
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Iterator

import numpy as np

from ._errors import UsageError

if TYPE_CHECKING:
    import pyvista

#: For each kind of grid: the end of its file's name, and the class of VTK that writes it.
_FILES = {
    "ImageData": ("vti", "vtkXMLImageDataWriter"),
    "RectilinearGrid": ("vtr", "vtkXMLRectilinearGridWriter"),
    "StructuredGrid": ("vts", "vtkXMLStructuredGridWriter"),
    "UnstructuredGrid": ("vtu", "vtkXMLUnstructuredGridWriter"),
}


@dataclass
class Image:
    """An array [z, y, x] and its place."""

    array: np.ndarray
    name: str
    spacing: tuple[float, float, float]
    origin: tuple[float, float, float]
    #: Directions of the axes x, y, z.
    direction: list[list[float]]


@dataclass
class Plain:
    """A source without meshes, and the field that is read of it."""

    source: Any
    field: str | None


def is_mesh(source: Any) -> bool:
    """Whether it is a data set of PyVista."""
    return hasattr(source, "GetPointData") and hasattr(source, "point_data")


@contextmanager
def plain(source: Any, field: str | None, scratch: Any) -> Iterator[Plain]:
    """A source whose meshes are arrays, or, if one cannot be, paths of files that go in the end."""
    listed = list(source) if isinstance(source, (list, tuple)) else [source]
    if not any(is_mesh(item) for item in listed):
        yield Plain(source, field)
        return
    if not all(is_mesh(item) for item in listed):
        raise UsageError("the steps of a series are meshes, arrays or paths, not several of these")
    fields = [_field(mesh, field) for mesh in listed]
    if all(_kind(mesh) == "ImageData" and of == "point" for mesh, (of, _) in zip(listed, fields)):
        yield Plain([_image(mesh, name) for mesh, (_, name) in zip(listed, fields)], None)
        return
    names = {name for _, name in fields}
    if len(names) > 1:
        raise UsageError(f"the steps have fields of several names, {sorted(names)}: give one")
    with tempfile.TemporaryDirectory(prefix="isospan-", dir=scratch) as folder:
        paths = []
        for number, (mesh, (of, name)) in enumerate(zip(listed, fields)):
            paths.append(os.path.join(folder, f"mesh_{number:06}.{_FILES[_kind(mesh)][0]}"))
            _write(mesh, of, name, paths[-1])
        yield Plain(paths, names.pop())


def _kind(mesh: pyvista.DataSet) -> str:
    for kind in type(mesh).__mro__:
        if kind.__name__ in _FILES:
            return kind.__name__
    raise UsageError(f"a mesh is one of {', '.join(_FILES)}, not {type(mesh).__name__}")


def _field(mesh: pyvista.DataSet, field: str | None) -> tuple[str, str]:
    """Whether the scalars belong to points or to cells, and their name."""
    _kind(mesh)
    if field is None:
        association, field = mesh.active_scalars_info
        of = association.name.lower()
    else:
        of = "point" if field in mesh.point_data else "cell" if field in mesh.cell_data else ""
    if field is None or of not in ("point", "cell"):
        names = [*mesh.point_data, *mesh.cell_data]
        raise UsageError(f"the mesh has no scalars {field or 'that are active'}; it has {names}")
    scalars = (mesh.point_data if of == "point" else mesh.cell_data)[field]
    if scalars.ndim != 1:
        raise UsageError(f"{field} has {scalars.shape[1]} values at each place; scalars have one")
    return of, field


def _image(mesh: Any, name: str) -> Image:
    nx, ny, nz = mesh.dimensions
    return Image(
        array=np.asarray(mesh.point_data[name]).reshape(nz, ny, nx),
        name=name,
        spacing=mesh.spacing,
        # That of the first sample, wherever the extent begins.
        origin=mesh.GetPoint(0),
        direction=np.asarray(mesh.direction_matrix).T.tolist(),
    )


def _write(mesh: Any, of: str, name: str, path: str) -> None:
    """Writes a grid with one field, as its bytes are in memory: always the same file."""
    from vtkmodules import vtkIOXML

    kind = _kind(mesh)
    only = mesh.copy(deep=False)
    only.clear_data()
    # Arrays of VTK keep what was asked of them, and writers write that too: these are new ones.
    source, target = (getattr(m, f"{of}_data") for m in (mesh, only))
    target[name] = np.asarray(source[name])
    if kind == "RectilinearGrid":
        for axis in "xyz":
            setattr(only, axis, np.array(getattr(mesh, axis)))
            # One without a name is written with its address.
            getattr(only, f"Get{axis.upper()}Coordinates")().SetName(axis)
    elif kind != "ImageData":
        only.points = np.asarray(mesh.points)
    writer = getattr(vtkIOXML, _FILES[kind][1])()
    writer.SetFileName(path)
    writer.SetInputData(only)
    writer.SetHeaderTypeToUInt64()
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToNone()
    if not writer.Write():
        raise OSError(f"VTK could not write the mesh to {path}")
