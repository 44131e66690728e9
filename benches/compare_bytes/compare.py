#!/usr/bin/env python3
"""Compares archives with compressed volumes: bytes at the same RMS error, and the surfaces.

    compare.py VOLUME... [--generated] [--targets 0.5,1,2,4] [--surfaces [1,2]]
               [--ours NAME=OPTIONS]... [--coders "NAME;NAME"] [--figure FILE.png]
               [--json FILE] [--with FILE.json]...

A VOLUME is a file that VTK or NumPy reads (nii.gz, nhdr, nrrd, mha, vtk, vti, slc, npy, npz), or a
folder of tif files; NAME=FILE names it. Targets are RMS errors over all samples in percent of the
range of values. Each coder is asked for more and more error until the target lies between two
answers; bits a sample are interpolated between these (both in logarithms). CPU seconds to write and
to read are those of the answer that meets the target.

* *isospan*: `reduce --target-rms`, or what --ours says: `--ours "halton=--points halton"` makes a
  coder "halton", and --ours may be given several times. All files
  of the archive count. The samples are what `probe` finds at all places.
* *wavelet*: the crate isospan-wavelet, which an archive of volumes will use; its own bytes, whole.
* *SZ3*, *SPERR*: HDF5 filters of hdf5plugin, with an absolute bound, all samples at once. *Chunks*:
  each of 32^3 alone, what lets a part be read; those at upper ends are smaller. Each has a dataset
  with its true shape. *Padded chunks*: a dataset in chunks, which HDF5 pads at the upper ends.
  SPERR refuses rows of samples and single ones: such chunks are stored as they are. *SPERR, rate*:
  it gets a number of bits a sample, and no bound; only for all samples at once.
* *ZFP*: zfpy, with an absolute tolerance. *TTHRESH*: numcodecs-wasm-tthresh, with a relative error.
* *hammersley*: `reduce --points hammersley`, exact values, at 4, 2, 1, 1/2, ... of the samples.
* *voxels*: every k-th sample along each axis, compressed with xz, and trilinear values between.

With --surfaces, for targets of 1 and 2 % (or those given): the surfaces of decoded samples
(vtkFlyingEdges3D) at two isovalues (35 and 60 % of the way through the range of the middle 98 % of
the samples), and isospan's own surface, beside that of all samples: mean, RMS and largest distance
to it in samples, mean angle between triangles' normals in degrees, components, false islands
(components no vertex of which has a vertex of the true surface within 2 samples), Euler number,
bytes read, CPU seconds from the files. They are those of the answer that meets the target; where
its error is below half of it (k and ZFP's bounds are coarse) there are none.

Rows of earlier runs (--json) are added by --with, in the order that is given.

Needs cargo, or a built program (--program), and the Python packages below: where they are missing,
a virtual environment is made in target/compare_bytes and they are installed there from PyPI.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
# numcodecs cannot read the version of zfpy's later build.
PACKAGES = ["numpy", "scipy", "h5py", "hdf5plugin", "zfpy==1.0.1", "numcodecs-wasm-tthresh", "vtk"]
PACKAGES += ["matplotlib"]


def target_folder():
    answer = subprocess.check_output([ROOT / "tools/target_folder"], text=True)
    return pathlib.Path(answer.strip())


try:
    import coders
    import errors
    import figure
    import surfaces
    import tables
    import volumes
except ImportError:
    folder = target_folder() / "compare_bytes"
    python = folder / "bin/python"
    if pathlib.Path(sys.prefix) == folder:
        raise
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    os.execv(python, [python, __file__, *sys.argv[1:]])


def numbers(text):
    return [float(t) for t in text.split(",")]


def name_and_options(text):
    name, equals, options = text.partition("=")
    if not (name and equals and options.strip()):
        raise argparse.ArgumentTypeError(f'{text}: expected NAME=OPTIONS, as "a=--points halton"')
    return name, options.split()


def arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("volumes", nargs="*", help="files, or NAME=FILE")
    add("--generated", action="store_true", help="three made volumes of 96^3 samples too")
    add("--targets", type=numbers, default=[0.5, 1.0, 2.0, 4.0])
    add("--ours", type=name_and_options, action="append", metavar="NAME=OPTIONS",
        help="options of `reduce`, to which --target-rms is added [isospan=]")
    add("--coders", type=lambda text: text.split(";"), metavar="NAMES",
        help='some of the others: "SZ3;SPERR, chunks" [all]')
    add("--halvings", type=int, default=9,
        help="the least fraction of Hammersley points is 2 to minus this")
    add("--surfaces", type=numbers, nargs="?", const=[1.0, 2.0], default=[], metavar="TARGETS")
    add("--figure", type=pathlib.Path)
    add("--json", type=pathlib.Path, help="writes all rows")
    add("--with", type=pathlib.Path, action="append", default=[], dest="earlier",
        metavar="FILE", help="rows of an earlier run")
    add("--program", type=pathlib.Path, help="isospan, built already")
    add("--wavelet", type=pathlib.Path, help="the example `array` of isospan-wavelet, built already")
    add("--scratch", type=pathlib.Path)
    settings = parser.parse_args()
    settings.ours = settings.ours or [("isospan", [])]
    missing = [t for t in settings.surfaces if t not in settings.targets]
    settings.targets = sorted([*settings.targets, *missing])
    return settings


def all_coders(settings):
    """(name, coder, how its setting is found) of ours, and of those that are asked for."""
    program = settings.program
    for name, options in settings.ours:
        yield name, coders.Isospan(program, [*options, "--target-rms"]), errors.by_target
    Hdf5, bound = coders.Hdf5, errors.by_halves(lambda target: 2 * target)
    fractions = lambda volume: [
        f for k in range(-2, settings.halvings + 1) if volume.samples.size * (f := 2.0**-k) >= 500
    ]
    even = coders.Isospan(program, ["--points", "hammersley", "--fraction"])
    others = [
        ("hammersley", even, errors.by_steps(fractions)),
        ("wavelet", coders.Wavelet(settings.wavelet), errors.by_halves(lambda target: 5 * target)),
        ("SPERR", Hdf5(coders.sperr, coders.whole), bound),
        ("SPERR, rate", Hdf5(coders.sperr_of_rate, coders.whole), errors.by_halves(lambda _: 16.0)),
        ("SPERR, chunks", Hdf5(coders.sperr, coders.chunks), bound),
        ("SPERR, padded chunks", Hdf5(coders.sperr, coders.padded), bound),
        ("SZ3", Hdf5(coders.sz3, coders.whole), bound),
        ("SZ3, chunks", Hdf5(coders.sz3, coders.chunks), bound),
        ("ZFP", coders.zfp, bound),
        ("TTHRESH", None, bound),
        ("voxels", coders.voxels, errors.by_steps(lambda _: range(1, 9))),
    ]
    names = [name for name, _, _ in others]
    for name in settings.coders or []:
        if name not in names:
            sys.exit(f"--coders: {name} is none of {'; '.join(names)}")
    for name, coder, find in others:
        if settings.coders is None or name in settings.coders:
            coder = coders.load_tthresh() if name == "TTHRESH" else coder
            if coder is not None:
                yield name, coder, find


def named_volumes(settings):
    for text in settings.volumes:
        name, _, file = text.rpartition("=")
        path = pathlib.Path(file)
        yield volumes.Volume(name or path.name.split(".")[0], volumes.load(path))
    if settings.generated:
        yield from volumes.generated()


def measure(volume, some_coders, settings, scratch):
    """Rows of bytes and rows of surfaces of one volume."""
    of_bytes, of_surfaces = [], []
    truths = surfaces.truths(volume) if settings.surfaces else []
    of_surfaces += surfaces.true_rows(volume, truths)
    for name, coder, find in some_coders:
        curve = errors.Curve(name, coder, volume, scratch)
        for percent in settings.targets:
            target = percent / 100 * volume.extent
            point = errors.tried(curve, lambda: find(curve, target))
            if point is None:
                continue
            of_bytes.append(dict(
                volume=volume.name, coder=name, target=percent, samples=volume.samples.size,
                bits=8 * point.size / volume.samples.size,
                reached=100 * point.reached / volume.extent,
                largest=100 * point.largest / volume.extent, write=point.write, read=point.read,
            ))
            if percent in settings.surfaces and point.reached >= target / 2:
                about = dict(volume=volume.name, target=percent)
                about["reached"] = 100 * point.reached / volume.extent
                describe = lambda: surfaces.rows_of(
                    name, coder, curve.answer(target), about, truths, scratch
                )
                of_surfaces += errors.tried(curve, describe) or []
        print(f"{volume.name}, {name}: done", file=sys.stderr, flush=True)
    return of_bytes, of_surfaces


def keep(rows, file):
    if file:
        file.write_text(json.dumps(rows, indent=1))


def build(settings):
    """Builds the programs that are not given."""
    release = ["cargo", "build", "--locked", "--release"]
    if settings.program is None:
        subprocess.run(release, cwd=ROOT, check=True)
        settings.program = target_folder() / "release/isospan"
    if settings.wavelet is None and "wavelet" in (settings.coders or ["wavelet"]):
        example = ["--package", "isospan-wavelet", "--example", "array"]
        subprocess.run([*release, *example], cwd=ROOT, check=True)
        settings.wavelet = target_folder() / "release/examples/array"


def main():
    settings = arguments()
    if settings.volumes or settings.generated:
        build(settings)
    rows = dict(bytes=[], surfaces=[])
    for file in settings.earlier:
        for kind, more in json.loads(file.read_text()).items():
            rows[kind] += more
    some_coders = list(all_coders(settings))
    for volume in named_volumes(settings):
        with tempfile.TemporaryDirectory(prefix="compare_bytes.", dir=settings.scratch) as scratch:
            of_bytes, of_surfaces = measure(volume, some_coders, settings, pathlib.Path(scratch))
        rows["bytes"] += of_bytes
        rows["surfaces"] += of_surfaces
        keep(rows, settings.json)
    keep(rows, settings.json)
    ours = [name for name, _ in settings.ours]
    tables.tables_of_bytes(rows["bytes"], ours)
    if rows["surfaces"]:
        tables.tables_of_islands(rows["surfaces"])
        tables.table_of_surfaces(rows["surfaces"])
    if settings.figure:
        figure.draw(rows["bytes"], ours, settings.figure)


main()
