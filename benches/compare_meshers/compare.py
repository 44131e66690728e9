#!/usr/bin/env python3
"""Meshes the same points with HXT, CGAL, Geogram and isospan, one after the other and round by round, and prints a table of ratios.

    compare.py [--sets hammersley,halton,cross,regular] [--counts 62500,250000,1000000] [--threads 1,2] [--rounds 5] [--cpu]
               [--peers HXT,CGAL,Geogram|none] [--memory GIB]

Builds what it needs: isospan with cargo; CGAL with g++ (Debian: apt-get install g++ libcgal-dev libtbb-dev); HXT (in the PyPI
package gmsh) and Geogram (a static library in the PyPI package geogram) in a virtual environment where cargo builds, or in one given by
--python. A mesher that cannot be had is left out, saying why. Each figure is the median over the rounds. Wall seconds mean something on a
quiet machine only; with --cpu the CPU seconds of all threads are compared instead. With --memory each program gets so much address space:
one that needs more fails, and is left out of that row. --peers none runs isospan alone.

isospan meshes as one (kernel: one thread, memory reused) and in chunks (stage: samples of the boundary on top, halos and certification
included; its points a second are those of all points, boundary samples too; several threads work on several chunks). Files of
points hold f64 triples of multiples of 2^-24, so all mesh the same points.
"""
import argparse
import pathlib
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import venv

HERE = pathlib.Path(__file__).resolve().parent
CGAL_FLAGS = ["-march=native", "-frounding-math"]
PEERS = ["HXT", "CGAL", "Geogram"]
COLUMNS = [*PEERS, "kernel", "stage"]
CGAL_FLAGS += ["-DCGAL_LINKED_WITH_TBB", "-DCGAL_CONCURRENT_TRIANGULATION_3"]


def settings():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    numbers = lambda text: [int(n) for n in text.split(",")]
    parser.add_argument("--sets", type=lambda t: t.split(","), default="hammersley,halton,cross,regular".split(","))
    parser.add_argument("--counts", type=numbers, default=[62_500, 250_000, 1_000_000])
    parser.add_argument("--threads", type=numbers, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--chunk", type=int, default=250_000, help="points of a chunk, about")
    some = lambda text: [] if text == "none" else text.split(",")
    parser.add_argument("--peers", type=some, default=PEERS, help="those to compare with, or none")
    parser.add_argument("--memory", type=float, help="address space of each program in GiB; 10 million points take isospan 10")
    parser.add_argument("--cpu", action="store_true", help="compare CPU seconds, not wall seconds")
    parser.add_argument("--python", help="a Python that has numpy, gmsh and geogram")
    chosen = parser.parse_args()
    if unknown := set(chosen.peers) - set(PEERS):
        parser.error(f"--peers knows {', '.join(PEERS)} and none, not {', '.join(sorted(unknown))}")
    return chosen


def left_out(name, why):
    print(f"{name} is left out: {why}", file=sys.stderr)


def root():
    """Where the crate is."""
    found = ["cargo", "locate-project", "--workspace", "--message-format", "plain"]
    return pathlib.Path(subprocess.run(found, cwd=HERE, check=True, capture_output=True, text=True).stdout.strip()).parent


def target():
    """Where cargo builds."""
    return pathlib.Path(subprocess.check_output([root() / "tools/target_folder"], text=True).strip())


def environment():
    """A Python with the packages of HXT and Geogram, made where cargo builds at the first run."""
    folder = target() / "compare_meshers"
    python = folder / "bin/python"
    if not python.exists():
        venv.create(folder, with_pip=True, clear=True)
    for package in ["numpy", "gmsh", "geogram"]:
        pip = subprocess.run([python, "-m", "pip", "install", "--quiet", package], capture_output=True, text=True)
        if pip.returncode != 0:
            print(f"pip cannot install {package}:", *pip.stderr.strip().splitlines()[-1:], file=sys.stderr)
    return str(python)


def compile_cpp(name, flags, help_, program):
    """The command of a C++ program beside this file, or None."""
    if not shutil.which("g++"):
        return left_out(name, "there is no g++")
    run = subprocess.run(["g++", "-std=c++17", "-O3", "-DNDEBUG", *flags, "-o", program], capture_output=True, text=True)
    if run.returncode != 0:
        errors = [line for line in run.stderr.splitlines() if "error" in line or "undefined" in line]
        return left_out(name, f"g++ fails ({help_}): " + "".join(errors[:1]))
    return [program]


def geogram(python, work):
    """Geogram from the static library and the headers of its Python package."""
    where = subprocess.run([python, "-c", "import geogram; print(geogram.__path__[0])"], capture_output=True, text=True)
    if where.returncode != 0:
        return left_out("Geogram", f"no package geogram in {python}")
    site = pathlib.Path(where.stdout.strip()).parent
    flags = ["-fopenmp", f"-I{site}/include/geogram1", str(HERE / "geogram.cpp"), f"{site}/lib64/libgeogram.a"]
    flags += [*map(str, site.glob("geogram.libs/libtbb*")), f"-Wl,-rpath,{site}/geogram.libs", "-ldl", "-lpthread"]
    return compile_cpp("Geogram", flags, "the package of 0.0.7 has all it needs", str(work / "geogram"))


def hxt(python):
    run = subprocess.run([python, "-c", "import numpy, gmsh"], capture_output=True, text=True)
    if run.returncode != 0:
        return left_out("HXT", f"{python} cannot import numpy and gmsh: {run.stderr.strip().splitlines()[-1]}")
    return [python, str(HERE / "hxt.py")]


def build(work, python, wanted):
    """The commands that mesh a file: ours, and name -> (command before FILE REPEAT THREADS)."""
    subprocess.run(["cargo", "build", "--release", "--quiet", "--bin", "mesh_points"], cwd=HERE, check=True)
    python = python or (environment() if {"HXT", "Geogram"} & set(wanted) else None)
    cgal = [*CGAL_FLAGS, str(HERE / "cgal.cpp"), "-lgmp", "-lmpfr", "-ltbb", "-ltbbmalloc", "-lpthread"]
    peers = {
        "HXT": lambda: hxt(python),
        "CGAL": lambda: compile_cpp("CGAL", cgal, "apt-get install libcgal-dev libtbb-dev", str(work / "cgal")),
        "Geogram": lambda: geogram(python, work),
    }
    ours = str(target() / "release/mesh_points")
    return ours, {name: command for name in PEERS if name in wanted and (command := peers[name]())}


def measure(command, cpu, memory):
    """(points, tetrahedra, mean seconds of the command's repetitions), or None if it failed."""
    most = int(memory * 2**30) if memory else resource.RLIM_INFINITY
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (most, most))
    run = subprocess.run(command, capture_output=True, text=True, preexec_fn=limit)
    rows = [line.split() for line in run.stdout.splitlines() if len(line.split()) == 4]
    if run.returncode != 0 or not rows:
        print("failed:", " ".join(command), run.stderr.strip()[-300:], file=sys.stderr)
        return None
    seconds = statistics.mean(float(row[3 if cpu else 2]) for row in rows)
    return int(rows[0][0]), int(rows[0][1]), seconds


def compare(ours, peers, name, count, file, threads, chosen):
    """Median seconds and the counts of each mesher on a file, which has so many points of a set."""
    commands = {peer: [*command, file, "1", str(threads)] for peer, command in peers.items()}
    if threads == 1:
        commands["kernel"] = [ours, "kernel", file, "5"]
    commands["stage"] = [ours, "stage", name, str(count), "1", str(threads), str(chosen.chunk)]
    found = {mesher: [] for mesher in commands}
    for _ in range(chosen.rounds):
        for mesher, command in commands.items():
            one = measure(command, chosen.cpu, chosen.memory)
            if one:
                found[mesher].append(one)
    median = lambda runs: statistics.median(run[2] for run in runs)
    return {mesher: (runs[0][0], runs[0][1], median(runs)) for mesher, runs in found.items() if runs}


def row(name, threads, of):
    """A line of the table: M points a second, and ratios."""
    rate = {key: points / seconds / 1e6 for key, (points, _, seconds) in of.items() if seconds > 0}
    ours = rate.get("kernel") or rate.get("stage")
    show = lambda key: f"{rate[key]:.3f}" if key in rate else "–"
    ratio = lambda a, b: f"{a / b:.2f}" if a and b else "–"
    points = next(iter(of.values()))[0]
    cells = [name, f"{points:,}", str(threads), *map(show, COLUMNS)]
    cells += [ratio(ours, rate.get(peer)) for peer in PEERS] + [ratio(rate.get("stage"), rate.get("kernel"))]
    return "| " + " | ".join(cells) + " |"


def main():
    chosen = settings()
    with tempfile.TemporaryDirectory() as folder:
        work = pathlib.Path(folder)
        ours, peers = build(work, chosen.python, chosen.peers)
        unit = "CPU second" if chosen.cpu else "second"
        print(f"M points a {unit}, median of {chosen.rounds}; ratios: ours (kernel; with more threads, stage) to each, stage to kernel\n")
        print("| set | points | threads |", " | ".join(COLUMNS + [f"× {peer}" for peer in PEERS]), "| stage/kernel |")
        print("|---|---|---|" + "---|" * (len(COLUMNS) + len(PEERS) + 1), flush=True)
        for name in chosen.sets:
            for count in chosen.counts:
                file = str(work / "points")
                subprocess.run([ours, "points", name, str(count), file], check=True)
                for threads in chosen.threads:
                    of = compare(ours, peers, name, count, file, threads, chosen)
                    if of:
                        print(row(name, threads, of), flush=True)


main()
