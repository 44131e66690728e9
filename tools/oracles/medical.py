"""NIfTI and MINC by nibabel, DICOM by pydicom and highdicom, ITK's formats by SimpleITK, NRRD by pynrrd."""

from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pydicom
import SimpleITK as sitk
from highdicom import AlgorithmIdentificationSequence, sr
from highdicom.pm import ParametricMap, RealWorldValueMapping
from highdicom.seg import Segmentation, SegmentDescription
from pydicom.data import get_testdata_file
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, RLELossless, generate_uid

from placing import SHAPE, Case, Refused, affine, along, grid, numbers, program, rotation

# Turned, with an axis that counts down, and a spacing of each axis.
OBLIQUE = np.eye(4)
OBLIQUE[:3, :3] = rotation(20, -35, 50) @ np.diag([0.7, -1.25, 2.5])
OBLIQUE[:3, 3] = -40.5, 12.25, 300


def image(path, frames=None, **more):
    """A file as nibabel reads it; `frames` are the times of its last axis."""
    read = nibabel.load(path)
    values, places = read.get_fdata(), affine(read.affine, read.shape[:3])
    if frames is None:
        return Case(path, values, places, **more)
    return Case(path, np.moveaxis(values, 3, 0), places, times=tuple(frames), **more)


@program("nibabel")
def nifti(at):
    for n, dtype in enumerate(("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")):
        kind = nibabel.Nifti2Image if n % 2 else nibabel.Nifti1Image
        for order, suffix in ("<", ".nii"), (">", ".nii.gz"):
            path = at / f"{dtype}{'le' if order == '<' else 'be'}{suffix}"
            header = kind.header_class(endianness=order)
            header.set_data_dtype(order + dtype)
            kind(numbers(dtype), OBLIQUE, header).to_filename(path)
            yield image(path)
    scaled = nibabel.Nifti1Image(numbers("f4"), OBLIQUE)
    scaled.header.set_data_dtype("i2")
    scaled.header.set_xyzt_units("micron", "msec")
    scaled.to_filename(at / "scaled.nii")
    yield image(at / "scaled.nii", length="um")
    slope = nibabel.Nifti1Pair(numbers("f4"), OBLIQUE)
    slope.header.set_data_dtype("u1")
    slope.header.set_slope_inter(0.25, -4)
    slope.to_filename(at / "slope.img")
    yield image(at / "slope.hdr")
    turned = nibabel.Nifti1Image(numbers("f4"), OBLIQUE)
    turned.set_sform(None, 0)
    turned.set_qform(OBLIQUE, 1)
    turned.to_filename(at / "qform.nii")
    yield image(at / "qform.nii")
    # Both: the affine map is used, here a sheared one.
    sheared = OBLIQUE.copy()
    sheared[:3, 0] += 0.4 * sheared[:3, 1]
    turned.set_sform(sheared, 2)
    turned.to_filename(at / "both.nii.gz")
    yield image(at / "both.nii.gz")
    # Neither: the spacing alone. (nibabel supposes a map of its own.)
    plain = nibabel.Nifti1Image(numbers("f4"), None)
    plain.header.set_zooms((0.5, 2, 3))
    plain.header.set_xyzt_units("meter")
    plain.to_filename(at / "neither.nii")
    yield Case(at / "neither.nii", numbers("f4"), affine(np.diag([0.5, 2, 3, 1]), SHAPE), length="m")


@program("nibabel")
def nifti_frames(at):
    values = numbers("i2", (*SHAPE, 3))
    for kind, suffix in (nibabel.Nifti1Image, "nii"), (nibabel.Nifti1Pair, "img"), (nibabel.Nifti2Image, "nii.gz"):
        series = kind(values, OBLIQUE)
        series.header.set_zooms((0.7, 1.25, 2.5, 1.5))
        series.header.set_xyzt_units("mm", "sec")
        series.header["toffset"] = 10
        path = at / f"{kind.__name__}.{suffix}"
        series.to_filename(path)
        yield image(path, (10, 11.5, 13), length="mm", time="s")
    vectors = nibabel.Nifti1Image(numbers("f4", (*SHAPE, 1, 3)), OBLIQUE)
    vectors.to_filename(at / "vectors.nii")
    yield Refused(at / "vectors.nii", "vector|several numbers|components")
    nibabel.Nifti1Image(numbers("f4").astype("c8"), OBLIQUE).to_filename(at / "complex.nii")
    yield Refused(at / "complex.nii", "complex")


@program("nibabel")
def nibabel_files(at):
    data = Path(nibabel.__file__).parent / "tests" / "data"
    for name in "anatomical.nii", "standard.nii.gz", "resampled_anat_moved.nii":
        yield image(data / name)
    for name in "functional.nii", "example_nifti2.nii.gz":
        read = nibabel.load(data / name)
        step, start = read.header.get_zooms()[3], float(read.header["toffset"])
        yield image(data / name, [start + step * t if step else None for t in range(read.shape[3])])
    for name in (
        "tiny.mnc",
        "small.mnc",
        "minc1_1_scale.mnc",
        "minc1-no-att.mnc",
        "minc2_1_scale.mnc",
        "minc2-no-att.mnc",
    ):
        yield image(data / name)
    for name in "minc1_4d.mnc", "minc2_4d.mnc", "minc2-4d-d.mnc":
        # Time is the first axis.
        read = nibabel.load(data / name)
        time = read.dataobj.minc_file._dims[0]
        times = tuple(time.start + time.step * t for t in range(read.shape[0]))
        yield Case(data / name, read.get_fdata(), affine(read.affine, read.shape[1:]), times=times)
    for name, words in {
        "test.mgz": "MGH|FreeSurfer",
        "analyze.hdr": "Analyze",
        "example4d+orig.HEAD": "AFNI",
        "example4d+orig.BRIK.gz": "AFNI",
        "phantom_EPI_asc_CLEAR_2_1.PAR": "PAR",
        "tinypet.v": "ECAT",
    }.items():
        yield Refused(data / name, words)


def slice_of_ct(number, values, matrix):
    """A slice, whose places are the columns of a matrix: along columns, rows and slices."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = CTImageStorage, generate_uid()
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    one = FileDataset(None, {}, file_meta=meta, preamble=b"\0" * 128)
    one.SOPClassUID, one.SOPInstanceUID = CTImageStorage, meta.MediaStorageSOPInstanceUID
    one.Modality, one.SeriesInstanceUID, one.StudyInstanceUID = "CT", "1.2.3.4", "1.2.3"
    one.FrameOfReferenceUID, one.InstanceNumber = "1.2.5", 1 + (number * 7) % 11
    one.PatientID, one.PatientName, one.PatientBirthDate, one.PatientSex = "1", "A^B", "", ""
    one.StudyDate, one.StudyTime, one.AccessionNumber, one.StudyID = "20200101", "120000", "", ""
    one.ReferringPhysicianName = ""
    spacing = np.linalg.norm(matrix[:3, :2], axis=0)
    one.SliceThickness = 2.5
    one.PixelSpacing = [float(f"{s:.10g}") for s in spacing[::-1]]
    one.ImageOrientationPatient = [float(f"{v:.12g}") for v in (matrix[:3, :2] / spacing).T.ravel()]
    one.ImagePositionPatient = [float(f"{v:.12g}") for v in matrix[:3, 3] + number * matrix[:3, 2]]
    one.Rows, one.Columns = values.shape
    one.SamplesPerPixel, one.PhotometricInterpretation = 1, "MONOCHROME2"
    bits = 8 * values.dtype.itemsize
    one.BitsAllocated, one.BitsStored, one.HighBit = bits, bits, bits - 1
    one.PixelRepresentation = int(values.dtype.kind == "i")
    one.PixelData = values.tobytes()
    return one


# Of scanners: oblique, with slices along the normal.
SCANNER = np.eye(4)
SCANNER[:3, :3] = rotation(10, 25, -15) @ np.diag([0.75, 1.5, -2.5])
SCANNER[:3, 3] = -110.5, 80.25, 40


@program("pydicom")
def dicom(at):
    # Places of an array [slice, row, column].
    columns = SCANNER[:, [2, 1, 0, 3]]
    for dtype in "u1", "u2", "i2", "i4":
        folder = at / dtype
        folder.mkdir()
        for n, values in enumerate(numbers(dtype)):
            slice_of_ct(n, values, SCANNER).save_as(folder / f"{(n * 3) % 5}.dcm", enforce_file_format=True)
        yield Case(folder, numbers(dtype), affine(columns, SHAPE), length="mm")
    folder = at / "scaled"
    folder.mkdir()
    stored = numbers("u2") >> 4
    for n, values in enumerate(stored):
        one = slice_of_ct(n, values, SCANNER)
        one.BitsStored, one.HighBit, one.RescaleSlope, one.RescaleIntercept, one.RescaleType = 12, 11, 0.5, -1024, "HU"
        one.PixelPaddingValue = int(stored.min())
        one["PixelPaddingValue"].VR = "US"
        one.save_as(folder / f"{n}.dcm", enforce_file_format=True)
    values = np.where(stored == stored.min(), np.nan, stored * 0.5 - 1024)
    yield Case(folder, values, affine(columns, SHAPE), unit="HU", length="mm")
    packed = at / "packed"
    packed.mkdir()
    for n, values in enumerate(numbers("u2")):
        one = slice_of_ct(n, values, SCANNER)
        one.compress(RLELossless)
        one.save_as(packed / f"{n}.dcm", enforce_file_format=True)
    yield Refused(packed, "RLE")


@program("pydicom")
def dicom_frames(at):
    """Frames with places of their own, in another order than along the normal."""
    values = numbers("i2")
    order = [3, 0, 4, 1, 2]
    many = slice_of_ct(0, values[0], SCANNER)
    many.SOPClassUID = many.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2.1"
    many.NumberOfFrames, many.PixelData = len(values), values[order].tobytes()
    shared, frames = pydicom.Dataset(), []
    measures, orientation, scale = pydicom.Dataset(), pydicom.Dataset(), pydicom.Dataset()
    measures.PixelSpacing, measures.SliceThickness = many.PixelSpacing, 2.5
    orientation.ImageOrientationPatient = many.ImageOrientationPatient
    scale.RescaleSlope, scale.RescaleIntercept, scale.RescaleType = 2, -10, "HU"
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [orientation]
    shared.PixelValueTransformationSequence = [scale]
    for n in order:
        frame, place = pydicom.Dataset(), pydicom.Dataset()
        place.ImagePositionPatient = [float(f"{v:.12g}") for v in SCANNER[:3, 3] + n * SCANNER[:3, 2]]
        frame.PlanePositionSequence = [place]
        frames.append(frame)
    many.SharedFunctionalGroupsSequence, many.PerFrameFunctionalGroupsSequence = [shared], frames
    del many.PixelSpacing, many.ImageOrientationPatient, many.ImagePositionPatient
    many.save_as(at / "many.dcm", enforce_file_format=True)
    yield Case(at / "many.dcm", values * 2.0 - 10, affine(SCANNER[:, [2, 1, 0, 3]], SHAPE), unit="HU", length="mm")


def dose(path):
    """Doses by radiation, as pydicom reads them."""
    read = pydicom.dcmread(path)
    spacing, first = [float(s) for s in read.PixelSpacing], [float(p) for p in read.ImagePositionPatient]
    places = along(
        first[0] + spacing[1] * np.arange(read.Columns),
        first[1] + spacing[0] * np.arange(read.Rows),
        first[2] + np.array(read.GridFrameOffsetVector, float),
    )
    return Case(path, read.pixel_array * float(read.DoseGridScaling), places, length="mm")


@program("pydicom")
def pydicom_files(at):
    yield dose(Path(get_testdata_file("rtdose.dcm")))
    for name, words in {
        "CT_small.dcm": "slice|one image",
        "JPEG2000.dcm": "JPEG",
        "examples_rgb_color.dcm": "RGB|colour",
        "SC_rgb_rle_2frame.dcm": "RLE|RGB|colour",
    }.items():
        yield Refused(Path(get_testdata_file(name)), words)


def segment(kind):
    """A sphere in numbers of slices of CT, and the slices."""
    slices = [slice_of_ct(n, values, SCANNER) for n, values in enumerate(numbers("u2"))]
    z, y, x = np.mgrid[: SHAPE[0], : SHAPE[1], : SHAPE[2]]
    far = np.sqrt((z - 2) ** 2 + (y - 2.5) ** 2 + (x - 3) ** 2)
    part = np.clip(1.2 - far / 4, 0.1, 1) if kind == "FRACTIONAL" else (far < 2.3)
    return slices, part


@program("highdicom")
def dicom_segments(at):
    for kind in "BINARY", "FRACTIONAL":
        slices, part = segment(kind)
        code = sr.CodedConcept("91723000", "SCT", "Anatomical structure")
        algorithm = AlgorithmIdentificationSequence("a", code, "1")
        describe = SegmentDescription(1, "ball", code, code, "AUTOMATIC", algorithm)
        made = Segmentation(
            slices, part.astype("f4") if kind == "FRACTIONAL" else part.astype("u1"), kind, [describe],
            generate_uid(), 1, generate_uid(), 1, "m", "m", "1", "1", omit_empty_frames=False,
            max_fractional_value=200,
        )  # fmt: skip
        path = at / f"{kind}.dcm"
        made.save_as(path)
        if kind == "BINARY":
            yield Refused(path, "bit")
        else:
            stored = np.round(part.astype("f4") * 200) / 200
            yield Case(path, stored, affine(SCANNER[:, [2, 1, 0, 3]], SHAPE), length="mm")


@program("highdicom")
def dicom_maps(at):
    for dtype, number in ("u2", int), ("f4", float):
        slices, values = segment("BINARY")[0], numbers(dtype)
        mapping = RealWorldValueMapping(
            lut_label="m",
            lut_explanation="m",
            unit=sr.CodedConcept("s", "UCUM", "second"),
            value_range=(number(values.min()), number(values.max())),
            slope=0.5,
            intercept=-7,
        )
        made = ParametricMap(
            slices, values[..., None], generate_uid(), 1, generate_uid(), 1, "m", "m", "1", "1",
            contains_recognizable_visual_features=False, real_world_value_mappings=[[mapping]],
            window_center=0, window_width=1,
        )  # fmt: skip
        made.save_as(at / f"{dtype}.dcm")
        if dtype == "f4":
            yield Refused(at / "f4.dcm", "float")
        else:
            yield Case(at / "u2.dcm", values * 0.5 - 7, affine(SCANNER[:, [2, 1, 0, 3]], SHAPE), length="mm")


def itk_image(values, spacing=(0.7, 1.25, 2.5), origin=(-40.5, 12.25, 300), turn=True):
    picture = sitk.GetImageFromArray(values)
    picture.SetSpacing(spacing)
    picture.SetOrigin(origin)
    if turn:
        direction = rotation(20, -35, 50) @ np.diag([1, -1, -1])
        picture.SetDirection(direction.ravel().tolist())
    return picture


def as_itk_reads(path, sign=(1, 1, 1), **more):
    """A file as SimpleITK reads it, with axes turned by signs."""
    picture = sitk.ReadImage(str(path))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(picture.GetDirection()).reshape(3, 3) @ np.diag(picture.GetSpacing())
    matrix[:3, 3] = picture.GetOrigin()
    matrix[:3] *= np.array(sign)[:, None]
    values = sitk.GetArrayFromImage(picture)
    return Case(path, values, affine(matrix[:, [2, 1, 0, 3]], values.shape), **more)


@program("simpleitk")
def itk(at):
    for n, dtype in enumerate(("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")):
        for suffix, pack in ("mha", n % 2), ("mhd", (n + 1) % 2), ("nrrd", n % 2), ("nhdr", (n + 1) % 2), ("nii.gz", 0):
            path = at / f"{dtype}.{suffix}"
            sitk.WriteImage(itk_image(numbers(dtype)), str(path), bool(pack))
            # NIfTI counts to the right and front, ITK to the left and back.
            yield as_itk_reads(path, (-1, -1, 1) if suffix == "nii.gz" else (1, 1, 1))
    for dtype in "u1", "i2", "f4":
        for suffix in "vtk", "mrc", "h5", "img":
            path = at / f"{dtype}.{suffix}"
            sitk.WriteImage(itk_image(numbers(dtype), turn=suffix in ("h5", "img")), str(path))
            yield as_itk_reads(path, (-1, -1, 1) if suffix == "img" else (1, 1, 1))
    path = at / "slices"
    path.mkdir()
    picture = itk_image(numbers("i2"))
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    names = [str(path / f"{n}.dcm") for n in range(SHAPE[0])]
    for n, name in enumerate(names):
        one = picture[:, :, n]
        one.SetMetaData("0020|0032", "\\".join(f"{p:.9f}" for p in picture.TransformIndexToPhysicalPoint((0, 0, n))))
        direction = np.array(picture.GetDirection()).reshape(3, 3)
        one.SetMetaData("0020|0037", "\\".join(f"{d:.12f}" for d in direction[:, :2].T.ravel()))
        one.SetMetaData("0020|000e", "1.2.3")
        one.SetMetaData("0008|0060", "CT")
        one.SetMetaData("0008|0018", f"1.2.3.{n}")
        writer.SetFileName(name)
        writer.Execute(one)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = direction @ np.diag(picture.GetSpacing()), picture.GetOrigin()
    yield Case(path, numbers("i2"), affine(matrix[:, [2, 1, 0, 3]], SHAPE), length="mm")


@program("simpleitk")
def itk_refused(at):
    picture = itk_image(numbers("f4"))
    vectors = sitk.Compose(picture, picture, picture)
    for suffix in "mha", "nrrd", "nii", "vtk", "h5":
        sitk.WriteImage(vectors, str(at / f"vectors.{suffix}"))
        yield Refused(at / f"vectors.{suffix}", "vector|component|channels|several numbers|numbers of each")
    sitk.WriteImage(picture, str(at / "a.gipl"))
    yield Refused(at / "a.gipl", "GIPL")


@program("simpleitk")
def itk_frames(at):
    series = sitk.JoinSeries([itk_image(v) for v in numbers("f4", (3, *SHAPE))], 20.0, 1.5)
    # Its NRRD has a space of four dimensions.
    for suffix in "mha", "nii", "nrrd":
        path = at / f"frames.{suffix}"
        sitk.WriteImage(series, str(path))
        values, places = as_itk_reads_first(path, (-1, -1, 1) if suffix == "nii" else (1, 1, 1))
        # The origin of NIfTI's fourth axis is lost.
        yield Case(path, values, places, times=(None,) * 3 if suffix == "nii" else (20, 21.5, 23))


def as_itk_reads_first(path, sign):
    """All frames, and the places of the first one."""
    series = sitk.ReadImage(str(path))
    first = series[:, :, :, 0]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(first.GetDirection()).reshape(3, 3) @ np.diag(first.GetSpacing())
    matrix[:3, 3] = first.GetOrigin()
    matrix[:3] *= np.array(sign)[:, None]
    values = sitk.GetArrayFromImage(series)
    return values, affine(matrix[:, [2, 1, 0, 3]], values.shape[1:])


def oblique_nrrd(**more):
    return {
        "space": "left-posterior-superior",
        "space directions": OBLIQUE[:3, :3].T,
        "space origin": OBLIQUE[:3, 3],
        "kinds": ["domain"] * 3,
        **more,
    }


@program("pynrrd")
def nrrd_files(at):
    for n, dtype in enumerate(("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")):
        for m, encoding in enumerate(("raw", "gzip", "ascii")):
            order = "<>"[(n + m) % 2]
            path = at / f"{dtype}_{encoding}.{'nhdr' if (n + m) % 3 == 0 else 'nrrd'}"
            head = oblique_nrrd(encoding=encoding, endian="little" if order == "<" else "big")
            nrrd.write(str(path), numbers(order + dtype), head)
            values, found = nrrd.read(str(path))
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = found["space directions"].T, found["space origin"]
            yield Case(path, values, affine(matrix, SHAPE))
    spaced = {"spacings": [0.5, 2, 3], "units": ["mm"] * 3}
    nrrd.write(str(at / "spacings.nrrd"), numbers("f4"), spaced)
    yield Case(at / "spacings.nrrd", numbers("f4"), affine(np.diag([0.5, 2, 3, 1]), SHAPE), length="mm")
    mixed = oblique_nrrd(**{"space units": ["mm", "mm", "um"], "space directions": np.diag([2.0, 3, 4])})
    nrrd.write(str(at / "mixed.nrrd"), numbers("f4"), mixed)
    matrix = np.diag([2.0, 3, 0.004, 1])
    matrix[:3, 3] = OBLIQUE[:3, 3] * [1, 1, 0.001]
    yield Case(at / "mixed.nrrd", numbers("f4"), affine(matrix, SHAPE), length="mm")
    # [z, y, x], as most of Python has it.
    nrrd.write(str(at / "c.nrrd"), numbers("i2"), {"spacings": [1, 2, 3]}, index_order="C")
    yield Case(at / "c.nrrd", numbers("i2"), grid((1, 2, 3)))
    nrrd.write(str(at / "bzip2.nrrd"), numbers("i2"), {"encoding": "bzip2"})
    yield Refused(at / "bzip2.nrrd", "bzip2")


@program("pynrrd")
def nrrd_frames(at):
    values = numbers("f4", (*SHAPE, 3))
    none = [np.nan] * 3
    matrix = np.vstack([OBLIQUE[:3, :3].T, none])
    head = oblique_nrrd(**{"space directions": matrix, "kinds": ["domain"] * 3 + ["time"]})
    nrrd.write(str(at / "last.nrrd"), values, head)
    yield Case(at / "last.nrrd", np.moveaxis(values, 3, 0), affine(OBLIQUE, SHAPE), times=(None,) * 3)
    values = numbers("i2", (4, *SHAPE))
    head = oblique_nrrd(
        **{"space directions": np.vstack([none, OBLIQUE[:3, :3].T]), "kinds": ["list"] + ["domain"] * 3}
    )
    nrrd.write(str(at / "first.nrrd"), values, {**head, "encoding": "raw"})
    yield Case(at / "first.nrrd", values, affine(OBLIQUE, SHAPE), times=(None,) * 4)
    nrrd.write(str(at / "packed.nrrd"), values, head)
    yield Refused(at / "packed.nrrd", "interleaved")
    head["kinds"][0] = "vector"
    nrrd.write(str(at / "vector.nrrd"), values, head)
    yield Refused(at / "vector.nrrd", "vector|component|numbers of each|kind")
