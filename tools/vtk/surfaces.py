"""Reads with VTK, trimesh, meshoptimizer, lib3mf and Draco the surfaces that tools/vtk/test has made in this folder, and compares what they keep besides."""
import json
import pathlib

import DracoPy
import h5py
import lib3mf
import meshoptimizer
import numpy as np
import trimesh
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

METRES = 1e-6


def read(reader, name):
    reader.SetFileName(name)
    reader.Update()
    assert reader.GetErrorCode() == 0, name
    return reader.GetOutput()


def field(polys, name):
    array = polys.GetFieldData().GetAbstractArray(name)
    return None if array is None else [array.GetVariantValue(n).ToString() for n in range(array.GetNumberOfValues())]


def near(found, expected, tolerance, what):
    assert np.allclose(found, expected, rtol=tolerance, atol=0), f"{what}: {found}, expected {expected}"


def y_up(points):
    """World coordinates in micrometres as metres, y up."""
    x, y, z = np.asarray(points, float).T * METRES
    return np.stack([x, z, -y], axis=1)


def points(polys):
    return vtk_to_numpy(polys.GetPoints().GetData())


with open("units.json") as file:
    expected = json.load(file)
vtp = read(vtkXMLPolyDataReader(), "units.vtp")
for name, polys in (("vtp", vtp), ("vtkhdf", read(vtkHDFReader(), "units.vtkhdf"))):
    assert field(polys, "isovalue") == ["1000.5"] and polys.GetPointData().GetArray("isovalue") is None, name
for name, reader in (("vtp", vtkXMLPolyDataReader()), ("vtkhdf", vtkHDFReader())):
    both = read(reader, f"units_both.{name}")
    assert field(both, "isovalue") is None and both.GetPointData().GetArray("isovalue") is not None, name
assert field(vtp, "length_unit") == ["µm"] and field(vtp, "value_unit") == ["HU"]
with h5py.File("units.vtkhdf") as file:
    assert {"length_unit µm", "value_unit HU"} <= set(file["comments"].asstr()[:])
world = points(vtp)

# Steps.
for number in range(3):
    polys = read(vtkXMLPolyDataReader(), f"step_{number}.vtp")
    assert field(polys, "TimeValue") == [str((0, 0.5, 2)[number])] and field(polys, "time_unit") == ["s"]
reader = vtkHDFReader()
reader.SetFileName("steps.vtkhdf")
reader.UpdateInformation()
times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
assert times == (0.0, 0.5, 2.0), times
for number, time in enumerate(times):
    reader.UpdateTimeStep(time)
    polys, single = reader.GetOutput(), read(vtkXMLPolyDataReader(), f"step_{number}.vtp")
    assert np.array_equal(points(polys), points(single)), number
    corners = [vtk_to_numpy(p.GetPolys().GetConnectivityArray()) for p in (polys, single)]
    assert np.array_equal(*corners), number
    for name in ("isovalue", "Normals"):
        arrays = [vtk_to_numpy(p.GetPointData().GetArray(name)) for p in (polys, single)]
        assert np.array_equal(*arrays), (number, name)

# The isovalue of one surface is that of all steps.
reader = vtkHDFReader()
reader.SetFileName("steps_one.vtkhdf")
reader.UpdateInformation()
for time in times:
    reader.UpdateTimeStep(time)
    polys = reader.GetOutput()
    assert polys.GetNumberOfPoints() > 0 and field(polys, "isovalue") == ["1000.5"], time

# GLB, as trimesh and all that takes it for metres have it.
scene = trimesh.load_scene("units.glb", process=False)
mesh = scene.to_geometry()
assert len(mesh.faces) == expected["triangles"] and list(scene.graph.nodes_geometry) == ["isovalue 1000.5"]
near(mesh.vertices, y_up(world), 1e-6, "GLB in metres")
material = next(iter(scene.geometry.values())).visual.material
assert material.doubleSided and material.metallicFactor == 0 and 0 < material.roughnessFactor < 1
assert mesh.is_winding_consistent
normals = next(iter(scene.geometry.values())).vertex_normals
assert len(normals) == expected["vertices"]
scene = trimesh.load_scene("units_both.glb", process=False)
assert sorted(scene.graph.nodes_geometry) == ["isovalue 1000.5", "isovalue 400"]
assert sum(len(g.faces) for g in scene.geometry.values()) > expected["triangles"]
ends = sum(len(g.vertices) for g in scene.geometry.values())
both = read(vtkXMLPolyDataReader(), "units_both.vtp")
assert ends == both.GetNumberOfPoints()
near(scene.bounds, np.sort(y_up(np.array([points(both).min(0), points(both).max(0)])), axis=0), 1e-6, "GLB of two")
packed = trimesh.load_scene("units_packed.glb", process=False).to_geometry()
extent = np.ptp(y_up(world), axis=0).max()
assert np.abs(packed.vertices - y_up(world)).max() < extent / 131070 * 1.01
assert np.array_equal(packed.faces, mesh.faces)


def chunks(name):
    """The JSON text and the binary data of a GLB."""
    data = pathlib.Path(name).read_bytes()
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + length]), data[20 + length + 8 :]


# What meshoptimizer decodes is what the quantized file has; triangles may begin at another corner.
document, data = chunks("units_packed.glb")
coded, coded_data = chunks("units_coded.glb")
assert coded["extensionsRequired"] == ["KHR_mesh_quantization", "EXT_meshopt_compression"]
assert coded["accessors"] == document["accessors"] and coded["nodes"] == document["nodes"]
for plain, view in zip(document["bufferViews"], coded["bufferViews"], strict=True):
    of = view["extensions"]["EXT_meshopt_compression"]
    assert (view["byteOffset"], view["byteLength"]) == (plain["byteOffset"], plain["byteLength"])
    expected_bytes = np.frombuffer(data, np.uint8, plain["byteLength"], plain["byteOffset"])
    packed_bytes = np.frombuffer(coded_data, np.uint8, of["byteLength"], of["byteOffset"])
    if of["mode"] == "ATTRIBUTES":
        decoded = meshoptimizer.decode_vertex_buffer(of["count"], of["byteStride"], packed_bytes.tobytes())
        assert decoded.tobytes()[: len(expected_bytes)] == expected_bytes.tobytes()
    else:
        decoded = np.asarray(meshoptimizer.decode_index_buffer(of["count"], 4, packed_bytes.tobytes()))
        expected_corners = expected_bytes.view(f"<u{of['byteStride']}").reshape(-1, 3).astype(np.int64)
        corners = decoded.reshape(-1).view(np.uint32).reshape(-1, 3).astype(np.int64)
        turns = [np.roll(corners, turn, axis=1) for turn in range(3)]
        assert np.logical_or.reduce([(turn == expected_corners).all(axis=1) for turn in turns]).all()
colours = next(iter(trimesh.load_scene("units_colours.glb", process=False).geometry.values())).visual
# The surface has one value, so all of it has one colour; glTF's colours are linear.
rgba = np.unique(np.asarray(colours.vertex_attributes["color"] if colours.kind == "texture" else colours.vertex_colors), axis=0)
ply = trimesh.load("units_colours.ply", process=False).visual.vertex_colors
srgb = np.median(ply, axis=0)[:3] / 255
linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
assert np.abs(np.median(rgba, axis=0)[:3] / 255 - linear).max() < 0.01, (rgba, linear)

# 3MF, as lib3mf and trimesh have it.
wrapper = lib3mf.get_wrapper()
for name, count in (("units", 1), ("units_both", 2), ("units_colours", 1)):
    model = wrapper.CreateModel()
    three = model.QueryReader("3mf")
    three.ReadFromFile(f"{name}.3mf")
    assert three.GetWarningCount() == 0, [three.GetWarning(n) for n in range(three.GetWarningCount())]
    assert model.GetUnit() == lib3mf.ModelUnit.MicroMeter, model.GetUnit()
    objects = model.GetMeshObjects()
    found = []
    while objects.MoveNext():
        found.append(objects.GetCurrentMeshObject())
    assert len(found) == count and found[-1].GetName() == "isovalue 1000.5", name
    assert found[-1].GetTriangleCount() == expected["triangles"] and found[-1].GetVertexCount() == expected["vertices"]
    if name == "units":
        vertices = np.array([list(v.Coordinates) for v in found[0].GetVertices()])
        near(vertices, world, 1e-6, "3MF")
        assert found[0].IsManifoldAndOriented() or not mesh.is_watertight
    if name == "units_colours":
        groups = model.GetColorGroups()
        assert groups.MoveNext()
        group = groups.GetCurrentColorGroup()
        assert group.GetCount() == 257
        properties = found[0].GetTriangleProperties(0)
        assert properties.ResourceID == group.GetResourceID()
        colour = group.GetColor(properties.PropertyIDs[0])
        assert np.abs(np.array([colour.Red, colour.Green, colour.Blue]) / 255 - srgb).max() < 0.02
scene = trimesh.load_scene("units.3mf", process=False)
assert scene.units == "micron" and sum(len(g.faces) for g in scene.geometry.values()) == expected["triangles"], scene.units

# Meshes of neuroglancer, decoded by Draco's own library: micrometres as nanometres.
folder = pathlib.Path("units.precomputed")
info = json.loads((folder / "info").read_text())
assert info["@type"] == "neuroglancer_multilod_draco" and info["vertex_quantization_bits"] == 16, info
properties = json.loads((folder / "segment_properties/info").read_text())["inline"]
assert properties["ids"] == ["1", "2"] and properties["properties"][0]["values"] == ["isovalue 400", "isovalue 1000.5"]
shard = (folder / "0.shard").read_bytes()
assert info["sharding"]["minishard_bits"] == info["sharding"]["shard_bits"] == 0, info
start, end = np.frombuffer(shard, "<u8", 2) + 16
segments, gaps, lengths = np.frombuffer(shard[start:end], "<u8").reshape(3, -1)
assert np.cumsum(segments).tolist() == [1, 2]
at = int(16 + gaps[0] + lengths[0] + gaps[1])
floats = np.frombuffer(shard[at : at + int(lengths[1])], "<f4")
numbers = floats.view("<u4")
cell, origin, levels = floats[:3].astype(float), floats[3:6].astype(float), int(numbers[6])
scales = floats[7 : 7 + levels]
assert levels > 1 and (np.diff(scales) > 0).all() and not floats[7 + levels : 7 + 4 * levels].any(), floats
counts = numbers[7 + 4 * levels : 7 + 5 * levels].tolist()
rest = numbers[7 + 5 * levels :]
# The fragments lie between the manifest of the first segment and this one.
mesh_bytes, at = shard[int(16 + gaps[0] + lengths[0]) : at], 0
transform = np.array([*info["transform"], 0, 0, 0, 1]).reshape(4, 4)
areas, sizes = [], []
for level, count in enumerate(counts):
    places, bytes_of_cells, rest = rest[: 3 * count].reshape(3, count).T, rest[3 * count : 4 * count], rest[4 * count :]
    step, area, faces, corners = cell * 2.0**level / 65535, 0, 0, []
    for place, size in zip(places.astype(int), bytes_of_cells.tolist()):
        if size:
            mesh = DracoPy.decode(mesh_bytes[at : at + size])
            at += size
            corners.append(np.asarray(mesh.points, float) + 65535 * place)
            found = (origin + step * corners[-1]) @ transform[:3, :3].T + transform[:3, 3]
            a, b, c = (found[np.asarray(mesh.faces).reshape(-1, 3)[:, n]] for n in range(3))
            area += np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
            faces += len(a)
    areas.append(area)
    sizes.append(faces)
    if level == 0:
        # Each vertex is there, in the nearest of the steps.
        ours = {tuple(corner) for corner in np.concatenate(corners).astype(int).tolist()}
        assert all(tuple(place) in ours for place in np.round((world - origin) / step).astype(int).tolist())
assert at == len(mesh_bytes) and not len(rest)
triangles = vtk_to_numpy(vtp.GetPolys().GetConnectivityArray()).reshape(-1, 3)
a, b, c = (world[triangles[:, n]] * 1000 for n in range(3))
near(areas[0], np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, 1e-4, "area for neuroglancer")
assert all(coarser < 0.6 * finer for finer, coarser in zip(sizes, sizes[1:])), sizes
near(areas, areas[0], 0.1, "areas of levels")
print("tools/vtk/surfaces.py: VTK, trimesh, meshoptimizer, lib3mf and Draco find units, times, steps, parts and colours of surfaces")
