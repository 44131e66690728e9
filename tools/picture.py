#!/usr/bin/env python3
"""Draws PLY surfaces as a PNG: a panel each, side by side, seen from the same direction.

    picture.py -o tooth.png dentin.ply:e6cfa4 enamel.ply:dfe6ee --azimuth 30 --elevation 15 --up z

By hand only, not part of the tests: needs `pip install vtk numpy pillow`, and a Mesa that renders without a window. Key,
fill and rim light follow the camera; ambient occlusion darkens crevices; the picture is drawn three times as large as
asked and reduced, which smooths edges. Normals of the file are used; without them, flat triangles.
"""

import argparse
import io
import sys

import numpy as np
import vtk
from PIL import Image
from vtk.util.numpy_support import vtk_to_numpy

LARGER = 3
DEFAULT_COLOUR = "d8cbb4"


def rgb(text):
    return tuple(int(text[i : i + 2], 16) / 255 for i in (0, 2, 4))


def read_surface(argument):
    """The surface of `FILE[:COLOUR]`, and its colour."""
    path, _, colour = argument.partition(":")
    reader = vtk.vtkPLYReader()
    reader.SetFileName(path)
    reader.Update()
    mesh = reader.GetOutput()
    if mesh.GetNumberOfPolys() == 0:
        sys.exit(f"{path}: no triangles were read")
    return mesh, rgb(colour or DEFAULT_COLOUR)


def actor_of(mesh, colour):
    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputData(mesh)
    mapper.ScalarVisibilityOff()
    actor = vtk.vtkActor()
    actor.SetMapper(mapper)
    look = actor.GetProperty()
    look.SetColor(colour)
    look.SetAmbient(0.3)
    look.SetDiffuse(0.8)
    look.SetSpecular(0.22)
    look.SetSpecularPower(28)
    if mesh.GetPointData().GetNormals() is None:
        look.SetInterpolationToFlat()
    else:
        look.SetInterpolationToPhong()
    return actor


def add_lights(renderer):
    for position, strength in (((-0.8, 0.9, 1.2), 0.95), ((1.2, 0.1, 1.0), 0.45), ((0.2, 1.0, -0.6), 0.35)):
        light = vtk.vtkLight()
        light.SetLightTypeToCameraLight()
        light.SetPosition(position)
        light.SetFocalPoint(0, 0, 0)
        light.SetIntensity(strength)
        renderer.AddLight(light)


def aim(renderer, bounds, args):
    """Looks at the middle of the box from azimuth and elevation about the upward axis."""
    lo_hi = np.array(bounds).reshape(3, 2)
    centre, size = lo_hi.mean(axis=1), np.linalg.norm(lo_hi[:, 1] - lo_hi[:, 0])
    up = np.eye(3)["xyz".index(args.up[-1])] * (-1 if args.up.startswith("-") else 1)
    right = np.roll(up, 1)
    front = np.cross(right, up)
    a, e = np.radians(args.azimuth), np.radians(args.elevation)
    towards = np.cos(e) * (np.cos(a) * front + np.sin(a) * right) + np.sin(e) * up
    camera = renderer.GetActiveCamera()
    camera.SetFocalPoint(centre)
    camera.SetPosition(centre + 3 * size * towards)
    camera.SetViewUp(up)
    camera.SetViewAngle(20)
    renderer.ResetCamera(bounds)
    camera.Zoom(args.zoom)
    renderer.ResetCameraClippingRange()
    return size


def occlusion(size):
    passes = vtk.vtkSSAOPass()
    passes.SetRadius(0.1 * size)
    passes.SetBias(0.002 * size)
    passes.SetKernelSize(128)
    passes.BlurOn()
    passes.SetDelegatePass(vtk.vtkRenderStepsPass())
    return passes


def draw(mesh, colour, bounds, args):
    """One panel, as an array of rows from the top."""
    renderer = vtk.vtkRenderer()
    renderer.SetBackground(rgb(args.background))
    renderer.AutomaticLightCreationOff()
    renderer.AddActor(actor_of(mesh, colour))
    add_lights(renderer)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(args.width * LARGER, args.height * LARGER)
    window.AddRenderer(renderer)
    renderer.SetPass(occlusion(aim(renderer, bounds, args)))
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.Update()
    image = grab.GetOutput()
    x, y, _ = image.GetDimensions()
    return vtk_to_numpy(image.GetPointData().GetScalars()).reshape(y, x, 3)[::-1]


def png_bytes(image, most):
    """The PNG, in 256 colours where it would be larger than `most` bytes."""
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    if out.tell() > most:
        out = io.BytesIO()
        image.quantize(256, dither=Image.Dither.FLOYDSTEINBERG).save(out, "PNG", optimize=True)
    if out.tell() > most:
        sys.exit(f"the picture takes {out.tell()} bytes, more than {most}: draw it smaller")
    return out.getvalue()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("surface", nargs="+", metavar="FILE[:RRGGBB]")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--width", type=int, default=480, help="of a panel, in pixels")
    parser.add_argument("--height", type=int, default=560)
    parser.add_argument("--azimuth", type=float, default=30)
    parser.add_argument("--elevation", type=float, default=15)
    parser.add_argument("--up", default="z", choices=["x", "y", "z", "-x", "-y", "-z"])
    parser.add_argument("--zoom", type=float, default=1.25)
    parser.add_argument("--background", default="ffffff")
    parser.add_argument("--most-bytes", type=int, default=300_000)
    args = parser.parse_args()
    surfaces = [read_surface(s) for s in args.surface]
    boxes = np.array([mesh.GetBounds() for mesh, _ in surfaces])
    bounds = [f(boxes[:, i]) for i, f in enumerate([np.min, np.max] * 3)]
    panels = [draw(mesh, colour, bounds, args) for mesh, colour in surfaces]
    wide = Image.fromarray(np.ascontiguousarray(np.hstack(panels)))
    picture = wide.resize((args.width * len(panels), args.height), Image.Resampling.LANCZOS)
    with open(args.output, "wb") as file:
        file.write(png_bytes(picture, args.most_bytes))


if __name__ == "__main__":
    main()
