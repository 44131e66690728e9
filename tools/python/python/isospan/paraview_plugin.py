"""The ParaView plugin: in Tools, Manage Plugins, Load New, choose this file.

ParaView's Python needs isospan: ``pvpython -m pip install isospan``, or a PYTHONPATH where it lies.
Open the file ``manifest.zst`` of an archive, or type the name of its folder. Port 0 is the
surfaces, port 1 the tetrahedra, which are empty unless they are asked for. With VTK alone the class
is a source as any other. (ParaView imports a plugin by the name of its file: as paraview.py it
would hide ParaView's own module.)
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.util.vtkAlgorithm import VTKPythonAlgorithmBase
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import (
    vtkCellArray,
    vtkDataObject,
    vtkPolyData,
    vtkUnstructuredGrid,
)
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

import isospan

try:
    from paraview.util.vtkAlgorithm import smdomain, smhint, smproperty, smproxy
except ImportError:
    # With VTK alone, what tells ParaView about the class tells nobody.
    class _Nothing:
        def __getattr__(self, _name: str) -> Any:
            return lambda *_about, **_more: lambda given: given

    smdomain = smhint = smproperty = smproxy = _Nothing()


def poly_data(surfaces: list[isospan.Surface], out: vtkPolyData) -> None:
    """Puts surfaces into one data set, with normals, and for each vertex the isovalue."""
    counts = [len(s.vertices) for s in surfaces]
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    points = vtkPoints()
    points.SetData(numpy_to_vtk(np.concatenate([s.vertices for s in surfaces]), deep=True))
    faces = np.concatenate([s.faces.astype(np.int64) + start for s, start in zip(surfaces, starts)])
    cells = vtkCellArray()
    cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces).ravel(), deep=True))
    normals = numpy_to_vtk(np.concatenate([s.normals for s in surfaces]), deep=True)
    normals.SetName("Normals")
    isovalues = numpy_to_vtk(np.repeat([s.isovalue for s in surfaces], counts), deep=True)
    isovalues.SetName("isovalue")
    out.SetPoints(points)
    out.SetPolys(cells)
    out.GetPointData().SetNormals(normals)
    out.GetPointData().SetScalars(isovalues)


@smproxy.reader(
    name="IsospanReader",
    label="Isospan Reader",
    extensions="isospan json",
    file_description="isospan archives",
)
class IsospanReader(VTKPythonAlgorithmBase):
    """Isosurfaces, and if wanted tetrahedra, of an archive, at any of its times."""

    def __init__(self) -> None:
        super().__init__(nInputPorts=0, nOutputPorts=2, outputType="vtkPolyData")
        self._path: str | None = None
        self._isovalues: list[float] = []
        self._bounds = [-np.inf, np.inf] * 3
        self._cut, self._tetrahedra = False, False

    def FillOutputPortInformation(self, port: int, info: Any) -> int:
        kind = ("vtkPolyData", "vtkUnstructuredGrid")[port]
        info.Set(vtkDataObject.DATA_TYPE_NAME(), kind)
        return 1

    @smproperty.stringvector(name="FileName")
    @smdomain.filelist()
    @smhint.filechooser(extensions="isospan json", file_description="isospan archives")
    def SetFileName(self, path: str | None) -> None:
        """The folder of the archive, or its file manifest.zst."""
        if path is not None and os.path.basename(path) == "manifest.zst":
            path = os.path.dirname(path)
        if path != self._path:
            self._path = path
            self.Modified()

    @smproperty.doublevector(
        name="TimestepValues", information_only="1", si_class="vtkSITimeStepsProperty"
    )
    def GetTimestepValues(self) -> list[float]:
        """The times of the steps; their numbers where they have none."""
        return [] if self._path is None else _times(self._path)[0]

    @smproperty.xml(
        """<DoubleVectorProperty name="Isovalues" command="AddIsovalue"
            clean_command="ClearIsovalues" number_of_elements_per_command="1"
            number_of_elements="0" repeat_command="1">
            <Documentation>
                Isovalues; without any, the one that the spectrum marks most.
            </Documentation>
        </DoubleVectorProperty>"""
    )
    def AddIsovalue(self, isovalue: float) -> None:
        """One more isovalue."""
        self._isovalues.append(isovalue)
        self.Modified()

    def ClearIsovalues(self) -> None:
        """No isovalue: then it is the one that the spectrum marks most."""
        self._isovalues = []
        self.Modified()

    @smproperty.intvector(name="CutAtRegion", default_values=0)
    @smdomain.xml('<BooleanDomain name="bool"/>')
    def SetCutAtRegion(self, cut: int) -> None:
        """Whether surfaces are cut at the region; tetrahedra are those that touch it."""
        self._cut = bool(cut)
        self.Modified()

    @smproperty.doublevector(name="Region", default_values=[0.0, 1.0, 0.0, 1.0, 0.0, 1.0])
    def SetRegion(self, x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> None:
        """A box in world units."""
        self._bounds = [x0, x1, y0, y1, z0, z1]
        self.Modified()

    @smproperty.intvector(name="Tetrahedra", default_values=0)
    @smdomain.xml('<BooleanDomain name="bool"/>')
    def SetTetrahedra(self, wanted: int) -> None:
        """Whether port 1 has the tetrahedra."""
        self._tetrahedra = bool(wanted)
        self.Modified()

    def RequestInformation(self, _request: Any, _inputs: Any, outputs: Any) -> int:
        if self._path is None:
            raise isospan.UsageError("the reader has no file name")
        times = _times(self._path)[0]
        for port in range(2):
            info = outputs.GetInformationObject(port)
            for time in times:
                info.Append(Pipeline.TIME_STEPS(), time)
            for end in (times[0], times[-1]):
                info.Append(Pipeline.TIME_RANGE(), end)
        return 1

    def RequestData(self, _request: Any, _inputs: Any, outputs: Any) -> int:
        surface, tetrahedra = (
            vtkPolyData.GetData(outputs, 0),
            vtkUnstructuredGrid.GetData(outputs, 1),
        )
        with self._archive(outputs) as archive:
            isovalues = self._isovalues or [_marked(archive)]
            box: dict[str, Any] = {"bounds": [float(b) for b in self._bounds]} if self._cut else {}
            poly_data(archive.surface(sorted(set(isovalues)), **box), surface)
            if self._tetrahedra:
                _read_tetrahedra(archive, box, tetrahedra)
        return 1

    def _archive(self, outputs: Any) -> isospan.Archive:
        """The archive at the time that is asked for; its first step if none is."""
        path = self._path or ""
        for port in range(2):
            info = outputs.GetInformationObject(port)
            if info.Has(Pipeline.UPDATE_TIME_STEP()):
                wanted = info.Get(Pipeline.UPDATE_TIME_STEP())
                times, numbers = _times(path)
                if len(times) == 1:
                    break
                nearest = int(np.argmin(np.abs(np.array(times) - wanted)))
                return isospan.open(path, step=numbers[nearest])
        return isospan.open(path)


def _times(path: str) -> tuple[list[float], list[int]]:
    """Times and numbers of the steps."""
    with isospan.open(path) as archive:
        steps = archive.steps
    return [float(s["number"] if s["time"] is None else s["time"]) for s in steps], [
        s["number"] for s in steps
    ]


def _marked(archive: isospan.Archive) -> float:
    from isospan._pyvista import default_isovalue

    return default_isovalue(archive)


def _read_tetrahedra(
    archive: isospan.Archive, box: dict[str, Any], out: vtkUnstructuredGrid
) -> None:
    import tempfile

    with tempfile.TemporaryDirectory(prefix="isospan-") as folder:
        file = os.path.join(folder, "tetrahedra.vtu")
        archive.save_tetrahedra(file, **box)
        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(file)
        reader.Update()
        out.ShallowCopy(reader.GetOutput())
