"""HXT (through the PyPI package gmsh) on the points of a file: hxt.py FILE REPEAT THREADS

Prints a line a repetition: points, tetrahedra, wall seconds, CPU seconds (of all threads).
"""
import sys
import time

import gmsh
import numpy

file, repeat, threads = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
coordinates = numpy.fromfile(file, dtype="<f8")
gmsh.initialize()
for option, value in [
    ("General.Verbosity", 0),
    ("General.NumThreads", threads),
    ("Mesh.MaxNumThreads3D", threads),
    ("Mesh.Algorithm3D", 10),
]:
    gmsh.option.setNumber(option, value)
for _ in range(repeat):
    cpu, start = time.process_time(), time.perf_counter()
    tets = len(gmsh.algorithm.tetrahedralize(coordinates)[0]) // 4
    wall = time.perf_counter() - start
    print(len(coordinates) // 3, tets, f"{wall:.4f} {time.process_time() - cpu:.4f}", flush=True)
