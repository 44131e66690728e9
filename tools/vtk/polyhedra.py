"""Meshes of polyhedra, with VTK: `polyhedra.py write` writes them into this folder, in every encoding of VTK; `polyhedra.py compare`
compares what isospan made of them with VTK's volumes and contours."""
import itertools
import json
import sys

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkIdList, vtkPoints
from vtkmodules.vtkCommonDataModel import VTK_HEXAHEDRON, VTK_POLYHEDRON, vtkUnstructuredGrid
from vtkmodules.vtkFiltersCore import vtkContourFilter, vtkTriangleFilter
from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader, vtkXMLUnstructuredGridWriter

N, ISOVALUE = 5, 6.3
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
FACES = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]


def cubes():
    """N x N x N cubes of side 2, of which those in the middle are cut into eight: corner, side."""
    for k in np.ndindex(N, N, N):
        at = 2 * np.array(k)
        if all(c == 2 for c in k) or k == (3, 2, 2):
            yield from ((at + part, 1) for part in np.ndindex(2, 2, 2))
        else:
            yield at, 2


def mesh(is_polyhedron):
    leaves = list(cubes())
    corners = {tuple(at + side * c) for at, side in leaves for c in CORNERS}
    numbers, cells = {}, []
    number = lambda p: numbers.setdefault(tuple(p), len(numbers))
    for at, side in leaves:
        faces = []
        for face in FACES:
            square = [at + side * CORNERS[c] for c in face]
            middle = sum(square) // 4
            # Beside smaller cubes, a side is their four sides.
            if side == 2 and tuple(middle) in corners:
                ends = [(a + b) // 2 for a, b in zip(square, square[1:] + square[:1])]
                faces += [[ends[i - 1], square[i], ends[i], middle] for i in range(4)]
            else:
                steps = [(a, (a + b) // 2) for a, b in zip(square, square[1:] + square[:1])]
                faces.append([p for a, b in steps for p in (a, b) if p is a or side == 2 and tuple(b) in corners])
        plain = len(faces) == 6 and all(len(face) == 4 for face in faces)
        if plain and not is_polyhedron(len(cells)):
            cells.append([number(at + side * c) for c in CORNERS])
        else:
            cells.append([[number(p) for p in face] for face in faces])
    grid, points = vtkUnstructuredGrid(), vtkPoints()
    places = np.array(list(numbers), float)
    points.SetData(numpy_to_vtk(places, deep=True))
    grid.SetPoints(points)
    for cell in cells:
        if isinstance(cell[0], list):
            stream = vtkIdList()
            for n in [len(cell)] + [n for face in cell for n in [len(face)] + face]:
                stream.InsertNextId(n)
            grid.InsertNextCell(VTK_POLYHEDRON, stream)
        else:
            grid.InsertNextCell(VTK_HEXAHEDRON, 8, cell)
    values = numpy_to_vtk((places @ [1.0, 0.5, -0.25]).astype(np.float32), deep=True)
    values.SetName("f")
    grid.GetPointData().SetScalars(values)
    return grid


MESHES = {"all": lambda n: True, "mixed": lambda n: n % 4 == 0}
ENCODINGS = list(itertools.product(("ascii", "binary", "appended", "raw"), (False, True)))


def write():
    for (name, is_polyhedron), (mode, is_packed) in itertools.product(MESHES.items(), ENCODINGS):
        writer = vtkXMLUnstructuredGridWriter()
        writer.SetInputData(mesh(is_polyhedron))
        writer.SetFileName(f"polyhedra_{name}_{mode}_{is_packed}.vtu")
        {"ascii": writer.SetDataModeToAscii, "binary": writer.SetDataModeToBinary}.get(mode, writer.SetDataModeToAppended)()
        writer.SetEncodeAppendedData(mode == "appended")
        (writer.SetCompressorTypeToZLib if is_packed else writer.SetCompressorTypeToNone)()
        assert writer.Write() == 1


def volume(grid):
    size = vtkCellSizeFilter()
    size.SetInputData(grid)
    size.Update()
    volumes = vtk_to_numpy(size.GetOutput().GetCellData().GetArray("Volume"))
    assert (volumes > 0).all()
    return volumes.sum()


def area(polys):
    triangles = vtkTriangleFilter()
    triangles.SetInputData(polys)
    triangles.Update()
    polys = triangles.GetOutput()
    cells = vtk_to_numpy(polys.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    a, b, c = np.moveaxis(vtk_to_numpy(polys.GetPoints().GetData())[cells].astype(float), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def read(reader, name):
    reader.SetFileName(name)
    reader.Update()
    return reader.GetOutput()


def near(found, expected, tolerance, what):
    assert abs(found - expected) <= tolerance * abs(expected), f"{what}: {found}, expected {expected}"


def compare():
    for name, (mode, is_packed) in itertools.product(MESHES, ENCODINGS):
        stem = f"polyhedra_{name}_{mode}_{is_packed}"
        theirs, ours = (read(vtkXMLUnstructuredGridReader(), file) for file in (f"{stem}.vtu", f"{stem}_tets.vtu"))
        with open(f"{stem}.json") as file:
            census = json.load(file)["mesh"]
        assert census["cells"] == theirs.GetNumberOfCells() and census["vertices"] == theirs.GetNumberOfPoints()
        assert census["bodies"] == 1 and census["inverted"] == census["degenerate"] == 0, census
        assert census["boundary_triangles"] == 12 * N * N, census
        near(volume(ours), (2 * N) ** 3, 1e-12, f"{stem}: volume")
        near(volume(ours), volume(theirs), 1e-12, f"{stem}: volume")
        contour = vtkContourFilter()
        contour.SetInputData(theirs)
        contour.SetValue(0, ISOVALUE)
        contour.Update()
        # A vertex of isospan stays off the ends of its edge by 1/1024 of it.
        near(area(read(vtkXMLPolyDataReader(), f"{stem}.vtp")), area(contour.GetOutput()), 1e-4, f"{stem}: contour")
    print("tools/vtk/test: polyhedra have VTK's volumes and contours")


{"write": write, "compare": compare}[sys.argv[1]]()
