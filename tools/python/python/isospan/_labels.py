"""Labels of a label image, and their surfaces."""

from __future__ import annotations

import json
import operator
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Mapping, Sequence, Union

import numpy as np

from ._errors import UsageError, _warn
from ._surface import Surface
from ._words import Whole, whole

if TYPE_CHECKING:
    import pyvista
    import trimesh

    PathLike = os.PathLike[str] | str

#: A name, or a name and red, green, blue and perhaps opacity, 0 to 255.
Style = Union[str, tuple[str, Sequence[Whole]]]
#: Names and colours: a file, as ``isospan surface --label-table`` takes it, or by label.
LabelTable = Union["PathLike", Mapping[Any, Style]]

#: Steps of smoothing without a number, and where there shall be none.
_SMOOTHED = 10


@dataclass(frozen=True)
class Label:
    """A label of an image."""

    #: Its number.
    label: int
    #: Its name; "" if it has none.
    name: str
    #: Red, green, blue and opacity, 0 to 255.
    colour: tuple[int, int, int, int]
    #: Its voxels.
    voxels: int
    #: The volume of its voxels, in cubed world units.
    volume: float
    #: The area of its surface, the faces of its voxels, in squared world units.
    area: float


def label_of(report: dict[str, Any]) -> Label:
    """A label of a report."""
    names = ("label", "name", "voxels", "volume", "area")
    return Label(colour=tuple(report["colour"]), **{name: report[name] for name in names})


class LabelSurface(Surface):
    """The closed surface of a label, a :class:`Surface` with the label's name and colour.

    Normals point out of the label. Neighbours share their walls: the same vertices and triangles,
    turned over. ``isovalue`` is the label.
    """

    def __init__(self, core: Any) -> None:
        super().__init__(core)
        self._about = json.loads(core.about)["label"]

    @property
    def label(self) -> int:
        """The label.

        >>> liver.label
        3
        """
        return self._about["label"]

    @property
    def name(self) -> str:
        """The label's name; "" if it has none.

        >>> liver.name
        'liver'
        """
        return self._about["name"]

    @property
    def colour(self) -> tuple[int, int, int, int]:
        """Red, green, blue and opacity, 0 to 255.

        >>> liver.colour
        (200, 60, 50, 255)
        """
        return tuple(self._about["colour"])

    @property
    def voxels(self) -> int:
        """Voxels of the label.

        >>> liver.voxels
        1000
        """
        return self._about["voxels"]

    def to_trimesh(self) -> trimesh.Trimesh:
        """A mesh of trimesh in the label's colour; vertices stay as they are, in their order."""
        mesh = super().to_trimesh()
        mesh.metadata = {"label": self.label, "name": self.name}
        mesh.visual.face_colors = np.array(self.colour, dtype=np.uint8)
        return mesh

    def to_pyvista(self) -> pyvista.PolyData:
        """A PyVista mesh, with the normals as ``Normals``, and the label and its name as field
        data."""
        mesh = super().to_pyvista()
        mesh.field_data.remove("isovalue")
        mesh.field_data["label"] = [self.label]
        mesh.field_data["name"] = [self.name]
        return mesh

    def _rows(self) -> dict[str, str]:
        rows = super()._rows()
        rows.pop("isovalue")
        return {"label": str(self.label), "name": self.name, "voxels": f"{self.voxels:,}", **rows}

    def __repr__(self) -> str:
        counts = f"{self._core.vertex_count} vertices, {len(self)} faces"
        name = f" {self.name!r}" if self.name else ""
        return f"<isospan.LabelSurface of {self.label}{name}: {counts}>"


def wanted_labels(
    labels: Any, background: bool, smooth: Any, table: LabelTable | None, compress: bool | str = False
) -> dict[str, Any]:
    """What is asked, as the extension takes it."""
    if isinstance(labels, str) and labels != "all":
        raise UsageError(f"labels are whole numbers, or 'all', not {labels!r}")
    is_all = labels is None or isinstance(labels, str)
    return {
        "labels": None if is_all else [_label(v) for v in np.atleast_1d(np.asarray(labels, object))],
        "background": bool(background),
        "smooth": _steps(smooth),
        "table": table if table is None or not isinstance(table, Mapping) else _entries(table),
        "compress": _compression(compress),
    }


def _compression(compress: bool | str) -> str | None:
    if isinstance(compress, str):
        if compress not in ("quantized", "meshopt"):
            raise UsageError(f"compress is True, False, 'quantized' or 'meshopt', not {compress!r}")
        return compress
    return "quantized" if compress else None


def _label(value: Any) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise UsageError(f"a label is a whole number, not {value!r}") from None


def _steps(smooth: Any) -> int:
    """Steps of smoothing: a number, or True for the usual one."""
    if smooth is None or smooth is False:
        return 0
    return _SMOOTHED if smooth is True else whole(smooth, "smooth")


def _entries(table: Mapping[Any, Style]) -> list[tuple[int, str, list[int] | None]]:
    """Labels, names and colours."""
    entries = []
    for label, style in table.items():
        name, colour = (style, None) if isinstance(style, str) else style
        entries.append((_label(label), str(name), None if colour is None else _colour(colour)))
    return entries


def _colour(colour: Sequence[Whole]) -> list[int]:
    numbers = [whole(v, "a colour") for v in colour]
    if len(numbers) not in (3, 4) or max(numbers) > 255:
        raise UsageError(f"a colour is three or four numbers of 0 to 255, not {numbers}")
    return [*numbers, 255][:4]


def warn_of_empty(found: Sequence[tuple[int, int]]) -> None:
    """Warns of labels, with their voxels, that have none."""
    without = [str(label) for label, voxels in found if voxels == 0]
    if without:
        _warn(f"no voxel has the label {' '.join(without[:10])}")
