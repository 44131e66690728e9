#!/usr/bin/env python3
"""A series in files: what a further step costs, in one reduce and appended, and an isovalue of every step against VTK.

usage: files.py [--isospan FILE] [--fraction 1/8] [--values fit|sample] [--threads 2] [--rounds 5] --isovalue V
                [--field PATTERN] [--first FIELD] INPUT...

INPUT are volumes, a file each step, or one file that has all steps: a 4-D NIfTI, or a VTU whose fields PATTERN matches. Of one file, --first
names the field of the first step. Steps are reduced together, and appended to an archive of the first one; then an isovalue of all is
extracted, and VTK reads and contours every step. Least CPU and wall times of some rounds, of the process and its threads. Needs vtk.
"""
import argparse, fnmatch, json, os, shutil, sys, tempfile, time

from vtkmodules.vtkFiltersCore import vtkContour3DLinearGrid, vtkFlyingEdges3D
from vtkmodules.vtkIOImage import vtkNIFTIImageReader
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLUnstructuredGridReader

from series import built, run


def triangles(filter, data, isovalue, array=None):
    """Of the surface of a volume, or of a mesh."""
    filter.SetInputData(data)
    filter.SetValue(0, isovalue)
    if array is not None:
        filter.SetInputArrayToProcess(0, 0, 0, *array)
    filter.Update()
    return filter.GetOutput().GetNumberOfPolys()


def contours(file, pattern, isovalue):
    """Triangles of all steps in a file."""
    if file.endswith(".vtu"):
        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(file)
        reader.Update()
        mesh = reader.GetOutput()
        names = [mesh.GetPointData().GetArrayName(i) for i in range(mesh.GetPointData().GetNumberOfArrays())]
        wanted = [n for n in names if fnmatch.fnmatch(n, pattern)]
        return [triangles(vtkContour3DLinearGrid(), mesh, isovalue, (0, n)) for n in wanted]
    if file.endswith(".vti"):
        reader = vtkXMLImageDataReader()
        reader.SetFileName(file)
        reader.Update()
        return [triangles(vtkFlyingEdges3D(), reader.GetOutput(), isovalue)]
    reader = vtkNIFTIImageReader()
    reader.SetFileName(file)
    reader.TimeAsVectorOn()
    reader.Update()
    volume = reader.GetOutput()
    made = []
    for frame in range(volume.GetNumberOfScalarComponents()):
        edges = vtkFlyingEdges3D()
        edges.SetArrayComponent(frame)
        made.append(triangles(edges, volume, isovalue))
    return made


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--isospan", help="the program [release of this tree]")
    p.add_argument("--fraction", default="1/8")
    p.add_argument("--values", choices=["fit", "sample"], default="fit")
    p.add_argument("--threads", default="2")
    p.add_argument("--rounds", type=int, default=5)
    p.add_argument("--isovalue", required=True)
    p.add_argument("--field", help="of a mesh: the pattern that the fields of the steps match")
    p.add_argument("--first", help="of one file: the field of the first step")
    p.add_argument("input", nargs="+")
    a = p.parse_args()
    a.isospan = a.isospan or built()
    folder = tempfile.mkdtemp()
    archive = os.path.join(folder, "series.isospan")
    common = ["--threads", a.threads, "--json", "-q"]
    fields = ["--field", a.field] if a.field else []
    first = [a.input[0], *(["--field", a.first] if a.first else [])]
    reduction = ["-o", archive, "--points", "hammersley", "--fraction", a.fraction, "--values", a.values, *common]
    # Times follow that of the first step, whatever the files tell.
    appended = [archive, *a.input, *fields, "--times", "1000000,1000001,...", *common]
    least = {}

    def lap(name, *command):
        wall, cpu, out = run(a.isospan, *command)
        before = least.get(name, (wall, cpu))
        least[name] = (min(before[0], wall), min(before[1], cpu))
        return out

    try:
        for _ in range(a.rounds):
            shutil.rmtree(archive, ignore_errors=True)
            lap("first", "reduce", *first, *reduction)
            lap("appended", "append", *appended)
            shutil.rmtree(archive)
            report = json.loads(lap("all", "reduce", *a.input, *fields, *reduction))
        steps = len(report["steps"])
        (wall, cpu), (all_wall, all_cpu), (more_wall, more_cpu) = (least[k] for k in ("first", "all", "appended"))
        further = [(all_wall - wall) / (steps - 1), (all_cpu - cpu) / (steps - 1)]
        print(f"{steps} steps, {report['points']} points: first step {1e3 * wall:.1f} ms, CPU {1e3 * cpu:.1f} ms")
        print(f"a further step: {1e3 * further[0]:.1f} ms, CPU {1e3 * further[1]:.1f} ms: 1/{cpu / further[1]:.1f} of the first")
        print(f"appended: {1e3 * more_wall / steps:.1f} ms, CPU {1e3 * more_cpu / steps:.1f} ms: 1/{cpu / (more_cpu / steps):.1f} of the first")
        print(f"steps a second: {1 / further[0]:.0f} in one reduce, {steps / more_wall:.0f} appended")
        sizes = [s["value_bytes"] + s["index_bytes"] for s in report["steps"]]
        print(f"bytes a step: {sum(sizes) / steps:.0f}, archive {report['archive_bytes']}")
        out = os.path.join(folder, "s_%04d.ply")
        for _ in range(a.rounds):
            text = lap("surface", "surface", archive, "-i", a.isovalue, "--all-steps", "-o", out, "--force", *common)
        made = sum(s["triangles"] for s in json.loads(text)["steps"])
        print(f"isovalue {a.isovalue} of all steps, to files: {least['surface'][0]:.3f} s, CPU {least['surface'][1]:.3f} s, {made} triangles")
        for _ in range(a.rounds):
            wall, cpu = time.perf_counter(), time.process_time()
            found = sum(sum(contours(f, a.field, float(a.isovalue))) for f in a.input)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            before = least.get("VTK", (wall, cpu))
            least["VTK"] = (min(before[0], wall), min(before[1], cpu))
        print(f"VTK reads and contours all: {least['VTK'][0]:.3f} s, CPU {least['VTK'][1]:.3f} s, {found} triangles, in memory")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    sys.exit(main())
