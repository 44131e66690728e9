"""Volumes: read from files, or made."""
import sys

import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy

READERS = {
    ".nii.gz": vtk.vtkNIFTIImageReader,
    ".nhdr": vtk.vtkNrrdReader,
    ".nrrd": vtk.vtkNrrdReader,
    ".mha": vtk.vtkMetaImageReader,
    ".vtk": vtk.vtkStructuredPointsReader,
    ".vti": vtk.vtkXMLImageDataReader,
    ".slc": vtk.vtkSLCReader,
}


class Volume:
    """Samples, z y x, as they are and as the `f32` that coders get."""

    def __init__(self, name, samples):
        self.name = name
        self.samples = np.ascontiguousarray(samples)
        self.values = self.samples.astype(np.float32)
        self.extent = float(self.values.max() - self.values.min())


def load(path):
    """The samples of a file."""
    name = path.name
    if name.endswith(".npy"):
        return np.load(path)
    if name.endswith(".npz"):
        return next(iter(np.load(path).values()))
    if path.is_dir():
        reader = vtk.vtkTIFFReader()
        files = vtk.vtkStringArray()
        for file in sorted(path.glob("*.tif")):
            files.InsertNextValue(str(file))
        reader.SetFileNames(files)
    else:
        kind = next((end for end in READERS if name.endswith(end)), None)
        if kind is None:
            sys.exit(f"{path}: not a kind of volume that this script reads")
        if not path.exists():
            sys.exit(f"{path}: no such file")
        reader = READERS[kind]()
        reader.SetFileName(str(path))
    reader.Update()
    image = reader.GetOutput()
    values = image.GetPointData().GetScalars() or image.GetPointData().GetArray(0)
    samples = vtk_to_numpy(values)
    if samples.ndim > 1:
        samples = np.linalg.norm(samples.astype(float), axis=1)
    return samples.reshape(image.GetDimensions()[::-1])


def generated():
    """Smooth, busy and noisy fields that are not in any collection."""
    axis = np.linspace(-1, 1, 96)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    r = np.hypot(x, y)
    rho = np.cos(2 * np.pi * 6 * np.cos(np.pi * r / 2))
    waves = (1 - np.sin(np.pi * z / 2) + 0.25 * (1 + rho)) / 2.5
    yield Volume("marschner-lobb", waves.astype(np.float32))
    x, y, z = (3 * np.pi * a for a in (x, y, z))
    gyroid = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    yield Volume("gyroid", gyroid.astype(np.float32))
    random = np.random.default_rng(1)
    spectrum = np.fft.rfftn(random.standard_normal((96, 96, 96)))
    f, half = np.fft.fftfreq(96) * 96, np.fft.rfftfreq(96) * 96
    k = np.sqrt(sum(g**2 for g in np.meshgrid(f, f, half, indexing="ij")))
    turbulence = np.fft.irfftn(spectrum * np.maximum(k, 1) ** (-11 / 6), s=(96, 96, 96))
    yield Volume("turbulence", turbulence.astype(np.float32))
