"""Files of other programs among the shared data, where these are: each with what is right."""

import gzip
import os
from pathlib import Path

import h5py
import netCDF4
import nrrd
import numpy as np
import tifffile
import zarr
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLUnstructuredGridReader

from arrays import as_read
from medical import as_itk_reads_first, dose, image
from placing import Case, Refused, affine, along, grid, program

ROOT = os.environ.get("ISOSPAN_SHARED_DATA")
TURN = Path(ROOT) / "turn3" if ROOT and (Path(ROOT) / "turn3").is_dir() else None


def of_turn(*packages):
    """Marks a function of the files of that folder; nothing is done where it is missing."""
    return program(*packages) if TURN else lambda function: function


@of_turn("nibabel")
def shared_minc(at):
    for name in "tiny.mnc", "minc1-no-att.mnc":
        yield image(TURN / name)
    # As gzip unpacks it, which passes over the zeros at the end.
    (at / "plain.nii").write_bytes(gzip.decompress((TURN / "q10_trail0.nii.gz").read_bytes()))
    plain = image(at / "plain.nii")
    yield Case(TURN / "q10_trail0.nii.gz", plain.values, plain.places)


@of_turn("tifffile")
def shared_tiff(at):
    lengths = {"imagej_zunit.tif": (0.5, 0.5, 2500), "ome_mixed_units.ome.tif": (500, 500, 2000)}
    for name, spacing in lengths.items():
        values = tifffile.imread(TURN / name)
        yield Case(TURN / name, values, grid(spacing, shape=values.shape), length="nm")
    with tifffile.TiffFile(TURN / "ilastik_3d.tif") as file:
        values, (many, of) = file.asarray(), file.pages[0].tags["XResolution"].value
        rows, height = file.pages[0].tags["YResolution"].value
        spacing = of / many, 0.1 * height / rows, 1e-10 * file.imagej_metadata["spacing"]
    yield Case(TURN / "ilastik_3d.tif", values, grid(spacing, shape=values.shape), length="cm")


@of_turn("pynrrd")
def shared_nrrd(at):
    values, _ = nrrd.read(str(TURN / "s4_mixunits.nrrd"))
    matrix = np.diag([1, 2, 0.003, 1])
    matrix[:3, 3] = 10, 20, 0.03
    yield Case(TURN / "s4_mixunits.nrrd", values, affine(matrix, values.shape), length="mm")
    values, head = nrrd.read(str(TURN / "s4_4dtime.nrrd"))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = head["space directions"][:3].T, head["space origin"]
    yield Case(TURN / "s4_4dtime.nrrd", np.moveaxis(values, 3, 0), affine(matrix, values.shape[:3]), times=(None,) * 3)


@of_turn("simpleitk")
def shared_itk(at):
    path = TURN / "s1_4d.mha"
    values, places = as_itk_reads_first(path, (1, 1, 1))
    yield Case(path, values, places, times=(None,) * len(values))


@of_turn("h5py")
def shared_hdf5(at):
    with h5py.File(TURN / "emd_tomviz.emd") as file:
        group = file["data/tomography"]
        values = group["data"][:].transpose(2, 1, 0)
        yield Case(TURN / "emd_tomviz.emd", values, along(*(group[f"dim{n}"][:] for n in (1, 2, 3))), length="nm")
    with h5py.File(TURN / "q6.hspy") as file:
        values = file["Experiments/x/data"][:]
    yield Case(TURN / "q6.hspy", values, grid((1, 2, 3), (5, 5, 5), values.shape), length="nm")


@of_turn("netcdf4")
def shared_netcdf(at):
    with h5py.File(TURN / "s6_mixedunits.nc") as file:
        x, y, z = (file[axis][:] for axis in "xyz")
    yield Case(TURN / "s6_mixedunits.nc", as_read(TURN / "s6_mixedunits.nc", "t"), along(x, 1000 * y, z), length="m")
    for name in "s6_packed.nc", "s6_unsigned3.nc":
        with netCDF4.Dataset(TURN / name) as file:
            lon, lat, lev = (file[axis][:] for axis in ("lon", "lat", "lev"))
        yield Case(TURN / name, as_read(TURN / name, "t"), along(lon, lat, lev))
    yield Refused(TURN / "q6_ugrid.nc", "UGRID|mesh")


@of_turn("zarr")
def shared_zarr(at):
    values = zarr.open_array(TURN / "s8_mixunit.zarr" / "0", mode="r")[:]
    yield Case(TURN / "s8_mixunit.zarr", values, grid((0.001, 0.002, 3), shape=values.shape), length="um")


@of_turn("pydicom")
def shared_dicom(at):
    yield dose(TURN / "rtdose.dcm")


@of_turn("vtk")
def shared_vtk(at):
    reader = vtkXMLImageDataReader()
    reader.SetFileName(str(TURN / "fields_target.vti"))
    reader.Update()
    for name in "temperature", "pressure":
        values = vtk_to_numpy(reader.GetOutput().GetPointData().GetArray(name)).reshape(48, 48, 48)
        yield Case(TURN / "fields_target.vti", values, grid(shape=values.shape), ("--field", name))
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(TURN / "s14_utm.vtu"))
    reader.Update()
    mesh = reader.GetOutput()
    values, points = vtk_to_numpy(mesh.GetPointData().GetArray("v")), vtk_to_numpy(mesh.GetPoints().GetData())
    yield Case(TURN / "s14_utm.vtu", values, points.astype(float), is_mesh=True)


@of_turn("numpy")
def shared_amira(at):
    data = (TURN / "rle_noterm.am").read_bytes()
    at, values = data.index(b"\n@1\n") + 4, []
    while len(values) < 512:
        count = data[at]
        values += data[at + 1 : at + 1 + count - 128] if count > 127 else [data[at + 1]] * count
        at += 1 + (count - 128 if count > 127 else 1)
    values = np.array(values, "u1").reshape(8, 8, 8)
    for name in "rle_noterm.am", "rle_term0.am":
        yield Case(TURN / name, values, grid(shape=values.shape))
