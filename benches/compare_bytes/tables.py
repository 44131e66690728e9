"""Markdown tables of rows."""
import math


def in_order(rows, key):
    return list(dict.fromkeys(r[key] for r in rows))


def print_table(heads, lines):
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for line in lines:
        print("| " + " | ".join(line) + " |")


def mean_ratio(pairs):
    """The geometric mean of ratios, and how many there are."""
    logs = [math.log(a / b) for a, b in pairs]
    return "-" if not logs else f"{math.exp(sum(logs) / len(logs)):.2f} ({len(logs)})"


def tables_of_bytes(rows, ours):
    """Bits a sample, and CPU seconds; a table for each target."""
    volumes, coders = in_order(rows, "volume"), in_order(rows, "coder")
    at = {(r["volume"], r["coder"], r["target"]): r for r in rows}
    for target in sorted(in_order(rows, "target")):
        get = lambda volume, coder: at.get((volume, coder, target))

        def lines(text):
            for volume in volumes:
                found = (get(volume, coder) for coder in coders)
                yield [volume, *("-" if r is None else text(r) for r in found)]

        print(f"\nBits a sample at an RMS error of {target:g} % of the range\n")
        means = []
        for mine in (name for name in ours if name in coders):
            line = [f"bytes of {mine} to theirs, geometric mean (volumes)"]
            for coder in coders:
                both = ((get(v, mine), get(v, coder)) for v in volumes)
                line.append(mean_ratio([(a["bits"], b["bits"]) for a, b in both if a and b]))
            means.append(line)
        print_table(["volume", *coders], [*lines(lambda r: f"{r['bits']:.3g}"), *means])
        print(f"\nCPU seconds to write and to read, at {target:g} %\n")
        print_table(["volume", *coders], lines(lambda r: f"{r['write']:.2f}, {r['read']:.2f}"))


def tables_of_islands(rows):
    """False islands at each isovalue, and mean angles between normals."""
    coders = [coder for coder in in_order(rows, "coder") if coder != "all samples"]
    for target in sorted(t for t in in_order(rows, "target") if t > 0):
        for title, text in [
            ("False islands", lambda r: f"{r['islands']}"),
            ("Mean angle between normals, degrees", lambda r: f"{r['angle']:.1f}"),
        ]:
            print(f"\n{title}, at {target:g} % and each isovalue\n")
            lines = []
            for volume in in_order(rows, "volume"):
                line = [volume]
                for coder in coders:
                    of_it = (r for r in rows if (r["volume"], r["coder"]) == (volume, coder))
                    line.append(", ".join(text(r) for r in of_it if r["target"] == target) or "-")
                lines.append(line)
            print_table(["volume", *coders], lines)


def table_of_surfaces(rows):
    heads = "volume, isovalue|target, reached, %|coder|bytes|mean, RMS, largest distance|normals|"
    heads += "components|false islands|Euler|triangles|bytes read|CPU s"
    place = {volume: k for k, volume in enumerate(in_order(rows, "volume"))}
    lines = []
    for r in sorted(rows, key=lambda r: (place[r["volume"]], r["target"], r["isovalue"])):
        lines.append([
            f"{r['volume']}, {r['isovalue']:.4g}", f"{r['target']:g}, {r['reached']:.2f}",
            r["coder"], f"{r['size']}", f"{r['mean']:.3f}, {r['rms']:.3f}, {r['most']:.2f}",
            f"{r['angle']:.1f}", f"{r['components']}", f"{r['islands']}", f"{r['euler']}",
            f"{r['triangles']}", f"{r['read']}", f"{r['seconds']:.2f}",
        ])
    print("\nSurfaces; distances in samples, angles in degrees\n")
    print_table(heads.split("|"), lines)
