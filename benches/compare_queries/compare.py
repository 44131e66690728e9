#!/usr/bin/env python3
"""Asks isospan and VTK for the same isosurfaces, round by round, and prints medians and ratios.

    compare.py [--points 1000000] [--sets halton] [--isovalues 20] [--rounds 3] [--threads 1] [--edge 512] [--scratch FOLDER]

Two questions, of a smooth field (a sphere) and of a busy one (a gyroid of 12 periods):

* *mesh*: the tetrahedra of an archive of points, for one isovalue after another. VTK has the mesh in memory, and a scalar tree built
  (vtkSpanSpace), its best case. isospan is asked several ways: as a process that opens the archive, whose files are in the page cache, and writes a PLY
  file ("process"); as one that does so for all isovalues in one pass, a file each ("one pass", of which an isovalue's share is told); as a program
  that has the archive open and asks for surfaces in memory, with nothing kept from one to the next ("open archive") and with decoded blocks kept ("open
  archive, kept").
* *volume*: isospan from the pyramid of an EDGE^3 f32 volume, at an RMS error of 1 %: as a process, of levels 0 to 2; of an open archive, with nothing kept
  and with decoded nodes kept; vtkFlyingEdges3D on all samples in memory.

Ratios are of CPU time, which a busy machine disturbs less; with one thread that is the time on a quiet one. The oracle of active tetrahedra is brute
force over all of them, in numpy. The mesh goes from the archive to VTK by `isospan export`.

Needs cargo, or the built programs (--programs), and Python with numpy and vtk: where they are missing, a virtual environment is made in
target/compare_queries and vtk is installed there from PyPI.
"""
import argparse
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = pathlib.Path(subprocess.check_output([ROOT / "tools/target_folder"], text=True).strip())
FIELDS = {"smooth": (["sphere"], (-0.12, 0.2)), "busy": (["gyroid", "--periods", "12"], (-0.9, 0.9))}

try:
    import numpy
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
except ImportError:
    folder = TARGET / "compare_queries"
    python = folder / "bin/python"
    if pathlib.Path(sys.prefix) == folder:
        raise
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "vtk", "numpy"], check=True)
    os.execv(python, [python, __file__, *sys.argv[1:]])


def settings():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000, help="points of the mesh; 0 leaves that question out")
    parser.add_argument("--sets", nargs="+", default=["halton"], choices=["halton", "hammersley", "hyperbolic-cross", "regular"], help="their sets")
    parser.add_argument("--isovalues", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--edge", type=int, default=512, help="samples along an axis of the volume; 0 leaves that question out")
    parser.add_argument("--fields", nargs="+", choices=FIELDS, default=list(FIELDS))
    parser.add_argument("--scratch", type=pathlib.Path, help="folder for some GB of volumes and meshes")
    parser.add_argument("--programs", type=pathlib.Path, help="folder with isospan, ask_archive and make_volume, built already")
    return parser.parse_args()


def run(*command):
    """Wall and CPU seconds of a program."""
    start = time.perf_counter()
    process = subprocess.Popen([str(c) for c in command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, command)
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime


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
    """Label -> filter."""
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
    return filters


def ask_vtk(contour, isovalue):
    contour.SetValue(0, isovalue)
    start = time.perf_counter(), time.process_time()
    contour.Update()
    took = time.perf_counter() - start[0], time.process_time() - start[1]
    return took, contour.GetOutput().GetNumberOfPolys()


def brute_force(values, tets, isovalue):
    inside = (values >= numpy.float32(isovalue)).astype(numpy.int8)[tets].sum(axis=1)
    return int(((inside > 0) & (inside < 4)).sum())


class Table:
    """What each label took and found, question by question."""

    def __init__(self):
        self.rows = {}

    def add(self, label, seconds, triangles):
        self.rows.setdefault(label, []).append((*seconds, triangles))

    def print(self, title, best_of):
        """Ratios are to the best of the labels that `best_of` accepts."""
        medians = {label: [statistics.median(column) for column in zip(*rows)] for label, rows in self.rows.items()}
        best = min(median[1] for label, median in medians.items() if best_of(label))
        print(f"\n{title}\n{'':42} {'ms':>8} {'CPU ms':>8} {'times faster':>13} {'triangles':>10}")
        for label, (wall, cpu, triangles) in medians.items():
            print(f"{label:42} {1e3 * wall:8.1f} {1e3 * cpu:8.1f} {best / cpu:13.2f} {triangles:10.0f}", flush=True)


def count_ply(path):
    with open(path, "rb") as file:
        return next(int(line.split()[2]) for line in file if line.startswith(b"element face"))


def ask_process(programs, archive, isovalue, threads, out, *level):
    ask = (programs / "isospan", "surface", archive, f"--isovalue={isovalue!r}", *level, "-o", out)
    seconds = run(*ask, "--force", "--threads", threads, "-q")
    return seconds, count_ply(out)


def ask_in_one_pass(programs, archive, isovalues, threads, out):
    """An isovalue's share: seconds and triangles."""
    n, listed = len(isovalues), ",".join(repr(v) for v in isovalues)
    seconds = run(programs / "isospan", "surface", archive, f"--isovalue={listed}", "-o", out.with_name("pass_{}.ply"), "--force", "--threads", threads, "-q")
    made = set(out.parent.glob("pass_*.ply"))
    triangles = sum(count_ply(path) for path in made)
    for path in made:
        path.unlink()
    return tuple(s / n for s in seconds), triangles / n


def ask_open(programs, archive, isovalues, threads, rounds, kept):
    """For each round a list of seconds and triangles."""
    command = [programs / "ask_archive", archive, threads, rounds, kept, *(repr(v) for v in isovalues)]
    lines = subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True).stdout.split("\n")
    answers = [[] for _ in range(rounds)]
    for number, _, wall, cpu, triangles in (line.split() for line in lines if line):
        answers[int(number)].append(((float(wall), float(cpu)), int(triangles)))
    return answers


def ask_kept(programs, archive, isovalues, threads, mib):
    """Seconds and triangles for each isovalue, of an archive that keeps what it has decoded: a first pass over the isovalues reads, the second is told."""
    return ask_open(programs, archive, 2 * isovalues, threads, 1, mib)[0][len(isovalues) :]


def mesh_question(args, programs, work, field, points):
    (make, (low, high)) = FIELDS[field]
    volume, archive, mesh, out = (work / name for name in ("mesh.nrrd", "mesh.isospan", "mesh.vtu", "out.ply"))
    run(programs / "make_volume", *make, "--dims", "256,256,256", "-o", volume)
    run(programs / "isospan", "-q", "reduce", volume, "-o", archive, "--points", points, "--count", args.points)
    volume.unlink()
    run(programs / "isospan", "-q", "export", archive, "-o", mesh)
    grid = read(vtk.vtkXMLUnstructuredGridReader(), mesh)
    mesh.unlink()
    array = grid.GetPointData().GetArray(0)
    grid.GetPointData().SetActiveScalars(array.GetName())
    tets = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, 4)
    filters = vtk_filters(grid, array.GetName())
    isovalues = [float(numpy.float32(v)) for v in numpy.linspace(low, high, args.isovalues)]
    table = Table()
    for _ in range(args.rounds):
        for v in isovalues:
            table.add("isospan, process", *ask_process(programs, archive, v, args.threads, out))
        table.add("isospan, one pass", *ask_in_one_pass(programs, archive, isovalues, args.threads, out))
        for answer in ask_open(programs, archive, isovalues, args.threads, 1, 0)[0]:
            table.add("isospan, open archive", *answer)
        for answer in ask_kept(programs, archive, isovalues, args.threads, 4096):
            table.add("isospan, open archive, kept", *answer)
        for label, contour in filters.items():
            for v in isovalues:
                table.add(label, *ask_vtk(contour, v))
    print(f"\n{grid.GetNumberOfPoints()} points, {len(tets)} tetrahedra; active ones by brute force, and by isospan:")
    for v in isovalues[:: max(1, len(isovalues) // 4)]:
        command = [programs / "isospan", "count", archive, f"--isovalue={v!r}", "--json"]
        said = subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True)
        print(f"  {v:10.4f} {brute_force(vtk_to_numpy(array), tets, v):10} {' '.join(said.stdout.split())[:110]}")
    table.print(f"mesh of {points} points, {field} field, {args.threads} threads, medians over isovalues and rounds", lambda label: label.startswith("vtk"))


def volume_question(args, programs, work, field):
    (make, (low, high)) = FIELDS[field]
    volume, archive, out = (work / name for name in ("volume.nrrd", "volume.isospan", "out.ply"))
    run(programs / "make_volume", *make, "--dims", f"{args.edge},{args.edge},{args.edge}", "-o", volume)
    run(programs / "isospan", "-q", "reduce", volume, "-o", archive)
    image = read(vtk.vtkNrrdReader(), volume)
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.ComputeScalarsOff()
    isovalues = [float(numpy.float32(v)) for v in numpy.linspace(low, high, 5)]
    table = Table()
    for _ in range(args.rounds):
        for v in isovalues:
            for level in (0, 1, 2):
                answer = ask_process(programs, archive, v, args.threads, out, "--level", level)
                table.add(f"isospan, process, level {level}", *answer)
            table.add("vtkFlyingEdges3D", *ask_vtk(edges, v))
        for answer in ask_open(programs, archive, isovalues, args.threads, 1, 0)[0]:
            table.add("isospan, open archive", *answer)
        for answer in ask_kept(programs, archive, isovalues, args.threads, 16384):
            table.add("isospan, open archive, kept", *answer)
    table.print(f"volume of {args.edge}^3, {field} field, {args.threads} threads, medians", lambda label: label.startswith("vtk"))


def build():
    """The folder of the programs."""
    examples = ["--bin", "make_volume", "--bin", "ask_archive"]
    subprocess.run(["cargo", "build", "--release", "--quiet", "--bin", "isospan", *examples], cwd=ROOT, check=True)
    folder = pathlib.Path(tempfile.mkdtemp(prefix="compare_queries"))
    for path in ("isospan", "make_volume", "ask_archive"):
        (folder / pathlib.Path(path).name).symlink_to(TARGET / "release" / path)
    return folder


def main():
    args = settings()
    programs = args.programs.resolve() if args.programs else build()
    if args.scratch:
        args.scratch.mkdir(parents=True, exist_ok=True)
    vtk.vtkSMPTools.Initialize(args.threads)
    for field in args.fields:
        questions = [(mesh_question, points) for points in args.sets if args.points] + [(volume_question,)] * bool(args.edge)
        for question, *of in questions:
            with tempfile.TemporaryDirectory(dir=args.scratch) as work:
                question(args, programs, pathlib.Path(work), field, *of)


if __name__ == "__main__":
    main()
