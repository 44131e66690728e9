"""The extension module: what the package is built on. Not for users."""

from os import PathLike
from typing import Any, Callable, Sequence, TypeAlias

_Path: TypeAlias = str | PathLike[str]
_When: TypeAlias = tuple[int | str | tuple[int, str] | None, float | None]
_Level: TypeAlias = tuple[int | None, int | None, str | None]
_Callback: TypeAlias = Callable[[str, int, int, str], Any] | None
_Report: TypeAlias = dict[str, Any]

__version__: str

def program(arguments: Sequence[str]) -> int: ...
def reduce(
    arguments: Sequence[str], volumes: Sequence[Volume] | None, progress: _Callback
) -> _Report: ...
def append(
    arguments: Sequence[str], volumes: Sequence[Volume] | None, progress: _Callback
) -> _Report: ...
def plan(arguments: Sequence[str], shards: int, progress: _Callback) -> _Report: ...
def status(archive: _Path) -> _Report: ...
def work(archive: _Path, shard: str, machine: _Report) -> _Report: ...
def commit(archive: _Path, machine: _Report, progress: _Callback) -> _Report: ...
def is_archive(path: _Path) -> bool: ...
def keep(object: Any) -> None: ...

class Numbers:
    @property
    def __array_interface__(self) -> dict[str, Any]: ...

class Volume:
    @staticmethod
    def of_array(
        name: str,
        array: Any,
        scalar: str,
        origin: Sequence[float],
        spacing: Sequence[float],
        direction: Sequence[Sequence[float]] | None,
    ) -> Volume: ...
    @staticmethod
    def of_boxes(
        name: str,
        dims: Sequence[int],
        scalar: str,
        origin: Sequence[float],
        spacing: Sequence[float],
        boxes: Callable[[], Any],
    ) -> Volume: ...

class Surface:
    isovalue: float
    comment: str
    vertex_count: int
    face_count: int
    def __init__(
        self, vertices: bytes, faces: bytes, isovalue: float, comment: str, origin: list[float]
    ) -> None: ...
    @property
    def origin(self) -> list[float]: ...
    def vertices(self) -> dict[str, Any]: ...
    def faces(self) -> dict[str, Any]: ...
    def to_bytes(self) -> tuple[bytes, bytes]: ...
    def save(self, path: _Path) -> int: ...
    @staticmethod
    def save_all(surfaces: Sequence[Surface], path: _Path) -> int: ...

class Archive:
    dims: list[int]
    geometry: dict[str, Any]
    units: dict[str, str]
    def __init__(self, path: _Path, when: _When) -> None: ...
    def info(self, when: _When) -> _Report: ...
    def value_range(self, when: _When) -> list[float] | None: ...
    def spectrum(self, when: _When) -> _Report: ...
    def count(self, isovalue: float, level: _Level, when: _When) -> int: ...
    def surfaces(self, wanted: _Report, machine: _Report, when: _When) -> list[Surface]: ...
    def save_surfaces(
        self, out: _Path, wanted: _Report, machine: _Report, when: _When, progress: _Callback
    ) -> _Report: ...
    def save_series(
        self, out: _Path, wanted: _Report, machine: _Report, steps: str | None, progress: _Callback
    ) -> _Report: ...
    def probe(
        self, points: bytes, level: _Level, machine: _Report, when: _When
    ) -> Numbers: ...
    def sample(
        self, dims: Sequence[int], level: _Level, machine: _Report, when: _When
    ) -> Numbers: ...
    def save_samples(
        self,
        out: _Path,
        dims: Sequence[int],
        level: _Level,
        machine: _Report,
        when: _When,
        progress: _Callback,
    ) -> _Report: ...
    def save_tetrahedra(
        self, out: _Path, part: _Report, machine: _Report, when: _When, progress: _Callback
    ) -> _Report: ...
    def save_grid(
        self, out: _Path, grid: _Report, machine: _Report, when: _When, progress: _Callback
    ) -> _Report: ...
    def measure(
        self,
        against: _Path | Volume,
        field: str | None,
        step: int | None,
        map: _Path | None,
        level: _Level,
        machine: _Report,
        progress: _Callback,
    ) -> _Report: ...
    def check(self) -> None: ...
