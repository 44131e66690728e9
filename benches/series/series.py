#!/usr/bin/env python3
"""A series of volumes: what a further step costs, and an isovalue of every step against VTK.

usage: series.py [--isospan FILE] [--steps 100] [--size 256] [--batch 10] [--fraction 1/8] [--values fit|sample]
                 [--threads 2] [--measure] [--folder FOLDER]

Steps are f32 volumes of waves that drift and grow, made a batch at a time, reduced (the first batch) or appended, contoured by VTK
(vtkFlyingEdges3D, read from the file by numpy's memory map; its surface is then written as binary PLY), and removed again: the disk holds one
batch. Needs numpy and vtk. Times are wall times, and CPU times of the process and its threads. isospan syncs each file that it writes, VTK
does not.
"""
import argparse, json, os, resource, shutil, subprocess, sys, tempfile, time

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D
from vtkmodules.vtkIOPLY import vtkPLYWriter


def field(size, t):
    """A drifting gyroid with a slow wave upon it, and a texture that stays."""
    x = np.linspace(0, 4 * np.pi, size, dtype=np.float32)
    s = 0.05 * t
    sx, cx = np.sin(x + s), np.cos(x + s)
    sy, cy = np.sin(x), np.cos(x)
    sz, cz = np.sin(x - s / 2), np.cos(x - s / 2)
    out = sx[None, None, :] * cy[None, :, None] + sy[None, :, None] * cz[:, None, None]
    out += sz[:, None, None] * cx[None, None, :]
    out *= 1 + 0.1 * np.sin(0.1 * t)
    texture = np.sin(37 * x)
    out += np.float32(0.02) * texture[None, None, :] * texture[None, :, None] * texture[:, None, None]
    return out


def cpu_of_children():
    r = resource.getrusage(resource.RUSAGE_CHILDREN)
    return r.ru_utime + r.ru_stime


def run(*command):
    """Wall and CPU seconds, and the result."""
    cpu, wall = cpu_of_children(), time.perf_counter()
    out = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    return time.perf_counter() - wall, cpu_of_children() - cpu, out


def contour(file, isovalue, out):
    """Reads a volume, contours it, writes the surface: (wall, CPU) seconds of each, triangles."""
    at = [(time.perf_counter(), time.process_time())]
    lap = lambda: at.append((time.perf_counter(), time.process_time()))
    values = np.load(file, mmap_mode="r")
    image = vtkImageData()
    image.SetDimensions(*values.shape[::-1])
    flat = np.ascontiguousarray(values).ravel()
    image.GetPointData().SetScalars(numpy_to_vtk(flat))
    lap()
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, isovalue)
    edges.ComputeNormalsOn()
    edges.Update()
    lap()
    writer = vtkPLYWriter()
    writer.SetInputConnection(edges.GetOutputPort())
    writer.SetFileName(out)
    writer.SetFileTypeToBinary()
    writer.Write()
    lap()
    os.remove(out)
    return *[(y[0] - x[0], y[1] - x[1]) for x, y in zip(at, at[1:])], edges.GetOutput().GetNumberOfPolys()


def built():
    """The program, where cargo builds its release."""
    tool = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "tools", "target_folder")
    return os.path.join(subprocess.check_output([tool], text=True).strip(), "release", "isospan")


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--isospan", help="the program [release of this tree]")
    p.add_argument("--steps", type=int, default=100)
    p.add_argument("--size", type=int, default=256)
    p.add_argument("--batch", type=int, default=10)
    p.add_argument("--fraction", default="1/8")
    p.add_argument("--values", choices=["fit", "sample"], default="sample")
    p.add_argument("--threads", default="2")
    p.add_argument("--isovalue", default="0.3")
    p.add_argument("--measure", action="store_true", help="measure each step against its samples")
    p.add_argument("--folder", help="where the volumes and the archive are [a temporary folder]")
    a = p.parse_args()
    a.isospan = a.isospan or built()
    folder = tempfile.mkdtemp(dir=a.folder)
    common = ["--threads", a.threads, "--json", "-q"] + ([] if a.measure else ["--no-measure"])
    reduction = ["--points", "hammersley", "--fraction", a.fraction, "--values", a.values, *common]
    archive, vtk = os.path.join(folder, "series.isospan"), []
    try:
        for first in range(0, a.steps, a.batch):
            files = []
            for t in range(first, min(first + a.batch, a.steps)):
                files.append(os.path.join(folder, f"v{t:04d}.npy"))
                np.save(files[-1], field(a.size, t))
            if first == 0:
                # What the first step costs alone.
                alone = os.path.join(folder, "alone.isospan")
                one = run(a.isospan, "reduce", files[0], "-o", alone, *reduction)
                shutil.rmtree(alone)
                some = run(a.isospan, "reduce", *files, "-o", archive, *reduction)
                further = [(x - y) / (len(files) - 1) for x, y in zip(some[:2], one[:2])]
                points = json.loads(one[2])["points"]
                print(f"{a.size}^3, {points} points: first step {one[0]:.2f} s, CPU {one[1]:.2f} s")
                print(f"a further step: {further[0]:.3f} s, CPU {further[1]:.3f} s: 1/{one[1] / further[1]:.1f} of the first")
                report = json.loads(some[2])
                print("stages of one:", json.loads(one[2])["seconds"])
                print("stages of", len(files), ":", report["seconds"])
            else:
                wall, cpu, out = run(a.isospan, "append", archive, *files, *common)
                if first == a.batch:
                    print(f"append of {len(files)}: {wall:.2f} s, CPU {cpu:.2f} s")
                report = json.loads(out)
            sizes = [(s["value_bytes"], s["index_bytes"]) for s in report["steps"]]
            print(f"steps {first} on: {[s[0] for s in sizes]} bytes of values, {sizes[0][1]} of index and spectrum")
            vtk += [contour(f, float(a.isovalue), os.path.join(folder, "vtk.ply")) for f in files]
            for f in files:
                os.remove(f)
        out = os.path.join(folder, "s_%04d.ply")
        wall, cpu, text = run(
            a.isospan, "surface", archive, "-i", a.isovalue, "--all-steps", "-o", out, "--threads", "1", "--json", "-q", "--force"
        )
        of_steps = json.loads(text)["steps"]
        triangles = sum(s["triangles"] for s in of_steps)
        written = sum(s["seconds"].get("write", 0.0) for s in of_steps)
        parts = [[sum(v[part][clock] for v in vtk) for clock in (0, 1)] for part in (0, 1, 2)]
        (read, read_cpu), (made, made_cpu), (wrote, wrote_cpu) = parts
        print(f"isovalue {a.isovalue} of all {a.steps} steps, to files: {wall:.2f} s (writing {written:.2f} s), CPU {cpu:.2f} s, {triangles} triangles")
        print(
            f"VTK reads {read:.2f} s and contours {made:.2f} s, CPU {read_cpu + made_cpu:.2f} s, {sum(v[3] for v in vtk)} triangles, in memory; "
            f"writes them {wrote:.2f} s, CPU {wrote_cpu:.2f} s"
        )
        print("archive:", sum(os.path.getsize(os.path.join(d, f)) for d, _, fs in os.walk(archive) for f in fs), "bytes")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    sys.exit(main())
