"""The widget of the napari plugin: a slider over the spectrum of the selected archive."""

from __future__ import annotations

from typing import Any

from qtpy.QtCore import QPointF, Qt
from qtpy.QtGui import QColor, QPainter, QPen, QPolygonF
from qtpy.QtWidgets import QDoubleSpinBox, QLabel, QSlider, QVBoxLayout, QWidget

from ._archive import Archive, Spectrum
from ._napari import KEY, STEPS, curve, isovalue_at, layer_data, place_of


class _Curve(QWidget):
    """The area of the isosurface over the isovalue."""

    def __init__(self) -> None:
        super().__init__()
        self.setMinimumHeight(80)
        self._spectrum: Spectrum | None = None
        self._ends, self._isovalue = (0.0, 1.0), 0.0

    def show_spectrum(self, spectrum: Spectrum | None, ends: tuple[float, float]) -> None:
        self._spectrum, self._ends = spectrum, ends
        self.update()

    def show_isovalue(self, isovalue: float) -> None:
        self._isovalue = isovalue
        self.update()

    def paintEvent(self, _event: Any) -> None:  # noqa: N802
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(30, 30, 30))
        if self._spectrum is None:
            return
        painter.setRenderHint(QPainter.Antialiasing)
        painter.setPen(QPen(QColor(120, 180, 240), 1.5))
        points = curve(self._spectrum, self._ends, self.width(), self.height())
        painter.drawPolyline(QPolygonF([QPointF(x, y) for x, y in points]))
        x = place_of(self._isovalue, self._ends) / STEPS * (self.width() - 1)
        painter.setPen(QPen(QColor(240, 200, 80), 1.5))
        painter.drawLine(QPointF(x, 0), QPointF(x, self.height()))


class Isosurface(QWidget):
    """Drags the isovalue of the selected layer, where that is of an archive."""

    def __init__(self, napari_viewer: Any) -> None:
        super().__init__()
        self._viewer = napari_viewer
        self._archive: Archive | None = None
        self._layer: Any = None
        self._ends = (0.0, 1.0)
        self._title, self._curve, self._status = QLabel(), _Curve(), QLabel()
        self._slider, self._number = QSlider(Qt.Horizontal), QDoubleSpinBox()
        self._slider.setRange(0, STEPS)
        self._number.setDecimals(6)
        self._number.setKeyboardTracking(False)
        rows = QVBoxLayout(self)
        for row in (self._title, self._curve, self._slider, self._number, self._status):
            rows.addWidget(row)
        rows.addStretch()
        self._slider.valueChanged.connect(
            lambda place: self.show_isovalue(isovalue_at(place, self._ends))
        )
        self._number.valueChanged.connect(self.show_isovalue)
        napari_viewer.layers.selection.events.active.connect(lambda _event: self.look())
        self.look()

    def look(self) -> None:
        """Takes up the selected layer."""
        layer = self._viewer.layers.selection.active
        about = None if layer is None else layer.metadata.get(KEY)
        for part in (self._curve, self._slider, self._number):
            part.setEnabled(about is not None)
        if about is None:
            self._archive = self._layer = None
            self._title.setText("Select a layer that is of an archive")
            self._curve.show_spectrum(None, (0.0, 1.0))
            return
        self._archive, self._layer = Archive(about["path"]), layer
        spectrum = self._archive.spectrum()
        self._ends = spectrum.range or (0.0, 1.0)
        self._title.setText(layer.name)
        self._number.blockSignals(True)
        self._number.setRange(*self._ends)
        self._number.setSingleStep((self._ends[1] - self._ends[0]) / 100)
        self._number.blockSignals(False)
        self._curve.show_spectrum(spectrum, self._ends)
        self._mark(about["isovalue"], len(layer.data[1]))

    def show_isovalue(self, isovalue: float) -> None:
        """Extracts the surface of an isovalue, and shows it in the place of the one before."""
        if self._archive is None:
            return
        surface = self._archive.surface(isovalue)
        self._layer.data = layer_data(surface)
        self._layer.metadata[KEY]["isovalue"] = isovalue
        self._mark(isovalue, len(surface))

    def _mark(self, isovalue: float, triangles: int) -> None:
        for part in (self._slider, self._number):
            part.blockSignals(True)
        self._slider.setValue(place_of(isovalue, self._ends))
        self._number.setValue(isovalue)
        for part in (self._slider, self._number):
            part.blockSignals(False)
        self._curve.show_isovalue(isovalue)
        self._status.setText(f"{triangles} triangles")
