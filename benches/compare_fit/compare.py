#!/usr/bin/env python3
"""Compares the surfaces of sampled and fitted archives with those of all samples; prints a Markdown table.

    compare.py [--program PATH] [--before PATH] [--fraction 1/8] [--keep FOLDER] [--errors] INPUT[:ISOVALUE,...]...

* *full*: `--points regular --fraction 1 --values sample`, which has all samples.
* *sampled*, *fitted*: `--values sample` and `--values fit` at the fraction. *Before*: fitted by another build.

Lengths are in point spacings, in index space, where points are even. `away` is the distance of the component that is farthest from the
full surface, at its nearest vertex; `islands` are further than two spacings. Both are too large by a quarter of a voxel at most. `largest`
and `mean` are distances from the fitted (or sampled) surface to the full one, at vertices and at middles of triangles. RMS errors are
those that `reduce` measures. `--errors` prints these alone, without surfaces. Archives are kept in the folder, and used again.

Needs a Python with numpy and scipy (PyPI).
"""
import argparse
import fractions
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy
import scipy.sparse
import scipy.spatial

ROOT = pathlib.Path(__file__).resolve().parents[2]


def answer(program, *arguments):
    run = subprocess.run([program, *map(str, arguments), "--json", "--quiet"], stdout=subprocess.PIPE)
    if run.returncode:
        sys.exit(f"{' '.join(map(str, [program, *arguments]))}: exit code {run.returncode}")
    return json.loads(run.stdout)


def make(program, path, out, *options):
    """The archive, made unless it is there."""
    if not out.exists():
        answer(program, "reduce", path, "-o", out, *options)
    return out


def components(program, archive, isovalue, geometry, folder):
    """Vertices and middles of triangles in index space, and the component of each."""
    path = folder / "surface.ply"
    answer(program, "surface", archive, f"--isovalue={isovalue}", "-o", path, "--force")
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = [line.split() for line in head.decode().splitlines()]
    vertices, faces = (int(line[2]) for line in lines if line[0] == "element")
    row = sum(line[:2] == ["property", "float"] for line in lines)
    places = numpy.frombuffer(body, "<f4", vertices * row).reshape(-1, row)[:, :3].astype(float)
    cells = numpy.frombuffer(body, numpy.dtype([("n", "u1"), ("v", "<i4", 3)]), faces, 4 * row * vertices)["v"]
    matrix = numpy.array(geometry["direction"]).T * geometry["spacing"]
    places = (places - geometry["origin"]) @ numpy.linalg.inv(matrix).T
    edges = (cells[:, [0, 1]].ravel(), cells[:, [1, 2]].ravel())
    graph = scipy.sparse.coo_matrix((numpy.ones(len(edges[0]), "u1"), edges), (vertices, vertices))
    _, parts = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return numpy.concatenate([places, places[cells].mean(axis=1)]), numpy.concatenate([parts, parts[cells[:, 0]]])


def row_of(surface, tree, spacing):
    """Components, islands, the farthest component, largest and mean distance."""
    places, parts = surface
    if not len(places):
        return "0 | 0 | | | "
    distances = tree.query(places)[0] / spacing
    nearest = numpy.full(parts.max() + 1, numpy.inf)
    numpy.minimum.at(nearest, parts, distances)
    return f"{len(nearest)} | {(nearest > 2).sum()} | {nearest.max():.2f} | {distances.max():.2f} | {distances.mean():.3f}"


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("inputs", nargs="+", metavar="INPUT[:ISOVALUE,...]")
    arguments.add_argument("--program", default=ROOT / "target/release/isospan")
    arguments.add_argument("--before", help="another build, whose fitted values are compared too")
    arguments.add_argument("--fraction", default="1/8", type=fractions.Fraction)
    arguments.add_argument("--keep", type=pathlib.Path, help="a folder for the archives [default: a temporary one]")
    arguments.add_argument("--errors", action="store_true", help="RMS errors alone")
    arguments.add_argument("--option", action="append", default=[], help="for reduce, of sampled and fitted ones")
    args = arguments.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        temporary = pathlib.Path(temporary)
        folder = args.keep or temporary
        folder.mkdir(exist_ok=True)
        print("| volume | isovalue | values | RMS error | to sampled | components | islands | away | largest | mean |")
        print("|---|---|---|---|---|---|---|---|---|---|")
        for text in args.inputs:
            path, _, isovalues = text.partition(":")
            stem = re.sub(r"\W+", "_", pathlib.Path(path).name)
            kinds = {"sampled": (args.program, "sample"), "fitted": (args.program, "fit")}
            if args.before:
                kinds["before"] = (args.before, "fit")
            name = re.sub(r"\W+", "_", "_".join([stem, str(args.fraction), *args.option]))
            archives = {
                kind: make(program, path, folder / f"{name}_{kind}.isospan", "--fraction", args.fraction, "--values", values, *args.option)
                for kind, (program, values) in kinds.items()
            }
            rms = {kind: answer(args.program, "info", archive)["steps"][0]["error"][0] for kind, archive in archives.items()}
            error = {kind: f"{rms[kind]:.5g} | {rms[kind] / (rms['sampled'] or 1):.4f}" for kind in archives}
            if args.errors:
                for kind in archives:
                    print(f"| {stem} | | {kind} | {error[kind]} | | | | |", flush=True)
                continue
            whole = make(args.program, path, folder / f"{stem}_full.isospan", "--points", "regular", "--fraction", 1, "--values", "sample", "--no-measure")
            geometry = answer(args.program, "info", whole)["geometry"]
            spacing = float(1 / args.fraction) ** (1 / 3)
            for isovalue in isovalues.split(","):
                places, parts = components(args.program, whole, isovalue, geometry, temporary)
                print(f"| {stem} | {isovalue} | full | | | {len(numpy.unique(parts))} | | | | |", flush=True)
                tree = scipy.spatial.cKDTree(places)
                for kind, archive in archives.items():
                    found = components(args.program, archive, isovalue, geometry, temporary)
                    print(f"| | | {kind} | {error[kind]} | {row_of(found, tree, spacing)} |", flush=True)


if __name__ == "__main__":
    main()
