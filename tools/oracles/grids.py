"""Images and grids by VTK and PyEVTK."""

import numpy as np
import pyevtk.hl
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkImageData, vtkRectilinearGrid, vtkStructuredGrid
from vtkmodules.vtkIOHDF import vtkHDFWriter
from vtkmodules.vtkIOImage import vtkMetaImageWriter, vtkNIFTIImageWriter, vtkTIFFWriter
from vtkmodules.vtkIOLegacy import vtkDataSetReader, vtkDataSetWriter
from vtkmodules.vtkIOMINC import vtkMINCImageWriter
from vtkmodules.vtkIOParallelXML import vtkXMLPImageDataWriter
from vtkmodules.vtkIOXML import (
    vtkXMLImageDataWriter,
    vtkXMLRectilinearGridWriter,
    vtkXMLStructuredGridWriter,
)

from placing import SHAPE, Case, Refused, affine, along, grid, numbers, program, rotation

TYPES = "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8"
SPACING, ORIGIN = (0.5, 1.25, 2.5), (-3.5, 10, 7)
UNEVEN = np.array([0, 0.5, 1.5, 3, 5, 7.5, 10.5]), 10 + 1.25 * np.arange(6), 7 + 2.5 * np.arange(5)


def give(data, values, in_cells=False, name="v"):
    array = numpy_to_vtk(np.ascontiguousarray(values).ravel(), deep=True)
    array.SetName(name)
    (data.GetCellData() if in_cells else data.GetPointData()).SetScalars(array)
    return data


def image(values, turn=None, first=(0, 0, 0), in_cells=False):
    """An image, and the places of its values [z, y, x]."""
    picture = vtkImageData()
    more = int(in_cells)
    ends = [n + f - 1 + more for n, f in zip(reversed(values.shape), first)]
    picture.SetExtent(*(v for pair in zip(first, ends) for v in pair))
    picture.SetSpacing(SPACING)
    picture.SetOrigin(ORIGIN)
    if turn is not None:
        picture.SetDirectionMatrix(*turn.ravel())
    give(picture, values, in_cells)
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if turn is None else turn) @ np.diag(SPACING)
    matrix[:3, 3] = matrix[:3, :3] @ (np.array(first) + 0.5 * more) + ORIGIN
    return picture, affine(matrix[:, [2, 1, 0, 3]], values.shape)


def as_read(path, in_cells=False):
    """The values that VTK finds in a text, in which it writes six digits."""
    reader = vtkDataSetReader()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    array = (data.GetCellData() if in_cells else data.GetPointData()).GetScalars()
    return vtk_to_numpy(array).reshape(SHAPE)


def write(writer, data, path, **settings):
    writer.SetInputData(data)
    writer.SetFileName(str(path))
    for name, value in settings.items():
        getattr(writer, name)(value) if value is not None else getattr(writer, name)()
    assert writer.Write() == 1 or writer.GetErrorCode() == 0, path
    return path


XML = [
    {"SetDataModeToAscii": None}, {"SetDataModeToBinary": None}, {"SetDataModeToAppended": None, "SetEncodeAppendedData": 0},
    {"SetDataModeToAppended": None, "SetEncodeAppendedData": 1},
]  # fmt: skip
PACKERS = {"SetCompressorTypeToNone": None}, {"SetCompressorTypeToZLib": None}, {"SetCompressorTypeToLZ4": None}


@program("vtk")
def vtk_images(at):
    turn = rotation(20, -35, 50)
    for n, dtype in enumerate(TYPES):
        for m, mode in enumerate(XML):
            packer = PACKERS[(n + m) % 3]
            order = {
                "SetByteOrder": (n + m // 2) % 2,
                "SetHeaderTypeToUInt32" if n % 2 else "SetHeaderTypeToUInt64": None,
            }
            first, in_cells = ((0, 0, 0), (-3, 4, 20))[m % 2], (n + m) % 5 == 0
            picture, places = image(numbers(dtype), turn if n % 2 else None, first, in_cells)
            path = write(vtkXMLImageDataWriter(), picture, at / f"{dtype}_{m}.vti", **mode, **packer, **order)
            yield Case(path, numbers(dtype), places)
        for m, mode in enumerate(("SetFileTypeToASCII", "SetFileTypeToBinary")):
            picture, places = image(numbers(dtype), in_cells=(n + m) % 3 == 0)
            path = write(vtkDataSetWriter(), picture, at / f"{dtype}_{m}.vtk", **{mode: None})
            yield Case(path, as_read(path, (n + m) % 3 == 0), places)
    picture, _ = image(numbers("f4"))
    write(vtkXMLImageDataWriter(), picture, at / "lzma.vti", SetCompressorTypeToLZMA=None)
    yield Refused(at / "lzma.vti", "LZMA")
    # The writer loses a direction.
    picture, places = image(numbers("f4"), None, (2, 0, -1))
    write(vtkXMLPImageDataWriter(), picture, at / "pieces.pvti", SetNumberOfPieces=3, SetEndPiece=2)
    yield Case(at / "pieces.pvti", numbers("f4"), places)
    picture, places = image(numbers("f4"), turn, (2, 0, -1))
    write(vtkHDFWriter(), picture, at / "a.vtkhdf")
    yield Case(at / "a.vtkhdf", numbers("f4"), places)


@program("vtk")
def vtk_pictures(at):
    picture, places = image(numbers("i2"))
    write(vtkMetaImageWriter(), picture, at / "a.mha")
    yield Case(at / "a.mha", numbers("i2"), places)
    writer = vtkNIFTIImageWriter()
    write(writer, picture, at / "a.nii")
    yield Case(at / "a.nii", numbers("i2"), places)
    write(vtkTIFFWriter(), image(numbers("u2"))[0], at / "a.tif")
    yield Case(at / "a.tif", numbers("u2"), grid())
    write(vtkMINCImageWriter(), picture, at / "a.mnc")
    # It writes no image-min; nibabel does not read that either.
    yield Refused(at / "a.mnc", "image-min")


@program("vtk")
def vtk_grids(at):
    for n, dtype in enumerate(("u1", "i2", "f4", "f8")):
        values = numbers(dtype)
        straight, bent = vtkRectilinearGrid(), vtkStructuredGrid()
        straight.SetDimensions(7, 6, 5)
        for set_axis, axis in zip(
            (straight.SetXCoordinates, straight.SetYCoordinates, straight.SetZCoordinates), UNEVEN
        ):
            set_axis(numpy_to_vtk(axis, deep=True))
        places = along(*UNEVEN)
        give(straight, values)
        for m, mode in enumerate(XML):
            path = write(
                vtkXMLRectilinearGridWriter(), straight, at / f"{dtype}_{m}.vtr", **mode, **PACKERS[(n + m) % 3]
            )
            yield Case(path, values, places)
        x, y, z = np.moveaxis(places, -1, 0)
        places = np.stack([x + 0.1 * y, y + 0.02 * x * (z - 10), z + 0.05 * x], -1)
        points = vtkPoints()
        points.SetData(numpy_to_vtk(places.reshape(-1, 3), deep=True))
        bent.SetDimensions(7, 6, 5)
        bent.SetPoints(points)
        give(bent, values)
        for m, mode in enumerate(XML):
            path = write(vtkXMLStructuredGridWriter(), bent, at / f"{dtype}_{m}.vts", **mode, **PACKERS[(n + m) % 3])
            yield Case(path, values, places)
        for name, one, where in ("straight", straight, along(*UNEVEN)), ("bent", bent, places):
            for m, mode in enumerate(("SetFileTypeToASCII", "SetFileTypeToBinary")):
                path = write(vtkDataSetWriter(), one, at / f"{name}_{dtype}_{m}.vtk", **{mode: None})
                yield Case(path, as_read(path), where)
    cells = numbers("f4", (4, 5, 6))
    straight.GetPointData().Initialize()
    write(vtkXMLRectilinearGridWriter(), give(straight, cells, in_cells=True), at / "cells.vtr")
    yield Case(at / "cells.vtr", cells, along(*((axis[1:] + axis[:-1]) / 2 for axis in UNEVEN)))
    vectors = numpy_to_vtk(np.zeros((210, 3)), deep=True)
    vectors.SetName("u")
    picture = vtkImageData()
    picture.SetDimensions(7, 6, 5)
    picture.GetPointData().SetVectors(vectors)
    write(vtkXMLImageDataWriter(), picture, at / "vectors.vti")
    yield Refused(at / "vectors.vti", "vector|component|numbers")


@program("pyevtk")
def evtk(at):
    for n, dtype in enumerate(("u1", "i2", "i4", "i8", "f4", "f8")):
        values = numbers(dtype)
        # Its arrays have x first.
        turned = np.asfortranarray(values.T) if n % 2 else np.ascontiguousarray(values.T)
        pyevtk.hl.imageToVTK(str(at / dtype), ORIGIN, SPACING, pointData={"v": turned})
        yield Case(at / f"{dtype}.vti", values, grid(SPACING, ORIGIN))
        middle = [o + s / 2 for o, s in zip(ORIGIN, SPACING)]
        pyevtk.hl.imageToVTK(str(at / f"{dtype}_cells"), ORIGIN, SPACING, cellData={"v": turned})
        yield Case(at / f"{dtype}_cells.vti", values, grid(SPACING, middle))
        pyevtk.hl.gridToVTK(str(at / dtype), *UNEVEN, pointData={"v": turned})
        yield Case(at / f"{dtype}.vtr", values, along(*UNEVEN))
        places = along(*UNEVEN)
        places[..., 0] += 0.1 * places[..., 1]
        arrays = [np.ascontiguousarray(places[..., axis].T) for axis in range(3)]
        pyevtk.hl.gridToVTK(str(at / f"{dtype}_bent"), *arrays, pointData={"v": turned})
        yield Case(at / f"{dtype}_bent.vts", values, places)
