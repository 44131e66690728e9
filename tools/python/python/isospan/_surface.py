"""Surfaces in memory."""

from __future__ import annotations

import os
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, Sequence, SupportsIndex

import numpy as np

from . import _isospan

if TYPE_CHECKING:
    import numpy.typing as npt
    import pyvista
    import trimesh

    PathLike = os.PathLike[str] | str


class _Seen:
    """What NumPy needs to see memory of a surface, which it keeps alive."""

    def __init__(self, owner: _isospan.Surface, interface: dict[str, Any]) -> None:
        self._owner, self.__array_interface__ = owner, interface


def _table(title: str, rows: dict[str, str]) -> str:
    """A table of names and values, as notebooks show it."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in rows.items()
    )
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


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

    @cached_property
    def _report(self) -> dict[str, Any]:
        return self._core.report()

    @property
    def area(self) -> float:
        """Area, in squared world units.

        >>> round(sphere.area / (4 * np.pi * 10**2), 2)
        1.0
        """
        return self._report["area"]

    @property
    def volume(self) -> float | None:
        """Volume that the surface encloses, in cubed world units; None of one that is open.

        >>> round(sphere.volume / (4 / 3 * np.pi * 10**3), 1)
        1.0
        """
        return self._report["volume"]

    @property
    def bounds(self) -> tuple[float, float, float, float, float, float] | None:
        """Least and largest coordinates, x0, x1, y0, y1, z0, z1; None of one without vertices.

        >>> [round(v) for v in sphere.bounds]
        [6, 26, 6, 26, 6, 26]
        """
        box = self._report["bounding_box"]
        return None if box is None else tuple(box[end][axis] for axis in range(3) for end in (0, 1))

    @property
    def is_closed(self) -> bool:
        """Whether each edge belongs to two triangles."""
        return self._report["boundary_edges"] == 0 and len(self) > 0

    def components(self) -> list[Surface]:
        """The connected components, those of most triangles first.

        >>> len(sphere.components())
        1
        """
        return [type(self)(core) for core in self._core.components()]

    def compare(
        self,
        other: Surface,
        *,
        samples: SupportsIndex = 200_000,
        threads: SupportsIndex = 0,
        memory: SupportsIndex | str | None = None,
    ) -> dict[str, Any]:
        """Distances to another surface and back, as ``isospan compare --json`` prints them.

        samples: places on each, spread by area, besides its vertices.

        >>> sphere.compare(sphere)["hausdorff"]
        0.0
        """
        from ._archive import _machine
        from ._words import whole

        machine = _machine(whole(threads, "threads"), memory)
        return self._core.compare(other._core, whole(samples, "samples"), machine)

    def to_trimesh(self) -> trimesh.Trimesh:
        """A mesh of trimesh, with the normals; vertices stay as they are, in their order."""
        import trimesh

        return trimesh.Trimesh(
            vertices=self.vertices,
            faces=self.faces.astype(np.int64),
            vertex_normals=self.normals,
            metadata={"isovalue": self.isovalue},
            process=False,
        )

    def plot(self, **choices: Any) -> Any:
        """Shows the surface with PyVista. choices: as for ``pyvista.PolyData.plot``."""
        return self.to_pyvista().plot(**choices)

    def _repr_html_(self) -> str:
        return _table(f"isospan.{type(self).__name__}", self._rows())

    def _rows(self) -> dict[str, str]:
        """What notebooks show."""
        report = self._report
        volume = "open" if report["volume"] is None else f"{report['volume']:.6g}"
        return {
            "isovalue": f"{self.isovalue:g}",
            "vertices": f"{report['vertices']:,}",
            "triangles": f"{report['triangles']:,}",
            "area": f"{report['area']:.6g}",
            "volume": volume,
            "components": f"{report['components']:,}",
        }

    def save(self, path: PathLike) -> int:
        """Writes a file, .ply, .stl, .obj, .vtp, .vtkhdf, .glb or .3mf, or a folder .precomputed of
        meshes for neuroglancer, and returns its bytes.

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
        about = (self.isovalue, core.about, list(core.origin))
        return _unpickle, (*core.to_bytes(), *about, type(self))


def _unpickle(
    vertices: bytes,
    faces: bytes,
    isovalue: float,
    about: str,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    kind: type[Surface] = Surface,
) -> Surface:
    return kind(_isospan.Surface(vertices, faces, isovalue, about, list(origin)))


def save_surfaces(surfaces: Sequence[Surface], path: PathLike) -> int:
    """Writes several surfaces of an archive to one file, and returns its bytes.

    PLY, VTP and VTKHDF files have an array ``isovalue`` then, of labels ``label``, OBJ files a group
    for each surface, GLB files a node, 3MF files an object, a folder .precomputed a segment.
    """
    return _isospan.Surface.save_all([surface._core for surface in surfaces], path)
