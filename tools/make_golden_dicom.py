#!/usr/bin/env python3
"""Writes tests/data/dicom, small DICOM files of pydicom for the tests of src/io/formats/volume/dicom.

Needs pydicom and numpy. Sample (z, y, x) is 20 z + 5 y + x, where z counts along the normal of the slices.
Usage: tools/make_golden_dicom.py
"""
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import (
    BasicTextSRStorage,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    ParametricMapStorage,
    RTDoseStorage,
    SegmentationStorage,
)

OUT = Path(__file__).resolve().parent.parent / "tests" / "data" / "dicom"
CT, ENHANCED = "1.2.840.10008.5.1.4.1.1.2", "1.2.840.10008.5.1.4.1.1.2.1"
# Rows go along y of the patient, columns along -z: the normal is -x.
ORIENTATION = [0, 1, 0, 0, 0, -1]
SLICE = np.arange(20).reshape(4, 5)


def position(z):
    return [100 - 2.5 * z, -7.25, 30.5]


def new(name, kind, syntax):
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = kind
    meta.MediaStorageSOPInstanceUID = "1.2.3." + str(sum(name.encode()))
    meta.TransferSyntaxUID = syntax
    data = FileDataset(
        None,
        {},
        preamble=b"\0" * 128,
        file_meta=meta,
        is_implicit_VR=syntax == ImplicitVRLittleEndian,
        is_little_endian=syntax != ExplicitVRBigEndian,
    )
    data.SOPClassUID, data.SOPInstanceUID = kind, meta.MediaStorageSOPInstanceUID
    data.SeriesInstanceUID = "1.2.3.4"
    data.PatientName = "Phantom"
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.Rows, data.Columns = SLICE.shape
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 12, 11, 1
    return data


def save(data, name):
    data.save_as(OUT / name, enforce_file_format=True)


def series():
    """Five slices, in an order that is not that of their names, each in another syntax."""
    (OUT / "series").mkdir(exist_ok=True)
    syntaxes = [ExplicitVRLittleEndian, ImplicitVRLittleEndian, ExplicitVRBigEndian]
    for z, name in enumerate(["b", "e", "a", "d", "c"]):
        data = new(name, CT, syntaxes[z % 3])
        data.ImagePositionPatient, data.ImageOrientationPatient = position(z), ORIENTATION
        data.PixelSpacing = [0.5, 0.75]
        data.RescaleSlope, data.RescaleIntercept = 2, -1024
        # A sequence whose items have the elements of an image too.
        icon = Dataset()
        icon.Rows, icon.Columns = 1, 2
        data.IconImageSequence = Sequence([icon])
        data["IconImageSequence"].is_undefined_length = z % 2 == 0
        samples = (SLICE + 20 * z - 30).astype("i2")
        # Bits above those that are stored belong to overlays.
        samples = (samples.view("u2") & 0x0FFF | 0x5000).astype("<u2")
        big = syntaxes[z % 3] == ExplicitVRBigEndian
        data.PixelData = (samples.byteswap() if big else samples).tobytes()
        data["PixelData"].VR = "OW"
        save(data, "series/" + name)


def enhanced(name, slopes):
    """Frames in the reverse order, with functional groups."""
    data = new(name, ENHANCED, ExplicitVRLittleEndian)
    data.BitsStored, data.HighBit, data.PixelRepresentation, data.PixelPaddingValue = 16, 15, 0, 59
    data.NumberOfFrames = 3
    group, measures, plane = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, plane.ImageOrientationPatient = [0.5, 0.75], ORIENTATION
    group.PixelMeasuresSequence, group.PlaneOrientationSequence = Sequence([measures]), Sequence([plane])
    data.SharedFunctionalGroupsSequence = Sequence([group])
    frames = []
    for z, slope in zip((2, 1, 0), slopes):
        frame, place, values = Dataset(), Dataset(), Dataset()
        place.ImagePositionPatient = position(z)
        values.RescaleSlope, values.RescaleIntercept = slope, 1
        frame.PlanePositionSequence, frame.PixelValueTransformationSequence = Sequence([place]), Sequence([values])
        frames.append(frame)
    data.PerFrameFunctionalGroupsSequence = Sequence(frames)
    data.PixelData = np.stack([SLICE + 20 * z for z in (2, 1, 0)]).astype("<u2").tobytes()
    data["PixelData"].VR = "OW"
    save(data, name)


def dose(name, orientation, position, offsets):
    """A dose grid of three frames: 32 bits, a scale, and offsets of the frames."""
    data = new(name, RTDoseStorage, ImplicitVRLittleEndian)
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 32, 32, 31, 0
    data.ImagePositionPatient, data.ImageOrientationPatient = position, orientation
    data.PixelSpacing, data.NumberOfFrames = [0.5, 0.75], len(offsets)
    data.FrameIncrementPointer, data.GridFrameOffsetVector = 0x3004000C, offsets
    data.DoseUnits, data.DoseType, data.DoseGridScaling = "GY", "PHYSICAL", "2.5e-4"
    data.PixelData = np.stack([SLICE + 20 * z for z in range(len(offsets))]).astype("<u4").tobytes()
    data["PixelData"].VR = "OW"
    save(data, name)


def frames_of(kind, name, more=None):
    """A new file of two frames, with functional groups."""
    data = new(name, kind, ExplicitVRLittleEndian)
    data.NumberOfFrames = 2
    group, measures, plane = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, plane.ImageOrientationPatient = [0.5, 0.75], ORIENTATION
    group.PixelMeasuresSequence, group.PlaneOrientationSequence = Sequence([measures]), Sequence([plane])
    if more:
        group.RealWorldValueMappingSequence = Sequence([more])
    data.SharedFunctionalGroupsSequence = Sequence([group])
    frames = []
    for z in range(2):
        frame, place = Dataset(), Dataset()
        place.ImagePositionPatient = position(z)
        frame.PlanePositionSequence = Sequence([place])
        frames.append(frame)
    data.PerFrameFunctionalGroupsSequence = Sequence(frames)
    return data


def parametric_map(name):
    """A map whose values are 0.5 of the stored numbers, less 3."""
    mapping = Dataset()
    mapping.RealWorldValueSlope, mapping.RealWorldValueIntercept = 0.5, -3.0
    data = frames_of(ParametricMapStorage, name, mapping)
    data.PixelRepresentation = 0
    data.PixelData = np.stack([SLICE, SLICE + 20]).astype("<u2").tobytes()
    data["PixelData"].VR = "OW"
    save(data, name)


def fractions(name):
    """A segmentation of fractions, of 0 to 200."""
    data = frames_of(SegmentationStorage, name)
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 8, 8, 7, 0
    data.SegmentationType, data.SegmentationFractionalType = "FRACTIONAL", "OCCUPANCY"
    data.MaximumFractionalValue = 200
    data.PixelData = np.stack([10 * SLICE, SLICE]).astype("u1").tobytes()
    save(data, name)


def report(name):
    """A report, which is no image."""
    data = new(name, BasicTextSRStorage, ExplicitVRLittleEndian)
    for image in ["SamplesPerPixel", "PhotometricInterpretation", "Rows", "Columns", "BitsAllocated", "BitsStored"]:
        delattr(data, image)
    del data.HighBit, data.PixelRepresentation
    item = Dataset()
    item.RelationshipType, item.ValueType, item.TextValue = "CONTAINS", "TEXT", "nothing of note"
    data.ValueType, data.ContentSequence = "CONTAINER", Sequence([item])
    save(data, name)


if __name__ == "__main__":
    OUT.mkdir(parents=True, exist_ok=True)
    series()
    enhanced("enhanced.dcm", (1, 1, 1))
    enhanced("slopes.dcm", (1, 2, 4))
    transverse = [1, 0, 0, 0, 1, 0]
    dose("dose.dcm", ORIENTATION, position(0), [0, 2, 4])
    dose("dose_places.dcm", transverse, [-10, 20, -30.5], [-30.5, -28.5, -26.5])
    # Frames that go down, seen from the feet.
    dose("dose_feet.dcm", [-1, 0, 0, 0, 1, 0], [10, 20, 30.5], [30.5, 28.5, 26.5])
    fractions("fractions.dcm")
    parametric_map("map.dcm")
    report("report")
