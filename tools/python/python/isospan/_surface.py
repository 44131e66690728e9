"""Surfaces in memory."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Sequence

import numpy as np

from . import _isospan

if TYPE_CHECKING:
    import numpy.typing as npt
    import pyvista

    PathLike = os.PathLike[str] | str


class _Seen:
    """What NumPy needs to see memory of a surface, which it keeps alive."""

    def __init__(self, owner: _isospan.Surface, interface: dict[str, Any]) -> None:
        self._owner, self.__array_interface__ = owner, interface


class Surface:
    """An isosurface: triangles with normals, oriented, closed but where the domain ends.

    The arrays see the memory in which the surface was made: nothing is copied, and they cannot be
    written to (``array.copy()`` can). ``vertices`` and ``normals`` are columns of one array of six;
    but for a surface so far from 0 that float32 does not tell its vertices apart: ``vertices`` is an
    array of doubles then.
    """

    def __init__(self, core: _isospan.Surface) -> None:
        self._core = core
        rows = np.asarray(_Seen(core, core.vertices()))
        self._vertices, self._normals = rows[:, :3], rows[:, 3:]
        if any(core.origin):
            self._vertices = self._vertices + np.array(core.origin)
            self._vertices.flags.writeable = False
        self._faces = np.asarray(_Seen(core, core.faces()))

    @property
    def vertices(self) -> npt.NDArray[np.float32] | npt.NDArray[np.float64]:
        """Positions in world units, x, y, z: shape (n, 3), float32; float64 far from 0."""
        return self._vertices

    @property
    def normals(self) -> npt.NDArray[np.float32]:
        """Unit normals that point to lower values: shape (n, 3), float32."""
        return self._normals

    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """Three numbers of vertices for each triangle, counter-clockwise from outside: (m, 3),
        uint32."""
        return self._faces

    @property
    def isovalue(self) -> float:
        """The isovalue, in units of the field; inside are values that are not below it."""
        return self._core.isovalue

    def save(self, path: PathLike) -> int:
        """Writes a file, .ply, .stl, .obj, .vtp, .vtkhdf or .glb, and returns its bytes.

        It is the file that ``isospan surface`` writes, and replaces one that is there, as ``numpy.save``
        does.
        """
        return self._core.save(path)

    def to_pyvista(self) -> pyvista.PolyData:
        """A PyVista mesh, with the normals as ``Normals`` and the isovalue as field data."""
        import pyvista

        faces = np.empty((len(self.faces), 4), dtype=np.int64)
        faces[:, 0], faces[:, 1:] = 3, self.faces
        mesh = pyvista.PolyData(np.ascontiguousarray(self.vertices), faces=faces.ravel())
        mesh.point_data.active_normals = np.ascontiguousarray(self.normals)
        mesh.field_data["isovalue"] = [self.isovalue]
        return mesh

    def __len__(self) -> int:
        return self._core.face_count

    def __repr__(self) -> str:
        counts = f"{self._core.vertex_count} vertices, {self._core.face_count} faces"
        return f"<isospan.Surface of {self.isovalue:g}: {counts}>"

    def __reduce__(self) -> Any:
        core = self._core
        return _unpickle, (*core.to_bytes(), self.isovalue, core.comment, list(core.origin))


def _unpickle(
    vertices: bytes,
    faces: bytes,
    isovalue: float,
    comment: str,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> Surface:
    return Surface(_isospan.Surface(vertices, faces, isovalue, comment, list(origin)))


def save_surfaces(surfaces: Sequence[Surface], path: PathLike) -> int:
    """Writes several surfaces of an archive to one file, and returns its bytes.

    PLY, VTP and VTKHDF files have an array ``isovalue`` then, OBJ files a group for each surface.
    """
    return _isospan.Surface.save_all([surface._core for surface in surfaces], path)
