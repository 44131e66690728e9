#!/usr/bin/env python3
"""Meshes the same points with HXT, CGAL and isospan, one after the other and round by round, and prints a table of ratios.

    compare.py [--sets hammersley,halton,uniform,cross,bcc,regular] [--counts 62500,250000,1000000] [--threads 1,2] [--rounds 5]

Needs: cargo; for CGAL a C++ compiler and Debian's libcgal-dev and libtbb-dev; for HXT a Python with numpy and gmsh (--python). A mesher
that cannot be had is left out, saying so. Each figure is the median over the rounds. Wall seconds mean something on a quiet machine only;
with --cpu the CPU seconds of all threads are compared instead.

isospan meshes as one (kernel: one thread, memory reused) and in chunks (stage: samples of the boundary on top, halos and certification
included; its points a second are those of all points, boundary samples too). Files of points hold f64 triples of multiples of 2^-24, so all
mesh the same points.
"""
import argparse
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
CGAL_FLAGS = ["-std=c++17", "-O3", "-DNDEBUG", "-march=native", "-frounding-math"]
CGAL_FLAGS += ["-DCGAL_LINKED_WITH_TBB", "-DCGAL_CONCURRENT_TRIANGULATION_3"]


def settings():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    numbers = lambda text: [int(n) for n in text.split(",")]
    parser.add_argument("--sets", type=lambda t: t.split(","), default="hammersley,halton,uniform,cross,bcc,regular".split(","))
    parser.add_argument("--counts", type=numbers, default=[62_500, 250_000, 1_000_000])
    parser.add_argument("--threads", type=numbers, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--chunk", type=int, default=375_000, help="points of a chunk at most; halved boxes hold 250 000 on average")
    parser.add_argument("--cpu", action="store_true", help="compare CPU seconds, not wall seconds")
    parser.add_argument("--python", default=sys.executable, help="the Python that has gmsh")
    return parser.parse_args()


def build(work, python):
    """The commands that mesh a file: name -> (command before FILE REPEAT THREADS)."""
    subprocess.run(["cargo", "build", "--release", "--quiet", "--example", "mesh_points"], cwd=HERE, check=True)
    metadata = subprocess.run(
        ["cargo", "locate-project", "--workspace", "--message-format", "plain"], cwd=HERE, check=True, capture_output=True, text=True
    )
    ours = str(pathlib.Path(metadata.stdout.strip()).parent / "target/release/examples/mesh_points")
    peers = {}
    cgal = work / "cgal"
    compile_cgal = ["g++", *CGAL_FLAGS, str(HERE / "cgal.cpp"), "-o", str(cgal), "-lgmp", "-lmpfr", "-ltbb", "-ltbbmalloc", "-lpthread"]
    if shutil.which("g++") and subprocess.run(compile_cgal).returncode == 0:
        peers["CGAL"] = [str(cgal)]
    else:
        print("CGAL left out: it could not be compiled", file=sys.stderr)
    if subprocess.run([python, "-c", "import gmsh, numpy"], capture_output=True).returncode == 0:
        peers["HXT"] = [python, str(HERE / "hxt.py")]
    else:
        print("HXT left out: no gmsh in", python, file=sys.stderr)
    return ours, peers


def measure(command, cpu):
    """(points, tetrahedra, mean seconds of the command's repetitions), or None if it failed."""
    run = subprocess.run(command, capture_output=True, text=True)
    rows = [line.split() for line in run.stdout.splitlines() if len(line.split()) == 4]
    if run.returncode != 0 or not rows:
        print("failed:", " ".join(command), run.stderr.strip()[-300:], file=sys.stderr)
        return None
    seconds = statistics.mean(float(row[3 if cpu else 2]) for row in rows)
    return int(rows[0][0]), int(rows[0][1]), seconds


def compare(ours, peers, file, threads, chosen):
    """Median seconds and the counts of each mesher on a file."""
    commands = {name: [*command, file, "1", str(threads)] for name, command in peers.items()}
    if threads == 1:
        commands["kernel"] = [ours, "kernel", file, "5"]
    commands["stage"] = [ours, "stage", file, "1", str(threads), str(chosen.chunk)]
    found = {name: [] for name in commands}
    for _ in range(chosen.rounds):
        for name, command in commands.items():
            one = measure(command, chosen.cpu)
            if one:
                found[name].append(one)
    median = lambda runs: statistics.median(run[2] for run in runs)
    return {name: (runs[0][0], runs[0][1], median(runs)) for name, runs in found.items() if runs}


def row(name, threads, of):
    """A line of the table: M points a second, and ratios."""
    rate = {key: points / seconds / 1e6 for key, (points, _, seconds) in of.items() if seconds > 0}
    ours = rate.get("kernel") or rate.get("stage")
    show = lambda key: f"{rate[key]:.3f}" if key in rate else "–"
    ratio = lambda a, b: f"{a / b:.2f}" if a and b else "–"
    points = next(iter(of.values()))[0]
    cells = [name, f"{points:,}", str(threads), show("HXT"), show("CGAL"), show("kernel"), show("stage")]
    cells += [ratio(ours, rate.get("HXT")), ratio(ours, rate.get("CGAL")), ratio(rate.get("stage"), rate.get("kernel"))]
    return "| " + " | ".join(cells) + " |"


def main():
    chosen = settings()
    with tempfile.TemporaryDirectory() as folder:
        work = pathlib.Path(folder)
        ours, peers = build(work, chosen.python)
        unit = "CPU second" if chosen.cpu else "second"
        print(f"M points a {unit}, median of {chosen.rounds}; ratios: ours (kernel; with more threads, stage) to HXT and CGAL, stage to kernel\n")
        print("| set | points | threads | HXT | CGAL | kernel | stage | × HXT | × CGAL | stage/kernel |")
        print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
        for name in chosen.sets:
            for count in chosen.counts:
                file = str(work / "points")
                subprocess.run([ours, "points", name, str(count), file], check=True)
                for threads in chosen.threads:
                    print(row(name, threads, compare(ours, peers, file, threads, chosen)), flush=True)


main()
