"""VTK's marching cubes of the samples, and its nearest points, find how wrong a surface is: what
`isospan reduce --isovalue` says at its end.

Usage: distances.py VOLUME.npy ISOVALUE SURFACE.ply REPORT.json, of a volume whose spacing is 1."""

import json
import sys

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy


def of_samples(path, isovalue):
    """Marching cubes of an array that is indexed [z, y, x]."""
    samples = np.load(path)
    image = vtk.vtkImageData()
    image.SetDimensions(*samples.shape[::-1])
    values = numpy_to_vtk(np.ascontiguousarray(samples, dtype=np.float32).ravel(), deep=True)
    image.GetPointData().SetScalars(values)
    cubes = vtk.vtkMarchingCubes()
    cubes.SetInputData(image)
    cubes.SetValue(0, isovalue)
    cubes.ComputeNormalsOff()
    cubes.Update()
    return cubes.GetOutput()


def of_file(path):
    reader = vtk.vtkPLYReader()
    reader.SetFileName(path)
    reader.Update()
    return reader.GetOutput()


def parts(surface):
    points = vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64)
    triangles = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return points, triangles, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def pieces(surface):
    found = vtk.vtkPolyDataConnectivityFilter()
    found.SetInputData(surface)
    found.SetExtractionModeToAllRegions()
    found.Update()
    return found.GetNumberOfExtractedRegions()


def distances(surface, other):
    """Mean, RMS, 95 % and 99 % by area, and the largest, of the vertices from another surface."""
    locator = vtk.vtkStaticCellLocator()
    locator.SetDataSet(other)
    locator.BuildLocator()
    points, triangles, areas = parts(surface)
    found = np.empty(len(points))
    nearest, cell, part, square = [0.0] * 3, vtk.reference(0), vtk.reference(0), vtk.reference(0.0)
    for n, point in enumerate(points):
        locator.FindClosestPoint(point, nearest, cell, part, square)
        found[n] = float(square) ** 0.5
    at = found[triangles]
    weights = np.repeat(areas / 3, 3)
    order = np.argsort(at.ravel())
    sums = np.cumsum(weights[order])
    within = lambda part: at.ravel()[order][np.searchsorted(sums, part * sums[-1])]
    mean = (at.mean(axis=1) * areas).sum() / areas.sum()
    rms = ((at**2).mean(axis=1) * areas).sum() / areas.sum()
    return dict(mean=mean, rms=rms**0.5, p95=within(0.95), p99=within(0.99), max=at.max())


def main(volume, isovalue, surface, report):
    told = json.load(open(report))["surfaces"][0]
    samples, archive = of_samples(volume, float(isovalue)), of_file(surface)
    for name, found in (("source", samples), ("archive", archive)):
        _, triangles, areas = parts(found)
        print(name, f"area {areas.sum():.6g} of {told[name]['area']:.6g},", pieces(found), "pieces")
        assert abs(areas.sum() / told[name]["area"] - 1) < 1e-3
    assert pieces(archive) == told["archive"]["pieces"]
    for name, ours in (("to_source", (archive, samples)), ("to_archive", (samples, archive))):
        found = distances(*ours)
        print(name, *(f"{key} {value:.5g} ({told[name][key]:.5g})" for key, value in found.items()))
        for key, value in found.items():
            # Cubes with two ways through them may be cut in other ones.
            assert abs(told[name][key] - value) <= 0.02 * value + 1e-4 or key == "max", key


main(*sys.argv[1:])
