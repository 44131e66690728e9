"""Meshes by meshio and VTK: each vertex has its value."""

import meshio
import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkIdList, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
from vtkmodules.vtkFiltersCore import vtkCellDataToPointData
from vtkmodules.vtkIOParallel import vtkEnSightWriter
from vtkmodules.vtkIOHDF import vtkHDFWriter
from vtkmodules.vtkIOLegacy import vtkDataSetWriter
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from grids import PACKERS, XML, write
from placing import Case, Refused, numbers, program, rotation

# Corners of a box in VTK's order, and of its wedges and tetrahedra.
BOX = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
WEDGES = [(0, 1, 3, 4, 5, 7), (1, 2, 3, 5, 6, 7)]
TETRAHEDRA = [(0, 1, 3, 4), (1, 3, 4, 5), (3, 4, 5, 7), (1, 2, 3, 5), (2, 3, 5, 6), (3, 5, 6, 7)]
SHAPES = {"hexahedron": [tuple(range(8))], "wedge": WEDGES, "tetra": TETRAHEDRA}
NUMBERS = {"hexahedron": 12, "wedge": 13, "tetra": 10}


def box(kind, shape=(4, 5, 6), spread=1):
    """Vertices and cells of a skewed, turned box."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1).reshape(-1, 3)
    skew = rotation(20, -35, 50) @ np.array([[0.5, 0.1, 0], [0, 1.25, 0.2], [0, 0, 2.5]])
    points = (index @ skew.T + [100, -20, 3]) * spread
    number = np.arange(len(index)).reshape(shape)
    cells = []
    for i, j, k in np.ndindex(*(n - 1 for n in shape)):
        corners = [number[i + a, j + b, k + c] for a, b, c in BOX]
        cells += [[corners[c] for c in cell] for cell in SHAPES[kind]]
    cells = np.array(cells)
    if kind == "tetra":
        # All the same way round.
        a, b, c, d = (points[cells[:, n]] for n in range(4))
        turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
        cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    return points, cells


def grid_of(points, groups, values, cell_values=None):
    """VTK's mesh: `groups` are cells by their kind."""
    mesh, vertices = vtkUnstructuredGrid(), vtkPoints()
    vertices.SetData(numpy_to_vtk(points, deep=True))
    mesh.SetPoints(vertices)
    for kind, cells in groups.items():
        for cell in cells:
            ids = vtkIdList()
            for corner in cell:
                ids.InsertNextId(int(corner))
            mesh.InsertNextCell(NUMBERS[kind], ids)
    for data, of in ((mesh.GetPointData(), values), (mesh.GetCellData(), cell_values)):
        if of is not None:
            array = numpy_to_vtk(of, deep=True)
            array.SetName("v")
            data.SetScalars(array)
    return mesh


@program("vtk")
def vtk_meshes(at):
    for n, kind in enumerate(SHAPES):
        points, cells = box(kind)
        values = numbers("f4" if n % 2 else "f8", (len(points),))
        mesh = grid_of(points, {kind: cells}, values)
        for m, mode in enumerate(XML):
            path = write(vtkXMLUnstructuredGridWriter(), mesh, at / f"{kind}_{m}.vtu", **mode, **PACKERS[(n + m) % 3])
            yield Case(path, values, points, is_mesh=True)
        for m, mode in enumerate(("SetFileTypeToASCII", "SetFileTypeToBinary")):
            for version in 42, 51:
                path = at / f"{kind}_{m}_{version}.vtk"
                write(vtkDataSetWriter(), mesh, path, **{mode: None, "SetFileVersion": version})
                yield Case(path, values, points, is_mesh=True)
        yield Case(write(vtkHDFWriter(), mesh, at / f"{kind}.vtkhdf"), values, points, is_mesh=True)
    # Values of cells become means at the vertices.
    points, cells = box("hexahedron")
    mesh = grid_of(points, {"hexahedron": cells}, None, numbers("f8", (len(cells),)))
    means = vtkCellDataToPointData()
    means.SetInputData(mesh)
    means.Update()
    values = vtk_to_numpy(means.GetOutput().GetPointData().GetScalars())
    write(vtkXMLUnstructuredGridWriter(), mesh, at / "cells.vtu")
    yield Case(at / "cells.vtu", values, points, is_mesh=True)


@program("vtk")
def ensight(at):
    points, cells = box("tetra")
    values = numbers("f4", (len(points),))
    mesh = grid_of(points, {"tetra": cells}, values)
    blocks = numpy_to_vtk(np.ones(len(cells), "i4"), deep=True)
    blocks.SetName("BlockId")
    mesh.GetCellData().AddArray(blocks)
    writer = vtkEnSightWriter()
    writer.SetInputData(mesh)
    writer.SetPath(str(at))
    writer.SetBaseName("a")
    writer.SetFileName("a")
    writer.Write()
    writer.WriteCaseFile(1)
    yield Case(next(at.glob("*.case")), values, points.astype("f4"), is_mesh=True)


@program("meshio")
def meshio_files(at):
    for kind in SHAPES:
        points, cells = box(kind)
        values = numbers("f8", (len(points),))
        mesh = meshio.Mesh(points, [(kind, cells)], {"v": values})
        kinds = {
            "ascii.vtu": {"binary": False}, "plain.vtu": {"compression": None}, "zlib.vtu": {"compression": "zlib"},
            "ascii.vtk": {"file_format": "vtk42", "binary": False}, "binary.vtk": {"file_format": "vtk42"},
            "new.vtk": {"file_format": "vtk51", "binary": False}, "new_binary.vtk": {"file_format": "vtk51"},
            "2.msh": {"file_format": "gmsh22"}, "4.msh": {"file_format": "gmsh"}, "a.exo": {},
        }  # fmt: skip
        for suffix, more in kinds.items():
            path = at / f"{kind}_{suffix}"
            meshio.write(path, mesh, **more)
            yield Case(path, values, points, is_mesh=True)
        if kind == "tetra":
            # It has no values.
            meshio.write(at / "a.node", mesh)
            yield Case(at / "a.node", points[:, 0], points, ("--field", "x"), is_mesh=True)
    points, cells = box("tetra")
    mesh = meshio.Mesh(points, [("tetra", cells)], {"v": numbers("f8", (len(points),))})
    for suffix, words in {"xdmf": "XDMF", "med": "MED", "inp": "simulation", "cgns": "CGNS"}.items():
        meshio.write(at / f"a.{suffix}", mesh)
        yield Refused(at / f"a.{suffix}", words)
