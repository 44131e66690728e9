#!/usr/bin/env python3
"""Asks isospan and VTK for the same isosurfaces, round by round, and prints medians and ratios.

    compare.py [--points 1000000] [--isovalues 20] [--rounds 3] [--threads 1] [--edge 512] [--scratch FOLDER]

Two questions, of a smooth field (a sphere) and of a busy one (a gyroid of 12 periods):

* *mesh*: the tetrahedra of an archive of Halton points. isospan is a process that opens the archive, whose files are in the page cache, and
  writes a PLY file, for one isovalue, and for all in one pass; VTK has the mesh in memory, and a scalar tree built (vtkSpanSpace), its best case.
* *volume*: isospan from an archive with 1/8 of the samples of an EDGE^3 f32 volume, vtkFlyingEdges3D on the whole volume in memory.

The oracle of active tetrahedra is brute force over all of them, in numpy. Needs cargo, and a Python with numpy and vtk (PyPI). The mesh goes from
the archive to VTK by `isospan export`.
"""
import argparse
import pathlib
import statistics
import subprocess
import tempfile
import time

import numpy
import vtk
from vtk.util.numpy_support import vtk_to_numpy

ROOT = pathlib.Path(__file__).resolve().parents[2]
FIELDS = {"smooth": (["sphere"], (-0.12, 0.2)), "busy": (["gyroid", "--periods", "12"], (-0.9, 0.9))}


def settings():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--isovalues", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--edge", type=int, default=512, help="samples along an axis of the volume; 0 leaves that question out")
    parser.add_argument("--scratch", type=pathlib.Path, help="folder for some GB of volumes and meshes")
    parser.add_argument("--program", help="an isospan to ask instead of the one that is built here")
    return parser.parse_args()


def run(*command):
    start = time.perf_counter()
    subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def read(reader, path):
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def tree_of(grid):
    tree = vtk.vtkSpanSpace()
    tree.SetDataSet(grid)
    tree.BuildTree()
    return tree


def vtk_filters(grid, name):
    """Name -> a function of an isovalue that gives seconds and triangles."""
    filters = {}
    for kind in (vtk.vtkContour3DLinearGrid, vtk.vtkContourGrid):
        for with_tree in (False, True):
            contour = kind()
            contour.SetInputData(grid)
            contour.SetInputArrayToProcess(0, 0, 0, 0, name)
            for off in ("ComputeScalarsOff", "InterpolateAttributesOff"):
                getattr(contour, off, lambda: None)()
            if with_tree:
                contour.UseScalarTreeOn()
                contour.SetScalarTree(tree_of(grid))
            filters[kind.__name__ + (" + vtkSpanSpace" if with_tree else "")] = contour
    return {label: lambda v, f=f: timed(f, v) for label, f in filters.items()}


def timed(contour, isovalue):
    contour.SetValue(0, isovalue)
    start = time.perf_counter()
    contour.Update()
    output = contour.GetOutput()
    return time.perf_counter() - start, output.GetNumberOfPolys()


def brute_force(values, tets, isovalue):
    inside = (values >= numpy.float32(isovalue)).astype(numpy.int8)[tets].sum(axis=1)
    return int(((inside > 0) & (inside < 4)).sum())


def table(title, seconds, triangles):
    print(f"\n{title}\n{'':42} {'ms a query':>10} {'ratio':>7} {'triangles':>11}")
    ours = statistics.median(seconds["isospan"])
    for label, all_seconds in seconds.items():
        median = statistics.median(all_seconds)
        print(f"{label:42} {1e3 * median:10.1f} {median / ours:7.2f} {triangles[label] / len(all_seconds):11.0f}", flush=True)


def count_ply(path):
    with open(path, "rb") as file:
        return next(int(line.split()[2]) for line in file if line.startswith(b"element face"))


def mesh_question(args, program, make_volume, work, field):
    (make, (low, high)) = FIELDS[field]
    volume, archive, mesh, out = (work / name for name in ("mesh.nrrd", "mesh.isospan", "mesh.vtu", "out.ply"))
    run(make_volume, *make, "--dims", "256,256,256", "-o", volume)
    run(program, "-q", "reduce", volume, "-o", archive, "--points", "halton", "--count", args.points)
    run(program, "-q", "export", archive, "-o", mesh)
    grid = read(vtk.vtkXMLUnstructuredGridReader(), mesh)
    array = grid.GetPointData().GetArray(0)
    grid.GetPointData().SetActiveScalars(array.GetName())
    tets = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, 4)
    filters = vtk_filters(grid, array.GetName())
    isovalues = [float(numpy.float32(v)) for v in numpy.linspace(low, high, args.isovalues)]
    seconds, triangles = {"isospan": [], "isospan, all in one pass": []}, {"isospan": 0, "isospan, all in one pass": 0}
    common = ["--threads", args.threads, "-q"]
    for _ in range(args.rounds):
        for v in isovalues:
            seconds["isospan"].append(run(program, "surface", archive, f"--isovalue={v!r}", "-o", out, *common))
            triangles["isospan"] += count_ply(out)
            for label, ask in filters.items():
                took, found = ask(v)
                seconds.setdefault(label, []).append(took)
                triangles[label] = triangles.get(label, 0) + found
        every = "--isovalue=" + ",".join(map(repr, isovalues))
        one_pass = run(program, "surface", archive, every, "-o", out, *common)
        seconds["isospan, all in one pass"].append(one_pass / len(isovalues))
        triangles["isospan, all in one pass"] += count_ply(out) / len(isovalues)
    print(f"\n{grid.GetNumberOfPoints()} points, {len(tets)} tetrahedra; active ones by brute force, and by isospan:")
    for v in isovalues[:: max(1, len(isovalues) // 4)]:
        said = subprocess.run(
            [program, "count", str(archive), f"--isovalue={v!r}", "--json"], check=True, capture_output=True, text=True
        )
        print(f"  {v:10.4f} {brute_force(vtk_to_numpy(array), tets, v):10} {said.stdout.strip()[:110]}")
    table(f"mesh, {field} field, {args.threads} threads", seconds, triangles)


def volume_question(args, program, make_volume, work, field):
    (make, (low, high)) = FIELDS[field]
    volume, archive, out = (work / name for name in ("volume.nrrd", "volume.isospan", "out.ply"))
    run(make_volume, *make, "--dims", f"{args.edge},{args.edge},{args.edge}", "-o", volume)
    run(program, "-q", "reduce", volume, "-o", archive, "--fraction", "1/8")
    image = read(vtk.vtkNrrdReader(), volume)
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.ComputeScalarsOff()
    seconds, triangles = {"isospan": [], "vtkFlyingEdges3D": []}, {"isospan": 0, "vtkFlyingEdges3D": 0}
    for _ in range(args.rounds):
        for v in numpy.linspace(low, high, 5):
            ours = run(program, "surface", archive, f"--isovalue={v!r}", "-o", out, "--threads", args.threads, "-q")
            seconds["isospan"].append(ours)
            triangles["isospan"] += count_ply(out)
            took, found = timed(edges, float(v))
            seconds["vtkFlyingEdges3D"].append(took)
            triangles["vtkFlyingEdges3D"] += found
    table(f"volume of {args.edge}^3, {field} field, {args.threads} threads", seconds, triangles)


def main():
    args = settings()
    subprocess.run(["cargo", "build", "--release", "--quiet", "--example", "make_volume"], cwd=ROOT, check=True)
    if not args.program:
        subprocess.run(["cargo", "build", "--release", "--quiet"], cwd=ROOT, check=True)
    program = args.program or str(ROOT / "target/release/isospan")
    make_volume = ROOT / "target/release/examples/make_volume"
    vtk.vtkSMPTools.Initialize(args.threads)
    for field in FIELDS:
        with tempfile.TemporaryDirectory(dir=args.scratch) as work:
            mesh_question(args, program, make_volume, pathlib.Path(work), field)
        if args.edge:
            with tempfile.TemporaryDirectory(dir=args.scratch) as work:
                volume_question(args, program, make_volume, pathlib.Path(work), field)


if __name__ == "__main__":
    main()
