"""TIFF by tifffile and Pillow, maps by mrcfile and gemmi, OME-Zarr by ome-zarr, EMD and HyperSpy's files by their packages."""

import emdfile
import gemmi
import mrcfile
import numpy as np
import ome_zarr.format
import ome_zarr.writer
import PIL.Image
import tifffile
import zarr
from ncempy.io.emd import fileEMD
from rsciio import emd as rsciio_emd
from rsciio import hspy, nexus, ripple

from placing import SHAPE, Case, Refused, affine, grid, numbers, program

PLAIN = grid()
COMPRESSIONS = "none", "lzw", "zlib", "adobe_deflate", "deflate", "packbits", "zstd"


@program("tifffile")
def tiff(at):
    for n, dtype in enumerate(("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")):
        for m, order in enumerate("<>"):
            for tile in (None, (16, 16)):
                name = COMPRESSIONS[(n + 3 * m + bool(tile)) % len(COMPRESSIONS)]
                # tifffile predicts integers by 2, floats by 3.
                guess = (n + m) % 2 == 0 and name not in ("none", "packbits") and dtype not in ("u8", "i8", "f2")
                path = at / f"{dtype}{'lb'[m]}_{name}{'_tiles' if tile else ''}{'_guess' if guess else ''}.tif"
                values = numbers(order + dtype, (5, 34, 21))
                tifffile.imwrite(
                    path, values, byteorder=order, bigtiff=n % 3 == 0, compression=None if name == "none" else name,
                    predictor=guess, tile=tile, rowsperstrip=None if tile else 7, photometric="minisblack",
                )  # fmt: skip
                yield Case(path, tifffile.imread(path), grid(shape=values.shape))
    values = numbers("u2")
    given = ("--spacing", "0.5,2,3", "--origin", "-1,-2,10")
    tifffile.imwrite(at / "given.tif", values, photometric="minisblack")
    yield Case(at / "given.tif", values, grid((0.5, 2, 3), (-1, -2, 10)), given)
    slices = at / "slices"
    slices.mkdir()
    for n, page in enumerate(values):
        tifffile.imwrite(slices / f"s{n + 8}.tif", page, photometric="minisblack")
    yield Case(slices, values, PLAIN)
    for name, words in (
        ("jpeg2000", "JPEG 2000"),
        ("webp", "WebP"),
        ("lerc", "unknown compression"),
        ("jpegxl", "JPEG XL"),
        ("lzma", "LZMA"),
    ):
        picture = np.ascontiguousarray(np.broadcast_to(values[:, :, :, None] >> 8, (*SHAPE, 3)), "u1")
        is_grey = name != "webp"
        tifffile.imwrite(
            at / f"{name}.tif", picture[..., 0] if is_grey else picture, compression=name,
            photometric="minisblack" if is_grey else "rgb",
        )  # fmt: skip
        yield Refused(at / f"{name}.tif", words if is_grey else "WebP|RGB|colour")
    tifffile.imwrite(at / "rgb.tif", np.zeros((*SHAPE, 3), "u1"), photometric="rgb")
    yield Refused(at / "rgb.tif", "RGB|colour")
    tifffile.imwrite(at / "bits.tif", (values & 1023), photometric="minisblack", compression="zlib")
    yield Case(at / "bits.tif", values & 1023, PLAIN)
    tifffile.imwrite(at / "complex.tif", values.astype("c8"), photometric="minisblack")
    yield Refused(at / "complex.tif", "sample format 6")
    # A depth of its own, as SGI has it: pages of several slices.
    tifffile.imwrite(at / "volume.tif", numbers("u1", (16, 16, 16)), tile=(16, 16, 16), photometric="minisblack")
    yield Refused(at / "volume.tif", "2 slices")


@program("tifffile")
def imagej(at):
    for dtype in "u1", "u2", "f4":
        path, values = at / f"{dtype}.tif", numbers(dtype)
        tifffile.imwrite(
            path, values, imagej=True, resolution=(2, 0.8), metadata={"spacing": 2.5, "unit": "um", "axes": "ZYX"}
        )
        yield Case(path, values, grid((0.5, 1.25, 2.5)), length="um")
    nano = {"spacing": 2.5, "unit": "nm", "zunit": "um", "axes": "ZYX"}
    tifffile.imwrite(at / "zunit.tif", numbers("u2"), imagej=True, resolution=(2, 2), metadata=nano)
    yield Case(at / "zunit.tif", numbers("u2"), grid((0.5, 0.5, 2500)), length="nm")
    micro = {"spacing": 3, "unit": "\\u00B5m", "yunit": "nm", "axes": "ZYX"}
    tifffile.imwrite(at / "yunit.tif", numbers("u2"), imagej=True, resolution=(2, 2), metadata=micro)
    yield Case(at / "yunit.tif", numbers("u2"), grid((0.5, 0.0005, 3)), length="um")
    values = numbers("u2", (3, 5, 2, 6, 7))
    tifffile.imwrite(
        at / "hyper.tif", values, imagej=True, resolution=(2, 2),
        metadata={"spacing": 3, "unit": "micron", "axes": "TZCYX", "finterval": 1.5},
    )  # fmt: skip
    for channel in 0, 1:
        places = grid((0.5, 0.5, 3))
        args = "--channel", channel
        # Times of TIFF are not read.
        yield Case(at / "hyper.tif", values[:, :, channel], places, args, (None,) * 3, length="um")
    values = numbers("f4", (3, *SHAPE))
    tifffile.imwrite(at / "time.tif", values, imagej=True, metadata={"axes": "TZYX", "spacing": 2.0, "unit": "mm"})
    yield Case(at / "time.tif", values, grid((1, 1, 2)), times=(None,) * 3)


@program("tifffile")
def ome_tiff(at):
    size = {"PhysicalSizeX": 0.5, "PhysicalSizeY": 1.25, "PhysicalSizeZ": 2.5}
    for n, dtype in enumerate(("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8")):
        path = at / f"{dtype}.ome.tif"
        more = {f"PhysicalSize{axis}Unit": ("nm", "mm", "µm", "Å")[n % 4] for axis in "XYZ"}
        tifffile.imwrite(
            path, numbers(dtype, (5, 20, 33)), ome=True, compression=COMPRESSIONS[n % 7].replace("none", "") or None,
            tile=(16, 16) if n % 2 else None, photometric="minisblack", metadata={"axes": "ZYX", **size, **more},
        )  # fmt: skip
        places = grid((0.5, 1.25, 2.5), shape=(5, 20, 33))
        yield Case(path, tifffile.imread(path), places, length=("nm", "mm", "um", "Å")[n % 4])
    mixed = {"PhysicalSizeXUnit": "µm", "PhysicalSizeYUnit": "nm", "PhysicalSizeZUnit": "mm"}
    sizes = {"PhysicalSizeX": 0.5, "PhysicalSizeY": 500, "PhysicalSizeZ": 0.002}
    tifffile.imwrite(
        at / "mixed.ome.tif", numbers("u2"), photometric="minisblack", metadata={"axes": "ZYX", **sizes, **mixed}
    )
    yield Case(at / "mixed.ome.tif", numbers("u2"), grid((0.5, 0.5, 2)), length="um")
    two = {"axes": "ZYX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.25}
    tifffile.imwrite(at / "two.ome.tif", numbers("u2"), photometric="minisblack", metadata=two)
    yield Case(at / "two.ome.tif", numbers("u2"), grid((0.5, 0.25, 1)))
    for axes, shape in {"TCZYX": (3, 2, 5), "CTZYX": (2, 3, 5), "ZCTYX": (5, 2, 3), "TZCYX": (3, 5, 2)}.items():
        values = numbers("u2", (*shape, 6, 7))
        path = at / f"{axes}.ome.tif"
        tifffile.imwrite(
            path, values, photometric="minisblack",
            metadata={"axes": axes, **size, "TimeIncrement": 2.5, "TimeIncrementUnit": "s", "Channel": {"Name": ["DAPI", "GFP"]}},
        )  # fmt: skip
        values = np.moveaxis(values, [axes.index(a) for a in "TCZYX"], range(5))
        for args, channel in (("--channel", "GFP"), 1), (("--channel", 0), 0):
            yield Case(path, values[:, channel], grid((0.5, 1.25, 2.5)), args, (None,) * 3, length="um")
    # A pyramid, its levels in pages of their own below the first.
    values = numbers("u2", (5, 32, 48))
    with tifffile.TiffWriter(at / "levels.ome.tif", bigtiff=True) as out:
        more = {"photometric": "minisblack", "tile": (16, 16), "compression": "zlib"}
        out.write(values, subifds=1, metadata={"axes": "ZYX", **size}, **more)
        out.write(values[:, ::2, ::2], subfiletype=1, **more)
    yield Case(at / "levels.ome.tif", values, grid((0.5, 1.25, 2.5), shape=values.shape), length="um")


@program("pillow")
def pillow(at):
    for dtype, mode in ("u1", "L"), ("u2", "I;16"), ("i4", "I"), ("f4", "F"):
        for name in None, "tiff_lzw", "tiff_adobe_deflate", "packbits", "zstd":
            pages = [PIL.Image.fromarray(page) for page in numbers(dtype)]
            assert pages[0].mode == mode
            path = at / f"{dtype}_{name}.tif"
            pages[0].save(path, save_all=True, append_images=pages[1:], compression=name)
            yield Case(path, numbers(dtype), PLAIN)
    pages[0].convert("L").save(at / "a.png")
    yield Refused(at / "a.png", "PNG")
    bits = PIL.Image.fromarray(numbers("u1", (16, 16))).convert("1")
    bits.save(at / "bits.tif", save_all=True, append_images=[bits] * 4)
    yield Refused(at / "bits.tif", "bit")
    colours = bits.convert("P")
    colours.save(at / "palette.tif", save_all=True, append_images=[colours] * 4)
    yield Refused(at / "palette.tif", "palette")


@program("mrcfile")
def mrc(at):
    for n, dtype in enumerate(("i1", "i2", "u2", "f2", "f4")):
        for m, pack in enumerate(("", "gzip")):
            path = at / f"{dtype}{pack}.{'mrc' if not pack else 'mrc.gz'}"
            with mrcfile.new(path, compression=pack or None) as file:
                file.set_data(numbers(dtype))
                file.voxel_size = (0.5, 1.25, 2.5)
                if m:
                    file.header.origin = (-3.5, 10, 7)
                else:
                    file.nstart = (-4, 2, n)
            with mrcfile.open(path) as file:
                start, step = file.nstart, file.voxel_size
                spacing = [float(step[a]) for a in "xyz"]
                origin = [float(file.header.origin[a]) for a in "xyz"]
                if not m:
                    origin = [float(start[a]) * s for a, s in zip("xyz", spacing)]
                yield Case(path, np.array(file.data), grid(spacing, origin), length="Å")
    # Sections along x, rows along z, columns along y.
    with mrcfile.new(at / "turned.mrc") as file:
        file.set_data(numbers("f4"))
        file.header.mapc, file.header.mapr, file.header.maps = 2, 3, 1
        file.header.mx, file.header.my, file.header.mz = 5, 7, 6
        file.header.cella = (5 * 0.5, 7 * 1.25, 6 * 2.5)
    places = np.stack(np.meshgrid(np.arange(5) * 0.5, np.arange(6) * 2.5, np.arange(7) * 1.25, indexing="ij"), -1)
    yield Case(at / "turned.mrc", numbers("f4"), places[..., [0, 2, 1]], length="Å")
    values = numbers("i2", (3, *SHAPE))
    with mrcfile.new(at / "stack.mrc") as file:
        file.set_data(values)
        file.voxel_size = 2
    for n in range(3):
        yield Case(at / "stack.mrc", values[n], grid((2, 2, 2)), ("--field", f"v{n}"))
    with mrcfile.new(at / "extended.mrc") as file:
        file.set_data(numbers("i2"))
        file.set_extended_header(np.zeros(3, "V80"))
        file.voxel_size = 3
    yield Case(at / "extended.mrc", numbers("i2"), grid((3, 3, 3)))
    with mrcfile.new(at / "complex.mrc") as file:
        file.set_data(numbers("f4").astype("c8"))
    yield Refused(at / "complex.mrc", "complex")
    with mrcfile.new(at / "packed.mrc.bz2", compression="bzip2") as file:
        file.set_data(numbers("f4"))
    yield Refused(at / "packed.mrc.bz2", "packed")
    for order in "<>":
        path = at / f"order{'lb'[order == '>']}.mrc"
        with mrcfile.new_mmap(path, SHAPE, mrc_mode=2) as file:
            file.data[:] = numbers("f4")
        if order == ">":
            with mrcfile.open(path, "r+") as file:
                file._create_default_header()
                file.header.byteswap(inplace=True)
                file._header = file.header.view(file.header.dtype.newbyteorder())
                file.header.machst = [17, 17, 0, 0]
                file.set_data(numbers(">f4"))
        with mrcfile.open(path) as file:
            yield Case(path, np.array(file.data), PLAIN)


@program("gemmi")
def gemmi_maps(at):
    cells = {
        "box": (20, 25, 30, 90, 90, 90),
        "monoclinic": (20, 25, 30, 90, 105, 90),
        "triclinic": (20, 25, 30, 75, 105, 115),
        "hexagonal": (20, 20, 30, 90, 90, 120),
    }
    for name, cell in cells.items():
        for kind, mode in (gemmi.FloatGrid, 2), (gemmi.Int8Grid, 0):
            # u, v and w count along the edges of the cell.
            values = numbers("f4" if mode == 2 else "i1", (8, 9, 10))
            box = kind(values)
            box.set_unit_cell(gemmi.UnitCell(*cell))
            box.spacegroup = gemmi.SpaceGroup("P1")
            file = gemmi.Ccp4Map() if mode == 2 else gemmi.Ccp4Mask()
            file.grid = box
            file.update_ccp4_header(mode)
            path = at / f"{name}{mode}.ccp4"
            file.write_ccp4_map(str(path))
            whole = [[[box.get_position(u, v, w).tolist() for w in range(10)] for v in range(9)] for u in range(8)]
            yield Case(path, values, np.array(whole), length="Å")
            if mode == 2:
                first, last = (-2, 3, 1), (4, 11, 8)
                cut = gemmi.FractionalBox()
                # A little more than the numbers of the samples, because these are rounded.
                cut.minimum = gemmi.Fractional(*(f / n - 1e-4 for f, n in zip(first, values.shape)))
                cut.maximum = gemmi.Fractional(*(f / n + 1e-4 for f, n in zip(last, values.shape)))
                file.set_extent(cut)
                file.write_ccp4_map(str(at / f"{name}_part.map"))
                index = np.ix_(*(np.arange(f, t + 1) % n for f, t, n in zip(first, last, values.shape)))
                turn = np.array(box.unit_cell.orth.mat.tolist()) / values.shape
                matrix = np.eye(4)
                matrix[:3, :3], matrix[:3, 3] = turn, turn @ first
                yield Case(at / f"{name}_part.map", values[index], affine(matrix, values[index].shape), length="Å")


@program("ome-zarr")
def ome(at):
    for fmt in ome_zarr.format.FormatV04(), ome_zarr.format.FormatV05():
        v = fmt.version
        micro = {axis: "micrometer" for axis in "zyx"}
        size = {"z": 2.5, "y": 1.25, "x": 0.5}
        for dtype in "u1", "u2", "i4", "f4", "f8":
            path = at / f"{dtype}_{v}.zarr"
            ome_zarr.writer.write_image(
                numbers(dtype), str(path), scale_factors=None, axes="zyx", fmt=fmt, scale=size, axes_units=micro
            )
            yield Case(path, numbers(dtype), grid((0.5, 1.25, 2.5)), length="um")
        path, values = at / f"all_{v}.zarr", numbers("u2", (3, 2, *SHAPE))
        units, window = {**micro, "t": "second"}, {"min": 0, "max": 9, "start": 0, "end": 9}
        ome_zarr.writer.write_image(
            values, str(path), scale_factors=None, axes="tczyx", fmt=fmt, scale={"t": 2.5, "c": 1, **size}, axes_units=units,
            omero={"channels": [{"label": label, "color": "00FF00", "window": window} for label in ("DAPI", "GFP")]},
        )  # fmt: skip
        for args, c in (("--channel", "GFP"), 1), (("--channel", 0), 0):
            yield Case(path, values[:, c], grid((0.5, 1.25, 2.5)), args, (0, 2.5, 5), length="um", time="s")
        # Levels, each moved by the middles of its voxels.
        path, values = at / f"levels_{v}.zarr", numbers("u2", (8, 12, 16))
        halves = [{"z": 2, "y": 2, "x": 2}]
        method = ome_zarr.writer.Methods.NEAREST
        ome_zarr.writer.write_image(
            values, str(path), scale_factors=halves, axes="zyx", fmt=fmt, scale=size, axes_units=micro, method=method
        )
        found = zarr.open_group(path, mode="r")
        attributes = dict(found.attrs)
        for n, level in enumerate((attributes.get("ome") or attributes)["multiscales"][0]["datasets"]):
            moved = {one["type"]: one[one["type"]] for one in level["coordinateTransformations"]}
            spacing, origin = moved["scale"][::-1], moved.get("translation", [0] * 3)[::-1]
            data = found[level["path"]][:]
            yield Case(path, data, grid(spacing, origin, data.shape), ("--scale", n), length="um")
        mixed = {"z": "micrometer", "y": "nanometer", "x": "nanometer"}
        path = at / f"mixed_{v}.zarr"
        ome_zarr.writer.write_image(
            numbers("u2"),
            str(path),
            scale_factors=None,
            axes="zyx",
            fmt=fmt,
            scale={"z": 1, "y": 200, "x": 100},
            axes_units=mixed,
        )
        yield Case(path, numbers("u2"), grid((0.1, 0.2, 1)), length="um")


# Axes of a file of HyperSpy, the slowest first.
AXES = {"z": (2.5, 7, "µm"), "y": (1.25, 0, "µm"), "x": (0.5, -3.5, "µm")}


def signal(values, axes):
    """What rosettasciio's writers take."""
    return {
        "data": values,
        "axes": [
            {"name": name, "scale": scale, "offset": offset, "units": unit, "size": size, "index_in_array": n,
             "navigate": n < values.ndim - 2, "_type": "UniformDataAxis"}
            for n, ((name, (scale, offset, unit)), size) in enumerate(zip(axes.items(), values.shape))
        ],
        "metadata": {"General": {"title": "t"}, "Signal": {"signal_type": ""}},
        "original_metadata": {},
        "learning_results": {},
        "attributes": {"_lazy": False, "ragged": False},
        "package_info": {"package": "hyperspy", "package_version": "2.5.0"},
        "tmp_parameters": {},
        "models": {},
    }  # fmt: skip


@program("rosettasciio")
def hyperspy(at):
    places = grid((0.5, 1.25, 2.5), (-3.5, 0, 7))
    for dtype in "u1", "u2", "i4", "f4", "f8":
        hspy.file_writer(str(at / f"{dtype}.hspy"), signal(numbers(dtype), AXES))
        yield Case(at / f"{dtype}.hspy", numbers(dtype), places, length="um")
    mixed = {**AXES, "z": (2500, 7000, "nm")}
    hspy.file_writer(str(at / "mixed.hspy"), signal(numbers("f4"), mixed))
    yield Case(at / "mixed.hspy", numbers("f4"), places, length="um")
    rsciio_emd.file_writer(str(at / "a.emd"), signal(numbers("f4"), AXES))
    yield Case(at / "a.emd", numbers("f4"), places, length="um")
    nexus.file_writer(str(at / "a.nxs"), [signal(numbers("f4"), AXES)])
    yield Case(at / "a.nxs", numbers("f4"), places, length="um")
    ripple.file_writer(str(at / "a.rpl"), signal(numbers("f4"), AXES), encoding="latin-1")
    yield Refused(at / "a.rpl", "Ripple|raw")


@program("emdfile")
def emd(at):
    for names in (["z", "y", "x"], ["x", "y", "z"]):
        for dtype in "u2", "f4":
            values = numbers(dtype)
            steps = {"x": (-3.5, -3.0), "y": (0, 1.25), "z": (7, 9.5)}
            array = emdfile.Array(
                values, name="v", units="K", dims=[steps[n] for n in names], dim_units=["nm"] * 3, dim_names=names
            )
            path = at / f"{''.join(names)}_{dtype}.emd"
            emdfile.save(str(path), array)
            coordinates = [steps[n][0] + (steps[n][1] - steps[n][0]) * np.arange(s) for n, s in zip(names, SHAPE)]
            places = np.stack(np.meshgrid(*coordinates, indexing="ij"), -1)[..., [names.index(a) for a in "xyz"]]
            yield Case(path, values, places, length="nm")


@program("ncempy")
def ncem(at):
    for names in ("z", "y", "x"), ("x", "y", "z"):
        values = numbers("f4")
        vectors = {"x": -3.5 + 0.5 * np.arange(9), "y": 1.25 * np.arange(9), "z": 7 + 2.5 * np.arange(9)}
        dims = tuple((vectors[n][:s], n, "[n_m]") for n, s in zip(names, SHAPE))
        path = at / f"{''.join(names)}.emd"
        with fileEMD(str(path), readonly=False) as file:
            file.put_emdgroup("v", values, dims)
        places = np.stack(np.meshgrid(*(d[0] for d in dims), indexing="ij"), -1)[..., [names.index(a) for a in "xyz"]]
        yield Case(path, values, places, length="nm")
