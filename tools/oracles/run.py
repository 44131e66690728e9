"""Runs the cases: run.py PROGRAM FOLDER [WORD…]; see `test`."""

import concurrent.futures
import os
import sys
import traceback
import warnings
from pathlib import Path

import placing
import arrays  # noqa: F401
import grids  # noqa: F401
import medical  # noqa: F401
import meshes  # noqa: F401
import microscopy  # noqa: F401
import shared  # noqa: F401


def cases_of(packages, function, folder):
    """The cases of a function, and an error of the package that wrote them."""
    folder = folder / function.__name__
    folder.mkdir()
    found = []
    try:
        for case in function(folder):
            case.name = f"{function.__name__}:{placing.name_of(case, folder)}"
            found.append(case)
    except Exception:
        return found, f"{function.__name__}: {', '.join(packages)}: {traceback.format_exc(limit=-3)}"
    return found, None


def main(isospan, folder, words):
    warnings.simplefilter("ignore")
    placer = placing.Placer(isospan, folder)
    written, failures, lines = [], [], []
    for packages, function in placing.PROGRAMS:
        if words and function.__name__ not in [word.split(":")[0] for word in words]:
            continue
        cases, error = cases_of(packages, function, folder)
        failures += [error] if error else []
        written += [(packages, case) for case in cases if not words or any(w in case.name for w in words)]

    def attempt(number):
        _, case = written[number]
        try:
            return placer.try_case(case, number)
        except placing.Wrong as wrong:
            return f"{case.name}: {wrong}"
        except Exception:
            return f"{case.name}: {traceback.format_exc(limit=-2)}"

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        outcomes = list(pool.map(attempt, range(len(written))))
    failures += [outcome for outcome in outcomes if isinstance(outcome, str)]
    for packages in dict.fromkeys(packages for packages, _ in written):
        mine = [o for (p, _), o in zip(written, outcomes) if p == packages and not isinstance(o, str)]
        volumes, refusals = sum(mine), mine.count(0)
        lines.append(f"  {placing.versions(packages)}: {volumes} volumes placed, {refusals} files refused by name")
    print("\n".join(lines))
    for failure in failures:
        print(f"tools/oracles/test: {failure}", file=sys.stderr)
    print(f"{len(written) - len(failures)} passed, {len(failures)} failed")
    sys.exit(bool(failures))


main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])
