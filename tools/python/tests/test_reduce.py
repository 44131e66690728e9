"""Archives that Python makes are those that the program makes."""

import _thread
import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from conftest import TOOTH, field, same_files

import isospan

CHOICES = [
    ({}, []),
    (
        {"fraction": "1/8", "points": "halton", "adapt": True},
        ["--fraction=1/8", "--points=halton", "--adapt"],
    ),
    (
        {"fraction": 0.3, "points": "regular", "values": "sample"},
        ["--fraction=0.3", "--points=regular", "--values=sample"],
    ),
    (
        {"count": 400, "points": "hammersley", "shift": 0.25},
        ["--count=400", "--points=hammersley", "--shift=0.25"],
    ),
    ({"target_rms": "2%", "focus": (-0.5, 1)}, ["--target-rms=2%", "--focus=-0.5:1"]),
    ({"target_max": 0.2}, ["--target-max=0.2"]),
    ({"focus": "50%:100%", "fraction": "1/16"}, ["--focus=50%:100%", "--fraction=1/16"]),
    ({"shift": 0.5}, ["--shift=0.5"]),
    ({"ratio": 7}, ["--ratio=7"]),
    ({"size": "8KiB", "count": None}, ["--size=8KiB"]),
    ({"points": "pyramid"}, ["--points=pyramid"]),
    ({"points": "pyramid", "target_max": "2%"}, ["--points=pyramid", "--target-max=2%"]),
    (
        {"points": "regular", "value_bits": 10, "chunk_points": 500},
        ["--points=regular", "--value-bits=10", "--chunk-points=500"],
    ),
    (
        {"points": "halton", "value_bits": 12, "interp": "cubic", "measure": False},
        ["--points=halton", "--value-bits=12", "--interp=cubic", "--no-measure"],
    ),
    (
        {"points": "hyperbolic-cross", "cross_r": (1, 1, 2), "threads": 1, "memory": "256MiB"},
        ["--points=hyperbolic-cross", "--cross-r=1,1,2"],
    ),
    (
        {"missing": -1, "nan": "mask", "keyframes": 2},
        ["--missing=-1", "--nan=mask", "--keyframes=2"],
    ),
]


@pytest.fixture(scope="module")
def volume(tmp_path_factory):
    path = tmp_path_factory.mktemp("volume") / "field.npy"
    np.save(path, field(shape=(10, 14, 12)))
    return path


@pytest.mark.parametrize(
    "keywords, flags", CHOICES, ids=lambda c: "-".join(c) if isinstance(c, dict) else ""
)
def test_bytes_are_those_of_the_program(volume, program, tmp_path, keywords, flags):
    program("reduce", volume, "-o", tmp_path / "p.isospan", *flags)
    archive = isospan.reduce(volume, tmp_path / "s.isospan", **keywords)
    assert same_files(tmp_path / "p.isospan", tmp_path / "s.isospan", but=())
    assert archive.report["points"] == archive.info["points"]


@pytest.mark.parametrize(
    "keywords, flags",
    [
        ({}, []),
        ({"points": "halton", "fraction": "1/4"}, ["--points=halton", "--fraction=1/4"]),
        ({"points": "hammersley", "target_rms": "5%"}, ["--points=hammersley", "--target-rms=5%"]),
        ({"size": "4KiB"}, ["--size=4KiB"]),
    ],
)
def test_a_plan_is_that_of_the_program(volume, program, tmp_path, keywords, flags):
    out = tmp_path / "a.isospan"
    flags = [*flags, "--memory=256MiB", "--dry-run", "--json"]
    expected = program("reduce", volume, "-o", out, *flags)
    found = isospan.plan(volume, out, memory="256MiB", **keywords)
    of_array = isospan.plan(np.load(volume), out, memory="256MiB", **keywords)
    assert found.pop("refused") is None and of_array.pop("refused") is None
    # What is free changes from moment to moment, and flags have the words of the program.
    notices = [
        [(n["kind"], n["path"]) for n in report.pop("notices")] for report in (expected, found)
    ]
    assert notices[0] == notices[1]
    for report in (expected, found):
        report.pop("archive_free"), report.pop("scratch_free")
    assert found == expected and found["samples"] == 10 * 14 * 12
    assert of_array["archive_bytes"] == expected["archive_bytes"]
    assert not out.exists()


def test_a_plan_says_what_is_refused(volume, tmp_path):
    found = isospan.plan(volume, tmp_path / "a.isospan", memory="10kB")
    assert found["workers"] == 0 and "memory" in found["refused"]
    with pytest.raises(isospan.BudgetError) as caught:
        isospan.reduce(volume, tmp_path / "a.isospan", memory="10kB")
    assert str(caught.value) == found["refused"]


TARGETS = [
    ({"target_rms": "8%"}, ["--target-rms=8%"]),
    ({"target_max": "45%"}, ["--target-max=45%"]),
    ({"size": "20KiB"}, ["--size=20KiB"]),
    ({"ratio": 1.5}, ["--ratio=1.5"]),
]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    import pyvista

    path = tmp_path_factory.mktemp("mesh") / "field.vtu"
    grid = pyvista.ImageData(dimensions=(12, 12, 12)).to_tetrahedra()
    x, y, z = grid.points.T / 14
    grid["field"] = np.sin(5 * x) + y * y - 0.5 * z
    grid.save(path)
    return path


@pytest.mark.parametrize("kind", ["volume", "mesh"])
@pytest.mark.parametrize("keywords, flags", TARGETS, ids=lambda c: "-".join(c))
def test_targets_have_the_bytes_of_the_program(
    request, program, tmp_path, kind, keywords, flags
):
    source = request.getfixturevalue(kind)
    program("reduce", source, "-o", tmp_path / "p.isospan", *flags)
    archive = isospan.reduce(source, tmp_path / "s.isospan", **keywords)
    assert archive.target_met
    assert same_files(tmp_path / "p.isospan", tmp_path / "s.isospan", but=())


@pytest.mark.parametrize(
    "keywords, flags",
    [
        ({"isovalue": [0.1, 0.3]}, ["--isovalue=0.1,0.3"]),
        (
            {"isovalue": 0.1, "target_surface": 0.05},
            ["--isovalue=0.1", "--target-surface=0.05"],
        ),
    ],
)
def test_surfaces_are_measured_as_by_the_program(volume, program, tmp_path, keywords, flags):
    told = program("reduce", volume, "-o", tmp_path / "p.isospan", "--json", *flags)
    archive = isospan.reduce(volume, tmp_path / "s.isospan", **keywords)
    assert same_files(tmp_path / "p.isospan", tmp_path / "s.isospan", but=())
    surfaces = archive.report["surfaces"]
    assert surfaces == told["surfaces"]
    assert len(surfaces) == np.size(keywords["isovalue"])
    if "target_surface" in keywords:
        assert archive.target_met


def test_a_target_of_a_surface_needs_its_isovalue(volume, tmp_path):
    with pytest.raises(isospan.UsageError, match="isovalue"):
        isospan.reduce(volume, tmp_path / "a.isospan", target_surface=0.05)
    assert not (tmp_path / "a.isospan").exists()


def test_whole_numbers_without_loss_have_the_bytes_of_the_program(program, tmp_path):
    np.save(tmp_path / "v.npy", np.round(100 * field(shape=(10, 14, 12))).astype(np.int16))
    program("reduce", tmp_path / "v.npy", "-o", tmp_path / "p.isospan", "--lossless")
    archive = isospan.reduce(tmp_path / "v.npy", tmp_path / "s.isospan", lossless=True)
    assert archive.target_met
    assert same_files(tmp_path / "p.isospan", tmp_path / "s.isospan", but=())


def test_messages_name_keywords(volume, tmp_path):
    out = tmp_path / "a.isospan"
    refused = [
        ({"fraction": 0.5}, r'fraction is for point sets.* add points="hammersley"'),
        ({"points": "regular", "adapt": True}, r'adapt does not go with points="regular"'),
        ({"fraction": 0.5, "count": 7}, "'fraction' cannot be used with 'count'"),
        ({"target_rms": 1, "measure": False}, "'target_rms' cannot be used with 'measure=False'"),
        ({"interp": "nearest", "points": "regular", "values": "fit"}, r'values="sample", or interp="linear"'),
    ]
    for keywords, words in refused:
        with pytest.raises(isospan.UsageError, match=words) as caught:
            isospan.reduce(volume, out, **keywords)
        assert "--" not in str(caught.value) and "`" not in str(caught.value)
    isospan.reduce(volume, out)
    with pytest.raises(isospan.UsageError, match="or force=True to replace it"):
        isospan.reduce(volume, out, points="regular")


def test_a_target_that_is_not_met_is_a_warning(volume, tmp_path):
    for _ in range(2):
        with pytest.warns(isospan.TargetNotMet, match="a.isospan: written, but .* not met"):
            archive = isospan.reduce(
                volume, tmp_path / "a.isospan", points="hammersley", target_rms="1e-9%"
            )
        assert archive.target_met is False and not archive.report["target"]["met"]
    with warnings.catch_warnings():
        warnings.simplefilter("error", isospan.TargetNotMet)
        with pytest.raises(isospan.TargetNotMet):
            isospan.reduce(volume, tmp_path / "b.isospan", size="100B")
        assert isospan.reduce(volume, tmp_path / "c.isospan", target_rms="5%").target_met is True
    assert isospan.open(tmp_path / "b.isospan").target_met is None
    assert isospan.reduce(volume, tmp_path / "d.isospan", points="regular").target_met is None


def test_progress_names_the_try(volume, tmp_path):
    heard = []
    isospan.reduce(
        volume,
        tmp_path / "a.isospan",
        points="hammersley",
        target_rms="2%",
        progress=lambda stage, *_: heard.append(stage),
    )
    assert any(stage.startswith("try 2 of about ") for stage in heard), heard


def test_the_defaults_are_those_of_the_program(program, tmp_path):
    np.save(tmp_path / "v.npy", field())
    expected = program("reduce", tmp_path / "v.npy", "-o", tmp_path / "p.isospan", "--json")
    report = isospan.reduce(tmp_path / "v.npy", tmp_path / "s.isospan").report
    # Notices name settings as each says them: flags there, keywords here.
    [told], [here] = expected.pop("notices"), report.pop("notices")
    assert told.pop("text").endswith("--spacing X,Y,Z gives another")
    assert here.pop("text").endswith("spacing=(X, Y, Z) gives another")
    assert here == told
    assert report == {**expected, "seconds": report["seconds"]}
    assert same_files(tmp_path / "p.isospan", tmp_path / "s.isospan", but=())


def test_files_with_keywords_of_reading(program, tmp_path):
    field().astype(">i2").tofile(tmp_path / "v.raw")
    flags = ["--dims=20,24,18", "--type=int16", "--endian=big", "--spacing=1,2,0.5"]
    program("reduce", tmp_path / "v.raw", "-o", tmp_path / "p.isospan", *flags)
    archive = isospan.reduce(
        tmp_path / "v.raw",
        tmp_path / "s.isospan",
        dims=(20, 24, 18),
        type="int16",
        endian="big",
        spacing=(1, 2, 0.5),
    )
    assert same_files(tmp_path / "p.isospan", tmp_path / "s.isospan", but=())
    assert archive.spacing == (1, 2, 0.5)


def test_series_and_append(series, program, folder, tmp_path):
    steps = [folder / f"step_{n}.npy" for n in range(3)]
    isospan.reduce(steps[:2], tmp_path / "a.isospan", points="regular", fraction="1/2", times=(0, 0.5))
    archive = isospan.append(tmp_path / "a.isospan", [steps[2]], times="2")
    assert [s["time"] for s in archive.steps] == [0, 0.5, 2]
    np.testing.assert_array_equal(
        archive.surface(0.25, step=2).faces, series.surface(0.25, step=2).faces
    )
    again = isospan.append(archive, steps[2], times=[2.0])
    assert again.report["made_before"]


def test_force_and_made_before(volume, tmp_path):
    first = isospan.reduce(volume, tmp_path / "a.isospan", points="regular", fraction="1/4")
    assert not first.report["made_before"]
    assert isospan.reduce(volume, tmp_path / "a.isospan", points="regular", fraction="1/4").report["made_before"]
    with pytest.raises(isospan.UsageError):
        isospan.reduce(volume, tmp_path / "a.isospan", points="regular", fraction="1/2")
    isospan.reduce(volume, tmp_path / "a.isospan", points="regular", fraction="1/2", force=True)


def test_progress(volume, tmp_path):
    heard = []
    isospan.reduce(volume, tmp_path / "a.isospan", progress=lambda *told: heard.append(told))
    assert heard and all(isinstance(stage, str) and 0 <= done for stage, done, _, _ in heard)
    assert any(done == total > 0 for _, done, total, _ in heard)
    isospan.reduce(volume, tmp_path / "b.isospan", progress=True)

    class Stop(Exception):
        pass

    def stop(*_told):
        raise Stop

    with pytest.raises(Stop):
        isospan.reduce(TOOTH, tmp_path / "c.isospan", points="regular", fraction=1, progress=stop)
    assert not (tmp_path / "c.isospan/manifest.zst").exists()


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c(tmp_path):
    timer = threading.Timer(0.3, _thread.interrupt_main)
    timer.start()
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        isospan.reduce(TOOTH, tmp_path / "a.isospan", target_rms="0.1%")
    assert time.monotonic() - started < 20
    assert not (tmp_path / "a.isospan/manifest.zst").exists()


def test_other_threads_go_on_meanwhile(tmp_path):
    ticks, end = [], threading.Event()

    def tick():
        while not end.wait(0.005):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    isospan.reduce(TOOTH, tmp_path / "a.isospan", points="regular", fraction="1/64")
    end.set()
    thread.join()
    assert len(ticks) > 10


def test_exceptions_by_kind(volume, tooth, tmp_path):
    with pytest.raises(isospan.UsageError, match="fraction") as caught:
        isospan.reduce(volume, tmp_path / "a.isospan", fraction="x")
    assert caught.value.exit_code == 2 and isinstance(caught.value, ValueError)
    with pytest.raises(isospan.UsageError, match="points"):
        isospan.reduce(volume, tmp_path / "a.isospan", points="grid")
    with pytest.raises(isospan.UsageError, match="cannot be used with"):
        isospan.reduce(volume, tmp_path / "a.isospan", fraction=0.5, count=7)
    with pytest.raises(TypeError):
        isospan.reduce(volume, tmp_path / "a.isospan", fractoin=0.5)
    (tmp_path / "bad.npy").write_bytes(b"\x93NUMPY\x01\x00nothing")
    with pytest.raises(isospan.BadInputError) as caught:
        isospan.reduce(tmp_path / "bad.npy", tmp_path / "a.isospan")
    error = caught.value
    assert isinstance(error, (ValueError, isospan.Error)) and error.exit_code == 5
    assert (
        str(error.file) == str(tmp_path / "bad.npy") and error.expected and error.got and error.at
    )
    with pytest.raises(isospan.BudgetError) as caught:
        isospan.reduce(TOOTH, tmp_path / "a.isospan", memory=1000)
    assert isinstance(caught.value, MemoryError) and caught.value.needed > caught.value.available
    assert caught.value.resource == "memory" and caught.value.purpose == ""
    with pytest.raises(isospan.FileError) as caught:
        isospan.reduce(tmp_path / "nothing.nrrd", tmp_path / "a.isospan")
    assert isinstance(caught.value, OSError) and caught.value.errno == 2 and caught.value.doing
    assert str(caught.value.file) == str(tmp_path / "nothing.nrrd")
    with pytest.raises(isospan.UsageError, match="create it first"):
        tooth.surface(1000.5).save(tmp_path / "none" / "s.ply")
    with pytest.raises(isospan.Error) as caught:
        isospan.open(tmp_path / "nothing.isospan")
    assert str(caught.value.file) == str(tmp_path / "nothing.isospan")
    import pickle

    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error) and again.at == error.at and str(again) == str(error)


def test_notices_are_warnings(tmp_path):
    samples = field(shape=(40, 40, 40))
    samples[:20] = -9999
    np.save(tmp_path / "v.npy", samples)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        archive = isospan.reduce(tmp_path / "v.npy", tmp_path / "a.isospan")
    assert [n["text"] for n in archive.report["notices"]] == [str(w.message) for w in caught]
    assert caught and caught[0].category is isospan.Notice


def test_the_program_of_the_package(program, tooth, tmp_path):
    module = [sys.executable, "-m", "isospan"]
    done = subprocess.run([*module, "info", tooth.path, "--json"], capture_output=True, text=True)
    about = {"schema": "isospan.info.archive", "version": 1}
    assert done.returncode == 0 and json.loads(done.stdout) == {**about, **tooth.info}
    done = subprocess.run([*module, "-V"], capture_output=True, text=True)
    assert done.stdout == program("-V").strip() + "\n"
    assert done.stdout.split()[1] == isospan.__version__
    done = subprocess.run([*module, "info", tmp_path / "nothing"], capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.startswith("isospan: error: ")
    done = subprocess.run([*module, "reduce"], capture_output=True, text=True)
    assert done.returncode == 2


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_the_program_of_the_package_is_stopped_by_signals(tmp_path):
    arguments = ["reduce", str(TOOTH), "-o", str(tmp_path / "a.isospan"), "--target-rms", "0.1%", "-v"]
    process = subprocess.Popen(
        [sys.executable, "-m", "isospan", *arguments], stderr=subprocess.PIPE
    )
    # Its first line comes when it listens to signals.
    assert b"--memory" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 75, errors
