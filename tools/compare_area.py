#!/usr/bin/env python3
"""Surfaces of isospan against the full-resolution ones of VTK's Flying Edges, volume by volume.

    compare_area.py [--data DIR] [--program PATH] [--all-isovalues] [--values fit|sample] [--only WORD]

For each volume of DIR/MANIFEST.tsv (DIR: $ISOSPAN_SHARED_DATA) and its first isovalue: reduce at fraction 1 and at fraction
1/8, extract, check. One tab-separated row a volume: areas and their ratio at fraction 1, and at 1/8 the ratio again,
defects, boundary edges and how many of those do not lie on the domain's boundary. Formats that isospan does not read
(SLC, vtk.js, TIFF) are handed over as NRRD. A NIfTI's scale is applied to the isovalue: isospan scales samples, VTK
does not. Exits 1 where a surface has a defect or the area at fraction 1 deviates by more than --tolerance.

By hand only, not part of the tests: needs `pip install vtk numpy` and a release build.
"""

import argparse
import gzip
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from vtk.util.numpy_support import vtk_to_numpy

import vtk_area

READ_BY_ISOSPAN = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd", ".vti", ".vtk", ".npy", ".npz")
NRRD_TYPES = {"u1": "uint8", "i2": "int16", "u2": "uint16", "f4": "float", "f8": "double"}
DEFECTS = (
    "non_manifold_edges",
    "non_manifold_vertices",
    "misoriented_edges",
    "duplicate_triangles",
    "degenerate_triangles",
    "out_of_range_triangles",
    "non_finite_vertices",
)


def nifti_scale(path):
    """Slope and intercept of a NIfTI-1 file, (1, 0) for any other."""
    if not path.name.endswith((".nii", ".nii.gz")):
        return 1.0, 0.0
    opened = gzip.open(path) if path.name.endswith(".gz") else open(path, "rb")
    with opened as file:
        head = file.read(348)
    order = "<" if struct.unpack("<i", head[:4])[0] == 348 else ">"
    slope, intercept = struct.unpack(order + "2f", head[112:120])
    return (slope, intercept) if slope != 0 else (1.0, 0.0)


def write_nrrd(image, path):
    values = vtk_to_numpy(image.GetPointData().GetScalars())
    values = values.astype(values.dtype.newbyteorder("<"))
    sizes = " ".join(map(str, image.GetDimensions()))
    spacings = " ".join(repr(s) for s in image.GetSpacing())
    kind = NRRD_TYPES[values.dtype.str[1:]]
    with open(path, "wb") as file:
        file.write(
            f"NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {sizes}\nspacings: {spacings}\n"
            "endian: little\nencoding: raw\n\n".encode()
        )
        file.write(values.tobytes())


def run(command, may_fail=()):
    start = time.monotonic()
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if done.returncode not in (0, *may_fail):
        raise RuntimeError(f"exit {done.returncode}: {done.stderr.strip().splitlines()[-1:] or done.stdout}")
    return done.stdout, time.monotonic() - start


def reduced(program, source, field, fraction, values, folder):
    archive = folder / "x.isospan"
    command = [program, "reduce", source, "--points", "hammersley", "--fraction", fraction, "-o", archive, "--force"]
    command += ["--values", values]
    seconds = run(command + (["--field", field] if field else []))[1]
    return archive, seconds


def surface_report(program, archive, isovalue, folder):
    ply = folder / "x.ply"
    run([program, "surface", archive, "--isovalue", repr(isovalue), "-o", ply, "--force"])
    # Exit 5 tells of defects, which the report counts.
    return json.loads(run([program, "check", ply, "--within", archive, "--json"], may_fail=(5,))[0])


def rows_of(program, data, row, isovalues, values, folder):
    path = Path(data) / row["file"]
    image = vtk_area.read_volume(path)
    vtk_area.choose_field(image)
    field = image.GetPointData().GetScalars().GetName() if path.name.endswith((".vti", ".vtk")) else None
    source = path
    if not path.name.endswith(READ_BY_ISOSPAN):
        source, field = folder / "x.nrrd", None
        write_nrrd(image, source)
    slope, intercept = nifti_scale(path)
    reports = {}
    for fraction in ("1", "1/8"):
        archive, seconds = reduced(program, source, field, fraction, values, folder)
        for isovalue in isovalues:
            report = surface_report(program, archive, slope * isovalue + intercept, folder)
            reports[isovalue, fraction] = (report, seconds)
    for isovalue in isovalues:
        yield isovalue, vtk_area.isosurface(image, isovalue)[1], *(reports[isovalue, f] for f in ("1", "1/8"))


def defects(report):
    return {name: report[name] for name in DEFECTS if report[name]}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default=os.environ.get("ISOSPAN_SHARED_DATA"))
    root = Path(__file__).resolve().parent.parent
    parser.add_argument("--program", type=Path, help="[release of this tree]")
    parser.add_argument("--all-isovalues", action="store_true")
    parser.add_argument("--values", choices=("fit", "sample"), default="fit")
    parser.add_argument("--only", default="", help="volumes whose name contains this")
    parser.add_argument("--tolerance", type=float, default=0.05)
    args = parser.parse_args()
    if not args.program:
        target = subprocess.check_output([root / "tools/target_folder"], text=True).strip()
        args.program = Path(target) / "release" / "isospan"
    if not args.data:
        parser.error("give --data, or set ISOSPAN_SHARED_DATA")
    print("file\tisovalue\tVTK area\tarea at 1\tratio\tratio at 1/8\tdefects\tboundary at 1/8\tinside\treduce s")
    bad = 0
    for row in vtk_area.manifest_rows(args.data):
        if args.only not in row["file"]:
            continue
        isovalues = row["isovalues"] if args.all_isovalues else row["isovalues"][:1]
        with tempfile.TemporaryDirectory() as folder:
            try:
                for isovalue, area, (full, slow), (eighth, quick) in rows_of(
                    args.program, args.data, row, isovalues, args.values, Path(folder)
                ):
                    ratio = full["area"] / area
                    wrong = {**defects(full), **defects(eighth)}
                    inside = full["boundary_edges_outside"] + eighth["boundary_edges_outside"]
                    bad += abs(ratio - 1) > args.tolerance or bool(wrong) or inside > 0
                    print(
                        f"{row['file'].removeprefix('volumes/')}\t{isovalue:g}\t{area:.6g}\t{full['area']:.6g}\t{ratio:.4f}\t"
                        f"{eighth['area'] / area:.4f}\t{wrong or 'none'}\t{eighth['boundary_edges']}\t{inside}\t"
                        f"{slow:.1f}, {quick:.1f}",
                        flush=True,
                    )
            except (RuntimeError, ValueError) as reason:
                bad += not isinstance(reason, ValueError)
                print(f"{row['file']}: {reason}", file=sys.stderr, flush=True)
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
