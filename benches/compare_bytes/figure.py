"""A figure: bytes against error, a panel a volume."""
import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot, ticker
from matplotlib.lines import Line2D

from tables import in_order

# One colour a coder; whole volumes are drawn in full, parts that are read alone are dashed.
STYLES = {
    "wavelet": ("#111111", "-"),
    "SPERR": ("#1f5fa8", "-"),
    "SPERR, rate": ("#5fb3e6", "-"),
    "SPERR, chunks": ("#1f5fa8", "--"),
    "SPERR, padded chunks": ("#1f5fa8", ":"),
    "SZ3": ("#d98200", "-"),
    "SZ3, chunks": ("#d98200", "--"),
    "SZ3, padded chunks": ("#d98200", ":"),
    "ZFP": ("#2a8f57", "-"),
    "TTHRESH": ("#8156a8", "-"),
    "hammersley": ("#8c6d5a", "-"),
    "voxels": ("#9a9a9a", "-"),
}
OURS = ["#c8102e", "#ef5fa7", "#7a0019", "#ff8a5c"]
ACROSS = 3


def styles(coders, ours):
    """Colour, dashes and width of each coder."""
    spare = iter(f"C{k}" for k in range(100))
    made = {}
    for coder in coders:
        if coder in ours:
            made[coder] = (OURS[ours.index(coder) % len(OURS)], "-", 2.8)
        else:
            made[coder] = (*(STYLES.get(coder) or (next(spare), "-.")), 1.3)
    return made


def plain(value, _):
    return f"{value:g}"


def draw(rows, ours, path):
    volumes, targets = in_order(rows, "volume"), sorted(in_order(rows, "target"))
    looks = styles(in_order(rows, "coder"), ours)
    looks = dict(sorted(looks.items(), key=lambda look: look[0] not in ours))
    across = min(ACROSS, len(volumes))
    down = -(-len(volumes) // across)
    size = (3.9 * across, 3.3 * down + 0.7)
    sheet, panels = pyplot.subplots(down, across, figsize=size, squeeze=False, sharex=True)
    for panel in panels.flat[len(volumes):]:
        panel.axis("off")
    for k, (panel, volume) in enumerate(zip(panels.flat, volumes)):
        for coder, (colour, dashes, width) in looks.items():
            of_it = (r for r in rows if (r["volume"], r["coder"]) == (volume, coder))
            line = sorted((r["target"], r["bits"]) for r in of_it)
            if line:
                above = 5 if coder in ours else 2
                panel.plot(
                    *zip(*line), color=colour, linestyle=dashes, linewidth=width, zorder=above,
                    marker="o", markersize=6 if coder in ours else 3.2,
                )
        panel.set_title(volume, fontsize=11, fontweight="bold", loc="left")
        lay_out_axes(panel, targets)
        if k % across == 0:
            panel.set_ylabel("bits a sample", fontsize=10)
        if k + across >= len(volumes):
            panel.set_xlabel("RMS error, % of the range", fontsize=10)
            panel.tick_params(labelbottom=True)
    handles = [
        Line2D([], [], color=c, linestyle=d, linewidth=w, marker="o", markersize=4, label=coder)
        for coder, (c, d, w) in looks.items()
    ]
    columns = min(len(handles), 2 * across)
    rows_of_legend = -(-len(handles) // columns)
    sheet.tight_layout(rect=(0, 0, 1, 1 - (0.2 + 0.23 * rows_of_legend) / size[1]))
    sheet.legend(handles=handles, loc="upper center", ncols=columns, fontsize=10, frameon=False)
    sheet.savefig(path, dpi=130)


def lay_out_axes(panel, targets):
    """Logarithmic, with ticks at the targets, and at 1, 2 and 5 of each power of ten."""
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlim(targets[0] / 1.12, targets[-1] * 1.12)
    panel.xaxis.set_major_locator(ticker.FixedLocator(targets))
    panel.xaxis.set_minor_locator(ticker.NullLocator())
    low, high = panel.get_ylim()
    steps = (1, 2, 5) if high < 300 * low else (1,)
    panel.yaxis.set_major_locator(ticker.LogLocator(subs=steps, numticks=30))
    panel.yaxis.set_minor_locator(ticker.LogLocator(subs=range(1, 10), numticks=30))
    panel.yaxis.set_minor_formatter(ticker.NullFormatter())
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(ticker.FuncFormatter(plain))
    panel.tick_params(labelsize=9)
    panel.grid(color="#e3e3e3", linewidth=0.7)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
