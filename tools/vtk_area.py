#!/usr/bin/env python3
"""Triangles and area of the full-resolution isosurface of a volume, by VTK's Flying Edges.

    vtk_area.py FILE ISOVALUE [ISOVALUE ...]    one line an isovalue: triangles, area in world units
    vtk_area.py --manifest DIR                  a table of every volume of DIR/MANIFEST.tsv; triangle counts are
                                                compared with the manifest's, which proves that the file was read right

By hand only, not part of the tests: needs `pip install vtk numpy`. What VTK has no reader for (npz, vtk.js) is parsed
here. Stored values are used as they are: a NIfTI scale (scl_slope) is not applied. The tables are tab-separated.
"""

import argparse
import gzip
import json
import sys
import zipfile
from pathlib import Path

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

SKIPPED = {"variants", "series", "meshes"}


def image_of_array(values, spacing=(1.0, 1.0, 1.0)):
    """An image of an array indexed [z, y, x]."""
    image = vtk.vtkImageData()
    image.SetDimensions(values.shape[2], values.shape[1], values.shape[0])
    image.SetSpacing(spacing)
    flat = numpy_to_vtk(np.ascontiguousarray(values).ravel(), deep=True)
    flat.SetName("data")
    image.GetPointData().SetScalars(flat)
    return image


def read_npz(path):
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if len(names) != 1:
            raise ValueError(f"{path}: expected one array, got {names}")
        with archive.open(names[0]) as member:
            return image_of_array(np.load(member))


def read_npy(path):
    return image_of_array(np.load(path))


def read_vtkjs(path):
    header = json.loads(Path(path).read_text())
    array = header["pointData"]["arrays"][0]["data"]
    kind = {"Int16Array": "<i2", "Uint8Array": "u1", "Float32Array": "<f4"}[array["dataType"]]
    ref = array["ref"]
    data = gzip.decompress((Path(path).parent / ref["basepath"] / (ref["id"] + ".gz")).read_bytes())
    lo_hi = header["extent"]
    x, y, z = (lo_hi[2 * a + 1] - lo_hi[2 * a] + 1 for a in range(3))
    return image_of_array(np.frombuffer(data, kind).reshape(z, y, x).astype(kind.replace("<", "=")), header["spacing"])


def read_tiff_stack(first):
    files = sorted(Path(first).parent.glob("*.tif"))
    names = vtk.vtkStringArray()
    for file in files:
        names.InsertNextValue(str(file))
    reader = vtk.vtkTIFFReader()
    reader.SetFileNames(names)
    reader.Update()
    # A TIFF tells resolution in dots an inch; the stack is taken in voxel units.
    image = reader.GetOutput()
    image.SetSpacing(1.0, 1.0, 1.0)
    return image


def read_by_vtk(reader, path):
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def read_volume(path):
    """The volume of a file, as vtkImageData with active scalars."""
    path = Path(path)
    name = path.name.lower()
    if name.endswith(".npz"):
        return read_npz(path)
    if name.endswith(".npy"):
        return read_npy(path)
    if name.endswith(".json"):
        return read_vtkjs(path)
    if name.endswith((".tif", ".tiff")):
        return read_tiff_stack(path)
    for endings, reader in (
        ((".nii", ".nii.gz"), vtk.vtkNIFTIImageReader),
        ((".nrrd", ".nhdr"), vtk.vtkNrrdReader),
        ((".mha", ".mhd"), vtk.vtkMetaImageReader),
        ((".vti",), vtk.vtkXMLImageDataReader),
        ((".vtk",), vtk.vtkStructuredPointsReader),
        ((".slc",), vtk.vtkSLCReader),
    ):
        if name.endswith(endings):
            return read_by_vtk(reader(), path)
    raise ValueError(f"{path}: no reader for this kind of file")


def choose_field(image, field=None):
    """Makes a point array the one that is contoured: the one named, else the first scalar one."""
    data = image.GetPointData()
    if field is None:
        scalar = [i for i in range(data.GetNumberOfArrays()) if data.GetArray(i).GetNumberOfComponents() == 1]
        if not scalar:
            raise ValueError("no scalar point array")
        field = data.GetArrayName(scalar[0])
    if data.GetArray(field) is None:
        raise ValueError(f"no point array named {field}")
    data.SetActiveScalars(field)


def isosurface(image, isovalue):
    """Triangles, and area, of the isosurface; corner differences in f64."""
    contour = vtk.vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, isovalue)
    contour.ComputeNormalsOff()
    contour.ComputeGradientsOff()
    contour.ComputeScalarsOff()
    contour.Update()
    mesh = contour.GetOutput()
    if mesh.GetNumberOfPolys() == 0:
        return 0, 0.0
    points = vtk_to_numpy(mesh.GetPoints().GetData()).astype(np.float64)
    corners = points[vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return len(corners), float(0.5 * np.linalg.norm(normals, axis=1).sum())


def manifest_rows(folder):
    """The volumes of a manifest, as dictionaries; `isovalues` and `triangles` as lists of numbers."""
    lines = (Path(folder) / "MANIFEST.tsv").read_text().splitlines()
    lines = [line for line in lines if line and not line.startswith("#")]
    titles = lines[0].split("\t")
    for line in lines[1:]:
        row = dict(zip(titles, line.split("\t")))
        values = row.get("isovalues", "")
        if values in ("", "-") or row["file"].split("/")[0] in SKIPPED:
            continue
        row["isovalues"] = [float(v) for v in values.split(";")]
        row["triangles"] = [int(t) for t in row["triangles"].split(";")]
        yield row


def manifest_table(folder):
    print("file\tisovalue\ttriangles\tmanifest\tarea\tspacing")
    wrong = 0
    for row in manifest_rows(folder):
        try:
            image = read_volume(Path(folder) / row["file"])
            choose_field(image)
        except ValueError as reason:
            print(f"{row['file']}: skipped: {reason}", file=sys.stderr)
            continue
        spacing = ",".join(f"{s:.9g}" for s in image.GetSpacing())
        for isovalue, expected in zip(row["isovalues"], row["triangles"]):
            triangles, area = isosurface(image, isovalue)
            wrong += triangles != expected
            print(f"{row['file']}\t{isovalue:g}\t{triangles}\t{expected}\t{area:.9g}\t{spacing}", flush=True)
    if wrong:
        sys.exit(f"{wrong} triangle counts differ from the manifest's")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--manifest", metavar="DIR", help="a folder with a MANIFEST.tsv and its volumes")
    parser.add_argument("--field", help="the point array to contour")
    parser.add_argument("file", nargs="?")
    parser.add_argument("isovalue", nargs="*", type=float)
    args = parser.parse_args()
    if args.manifest:
        return manifest_table(args.manifest)
    if not args.file or not args.isovalue:
        parser.error("give FILE and ISOVALUE, or --manifest DIR")
    image = read_volume(args.file)
    choose_field(image, args.field)
    for isovalue in args.isovalue:
        triangles, area = isosurface(image, isovalue)
        print(f"{isovalue:g}\t{triangles}\t{area:.9g}")


if __name__ == "__main__":
    main()
