#!/usr/bin/env python3
"""Compares archives with compressed volumes: bytes at the same RMS error, and the surfaces that come of them.

    compare.py VOLUME... [--generated] [--targets 0.5,1,2,4] [--surfaces] [--figure FILE.png] [--json FILE]

A VOLUME is a file that VTK or NumPy reads (nii.gz, nhdr, nrrd, mha, vtk, vti, slc, npy, npz, tif); NAME=FILE names it.
Targets are RMS errors over all samples in percent of the range of values. Each coder is asked for more and more error
until the target lies between two answers; bits a sample are interpolated between these (both in logarithms).

* *isospan*: `reduce --points lattice --target-rms`. All files of the archive count. Its error is that of the values that
  `probe` finds at all samples.
* *hammersley*: `reduce --points hammersley`, exact values, at 4, 2, 1, 1/2, ... of the samples.
* *SZ3*, *SPERR*: HDF5 filters of hdf5plugin, whole and in chunks of 32^3 (what lets them read a part).
* *ZFP*: zfpy, with an absolute tolerance. *TTHRESH*: numcodecs-wasm-tthresh, with a relative error.
* *voxels*: every k-th sample along each axis, compressed with xz, and trilinear values between.

With --surfaces, for the first target that is 1 or more: the surface at two isovalues (35 and 60 % of the way through the
range of the middle 98 % of the samples), beside vtkFlyingEdges3D on all samples: mean, RMS and largest distance to it
in samples, mean angle between normals in degrees, components, Euler number, bytes read, CPU seconds from the files.

Needs cargo, or a built program (--program), and the Python packages below: where they are missing, a virtual
environment is made in target/compare_bytes and they are installed there from PyPI.
"""
import argparse
import contextlib
import json
import lzma
import math
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = pathlib.Path(subprocess.check_output([ROOT / "tools/target_folder"], text=True).strip())
# numcodecs cannot read the version of zfpy's later build.
PACKAGES = ["numpy", "h5py", "hdf5plugin", "zfpy==1.0.1", "numcodecs-wasm-tthresh", "vtk", "matplotlib"]

try:
    import h5py
    import hdf5plugin
    import numpy as np
    import vtk
    import zfpy
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy
except ImportError:
    folder = TARGET / "compare_bytes"
    python = folder / "bin/python"
    if pathlib.Path(sys.prefix) == folder:
        raise
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    os.execv(python, [python, __file__, *sys.argv[1:]])


# ---------------------------------------------------------------- volumes

READERS = {
    ".nii.gz": vtk.vtkNIFTIImageReader,
    ".nhdr": vtk.vtkNrrdReader,
    ".nrrd": vtk.vtkNrrdReader,
    ".mha": vtk.vtkMetaImageReader,
    ".vtk": vtk.vtkStructuredPointsReader,
    ".vti": vtk.vtkXMLImageDataReader,
    ".slc": vtk.vtkSLCReader,
}


def load(path):
    """The samples of a volume, z y x."""
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
    yield "marschner-lobb", ((1 - np.sin(np.pi * z / 2) + 0.25 * (1 + rho)) / 2.5).astype(np.float32)
    t = 3 * np.pi
    gyroid = np.sin(t * x) * np.cos(t * y) + np.sin(t * y) * np.cos(t * z) + np.sin(t * z) * np.cos(t * x)
    yield "gyroid", gyroid.astype(np.float32)
    random = np.random.default_rng(1)
    spectrum = np.fft.rfftn(random.standard_normal((96, 96, 96)))
    k = np.sqrt(sum(f**2 for f in np.meshgrid(*[np.fft.fftfreq(96) * 96] * 2, np.fft.rfftfreq(96) * 96, indexing="ij")))
    turbulence = np.fft.irfftn(spectrum * np.maximum(k, 1) ** (-11 / 6), s=(96, 96, 96))
    yield "turbulence", turbulence.astype(np.float32)


# ---------------------------------------------------------------- coders


class CoderFailed(Exception):
    """A coder gave no answer."""


class Answer:
    """What a coder made: bytes, decoded samples, CPU seconds."""

    def __init__(self, size, samples, write, read):
        self.size, self.samples, self.write, self.read = size, samples, write, read


def timed(work):
    start = time.process_time()
    return work(), time.process_time() - start


class Hdf5:
    def __init__(self, options, chunk):
        self.options, self.chunk = options, chunk

    def __call__(self, samples, error, scratch):
        path = scratch / "peer.h5"
        chunks = samples.shape if self.chunk is None else tuple(min(self.chunk, n) for n in samples.shape)

        def write():
            with h5py.File(path, "w") as file:
                file.create_dataset("v", data=samples, chunks=chunks, **self.options(error))
                size = file["v"].id.get_storage_size()
            return size

        def read():
            # Opened again: the cache of chunks has what was written.
            with h5py.File(path, "r") as file:
                return file["v"][:]

        size, seconds = timed(write)
        back, seconds_back = timed(read)
        return Answer(size, back, seconds, seconds_back)


def zfp(samples, error, _):
    data, write = timed(lambda: zfpy.compress_numpy(samples, tolerance=error))
    back, read = timed(lambda: zfpy.decompress_numpy(data))
    return Answer(len(data), back, write, read)


def tthresh(samples, error, _):
    coder = Tthresh(eb_mode="rmse", eb_rmse=error)
    try:
        with quiet():
            data, write = timed(lambda: coder.encode(samples))
            back, read = timed(lambda: coder.decode(data))
    except Exception as failure:  # its WebAssembly runs out of memory, or does not say why
        raise CoderFailed(str(failure)) from failure
    return Answer(len(bytes(data)), np.asarray(back).reshape(samples.shape), write, read)


@contextlib.contextmanager
def quiet():
    """TTHRESH writes what it does to standard output."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        with contextlib.redirect_stdout(None):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def load_tthresh():
    try:
        from numcodecs_wasm_tthresh import Tthresh as coder
    except Exception as error:  # a package of this name may be broken in many ways
        print(f"TTHRESH is left out: {error}", file=sys.stderr)
        return None
    return coder


def voxels(samples, step, _):
    """Every step-th sample along each axis, and the last one."""
    at = [np.unique(np.append(np.arange(0, n, step), n - 1)) for n in samples.shape]
    fewer = np.ascontiguousarray(samples[np.ix_(*at)])
    data, write = timed(lambda: lzma.compress(fewer.tobytes(), preset=6))

    def read():
        values = np.frombuffer(lzma.decompress(data), samples.dtype).reshape(fewer.shape).astype(np.float32)
        for axis in range(3):
            to = np.arange(samples.shape[axis])
            i = np.clip(np.searchsorted(at[axis], to, side="right") - 1, 0, len(at[axis]) - 2)
            part = (to - at[axis][i]) / (at[axis][i + 1] - at[axis][i])
            shape = [1, 1, 1]
            shape[axis] = -1
            part = part.reshape(shape).astype(np.float32)
            values = np.take(values, i, axis) * (1 - part) + np.take(values, i + 1, axis) * part
        return values

    back, seconds = timed(read)
    return Answer(len(data), back, write, seconds)


def cpu_of(command):
    process = subprocess.Popen([str(c) for c in command], stdout=subprocess.PIPE)
    output = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, command)
    return output, usage.ru_utime + usage.ru_stime


def folder_bytes(folder):
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


class Isospan:
    """The last option takes what is asked for."""

    def __init__(self, program, options):
        self.program, self.options = program, options

    def __call__(self, samples, asked, scratch):
        source, archive, values = scratch / "source.npy", scratch / "a.isospan", scratch / "values.npy"
        command = [self.program, "-q", "reduce", source, "-o", archive, "--force", *self.options]
        _, write = cpu_of([*command, asked])
        dims = ",".join(str(n) for n in samples.shape[::-1])
        _, read = cpu_of([self.program, "-q", "probe", archive, "--grid", dims, "-o", values, "--force"])
        return Answer(folder_bytes(archive), np.load(values).reshape(samples.shape), write, read)


def lattice(program):
    return Isospan(program, ["--points", "lattice", "--target-rms"])


# ---------------------------------------------------------------- bytes at an error


def rms(samples, back):
    difference = back.astype(np.float64) - samples
    return math.sqrt(np.mean(difference**2)), float(np.abs(difference).max())


class Curve:
    """Answers of a coder, by what it was asked for."""

    def __init__(self, name, coder, samples, scratch):
        self.name, self.coder, self.samples, self.scratch = name, coder, samples, scratch
        self.answers = {}

    def ask(self, setting):
        if setting not in self.answers:
            answer = self.coder(self.samples, setting, self.scratch)
            error, most = rms(self.samples, answer.samples)
            self.answers[setting] = (error, most, answer.size, answer.write, answer.read)
        return self.answers[setting]

    def between(self, target):
        """(bits a sample, largest error, CPU to write, to read) at an RMS error; None where no two answers enclose it."""
        points = sorted(self.answers.values())
        below = [p for p in points if p[0] <= target]
        above = [p for p in points if p[0] >= target]
        if not below or not above:
            return None
        a, b = min(below, key=lambda p: (p[2], -p[0])), above[0]
        if below[-1][0] > 0:
            a = below[-1]
        part = 0.0
        if a[0] > 0 and b[0] > a[0]:
            part = math.log(target / a[0]) / math.log(b[0] / a[0])
        size = math.exp((1 - part) * math.log(a[2]) + part * math.log(b[2]))
        return (8 * size / self.samples.size, *(max(a[k], b[k]) for k in (1, 3, 4)))

    def search(self, target):
        """Asks a coder with an error bound until two answers within a tenth enclose the target."""
        setting, low, high = target * 2, None, None
        for _ in range(14):
            try:
                error = self.ask(setting)[0]
            except CoderFailed as failure:
                print(f"{self.name}: {failure}", file=sys.stderr)
                return None
            if error <= target:
                low = setting
            if error >= target:
                high = setting
            if low is not None and high is not None:
                if self.ask(high)[0] < 1.1 * max(self.ask(low)[0], 1e-300) or high < 1.02 * low:
                    break
                setting = math.sqrt(low * high)
            else:
                setting = low * 2 if high is None else high / 2
        return self.between(target)


def peers(names):
    sperr = lambda error: hdf5plugin.Sperr(absolute=error, swap=True)
    sz3 = lambda error: hdf5plugin.SZ3(absolute=error)
    all_of_them = {
        "SZ3": Hdf5(sz3, None),
        "SZ3, chunks": Hdf5(sz3, 32),
        "SPERR": Hdf5(sperr, None),
        "SPERR, chunks": Hdf5(sperr, 32),
        "ZFP": zfp,
    }
    if Tthresh is not None:
        all_of_them["TTHRESH"] = tthresh
    return {name: coder for name, coder in all_of_them.items() if not names or name in names}


def bytes_of(name, samples, settings, scratch):
    """Rows of one volume: coder, target, bits a sample and so on."""
    values = samples.astype(np.float32)
    extent = float(values.max() - values.min())
    np.save(scratch / "source.npy", values)
    rows = []

    def add(coder, target, found):
        if found is not None:
            bits, most, write, read = found
            rows.append(dict(volume=name, coder=coder, target=target, bits=bits, largest=100 * most / extent, write=write, read=read))

    ours = Curve("isospan", lattice(settings.program), values, scratch)
    even = Curve("hammersley", Isospan(settings.program, ["--points", "hammersley", "--fraction"]), values, scratch)
    fractions = [2.0**-k for k in range(-2, settings.halvings + 1) if samples.size * 2.0**-k >= 500]
    for target in settings.targets:
        error, most, size, write, read = ours.ask(f"{target}%")
        if error <= 1.001 * target / 100 * extent:
            add("isospan", target, (8 * size / samples.size, most, write, read))
        for fraction in fractions:
            if even.ask(fraction)[0] > target / 100 * extent:
                break
        add("hammersley", target, even.between(target / 100 * extent))
    for coder, make in peers(settings.peers).items():
        curve = Curve(coder, make, values, scratch)
        for target in settings.targets:
            add(coder, target, curve.search(target / 100 * extent))
    curve = Curve("voxels", voxels, samples, scratch)
    for step in range(1, 9):
        curve.ask(step)
    for target in settings.targets:
        add("voxels", target, curve.between(target / 100 * extent))
    return rows


# ---------------------------------------------------------------- surfaces


def contour(samples, isovalue):
    image = vtk.vtkImageData()
    image.SetDimensions(samples.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(samples, np.float32).ravel(), deep=True))
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, isovalue)
    edges.ComputeNormalsOff()
    edges.Update()
    return edges.GetOutput()


def triangles(surface):
    return vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)


def describe(surface, reference):
    """Distances from the vertices of a surface to the reference, and what it is."""
    points = vtk_to_numpy(surface.GetPoints().GetData()).astype(float)
    cells = triangles(surface)
    normal = lambda p, t: np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])
    theirs = normal(vtk_to_numpy(reference.GetPoints().GetData()).astype(float), triangles(reference))
    mine = normal(points, cells)
    locator = vtk.vtkStaticCellLocator()
    locator.SetDataSet(reference)
    locator.BuildLocator()
    chosen = np.random.default_rng(0).permutation(len(cells))[:20000]
    close, cell, distance2 = [0.0] * 3, vtk.reference(0), vtk.reference(0.0)
    where = vtk.reference(0)
    found, angles = [], []
    for t in chosen:
        locator.FindClosestPoint(points[cells[t]].mean(axis=0), close, cell, where, distance2)
        found.append(math.sqrt(distance2.get()))
        a, b = mine[t], theirs[cell.get()]
        length = np.linalg.norm(a) * np.linalg.norm(b)
        if length > 0:
            angles.append(math.degrees(math.acos(min(1.0, abs(float(a @ b)) / length))))
    parts = vtk.vtkPolyDataConnectivityFilter()
    parts.SetInputData(surface)
    parts.SetExtractionModeToAllRegions()
    parts.Update()
    edges = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    euler = len(np.unique(cells)) - len(np.unique(edges, axis=0)) + len(cells)
    found = np.array(found)
    return dict(
        triangles=len(cells), mean=found.mean(), rms=math.sqrt((found**2).mean()), most=found.max(),
        angle=float(np.mean(angles)), components=parts.GetNumberOfExtractedRegions(), euler=int(euler),
    )


def surfaces_of(name, samples, settings, scratch):
    values = samples.astype(np.float32)
    extent = float(values.max() - values.min())
    percent = next((t for t in settings.targets if t >= 1), settings.targets[-1])
    target = percent / 100 * extent
    low, high = np.percentile(values, [1, 99])
    np.save(scratch / "source.npy", values)
    made = {}
    for coder, make in peers(settings.peers).items():
        curve = Curve(coder, make, values, scratch)
        curve.search(target)
        kept = [s for s, a in curve.answers.items() if a[0] <= target]
        if kept:
            made[coder] = make(values, max(kept, key=lambda s: curve.answers[s][0]), scratch)
    rows = []
    for part in (0.35, 0.6):
        isovalue = float(low + part * (high - low))
        reference = contour(values, isovalue)
        if reference.GetNumberOfPolys() == 0:
            continue
        about = dict(volume=name, isovalue=isovalue)
        rows.append(dict(**about, coder="all samples", **describe(reference, reference), size=4 * values.size, read=4 * values.size, seconds=0.0))
        archive, file = scratch / "a.isospan", scratch / "a.ply"
        size = lattice(settings.program)(values, f"{percent}%", scratch).size
        command = [settings.program, "-q", "surface", archive, f"--isovalue={isovalue}", "-o", file, "--json", "--force"]
        output, seconds = cpu_of(command)
        reader = vtk.vtkPLYReader()
        reader.SetFileName(str(file))
        reader.Update()
        read = json.loads(output)["bytes_read"]
        ours = describe(reader.GetOutput(), reference)
        rows.append(dict(**about, coder="isospan", **ours, size=size, read=read, seconds=seconds))
        for coder, answer in made.items():
            surface, seconds = timed(lambda: contour(answer.samples, isovalue))
            if surface.GetNumberOfPolys() == 0:
                continue
            rows.append(dict(**about, coder=coder, **describe(surface, reference), size=answer.size, read=answer.size, seconds=answer.read + seconds))
    return rows


# ---------------------------------------------------------------- tables


def table(rows, targets):
    coders = list(dict.fromkeys(r["coder"] for r in rows))
    volumes = list(dict.fromkeys(r["volume"] for r in rows))
    found = {(r["volume"], r["coder"], r["target"]): r["bits"] for r in rows}
    for target in targets:
        print(f"\nBits a sample at an RMS error of {target:g} % of the range\n")
        print("| volume | " + " | ".join(coders) + " |\n|" + "---|" * (len(coders) + 1))
        for volume in volumes:
            cells = [found.get((volume, coder, target)) for coder in coders]
            print(f"| {volume} | " + " | ".join("-" if c is None else f"{c:.3g}" for c in cells) + " |")
        means = []
        for coder in coders:
            ratios = [
                math.log(found[v, "isospan", target] / found[v, coder, target])
                for v in volumes
                if (v, coder, target) in found and (v, "isospan", target) in found
            ]
            means.append("-" if not ratios else f"{math.exp(sum(ratios) / len(ratios)):.2f} ({len(ratios)})")
        print("| isospan's bytes to theirs, geometric mean (volumes) | " + " | ".join(means) + " |")


def surface_table(rows):
    print("\n| volume, isovalue | coder | bytes | mean, RMS, largest distance | normals | components | Euler | triangles | bytes read | CPU s |")
    print("|" + "---|" * 10)
    for r in rows:
        print(
            f"| {r['volume']}, {r['isovalue']:.4g} | {r['coder']} | {r['size']} | {r['mean']:.3f}, {r['rms']:.3f}, {r['most']:.2f} | {r['angle']:.1f} "
            f"| {r['components']} | {r['euler']} | {r['triangles']} | {r['read']} | {r['seconds']:.2f} |"
        )


def figure(rows, path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    volumes = list(dict.fromkeys(r["volume"] for r in rows))
    coders = list(dict.fromkeys(r["coder"] for r in rows))
    across = min(4, len(volumes))
    down = -(-len(volumes) // across)
    sheet, panels = pyplot.subplots(down, across, figsize=(4 * across, 3.2 * down), squeeze=False)
    for panel in panels.flat[len(volumes):]:
        panel.axis("off")
    handles = {}
    for panel, volume in zip(panels.flat, volumes):
        for k, coder in enumerate(coders):
            line = sorted((r["bits"], r["target"]) for r in rows if r["volume"] == volume and r["coder"] == coder)
            if line:
                width = 2.4 if coder == "isospan" else 1
                handles[coder] = panel.loglog(*zip(*line), f"C{k}", marker="o", markersize=3, linewidth=width)[0]
        panel.set_title(volume, fontsize=9)
        panel.tick_params(labelsize=7)
    panels[0][0].set_xlabel("bits a sample", fontsize=8)
    panels[0][0].set_ylabel("RMS error, % of the range", fontsize=8)
    panels[0][0].legend(list(handles.values()), list(handles), fontsize=6)
    sheet.tight_layout()
    sheet.savefig(path, dpi=130)


def main():
    global Tthresh
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("volumes", nargs="*", help="files, or NAME=FILE")
    parser.add_argument("--generated", action="store_true", help="three made volumes of 96^3 samples too")
    parser.add_argument("--targets", type=lambda text: [float(t) for t in text.split(",")], default=[0.5, 1.0, 2.0, 4.0])
    parser.add_argument("--halvings", type=int, default=9, help="the least fraction of Hammersley points is 2 to minus this")
    parser.add_argument("--peers", type=lambda text: text.split(";"), default=[], help='some of the others: "SZ3;SPERR, chunks"')
    parser.add_argument("--surfaces", action="store_true")
    parser.add_argument("--figure", type=pathlib.Path)
    parser.add_argument("--json", type=pathlib.Path, help="writes all rows")
    parser.add_argument("--program", type=pathlib.Path, help="isospan, built already")
    parser.add_argument("--scratch", type=pathlib.Path)
    settings = parser.parse_args()
    if settings.program is None:
        subprocess.run(["cargo", "build", "--locked", "--release"], cwd=ROOT, check=True)
        settings.program = TARGET / "release/isospan"
    Tthresh = load_tthresh()

    def named():
        for text in settings.volumes:
            name, _, file = text.rpartition("=")
            path = pathlib.Path(file)
            yield name or path.name.split(".")[0], load(path)
        if settings.generated:
            yield from generated()

    rows, surfaces = [], []
    for name, samples in named():
        samples = np.ascontiguousarray(samples)
        scratch = pathlib.Path(tempfile.mkdtemp(prefix="compare_bytes.", dir=settings.scratch))
        try:
            rows += bytes_of(name, samples, settings, scratch)
            if settings.surfaces:
                surfaces += surfaces_of(name, samples, settings, scratch)
        finally:
            shutil.rmtree(scratch)
        print(f"{name}: done", file=sys.stderr)
        if settings.json:
            settings.json.write_text(json.dumps(dict(bytes=rows, surfaces=surfaces), indent=1))
    table(rows, settings.targets)
    if surfaces:
        surface_table(surfaces)
    if settings.figure:
        figure(rows, settings.figure)


main()
