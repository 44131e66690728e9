#!/usr/bin/env python3
"""Writes tests/data/exodus, small Exodus II files for the tests of src/io/formats/mesh/exodus.

Needs meshio, netCDF4 and numpy. The field heat of (x, y, z) is x + 10 y + 100 z + 1000 step.
Usage: tools/make_golden_exodus.py
"""
from pathlib import Path

import meshio
import netCDF4
import numpy as np

OUT = Path(__file__).resolve().parent.parent / "tests" / "data" / "exodus"
# A row of cells along x: a hexahedron, a wedge, a pyramid, a tetrahedron; and a quadrilateral.
POINTS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
    + [[2, 0, 0], [2, 0, 1]]
    + [[0.5, 0.5, 2], [0.5, 2, 0.5]],
    "f8",
)
BLOCKS = [
    ("HEX8", [[1, 2, 3, 4, 5, 6, 7, 8]]),
    ("wedge6", [[2, 9, 3, 6, 10, 7]]),
    ("SHELL4", [[1, 2, 3, 4], [1, 2, 6, 5]]),
    ("PYRAMID", [[5, 6, 7, 8, 11]]),
    ("TETRA", [[4, 3, 8, 12]]),
]
TIMES = [0.5, 1.5, 4.0]


def heat(step):
    return POINTS @ [1, 10, 100] + 1000 * step


def text(array, words):
    for i, word in enumerate(words):
        array[i, : len(word)] = list(word)
        array[i, len(word)] = "\0"


def write(name, form, times, old=False, packed=False):
    data = netCDF4.Dataset(OUT / name, "w", format=form)
    data.set_auto_mask(False)
    data.api_version = data.version = np.float32(4.98)
    data.floating_point_word_size, data.file_size, data.title = np.int32(8), np.int32(1), "a row of cells"
    cells = sum(len(cells) for _, cells in BLOCKS)
    sizes = dict(len_string=33, time_step=None, num_dim=3, num_nodes=len(POINTS), num_elem=cells)
    sizes |= dict(num_el_blk=len(BLOCKS) + 1, num_nod_var=2, num_elem_var=1)
    for dim, size in sizes.items():
        data.createDimension(dim, size)
    how = dict(zlib=True, shuffle=True) if packed else {}
    make = lambda name, kind, *dims: data.createVariable(name, kind, dims, **(how if kind != "S1" else {}))
    make("time_whole", "f8", "time_step")[:] = times
    if old:
        make("coord", "f4", "num_dim", "num_nodes")[:] = POINTS.T
    else:
        for axis, along in enumerate(("coordx", "coordy", "coordz")):
            make(along, "f8", "num_nodes")[:] = POINTS[:, axis]
    # Ids of nodes that decide nothing.
    make("node_num_map", "i4", "num_nodes")[:] = 100 - np.arange(len(POINTS))
    make("eb_status", "i4", "num_el_blk")[:] = [1] * len(BLOCKS) + [0]
    ids = make("eb_prop1", "i4", "num_el_blk")
    # netCDF4 has a property `name`, too.
    ids.setncattr("name", "ID")
    ids[:] = 10 * np.arange(1, len(BLOCKS) + 2)
    make("elem_var_tab", "i4", "num_el_blk", "num_elem_var")[:] = [[1], [0], [1], [1], [1], [0]]
    text(make("name_nod_var", "S1", "num_nod_var", "len_string"), ["heat", "load"])
    text(make("name_elem_var", "S1", "num_elem_var", "len_string"), ["mass"])
    if old:
        make("vals_nod_var", "f4", "time_step", "num_nod_var", "num_nodes")
    else:
        make("vals_nod_var1", "f8", "time_step", "num_nodes")
        make("vals_nod_var2", "f4", "time_step", "num_nodes")
    for number, (kind, nodes) in enumerate(BLOCKS, 1):
        elements, count = f"num_el_in_blk{number}", f"num_nod_per_el{number}"
        data.createDimension(elements, len(nodes))
        data.createDimension(count, len(nodes[0]))
        connect = make(f"connect{number}", "i8" if packed else "i4", elements, count)
        connect.elem_type = kind
        connect[:] = nodes
        # The wedge has no mass.
        if number != 2:
            make(f"vals_elem_var1eb{number}", "f8", "time_step", elements)
    for step in range(len(times)):
        values = [heat(step), np.full(len(POINTS), step)]
        for variable, of in enumerate(values):
            if old:
                data["vals_nod_var"][step, variable] = of
            else:
                data[f"vals_nod_var{variable + 1}"][step] = of
        for number, (_, nodes) in enumerate(BLOCKS, 1):
            if number != 2:
                data[f"vals_elem_var1eb{number}"][step] = [10 * number + step] * len(nodes)
    data.close()


HEX = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
HEX_EDGES = ["01", "12", "23", "30", "04", "15", "26", "37", "45", "56", "67", "74"]
WEDGE = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]]
WEDGE_EDGES = ["01", "12", "20", "03", "14", "25", "34", "45", "53"]
# Nodes after the corners lie in the middle of these.
SECOND_ORDER = [
    ("TETRA10", WEDGE[:4], ["01", "12", "20", "03", "13", "23"]),
    ("HEX20", HEX, HEX_EDGES),
    ("HEX27", HEX, HEX_EDGES + ["01234567", "0123", "4567", "0374", "1265", "0154", "3267"]),
    ("WEDGE15", WEDGE, WEDGE_EDGES),
    ("WEDGE18", WEDGE, WEDGE_EDGES + ["0143", "1254", "2035"]),
    ("PYRAMID13", HEX[:4] + [[0.5, 0.5, 1]], ["01", "12", "23", "30", "04", "14", "24", "34"]),
    ("PYRAMID14", HEX[:4] + [[0.5, 0.5, 1]], ["01", "12", "23", "30", "04", "14", "24", "34", "0123"]),
]


def second_order():
    """One element of each kind, two apart along x."""
    data = netCDF4.Dataset(OUT / "second_order.exo", "w", format="NETCDF3_64BIT_OFFSET")
    points = []
    for number, (kind, corners, middles) in enumerate(SECOND_ORDER, 1):
        corners = np.array(corners, "f8") + [2 * number, 0, 0]
        first = len(points) + 1
        points += [*corners] + [np.mean(corners[[int(c) for c in of]], axis=0) for of in middles]
        elements, count = f"num_el_in_blk{number}", f"num_nod_per_el{number}"
        data.createDimension(elements, 1)
        data.createDimension(count, len(points) + 1 - first)
        connect = data.createVariable(f"connect{number}", "i4", (elements, count))
        connect.elem_type = kind
        connect[:] = np.arange(first, len(points) + 1)[None]
    data.createDimension("num_el_blk", len(SECOND_ORDER))
    data.createDimension("num_nodes", len(points))
    for axis, along in enumerate(("coordx", "coordy", "coordz")):
        data.createVariable(along, "f8", ("num_nodes",))[:] = np.array(points)[:, axis]
    data.close()


def of_meshio():
    """The hexahedron and the tetrahedron, as meshio writes them."""
    cells = [("hexahedron", np.arange(8)[None]), ("tetra", np.array([[3, 2, 7, 11]]))]
    mesh = meshio.Mesh(POINTS, cells, point_data={"heat": heat(0)})
    meshio.write(OUT / "meshio.e", mesh, file_format="exodus")


OUT.mkdir(parents=True, exist_ok=True)
write("row.exo", "NETCDF3_64BIT_OFFSET", TIMES)
write("row_old.e", "NETCDF3_CLASSIC", TIMES[:1], old=True)
write("row_cdf5.g", "NETCDF3_64BIT_DATA", TIMES)
write("row_packed.exo", "NETCDF4", TIMES, packed=True)
of_meshio()
second_order()
