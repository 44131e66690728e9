#!/usr/bin/env python3
"""Writes tests/data/ensight, small EnSight Gold cases for the tests of src/io/formats/mesh/ensight.

Needs numpy and vtk, which writes one case and must read all of them.
The field heat of (x, y, z) is x + 10 y + 100 z + 1000 step.
Usage: tools/make_golden_ensight.py
"""
from pathlib import Path

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

OUT = Path(__file__).resolve().parent.parent / "tests" / "data" / "ensight"
POINTS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
    + [[2, 0, 0], [2, 0, 1]]
    + [[0.5, 0.5, 2], [0.5, 2, 0.5]],
    "f4",
)
# Each part: its number, its points, and its elements by type. The second part has its own copies of
# the points that it shares with the first.
PARTS = [
    (2, range(11), {"hexa8": [[0, 1, 2, 3, 4, 5, 6, 7]], "penta6": [[1, 8, 2, 5, 9, 6]]}),
    (5, [3, 2, 7, 11, 4, 5, 6, 10], {"tria3": [[0, 1, 2]], "tetra4": [[0, 1, 2, 3]], "pyramid5": [[4, 5, 6, 2, 7]]}),
]
TIMES = [0.5, 1.5, 4.0]


class Writer:
    def __init__(self, name, how):
        self.how, self.file = how, open(OUT / name, "wb")

    def text(self, line):
        self.file.write(f"{line}\n".encode() if self.how == "text" else line.encode().ljust(80, b"\0"))

    def numbers(self, numbers, a_line=1):
        numbers = np.asarray(numbers)
        is_float = numbers.dtype.kind == "f"
        if self.how == "text":
            for row in numbers.reshape(-1, a_line):
                self.file.write(("".join(f"{n:12.5e}" if is_float else f"{n:10d}" for n in row) + "\n").encode())
        else:
            order = "<" if self.how == "little" else ">"
            self.file.write(numbers.astype(order + ("f4" if is_float else "i4")).tobytes())


def heat(points, step):
    return (points @ [1, 10, 100] + 1000 * step).astype("f4")


def write(name, how, ids):
    geometry = Writer(f"{name}.geo", how)
    if how != "text":
        geometry.text("C Binary")
    geometry.text("a row of cells")
    geometry.text("")
    geometry.text("node id given" if ids else "node id off")
    geometry.text("element id given" if ids else "element id assign")
    geometry.text("extents")
    geometry.numbers(np.array([0, 2, 0, 2, 0, 2], "f4"), 2)
    for number, chosen, elements in PARTS:
        points = POINTS[list(chosen)]
        geometry.text("part")
        geometry.numbers([number])
        geometry.text(f"part of number {number}")
        geometry.text("coordinates")
        geometry.numbers([len(points)])
        if ids:
            geometry.numbers(100 - np.arange(len(points)))
        geometry.numbers(points.T)
        for kind, nodes in elements.items():
            geometry.text(kind)
            geometry.numbers([len(nodes)])
            if ids:
                geometry.numbers(7 + np.arange(len(nodes)))
            geometry.numbers(np.array(nodes) + 1, len(nodes[0]))
    for step in range(len(TIMES)):
        field = Writer(f"{name}.heat.{3 * step + 1:03}", how)
        field.text("the heat")
        for number, chosen, _ in PARTS:
            field.text("part")
            field.numbers([number])
            field.text("coordinates")
            field.numbers(heat(POINTS[list(chosen)], step))
    speed = Writer(f"{name}.speed", how)
    speed.text("the speed, of the second part alone")
    speed.text("part")
    speed.numbers([PARTS[1][0]])
    speed.text("coordinates undef")
    speed.numbers(np.array([-1], "f4"))
    values = POINTS[list(PARTS[1][1])].T * np.array([[1], [2], [3]], "f4")
    values[1, 2] = -1
    speed.numbers(values.astype("f4"))
    mass = Writer(f"{name}.mass", how)
    mass.text("the mass")
    for number, _, elements in PARTS:
        mass.text("part")
        mass.numbers([number])
        for at, (kind, nodes) in enumerate(elements.items()):
            mass.text(kind)
            mass.numbers(np.full(len(nodes), 10 * number + at, "f4"))
    times = " ".join(str(t) for t in TIMES)
    (OUT / f"{name}.case").write_text(
        f"""# a comment
FORMAT
type: ensight gold

GEOMETRY
model:   {name}.geo

VARIABLE
constant per case: density 2.5
scalar per node:    1 heat {name}.heat.***
vector per node:    speed {name}.speed
scalar per element: mass {name}.mass

TIME
time set: 1 all
number of steps: {len(TIMES)}
filename start number: 1
filename increment: 3
time values:
  {times}
"""
    )


def of_vtk():
    grid = vtk.vtkUnstructuredGrid()
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(POINTS, deep=True))
    grid.SetPoints(points)
    for kind, nodes in (12, [0, 1, 2, 3, 4, 5, 6, 7]), (13, [1, 8, 2, 5, 9, 6]), (14, [4, 5, 6, 7, 10]), (10, [3, 2, 7, 11]):
        grid.InsertNextCell(kind, len(nodes), nodes)
    for data, name, values in (
        (grid.GetPointData(), "heat", heat(POINTS, 0)),
        (grid.GetCellData(), "mass", np.arange(4, dtype="f4")),
        # What the writer makes parts of.
        (grid.GetCellData(), "BlockId", np.ones(4, "i4")),
    ):
        array = numpy_to_vtk(values, deep=True)
        array.SetName(name)
        data.AddArray(array)
    writer = vtk.vtkEnSightWriter()
    writer.SetInputDataObject(grid)
    writer.SetPath(str(OUT))
    writer.SetBaseName("vtk")
    writer.SetProcessNumber(0)
    writer.Write()
    writer.WriteCaseFile(1)


def check(name):
    """VTK finds in a case what was written."""
    reader = vtk.vtkGenericEnSightReader()
    reader.SetCaseFileName(str(OUT / f"{name}.case"))
    reader.ReadAllVariablesOn()
    reader.UpdateInformation()
    reader.SetTimeValue(TIMES[1])
    reader.Update()
    blocks = [reader.GetOutput().GetBlock(i) for i in range(2)]
    for block, (_, chosen, elements) in zip(blocks, PARTS):
        points = vtk_to_numpy(block.GetPoints().GetData())
        assert np.array_equal(points, POINTS[list(chosen)]) and block.GetNumberOfCells() == len(elements)
        assert np.array_equal(vtk_to_numpy(block.GetPointData().GetArray("heat")), heat(points, 1))


OUT.mkdir(parents=True, exist_ok=True)
for name, how, ids in ("text", "text", True), ("little", "little", False), ("big", "big", True):
    write(name, how, ids)
    check(name)
of_vtk()
