#!/usr/bin/env python3
"""Writes tests/data/pieces, small PVTI, PVTR and PVTS files of VTK for the tests of src/io/formats/vtk/xml.

Needs vtk and numpy. The sample of (x, y, z) is x + 10 y + 100 z, that of a cell half of it.
Usage: tools/make_golden_pieces.py
"""
from pathlib import Path

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk
from vtk.util.vtkAlgorithm import VTKPythonAlgorithmBase

OUT = Path(__file__).resolve().parent.parent / "tests" / "data" / "pieces"
# Inclusive bounds: 9 x 8 x 7 points, the first of them at (2, 0, -1).
EXTENT = (2, 10, 0, 7, -1, 5)


def values(extent):
    x0, x1, y0, y1, z0, z1 = extent
    z, y, x = np.mgrid[0 : z1 - z0, 0 : y1 - y0, 0 : x1 - x0]
    return (x + 10 * y + 100 * z).astype("f4").ravel()


def with_fields(grid):
    x0, x1, y0, y1, z0, z1 = EXTENT
    for data, bounds, name, by in (
        (grid.GetPointData(), (x0, x1 + 1, y0, y1 + 1, z0, z1 + 1), "heat", 1),
        (grid.GetCellData(), EXTENT, "mass", 0.5),
    ):
        array = numpy_to_vtk(by * values(bounds), deep=True)
        array.SetName(name)
        data.SetScalars(array)
    return grid


def image():
    grid = vtk.vtkImageData()
    grid.SetExtent(EXTENT)
    grid.SetOrigin(10, 20, 30)
    grid.SetSpacing(0.5, 0.25, 2)
    return with_fields(grid)


def rectilinear():
    grid = vtk.vtkRectilinearGrid()
    grid.SetExtent(EXTENT)
    for axis, table in enumerate((np.arange(9.0) ** 2, np.arange(8.0), 3 - np.arange(7.0) ** 3)):
        (grid.SetXCoordinates, grid.SetYCoordinates, grid.SetZCoordinates)[axis](numpy_to_vtk(table, deep=True))
    return with_fields(grid)


def curvilinear():
    grid = vtk.vtkStructuredGrid()
    grid.SetExtent(EXTENT)
    z, y, x = np.mgrid[0:7, 0:8, 0:9].astype("f4")
    places = np.stack([x + 0.1 * y, y + 0.1 * z, z + 0.1 * x], axis=-1).reshape(-1, 3)
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(places, deep=True))
    grid.SetPoints(points)
    return with_fields(grid)


class Source(VTKPythonAlgorithmBase):
    """Gives the part of a grid that a writer asks for."""

    def __init__(self, grid):
        super().__init__(nInputPorts=0, nOutputPorts=1, outputType=grid.GetClassName())
        self.grid = grid

    def RequestInformation(self, request, inputs, outputs):
        info = outputs.GetInformationObject(0)
        info.Set(vtk.vtkStreamingDemandDrivenPipeline.WHOLE_EXTENT(), EXTENT, 6)
        info.Set(vtk.vtkAlgorithm.CAN_PRODUCE_SUB_EXTENT(), 1)
        if isinstance(self.grid, vtk.vtkImageData):
            info.Set(vtk.vtkDataObject.ORIGIN(), self.grid.GetOrigin(), 3)
            info.Set(vtk.vtkDataObject.SPACING(), self.grid.GetSpacing(), 3)
        return 1

    def RequestData(self, request, inputs, outputs):
        info = outputs.GetInformationObject(0)
        part = vtk.vtkDataObject.GetData(outputs)
        part.DeepCopy(self.grid)
        part.Crop([info.Get(vtk.vtkStreamingDemandDrivenPipeline.UPDATE_EXTENT(), i) for i in range(6)])
        return 1


def write(grid, writer, name, pieces, ghosts=0):
    source = Source(grid)
    writer.SetInputConnection(source.GetOutputPort())
    writer.SetFileName(str(OUT / name))
    writer.SetNumberOfPieces(pieces)
    writer.SetStartPiece(0)
    writer.SetEndPiece(pieces - 1)
    writer.SetGhostLevel(ghosts)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToZLib()
    assert writer.Write()


if __name__ == "__main__":
    OUT.mkdir(parents=True, exist_ok=True)
    write(image(), vtk.vtkXMLPImageDataWriter(), "image.pvti", 4)
    write(image(), vtk.vtkXMLPImageDataWriter(), "ghosts.pvti", 2, ghosts=1)
    write(rectilinear(), vtk.vtkXMLPRectilinearGridWriter(), "rectilinear.pvtr", 3)
    write(curvilinear(), vtk.vtkXMLPStructuredGridWriter(), "curvilinear.pvts", 3)
