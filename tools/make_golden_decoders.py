#!/usr/bin/env python3
"""Writes tests/data/decoders, small compressed volumes of the programs of each field, for the tests of src/formats.

Needs numpy, tifffile, imagecodecs, nibabel, mrcfile, pynrrd, SimpleITK, vtk and numcodecs. Sample (z, y, x) of
16 x 16 x 16 is x + 3 y + 7 z.
Usage: tools/make_golden_decoders.py
"""
import gzip
import json
import zipfile
from pathlib import Path

import mrcfile
import nibabel
import nrrd
import numcodecs
import numpy as np
import SimpleITK
import tifffile
import vtk
from vtk.util.numpy_support import numpy_to_vtk

OUT = Path(__file__).resolve().parent.parent / "tests" / "data" / "decoders"
Z, Y, X = np.mgrid[0:16, 0:16, 0:16]
SAMPLES = (X + 3 * Y + 7 * Z).astype("<i2")


def tiff():
    for compression in ["lzw", "deflate", "packbits", "zstd"]:
        name = OUT / f"{compression}.tif"
        tifffile.imwrite(name, SAMPLES, compression=compression, photometric="minisblack", rowsperstrip=5)
    for name, samples, predictor in [("lzw_2", SAMPLES, 2), ("deflate_3", SAMPLES.astype("f4"), 3)]:
        compression = name.split("_")[0]
        options = {"compression": compression, "predictor": predictor, "tile": (16, 16)}
        tifffile.imwrite(OUT / f"{name}.tif", samples, photometric="minisblack", **options)


def whole_files():
    turned = np.transpose(SAMPLES, (2, 1, 0))
    nibabel.Nifti1Image(turned, np.eye(4)).to_filename(OUT / "nibabel.nii.gz")
    image = gzip.decompress((OUT / "nibabel.nii.gz").read_bytes())
    # Two members and zeros, as of bgzip on a tape; bytes that are no gzip.
    members = [gzip.compress(part, mtime=0) for part in (image[:5000], image[5000:])]
    (OUT / "members.nii.gz").write_bytes(b"".join(members) + bytes(512))
    (OUT / "junk.nii.gz").write_bytes(gzip.compress(image, mtime=0) + b"junk")
    with mrcfile.new(OUT / "mrcfile.mrc.gz", overwrite=True, compression="gzip") as file:
        file.set_data(SAMPLES)
    nrrd.write(str(OUT / "pynrrd.nrrd"), turned, {"encoding": "gzip"})
    for name in ["itk.mha", "itk.nrrd", "itk.nii.gz"]:
        SimpleITK.WriteImage(SimpleITK.GetImageFromArray(SAMPLES), str(OUT / name), useCompression=True)
    np.savez_compressed(OUT / "numpy.npz", samples=SAMPLES)


def vti():
    for name, compressor in [("zlib", vtk.vtkZLibDataCompressor()), ("lz4", vtk.vtkLZ4DataCompressor())]:
        image, writer = vtk.vtkImageData(), vtk.vtkXMLImageDataWriter()
        image.SetDimensions(16, 16, 16)
        samples = numpy_to_vtk(SAMPLES.ravel(), deep=1)
        samples.SetName("samples")
        image.GetPointData().SetScalars(samples)
        writer.SetFileName(str(OUT / f"{name}.vti"))
        writer.SetInputData(image)
        writer.SetCompressor(compressor)
        writer.SetBlockSize(1024)
        writer.EncodeAppendedDataOff()
        writer.Write()


def zarr():
    """Arrays of two chunks in a zip archive."""
    blosc = [
        numcodecs.Blosc(cname=cname, shuffle=shuffle)
        for cname in ["blosclz", "lz4", "zlib", "zstd"]
        for shuffle in [numcodecs.Blosc.NOSHUFFLE, numcodecs.Blosc.SHUFFLE, numcodecs.Blosc.BITSHUFFLE]
    ]
    others = [numcodecs.GZip(), numcodecs.Zlib(), numcodecs.Zstd(), numcodecs.LZ4()]
    for codec in blosc + others:
        config = codec.get_config()
        name = config["id"] + (f"_{config['cname']}_{config['shuffle']}" if "cname" in config else "")
        array = {
            "zarr_format": 2,
            "shape": [16, 16, 16],
            "chunks": [8, 16, 16],
            "dtype": "<i2",
            "compressor": config,
            "fill_value": 0,
            "order": "C",
            "filters": None,
        }
        with zipfile.ZipFile(OUT / f"{name}.zarr.zip", "w") as store:
            for file, content in [(".zarray", json.dumps(array))] + [
                (f"{n}.0.0", bytes(codec.encode(np.ascontiguousarray(SAMPLES[8 * n : 8 * n + 8])))) for n in range(2)
            ]:
                store.writestr(zipfile.ZipInfo(file), content)


if __name__ == "__main__":
    OUT.mkdir(parents=True, exist_ok=True)
    tiff()
    whole_files()
    vti()
    zarr()
