#!/usr/bin/env python3
"""How `reduce`, `surface`, `check` and `measure` would scale to more cores than this machine has, from
what one and two threads take here.

    benches/simulate_scaling/simulate.py [--program PROGRAM] [--samples 384] [reduce surface …]

`reduce` is simulated: its queue as src/pipeline/reduce/workers.rs has it. A feeder takes a permit for
each chunk, a pool of n threads makes chunks, one writer puts them in order, writes them and gives the
permits back; there are 3 permits a thread. Before and behind it are the parts that run alone: the
plan and the commit. Stage times come from the report of a run with one thread, scaled to its CPU time,
so that it matters little what else the machine does; how much chunks differ comes from a run whose
chunks are so large that progress tells the time of each. The simulation of two threads is printed
beside what two threads take.

`surface`, `check` and `measure` hand chunks to n threads and take results in order, with 4 chunks a
thread on their way (src/io/exec/ordered.rs). The work of all threads is the CPU time of a run with two threads.
The part that runs alone (reading the index, writing a surface) is what makes the
simulation of two threads take as long as they did. Chunks differ as they do in `reduce`. Welding a
surface is counted with the chunks, though one thread does it at a time.

Not in it: what threads take from each other, as memory bandwidth, caches, a clock that falls when
all cores work, and the disk. So the figures are upper bounds.

Times are the least of some rounds. Those of two threads want a machine that does nothing else.
"""

import argparse
import heapq
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
THREADS = [1, 2, 4, 8, 12, 16]
# WAITING in src/pipeline/plan/estimate.rs.
PERMITS_A_THREAD = 3
# `held` in src/io/exec/ordered.rs.
HELD_A_THREAD = 4
# The table is for this volume, and for one of so many times its samples.
LARGER = 16


def run(program, threads, *words):
    """What a command reports on so many cores, the seconds that it took, and its progress."""
    cores = sorted(os.sched_getaffinity(0))[:threads]
    words = ["taskset", "-c", ",".join(map(str, cores)), program, *map(str, words), "--json"]
    started, used = time.monotonic(), cpu_seconds()
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    seconds = time.monotonic() - started
    return json.loads(done.stdout), seconds, cpu_seconds() - used, done.stderr


def cpu_seconds():
    """CPU time of all commands so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def least(rounds, ask):
    """The quickest of some runs."""
    return min((ask() for _ in range(rounds)), key=lambda found: found[1])


def write_volume(path, n):
    """A gyroid of n³ bytes, finer along z, so that chunks differ as those of real data do."""
    import math

    def waves(turns):
        angles = [2 * math.pi * turns * i / n for i in range(n)]
        return [(math.sin(a), math.cos(a)) for a in angles]

    xs, zs = waves(4), waves(16)
    with open(path, "wb") as file:
        file.write(
            b"NRRD0004\ntype: uint8\ndimension: 3\nencoding: raw\n"
            + f"sizes: {n} {n} {n}\n\n".encode()
        )
        for sz, cz in zs:
            for sy, cy in xs:
                a, b, c = 40 * cy, 40 * sz, 40 * sy * cz
                file.write(bytes(int(128 + a * sx + b * cx + c) for sx, cx in xs))


def chunk_shares(stderr):
    """The time of each chunk over their mean, as progress told it."""
    events = [json.loads(line) for line in stderr.splitlines() if line.startswith("{")]
    # The points, of which most stages have none.
    events = [e for e in events if e.get("unit") == "points" and e["event"] != "note"]
    at = [(e["done"], e["elapsed_seconds"]) for e in events]
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(at, at[1:])]
    # Of equal size alone: where two chunks end within a second, progress tells of them together.
    usual = sorted(done for done, _ in steps)[len(steps) // 2]
    times = [t / done for done, t in steps if 0.5 * usual < done < 1.5 * usual]
    mean = sum(times) / len(times)
    return [t / mean for t in times]


def simulate(threads, chunks, work, write, shares, held=PERMITS_A_THREAD):
    """Seconds from the first chunk to the last one written."""
    permits, idle = held * threads, [0.0] * threads
    written = []
    for number in range(chunks):
        # The feeder waits until a permit comes back; the pool takes chunks in their order.
        fed = written[number - permits] if number >= permits else 0.0
        start = max(fed, heapq.heappop(idle))
        made = start + work * shares[number % len(shares)]
        heapq.heappush(idle, made)
        written.append(max(made, written[-1] if written else 0.0) + write)
    return written[-1]


def in_order(threads, chunks, shares):
    """Seconds for chunks of a second each, as `surface` and `measure` do them."""
    return simulate(threads, chunks, 1.0, 0.0, shares, held=HELD_A_THREAD)


def reduce_table(program, volume, out, rounds):
    def reduce(threads, *more):
        where = ["-o", out, "--force", "--points", "hammersley", "--progress", "json"]
        return run(program, threads, "reduce", volume, *where, *more)

    report, wall, one, _ = least(rounds, lambda: reduce(1))
    seconds = dict(report["seconds"])
    *_, stderr = reduce(1, "--chunk-points", 1_000_000)
    shares = chunk_shares(stderr)
    scale = min(one / wall, 1.0)
    alone = scale * (seconds["plan"] + seconds.get("commit", 0.0))
    write = scale * seconds["write"] / report["chunks"]
    # One thread and a writer beside it: what is left is the pool's.
    work = (one - alone) / report["chunks"]
    two = least(rounds, lambda: reduce(2))[1]
    chunks = report["chunks"]

    def speeds(more):
        """Those of so many times the chunks."""
        spans = {n: simulate(n, more * chunks, work, write, shares) for n in THREADS}
        return {n: more * alone + span for n, span in spans.items()}

    times, larger = speeds(1), speeds(LARGER)
    print(f"reduce: {report['points']} points, {report['chunks']} chunks of {work:.3f} s, written in")
    print(f"  {write * 1e3:.1f} ms each; plan and commit {alone:.2f} s; a chunk takes {min(shares):.2f}")
    print(f"  to {max(shares):.2f} of the mean ({len(shares)} seen)")
    print(f"  {one:.2f} s of CPU time with 1 thread ({wall:.2f} s), {two:.2f} s with 2, simulated {times[2]:.2f}")
    table = {
        f"reduce, {more * chunks} chunks": {n: of[1] / t for n, t in of.items()}
        for more, of in ((1, times), (LARGER, larger))
    }
    return table, chunks, shares


def new_name(folder):
    """A file that is not there yet: none is replaced."""
    return Path(folder, f"{time.monotonic_ns()}.ply")


def queue_table(name, chunks, shares, rounds, ask):
    """The speeds of a command that takes chunks in order, for this volume and a larger one."""
    _, two, used, _ = least(rounds, lambda: ask(2))
    if two > used:
        sys.exit(f"{name} took {two:.2f} s, more than its CPU time ({used:.2f} s): the machine is busy")
    total = sum(shares[n % len(shares)] for n in range(chunks))

    def share(threads, more):
        return in_order(threads, more * chunks, shares) / (more * total)

    # alone + work = used, and alone + work * share(2, 1) = two.
    work = min(max((used - two) / (1 - share(2, 1)), 0.0), used)
    alone = used - work
    print(f"{name}: {chunks} chunks; {used:.3f} s of CPU time and {two:.3f} s with 2 threads, of which")
    print(f"  {alone:.3f} s ({alone / used:.1%} of the CPU time) run alone")
    return {
        f"{name}, {more * chunks} chunks": {n: used / (alone + work * share(n, more)) for n in THREADS}
        for more in (1, LARGER)
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("commands", nargs="*", help="reduce, surface, check, measure: all of them")
    parser.add_argument("--program", default=ROOT / "target/release/isospan")
    parser.add_argument("--samples", type=int, default=384, help="along each axis of the volume")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--folder", help="for temporary files")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        volume, out = Path(folder, "v.nrrd"), Path(folder, "v.isospan")
        write_volume(volume, args.samples)
        program = args.program
        table, chunks, shares = reduce_table(program, volume, out, args.rounds)
        asked = {
            "surface": lambda n: run(
                program, n, "surface", out, "--isovalue", 128.5, "-o", new_name(folder)
            ),
            "check": lambda n: run(program, n, "check", out),
            "measure": lambda n: run(program, n, "measure", out, "--against", volume),
        }
        for name, ask in asked.items():
            if name in (args.commands or asked):
                table |= queue_table(name, chunks, shares, args.rounds, ask)
    print("\n| threads | " + " | ".join(table) + " |\n|---|" + "---|" * len(table))
    for n in THREADS:
        row = (f"{speed[n]:.1f} ({speed[n] / n:.0%})" for speed in table.values())
        print(f"| {n} | " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
