#!/usr/bin/env python3
"""How long VTK takes for the surfaces of the thesis's data sets, from all samples in memory, on one thread: a CSV line for each, with its name, milliseconds
(the median of 15 runs) and triangles. Grids are contoured by vtkFlyingEdges3D, meshes by vtkContour3DLinearGrid.

    vtk_times.py PROGRAM      PROGRAM is the built example thesis_data, which makes the data
"""
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import time

import vtk

RUNS = 15


def filter_of(path):
    """The filter that contours a file, whose data are read."""
    is_grid = path.suffix == ".vti"
    reader = vtk.vtkXMLImageDataReader() if is_grid else vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    data.GetPointData().SetActiveScalars(data.GetPointData().GetArrayName(0))
    contour = vtk.vtkFlyingEdges3D() if is_grid else vtk.vtkContour3DLinearGrid()
    contour.SetInputData(data)
    if is_grid:
        contour.ComputeScalarsOff()
    else:
        contour.ComputeScalarsOff()
        contour.InterpolateAttributesOff()
        contour.SetInputArrayToProcess(0, 0, 0, 0, data.GetPointData().GetArrayName(0))
    return contour


def main():
    vtk.vtkSMPTools.Initialize(1)
    with tempfile.TemporaryDirectory() as folder:
        said = subprocess.run([sys.argv[1], folder], check=True, capture_output=True, text=True).stderr
        for name, path, isovalue in re.findall(r"^(\w+): (.*?): .*; isovalue ([-+.\de]+);", said, re.M):
            contour, seconds = filter_of(pathlib.Path(path)), []
            contour.SetValue(0, float(isovalue))
            for _ in range(RUNS):
                contour.Modified()
                start = time.perf_counter()
                contour.Update()
                seconds.append(time.perf_counter() - start)
            triangles = contour.GetOutput().GetNumberOfPolys()
            print(f"{name},{1e3 * statistics.median(seconds):.4f},{triangles}", flush=True)


if __name__ == "__main__":
    main()
