"""Surfaces of decoded samples beside those of all samples."""
import math

import numpy as np
import scipy.sparse
import scipy.spatial
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from coders import Isospan, timed

# A component is a false island if no vertex has one of the true surface this near, in samples.
FAR = 2.0
# Distances and angles are those of so many triangles.
TRIANGLES = 20_000


def isovalues(volume):
    """35 and 60 % of the way through the range of the middle 98 % of the samples."""
    low, high = np.percentile(volume.values, [1, 99])
    return [float(low + part * (high - low)) for part in (0.35, 0.6)]


def contour(samples, isovalue):
    values = np.ascontiguousarray(samples, np.float32).ravel()
    image = vtk.vtkImageData()
    image.SetDimensions(samples.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(values, deep=True))
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, isovalue)
    edges.ComputeNormalsOff()
    edges.Update()
    return edges.GetOutput()


class Mesh:
    """Points and triangles of a surface, and normals of these, twice as long as their areas."""

    def __init__(self, surface):
        self.surface = surface
        self.points = vtk_to_numpy(surface.GetPoints().GetData()).astype(float)
        self.cells = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        a, b, c = (self.points[self.cells[:, k]] for k in range(3))
        self.normals = np.cross(b - a, c - a)

    def components(self):
        """How many there are, and that of each point; -1 where no triangle has the point."""
        used, cells = np.unique(self.cells, return_inverse=True)
        cells = cells.reshape(-1, 3)
        ends = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]]])
        graph = scipy.sparse.coo_matrix(
            (np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(len(used), len(used))
        )
        count, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
        of_points = np.full(len(self.points), -1)
        of_points[used] = labels
        return count, of_points

    def euler(self):
        cells = self.cells
        edges = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
        edges = np.sort(edges, axis=1).astype(np.int64)
        edges = np.unique(edges[:, 0] * len(self.points) + edges[:, 1])
        return len(np.unique(cells)) - len(edges) + len(cells)


class Truth:
    """The surface of all samples, and what finds the nearest of it."""

    def __init__(self, volume, isovalue):
        self.isovalue = isovalue
        self.mesh = Mesh(contour(volume.values, isovalue))
        self.tree = scipy.spatial.cKDTree(self.mesh.points)
        self.locator = vtk.vtkStaticCellLocator()
        self.locator.SetDataSet(self.mesh.surface)
        self.locator.BuildLocator()

    def nearest(self, places):
        """Distances to the surface, and the triangles that are nearest."""
        close, square = [0.0] * 3, vtk.reference(0.0)
        cell, part = vtk.reference(0), vtk.reference(0)
        squares, cells = [], []
        for place in places:
            self.locator.FindClosestPoint(place, close, cell, part, square)
            squares.append(square.get())
            cells.append(cell.get())
        return np.sqrt(squares), np.array(cells)


def truths(volume):
    """The true surfaces of a volume that are not empty."""
    made = (Truth(volume, isovalue) for isovalue in isovalues(volume))
    return [truth for truth in made if len(truth.mesh.cells)]


def islands(mesh, count, of_points, truth):
    """Components no vertex of which has a vertex of the true surface near it."""
    distance, _ = truth.tree.query(mesh.points, distance_upper_bound=FAR)
    near = of_points[np.isfinite(distance) & (of_points >= 0)]
    return count - len(np.unique(near))


def describe(surface, truth):
    """What a surface is, and how far it is from the true one; angles are between triangles."""
    mesh = Mesh(surface)
    chosen = np.random.default_rng(0).permutation(len(mesh.cells))[:TRIANGLES]
    distance, cells = truth.nearest(mesh.points[mesh.cells[chosen]].mean(axis=1))
    mine, theirs = mesh.normals[chosen], truth.mesh.normals[cells]
    length = np.linalg.norm(mine, axis=1) * np.linalg.norm(theirs, axis=1)
    some = length > 0
    cosine = np.abs((mine * theirs).sum(axis=1)[some]) / length[some]
    angle = np.degrees(np.arccos(np.minimum(cosine, 1)))
    count, of_points = mesh.components()
    return dict(
        triangles=len(mesh.cells),
        mean=float(distance.mean()),
        rms=math.sqrt((distance**2).mean()),
        most=float(distance.max()),
        angle=float(angle.mean()),
        components=int(count),
        islands=int(islands(mesh, count, of_points, truth)),
        euler=int(mesh.euler()),
    )


def rows_of(name, coder, answer, about, truths, scratch):
    """Rows of a coder's answer: the surfaces of its decoded samples, and an archive's own."""
    rows = []

    def add(coder, truth, surface, read, seconds):
        if surface.GetNumberOfPolys():
            this = dict(isovalue=truth.isovalue, coder=coder)
            cost = dict(size=answer.size, read=read, seconds=seconds)
            rows.append(about | this | describe(surface, truth) | cost)

    for truth in truths:
        surface, seconds = timed(lambda: contour(answer.samples, truth.isovalue))
        add(name, truth, surface, answer.size, answer.read + seconds)
        if isinstance(coder, Isospan):
            add(f"{name}, own surface", truth, *coder.surface(truth.isovalue, scratch))
    return rows


def true_rows(volume, truths):
    """Rows of the true surfaces themselves."""
    size = volume.values.nbytes
    rows = []
    for truth in truths:
        about = dict(volume=volume.name, target=0.0, reached=0.0, isovalue=truth.isovalue)
        cost = dict(coder="all samples", size=size, read=size, seconds=0.0)
        rows.append(about | describe(truth.mesh.surface, truth) | cost)
    return rows
