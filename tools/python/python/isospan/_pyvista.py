"""``pyvista.read("x.isospan")``: an archive as a mesh of PyVista; ``mesh.save("x.isospan")``: an
archive of a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Sequence

from ._archive import Archive

if TYPE_CHECKING:
    import pyvista


def read(
    path: str,
    /,
    *,
    isovalue: float | Sequence[float] | None = None,
    tetrahedra: bool = False,
    step: int | str | None = None,
    time: float | None = None,
    **choices: Any,
) -> pyvista.DataSet | pyvista.MultiBlock:
    """Reads an archive.

    isovalue: which isosurface; several give a MultiBlock of them. Without one it is the isovalue
        that the spectrum marks most, or the middle of the range where it marks none.
    tetrahedra: the tetrahedra instead, as an UnstructuredGrid.
    step, time: of a series. choices: as for Archive.surface, or for Archive.save_tetrahedra.
    """
    from ._errors import UsageError

    with Archive(path, step=step, time=time) as archive:
        if tetrahedra:
            if isovalue is not None:
                raise UsageError("tetrahedra have no isovalue: give one of the two")
            return archive.to_unstructured_grid(**choices)
        if isovalue is None:
            isovalue = default_isovalue(archive)
        found = archive.surface(isovalue, **choices)
        if not isinstance(found, list):
            return found.to_pyvista()
        import pyvista

        return pyvista.MultiBlock(
            {f"{surface.isovalue:g}": surface.to_pyvista() for surface in found}
        )


def write(mesh: pyvista.DataSet, path: str, /, **choices: Any) -> None:
    """Makes an archive of a mesh's scalars: those of an image at its samples, of any other grid at
    its vertices.

    choices: as for :func:`isospan.reduce`; field chooses scalars other than the active ones. An
        archive that is there is replaced with force=True alone.
    """
    from ._reduce import reduce

    reduce(mesh, path, **choices)


def default_isovalue(archive: Archive) -> float:
    """The isovalue that is worth a look most, of the archive's step."""
    from ._errors import Error

    spectrum = archive.spectrum()
    if spectrum.suggestions:
        return spectrum.suggestions[0]
    if spectrum.range is None:
        raise Error(f"{archive.path}: no point has a value, so there is no surface")
    return (spectrum.range[0] + spectrum.range[1]) / 2
