#!/usr/bin/env python3
"""Locates points in tetrahedral meshes and interpolates, by isospan and by VTK, round by round on one thread; prints medians of CPU seconds.

    compare.py MESH:FIELD... [--points 100000] [--rounds 5] [--program PATH]

* *grid*: isospan's default, a grid over the points past which the cells stream; nothing is built for the cells.
* *kd-tree*: the thesis's search over the cells' bounding boxes; building and answers.
* *VTK*: vtkProbeFilter with vtkStaticCellLocator, whose building is part of its update, as it is for each new mesh.

Points are uniform in the bounding box of the mesh. Needs cargo, and a Python with numpy and vtk (PyPI).
"""
import argparse
import pathlib
import statistics
import subprocess
import tempfile
import time

import numpy
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

ROOT = pathlib.Path(__file__).resolve().parents[2]


def read(path):
    reader = vtk.vtkXMLUnstructuredGridReader() if path.endswith(".vtu") else vtk.vtkUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    return reader.GetOutput()


def probe(grid, points, field):
    """Seconds and values of VTK."""
    cloud = vtk.vtkPolyData()
    coordinates = vtk.vtkPoints()
    coordinates.SetData(numpy_to_vtk(points, deep=1))
    cloud.SetPoints(coordinates)
    copy = vtk.vtkUnstructuredGrid()
    copy.ShallowCopy(grid)
    probe = vtk.vtkProbeFilter()
    probe.SetCellLocator(vtk.vtkStaticCellLocator())
    probe.SetInputData(cloud)
    probe.SetSourceData(copy)
    start = time.process_time()
    probe.Update()
    seconds = time.process_time() - start
    data = probe.GetOutput().GetPointData()
    values = vtk_to_numpy(data.GetArray(field)).astype(float)
    return seconds, numpy.where(vtk_to_numpy(data.GetArray("vtkValidPointMask")) > 0, values, numpy.nan)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", metavar="MESH:FIELD")
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--program", help="a locate_points to ask instead of the one that is built here")
    args = parser.parse_args()
    vtk.vtkSMPTools.Initialize(1)
    program = args.program
    if program is None:
        subprocess.run(["cargo", "build", "-q", "--release", "--bin", "locate_points"], cwd=ROOT, check=True)
        target = subprocess.check_output([ROOT / "tools/target_folder"], text=True).strip()
        program = pathlib.Path(target) / "release/locate_points"
    with tempfile.TemporaryDirectory() as scratch:
        for mesh in args.meshes:
            compare(program, *mesh.rsplit(":", 1), args, pathlib.Path(scratch))


def compare(program, path, field, args, scratch):
    grid = read(path)
    bounds = numpy.array(grid.GetBounds()).reshape(3, 2)
    points = numpy.random.default_rng(1).uniform(bounds[:, 0], bounds[:, 1], (args.points, 3))
    points.tofile(scratch / "points")
    rows = []
    for _ in range(args.rounds):
        out = subprocess.run([program, path, field, scratch / "points", scratch / "values", "1"], check=True, capture_output=True)
        seconds, values = probe(grid, points, field)
        rows.append([*map(float, out.stdout.split()), seconds])
    ours = numpy.fromfile(scratch / "values", "<f4").astype(float)
    both = ~numpy.isnan(ours) & ~numpy.isnan(values)
    ours_grid, build, answer, theirs = (statistics.median(column) for column in zip(*rows))
    print(f"{pathlib.Path(path).name}: {grid.GetNumberOfCells()} cells, {args.points} points, {both.sum()} found by both,"
          f" {(numpy.isnan(ours) != numpy.isnan(values)).sum()} by one; largest difference {abs(ours - values)[both].max():.3g}")
    print(f"  grid     {ours_grid * 1e3:8.1f} ms")
    if ours_grid == 0:
        raise SystemExit("compare.py: too few --points: they take less than the clock of CPU time tells")
    print(f"  kd-tree  {(build + answer) * 1e3:8.1f} ms  ({build * 1e3:.1f} to build, {answer * 1e3:.1f} to answer); {(build + answer) / ours_grid:.1f} x grid")
    print(f"  VTK      {theirs * 1e3:8.1f} ms; {theirs / ours_grid:.1f} x grid")


if __name__ == "__main__":
    main()
