"""Reads with VTK what tools/vtk/test has made in this folder, and compares."""
import json
import os

import h5py
import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import VTK_TETRA
from vtkmodules.vtkFiltersCore import vtkContourGrid, vtkProbeFilter
from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOGeometry import vtkGLTFReader, vtkOBJReader, vtkSTLReader
from vtkmodules.vtkIOPLY import vtkPLYReader
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader


def read(reader, name):
    reader.SetFileName(name)
    reader.Update()
    assert reader.GetErrorCode() == 0, name
    return reader.GetOutput()


def load(name):
    with open(name) as file:
        return json.load(file)


def corners(polys):
    """Positions of the corners, triangle by triangle."""
    cells = vtk_to_numpy(polys.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return vtk_to_numpy(polys.GetPoints().GetData())[cells]


def area(triangles):
    a, b, c = (triangles[:, k].astype(float) for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def expect_same(found, expected, name):
    """Two data sets with the same points, cells, arrays and active arrays."""

    def arrays(data, with_active=True):
        every = {data.GetArrayName(i): data.GetArray(i) for i in range(data.GetNumberOfArrays())}
        active = [data.GetScalars(), data.GetNormals()] if with_active else []
        return {key: vtk_to_numpy(array) for key, array in every.items()}, [a and a.GetName() for a in active]

    is_grid = found.IsA("vtkUnstructuredGrid")
    everything = []
    for data in (found, expected):
        cells = data.GetCells() if is_grid else data.GetPolys()
        points = vtk_to_numpy(data.GetPoints().GetData()) if data.GetNumberOfPoints() else np.empty(0)
        of_points, active = arrays(data.GetPointData())
        of_field, _ = arrays(data.GetFieldData(), False)
        all_arrays = {f"point {key}": values for key, values in of_points.items()}
        all_arrays |= {f"field {key}": values for key, values in of_field.items()}
        all_arrays |= {"points": points, "corners": vtk_to_numpy(cells.GetConnectivityArray())}
        all_arrays["offsets"] = np.array([cells.GetOffset(n) for n in range(cells.GetNumberOfCells())])
        if is_grid:
            all_arrays["types"] = np.array([data.GetCellType(n) for n in range(data.GetNumberOfCells())])
        everything.append((all_arrays, active, data.GetNumberOfCells()))
    (found, active, count), (expected, expected_active, expected_count) = everything
    assert count == expected_count and found.keys() == expected.keys(), (name, found.keys(), expected.keys())
    assert active == expected_active or not len(found["points"]), (name, active, expected_active)
    for key, values in found.items():
        assert values.dtype == expected[key].dtype or not len(values), (name, key, values.dtype)
        assert np.array_equal(values, expected[key], equal_nan=values.dtype.kind == "f"), (name, key)


def arrays_of(group):
    """All arrays below a group of HDF5. The library of h5py is newer, and stricter, than that of VTK."""
    found = {}
    for key in group:
        item = group[key]
        found |= arrays_of(item) if isinstance(item, h5py.Group) else {item.name: item[()]}
    return found


def near(found, expected, tolerance, what):
    assert abs(found - expected) <= tolerance * abs(expected), f"{what}: {found}, expected {expected}"


info = load("info.json")
plain, packed = (read(vtkXMLUnstructuredGridReader(), name) for name in ("plain.vtu", "packed.vtu"))
assert plain.GetNumberOfPoints() == info["points"] and plain.GetNumberOfCells() == info["tetrahedra"]
for grid in (plain, packed):
    assert (vtk_to_numpy(grid.GetCellTypes()) == VTK_TETRA).all()
for get in (
    lambda grid: grid.GetPoints().GetData(),
    lambda grid: grid.GetCells().GetConnectivityArray(),
    lambda grid: grid.GetPointData().GetScalars() or grid.GetPointData().GetArray(0),
):
    assert np.array_equal(vtk_to_numpy(get(plain)), vtk_to_numpy(get(packed)))
assert os.path.getsize("packed.vtu") < os.path.getsize("plain.vtu") / 2
assert os.path.getsize("packed.vtkhdf") < os.path.getsize("plain.vtkhdf") / 2
with h5py.File("plain.vtkhdf") as one, h5py.File("packed.vtkhdf") as other, h5py.File("both.vtkhdf") as third:
    assert other["VTKHDF/Points"].compression == "gzip" and one["VTKHDF/Points"].compression is None
    one, other = arrays_of(one), arrays_of(other)
    assert len(one) == 9 and one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)
    assert len(arrays_of(third)) == 21 and third["comments"].asstr()[0] == "isovalue 400 1000.5"
for name, reader in (("plain", vtkXMLUnstructuredGridReader), ("packed", vtkXMLUnstructuredGridReader),
                     ("empty", vtkXMLUnstructuredGridReader), ("surface", vtkXMLPolyDataReader),
                     ("both", vtkXMLPolyDataReader), ("none", vtkXMLPolyDataReader)):
    xml = "vtu" if reader is vtkXMLUnstructuredGridReader else "vtp"
    expect_same(read(vtkHDFReader(), f"{name}.vtkhdf"), read(reader(), f"{name}.{xml}"), name)
size = vtkCellSizeFilter()
size.SetInputData(packed)
size.Update()
volumes = vtk_to_numpy(size.GetOutput().GetCellData().GetArray("Volume"))
assert (volumes > 0).all(), "a tetrahedron is turned inside out"
near(volumes.sum(), np.prod([n - 1.0 for n in info["dims"]]), 1e-6, "volume of the domain")
part = read(vtkXMLUnstructuredGridReader(), "range.vtu")
low, high = part.GetScalarRange()
assert part.GetNumberOfCells() == load("range.json")["tetrahedra"] > 0 and 900 <= low and high <= 1100

# VTK contours the tetrahedra as we do.
expected = load("surface.json")
contour = vtkContourGrid()
contour.SetInputData(packed)
contour.SetValue(0, 1000.5)
contour.Update()
whole = area(corners(contour.GetOutput()))
assert contour.GetOutput().GetNumberOfPolys() == expected["triangles"]
glb = vtkGLTFReader()
glb.SetFileName("surface.glb")
glb.Update()
blocks = glb.GetOutput().NewIterator()
surfaces = {
    "ply": read(vtkPLYReader(), "surface.ply"),
    "stl": read(vtkSTLReader(), "surface.stl"),
    "obj": read(vtkOBJReader(), "surface.obj"),
    "vtp": read(vtkXMLPolyDataReader(), "surface.vtp"),
    "vtkhdf": read(vtkHDFReader(), "surface.vtkhdf"),
    "glb": blocks.GetCurrentDataObject(),
}
for name, polys in surfaces.items():
    assert polys.GetNumberOfPolys() == expected["triangles"], name
    # glTF's metres and axes are another frame, of the same scale.
    near(area(corners(polys)), whole, 1e-5, f"area of surface.{name}")
    if name != "stl":
        assert polys.GetNumberOfPoints() == expected["vertices"], name
        normals = vtk_to_numpy(polys.GetPointData().GetNormals())
        near(np.linalg.norm(normals, axis=1).mean(), 1, 1e-3, f"normals of surface.{name}")
both = read(vtkXMLPolyDataReader(), "both.vtp")
assert both.GetNumberOfPolys() == load("both.json")["triangles"]
assert set(np.unique(vtk_to_numpy(both.GetPointData().GetArray("isovalue")))) == {400.0, 1000.5}

# VTK's own probe of the tetrahedra.
grid = read(vtkXMLImageDataReader(), "grid.vti")
values = vtk_to_numpy(grid.GetPointData().GetScalars() or grid.GetPointData().GetArray(0))
assert np.array_equal(values.reshape(32, 31, 30), np.load("grid.npy"))
probe = vtkProbeFilter()
probe.SetInputData(grid)
probe.SetSourceData(packed)
probe.Update()
inside = vtk_to_numpy(probe.GetOutput().GetPointData().GetArray("vtkValidPointMask")) == 1
name = packed.GetPointData().GetArray(0).GetName()
theirs = vtk_to_numpy(probe.GetOutput().GetPointData().GetArray(name))
# VTK may take a tetrahedron that a point is only near to, most on the domain's faces.
within = np.zeros((32, 31, 30), bool)
within[1:-1, 1:-1, 1:-1] = True
within &= inside.reshape(within.shape)
assert within.sum() > 0.99 * 30 * 29 * 28, within.sum()
apart = np.abs(theirs - values).reshape(within.shape)[within]
assert (apart < 0.01).mean() > 0.99 and apart.max() < 2, ((apart < 0.01).mean(), apart.max())

error = read(vtkXMLImageDataReader(), "error.vti").GetCellData()
rms, largest, samples = (vtk_to_numpy(error.GetArray(name)).astype(float) for name in ("rms", "max", "samples"))
expected = load("error.json")
assert samples.sum() == expected["samples"]
near(largest.max(), expected["max"], 1e-6, "largest error of the map")
near(np.sqrt((rms**2 * samples).sum() / samples.sum()), expected["rms"], 1e-6, "RMS error of the map")
print("tools/vtk/test: VTK reads tetrahedra, surfaces and grids, and finds in them what isospan tells")
