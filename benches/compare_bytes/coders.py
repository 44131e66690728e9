"""Coders of volumes: each takes a volume and a setting, and gives bytes and decoded samples."""
import contextlib
import itertools
import json
import lzma
import os
import subprocess
import sys
import time

import h5py
import hdf5plugin
import numpy as np
import vtk
import zfpy

CHUNK = 32


class CoderFailed(Exception):
    """A coder gave no answer."""


class Answer:
    """What a coder made: bytes, decoded samples, CPU seconds to write and to read."""

    def __init__(self, size, samples, write, read):
        self.size, self.samples, self.write, self.read = size, samples, write, read


def timed(work):
    start = time.process_time()
    return work(), time.process_time() - start


# ---------------------------------------------------------------- HDF5


def sz3(error):
    return hdf5plugin.SZ3(absolute=error)


def sperr(error):
    # The filter takes the axis that varies fastest first, HDF5 last.
    return hdf5plugin.Sperr(absolute=error, swap=True)


def sperr_of_rate(samples_a_bit):
    return hdf5plugin.Sperr(rate=1 / samples_a_bit, swap=True)


def whole(shape):
    """(box, chunks) of one dataset for all samples, in one chunk."""
    yield (...,), shape


def padded(shape):
    """A filter of HDF5. The bytes are those of the chunks, without what says where they are."""
    yield (...,), tuple(min(CHUNK, n) for n in shape)


def chunks(shape):
    """A dataset for each chunk, in its true shape."""
    starts = (range(0, n, CHUNK) for n in shape)
    for corner in itertools.product(*starts):
        box = tuple(slice(a, min(a + CHUNK, n)) for a, n in zip(corner, shape))
        yield box, tuple(part.stop - part.start for part in box)


class Hdf5:
    """A filter of HDF5. The bytes are those of the chunks; what says where they are is left out."""

    def __init__(self, options, datasets):
        self.options, self.datasets = options, datasets

    def __call__(self, volume, setting, scratch):
        path = scratch / "peer.h5"
        values = volume.values
        datasets = list(self.datasets(values.shape))

        def write():
            size = 0
            with h5py.File(path, "w") as file:
                for k, (box, shape) in enumerate(datasets):
                    # SPERR refuses rows of samples, and single ones.
                    plain = sum(n > 1 for n in shape) < 2
                    options = {} if plain else self.options(setting)
                    made = file.create_dataset(str(k), data=values[box], chunks=shape, **options)
                    size += made.id.get_storage_size()
            return size

        def read():
            back = np.empty_like(values)
            # Opened again: the cache of chunks has what was written.
            with h5py.File(path, "r") as file:
                for k, (box, _) in enumerate(datasets):
                    back[box] = file[str(k)][:]
            return back

        size, seconds = timed(write)
        back, seconds_back = timed(read)
        return Answer(size, back, seconds, seconds_back)


# ---------------------------------------------------------------- others


def zfp(volume, error, _):
    data, write = timed(lambda: zfpy.compress_numpy(volume.values, tolerance=error))
    back, read = timed(lambda: zfpy.decompress_numpy(data))
    return Answer(len(data), back, write, read)


def load_tthresh():
    """The coder TTHRESH, or None."""
    try:
        from numcodecs_wasm_tthresh import Tthresh
    except Exception as error:  # a package of this name may be broken in many ways
        print(f"TTHRESH is left out: {error}", file=sys.stderr)
        return None

    def tthresh(volume, error, _):
        coder = Tthresh(eb_mode="rmse", eb_rmse=error)
        try:
            with quiet():
                data, write = timed(lambda: coder.encode(volume.values))
                back, read = timed(lambda: coder.decode(data))
        except Exception as failure:  # its WebAssembly runs out of memory, or does not say why
            raise CoderFailed(str(failure)) from failure
        return Answer(len(bytes(data)), np.asarray(back).reshape(volume.values.shape), write, read)

    return tthresh


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


def voxels(volume, step, _):
    """Every step-th sample along each axis, and the last one."""
    samples = volume.samples
    at = [np.unique(np.append(np.arange(0, n, step), n - 1)) for n in samples.shape]
    fewer = np.ascontiguousarray(samples[np.ix_(*at)])
    data, write = timed(lambda: lzma.compress(fewer.tobytes(), preset=6))

    def read():
        values = np.frombuffer(lzma.decompress(data), samples.dtype)
        values = values.reshape(fewer.shape).astype(np.float32)
        for axis in range(3):
            to = np.arange(samples.shape[axis])
            last = max(len(at[axis]) - 2, 0)
            i = np.clip(np.searchsorted(at[axis], to, side="right") - 1, 0, last)
            j = np.minimum(i + 1, len(at[axis]) - 1)
            part = (to - at[axis][i]) / np.maximum(at[axis][j] - at[axis][i], 1)
            shape = [1, 1, 1]
            shape[axis] = -1
            part = part.reshape(shape).astype(np.float32)
            values = np.take(values, i, axis) * (1 - part) + np.take(values, j, axis) * part
        return values

    back, seconds = timed(read)
    return Answer(len(data), back, write, seconds)


# ---------------------------------------------------------------- isospan


def cpu_of(command):
    """What a program prints, and its CPU seconds."""
    process = subprocess.Popen([str(c) for c in command], stdout=subprocess.PIPE)
    output = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise CoderFailed(f"{' '.join(map(str, command))}: exit code {process.returncode}")
    return output, usage.ru_utime + usage.ru_stime


class Wavelet:
    """The crate isospan-wavelet: a compressed array, by the step of its quantiser."""

    def __init__(self, program):
        self.program = program

    def __call__(self, volume, step, scratch):
        source, made, back = scratch / "source.f32", scratch / "made", scratch / "back.f32"
        volume.values.astype("<f4").tofile(source)
        dims = volume.values.shape[::-1]
        _, write = cpu_of([self.program, "compress", source, *dims, f"{step:.9g}", made])
        _, read = cpu_of([self.program, "decode", made, 0, back])
        decoded = np.fromfile(back, "<f4").reshape(volume.values.shape)
        return Answer(made.stat().st_size, decoded, write, read)


def folder_bytes(folder):
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


class Isospan:
    """An archive. The last of the options of `reduce` takes the setting."""

    def __init__(self, program, options):
        self.program, self.options = program, options

    def __call__(self, volume, asked, scratch):
        source, archive = scratch / "source.npy", scratch / "a.isospan"
        values = scratch / "values.npy"
        if not source.exists():
            np.save(source, volume.values)
        reduce = [self.program, "-q", "reduce", source, "-o", archive, "--force"]
        _, write = cpu_of([*reduce, *self.options, asked])
        dims = ",".join(str(n) for n in volume.values.shape[::-1])
        probe = [self.program, "-q", "probe", archive, "--grid", dims, "-o", values, "--force"]
        _, read = cpu_of(probe)
        back = np.load(values).reshape(volume.values.shape)
        return Answer(folder_bytes(archive), back, write, read)

    def surface(self, isovalue, scratch):
        """The surface of the archive made last, bytes read, CPU seconds."""
        archive, file = scratch / "a.isospan", scratch / "a.ply"
        command = [self.program, "-q", "surface", archive, f"--isovalue={isovalue}", "-o", file]
        output, seconds = cpu_of([*command, "--json", "--force"])
        reader = vtk.vtkPLYReader()
        reader.SetFileName(str(file))
        reader.Update()
        return reader.GetOutput(), json.loads(output)["bytes_read"], seconds
