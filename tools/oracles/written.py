"""Files that isospan exports, read by other programs: written.py PROGRAM FOLDER.

The samples are those of the source where it is kept without loss, else those of `isospan probe`, and lie at their places.
"""

import json
import subprocess
import sys
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import SimpleITK as sitk
import tifffile
import zarr
from ome_zarr.io import parse_url
from ome_zarr.reader import Reader
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLRectilinearGridReader, vtkXMLStructuredGridReader
from vtkmodules.vtkIOXML import vtkXMLRectilinearGridWriter, vtkXMLStructuredGridWriter
from vtkmodules.vtkCommonDataModel import vtkRectilinearGrid, vtkStructuredGrid
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.util.numpy_support import numpy_to_vtk

from placing import rotation

SHAPE = 70, 41, 36
AXES = rotation(20, -35, 50) @ np.diag([0.7, 1.25, 2.5])
ORIGIN = np.array([-40.5, 12.25, 300])
LPS = np.diag([-1, -1, 1])


def source(kind):
    x, y, z = np.meshgrid(*(np.linspace(0, 1, n) for n in SHAPE), indexing="ij")
    values = 100 + 60 * np.sin(9 * x + 4 * y) * np.cos(7 * z) + 30 * (x * x + y > 0.8)
    return np.round(values).astype(kind) if np.dtype(kind).kind in "ui" else values.astype(kind)


class Written:
    def __init__(self, program, folder):
        self.program, self.folder, self.failures, self.count = program, folder, [], 0

    def run(self, *words):
        done = subprocess.run([self.program, *map(str, words)], cwd=self.folder, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"isospan {' '.join(map(str, words))}: {done.stderr.strip()}")
        return done.stdout

    def reduce(self, name, *words):
        archive = self.folder / f"{Path(name).name.split('.')[0]}.isospan"
        self.run("reduce", name, "--points", "pyramid", "-o", archive, *words)
        return archive

    def equal(self, what, found, wanted):
        self.count += 1
        found, wanted = np.asarray(found), np.asarray(wanted)
        if found.shape != wanted.shape or not np.array_equal(found, wanted):
            worst = np.abs(found - wanted).max() if found.shape == wanted.shape else f"{found.shape} {wanted.shape}"
            self.failures.append(f"{what}: other samples ({worst})")

    def near(self, what, found, wanted, much=1e-5):
        # Numbers of a NIfTI header are f32.
        self.count += 1
        if not np.allclose(found, wanted, rtol=much, atol=much):
            worst = np.abs(np.asarray(found) - wanted).max()
            self.failures.append(f"{what}: off by up to {worst}")

    def is_so(self, what, found, wanted):
        self.count += 1
        if found != wanted:
            self.failures.append(f"{what}: {found!r}, expected {wanted!r}")


def image(test, path, values, axes, origin, anatomy):
    """A file by each program that reads it; `axes` and `origin` are of the world of the source."""
    name, kind = path.name, values.dtype
    ras = LPS if anatomy == "lps" else np.eye(3)
    lps = LPS if anatomy == "ras" else np.eye(3)
    if ".nii" in name:
        read = nibabel.load(path)
        test.is_so(f"{name} dtype", read.get_data_dtype(), kind)
        test.equal(name, np.asanyarray(read.dataobj), values)
        test.near(f"{name} affine", read.affine[:3, :3], ras @ axes)
        test.near(f"{name} origin", read.affine[:3, 3], ras @ origin)
        test.near(f"{name} qform", read.get_qform(), read.get_sform())
        test.is_so(f"{name} units", read.header.get_xyzt_units()[0], "mm")
    if name.endswith(".nrrd"):
        read, head = nrrd.read(str(path))
        test.is_so(f"{name} dtype", read.dtype, kind)
        test.equal(name, read, values)
        test.near(f"{name} directions", head["space directions"], axes.T)
        test.near(f"{name} origin", head["space origin"], origin)
        test.is_so(f"{name} units", list(head["space units"]), ["mm"] * 3)
    if ".nii" in name or name.endswith((".nrrd", ".mha", ".mhd")):
        read = sitk.ReadImage(str(path))
        test.equal(f"{name} by ITK", sitk.GetArrayFromImage(read).T, values)
        matrix = np.array(read.GetDirection()).reshape(3, 3) * np.array(read.GetSpacing())
        # ITK turns NIfTI's world; a NRRD and a MetaImage of an unknown world it takes as its own.
        turn = LPS @ ras if ".nii" in name else lps
        test.near(f"{name} directions by ITK", matrix, turn @ axes)
        test.near(f"{name} origin by ITK", read.GetOrigin(), turn @ origin, 1e-4)
    if name.endswith(".npy"):
        read = np.load(path)
        test.is_so(f"{name} dtype", read.dtype, kind)
        test.equal(name, read.T, values)
    if name.endswith(".tif"):
        with tifffile.TiffFile(path) as read:
            test.is_so(f"{name} pages", len(read.pages), values.shape[2])
            test.is_so(f"{name} dtype", read.pages[0].dtype, kind)
            test.equal(name, read.asarray().T, values)
            about, page = read.imagej_metadata, read.pages[0]
            test.is_so(f"{name} unit", about["unit"], "mm")
            resolutions = [page.tags[tag].value for tag in ("XResolution", "YResolution")]
            spacing = [n[1] / n[0] for n in resolutions] + [about["spacing"]]
            test.near(f"{name} spacing", spacing, np.linalg.norm(axes, axis=0))
    if name.endswith(".vti"):
        reader = vtkXMLImageDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        grid = reader.GetOutput()
        read = vtk_to_numpy(grid.GetPointData().GetScalars())
        test.is_so(f"{name} dtype", read.dtype, kind)
        test.equal(name, read.reshape(values.shape[::-1]).T, values)
        matrix = np.array([[grid.GetDirectionMatrix().GetElement(r, c) for c in range(3)] for r in range(3)])
        test.near(f"{name} directions", matrix * np.array(grid.GetSpacing()), axes)
        test.near(f"{name} origin", grid.GetOrigin(), origin)


def images(test):
    for n, kind in enumerate(("u1", "i2", "i4", "f4")):
        values, affine = source(kind), np.eye(4)
        affine[:3, :3], affine[:3, 3] = AXES, ORIGIN
        made = nibabel.Nifti1Image(values, affine)
        made.header.set_xyzt_units("mm")
        made.set_sform(affine, 1)
        made.to_filename(test.folder / f"n{kind}.nii")
        head = {"space directions": AXES.T, "space origin": ORIGIN, "space dimension": 3, "space units": ["mm"] * 3}
        nrrd.write(str(test.folder / f"r{kind}.nrrd"), values, head, compression_level=1)
        for letter, suffix, anatomy in ("n", "nii", "ras"), ("r", "nrrd", "unknown"):
            is_whole = kind != "f4"
            flags = ("--lossless",) if is_whole else ("--target-rms", "1%")
            archive = test.reduce(f"{letter}{kind}.{suffix}", *flags)
            test.run("probe", archive, "--grid", ",".join(map(str, SHAPE)), "-o", f"{archive.stem}-probe.npy")
            wanted = values if is_whole else np.load(test.folder / f"{archive.stem}-probe.npy").T
            for ending in "nii", "nii.gz", "nrrd", "mha", "mhd", "vti", "tif", "npy":
                for words in (), ("--compress",):
                    if words and ending in ("nii", "tif", "npy"):
                        continue
                    path = test.folder / f"{archive.stem}{len(words)}.{ending}"
                    test.run("export", archive, "-o", path, *words)
                    image(test, path, wanted, AXES, ORIGIN, anatomy)
            # A level, and a part of it.
            path = test.folder / f"{archive.stem}-part.nrrd"
            told = test.run("export", archive, "-o", path, "--level", 1, "--roi", "20:60,:,10:30", "--json")
            stride = json.loads(told)["stride"]
            read, head = nrrd.read(str(path))
            shape = (40 // stride[0] + 1, (SHAPE[1] - 1) // stride[1] + 1, 20 // stride[2] + 1)
            test.is_so(f"{path.name} shape", read.shape, shape)
            test.near(f"{path.name} origin", head["space origin"], ORIGIN + AXES @ [20, 0, 10], 1e-5)
            test.near(f"{path.name} directions", head["space directions"], (AXES * stride).T, 1e-5)


def numbers_of(name, values):
    array = numpy_to_vtk(values.T.ravel(), deep=True)
    array.SetName(name)
    return array


def grids(test):
    values = source("f4")
    lines = [np.linspace(0, 2, n) ** 2 for n in SHAPE]
    axes = vtkRectilinearGrid()
    axes.SetDimensions(SHAPE)
    for line, put in zip(lines, (axes.SetXCoordinates, axes.SetYCoordinates, axes.SetZCoordinates)):
        put(numpy_to_vtk(line, deep=True))
    x, y, z = np.meshgrid(*(np.arange(n, dtype=float) for n in SHAPE), indexing="ij")
    places = np.stack([x + 0.01 * y * y, y + 0.1 * z, z - 0.05 * x], -1)
    points, bent = vtkPoints(), vtkStructuredGrid()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(places.transpose(2, 1, 0, 3).reshape(-1, 3), deep=True))
    bent.SetDimensions(SHAPE)
    bent.SetPoints(points)
    for grid, suffix, writer, reader in (
        (axes, "vtr", vtkXMLRectilinearGridWriter(), vtkXMLRectilinearGridReader()),
        (bent, "vts", vtkXMLStructuredGridWriter(), vtkXMLStructuredGridReader()),
    ):
        grid.GetPointData().SetScalars(numbers_of("f", values))
        writer.SetFileName(str(test.folder / f"{suffix}.{suffix}"))
        writer.SetInputData(grid)
        writer.Write()
        archive = test.reduce(f"{suffix}.{suffix}", "--target-max", "0.001%")
        for words in (), ("--compress",):
            path = test.folder / f"{suffix}-out{len(words)}.{suffix}"
            test.run("export", archive, "-o", path, *words)
            reader.SetFileName(str(path))
            reader.Update()
            found = reader.GetOutput()
            read = vtk_to_numpy(found.GetPointData().GetArray("f")).reshape(SHAPE[::-1]).T
            test.near(f"{path.name} values", read, values, 5e-5)
            where = np.array([found.GetPoint(n) for n in range(0, found.GetNumberOfPoints(), 997)])
            right = np.array([grid.GetPoint(n) for n in range(0, grid.GetNumberOfPoints(), 997)])
            test.near(f"{path.name} places", where, right, 1e-12)


def zarrs(test):
    spacing = np.array([0.7, 1.25, 2.5])
    head = {"space directions": np.diag(spacing), "space origin": ORIGIN, "space dimension": 3, "space units": ["mm"] * 3}
    for kind in "u2", "f4":
        values = source(kind)
        nrrd.write(str(test.folder / f"z{kind}.nrrd"), values, head)
        archive = test.reduce(f"z{kind}.nrrd", *(("--lossless",) if kind == "u2" else ("--target-rms", "1%")))
        image = test.folder / f"z{kind}.ome.zarr"
        test.run("export", archive, "-o", image)
        node = list(Reader(parse_url(image))())[0]
        test.is_so(f"{image.name} axes", [axis["name"] for axis in node.metadata["axes"]], ["z", "y", "x"])
        test.is_so(f"{image.name} units", [axis["unit"] for axis in node.metadata["axes"]], ["millimeter"] * 3)
        for level, (data, steps) in enumerate(zip(node.data, node.metadata["coordinateTransformations"])):
            name = f"{image.name} level {level}"
            path = test.folder / "level.nrrd"
            test.run("export", archive, "-o", path, "--level", level, "--force")
            wanted, about = nrrd.read(str(path))
            wanted = np.round(wanted).astype(kind) if kind == "u2" else wanted
            read = np.asarray(data)
            test.is_so(f"{name} dtype", read.dtype, np.dtype(kind))
            test.equal(name, read.T, wanted)
            test.equal(f"{name} by zarr", zarr.open_array(image / str(level), mode="r")[:], read)
            test.near(f"{name} scale", steps[0]["scale"][::-1], np.diag(about["space directions"]), 1e-12)
            test.near(f"{name} translation", steps[1]["translation"][::-1], about["space origin"], 1e-12)
            if kind == "u2" and level == 0:
                test.equal(f"{name} source", read.T, values)


def series(test):
    for step in range(3):
        np.save(test.folder / f"t{step}.npy", np.ascontiguousarray((source("f4") * (1 + step)).T))
    test.run("reduce", *(f"t{n}.npy" for n in range(3)), "--points", "pyramid", "-o", "t.isospan", "--times", "1,1.5,2")
    test.run("export", "t.isospan", "-o", "t.zarr", "--all-steps")
    node = list(Reader(parse_url(test.folder / "t.zarr"))())[0]
    read = np.asarray(node.data[0])
    test.is_so("t.zarr axes", [axis["name"] for axis in node.metadata["axes"]], ["t", "z", "y", "x"])
    first = [steps[0]["scale"][0] for steps in node.metadata["coordinateTransformations"]]
    test.is_so("t.zarr step", first[0], 0.5)
    for step in range(3):
        test.run("export", "t.isospan", "-o", f"t{step}-out.npy", "--step", step)
        test.equal(f"t.zarr step {step}", read[step], np.load(test.folder / f"t{step}-out.npy"))


def main(program, folder):
    test = Written(program, folder)
    for cases in images, grids, zarrs, series:
        cases(test)
    for failure in test.failures:
        print(f"tools/oracles/test: {failure}", file=sys.stderr)
    print(f"written files: {test.count - len(test.failures)} passed, {len(test.failures)} failed")
    sys.exit(bool(test.failures))


main(sys.argv[1], Path(sys.argv[2]))
