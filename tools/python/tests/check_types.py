"""What a type checker knows of the package; it is checked by mypy, and not run."""

from typing import Any

import numpy as np
import numpy.typing as npt
from typing_extensions import assert_type

import isospan


def of_answers(archive: isospan.Archive) -> None:
    assert_type(archive.surface(1.5, roi="0:9,:,:", cap=True), isospan.Surface)
    assert_type(archive.surface([1.5, 2], largest=1), list[isospan.Surface])
    assert_type(archive.count(1.5), int)
    assert_type(archive.count([1.5, 2], step=1), npt.NDArray[np.uint64])
    assert_type(archive.probe([(0, 0, 0)]), npt.NDArray[np.float64])
    assert_type(archive.spectrum().suggestions, list[float])
    assert_type(archive.surface(1.5).faces, npt.NDArray[np.uint32])
    assert_type(archive.range, tuple[float, float] | None)
    assert_type(archive.measure("scan.nrrd"), dict[str, Any])
    assert_type(archive.numbers("50%"), dict[str, Any])
    assert_type(archive.surface(1.5, smooth=True, smooth_limit="0.1%"), isospan.Surface)


def of_labels(archive: isospan.Archive) -> None:
    assert_type(archive.labels(), list[isospan.Label])
    assert_type(archive.label_surface(3, smooth=True), isospan.LabelSurface)
    assert_type(archive.label_surface([3, 7], label_table={3: "a"}), list[isospan.LabelSurface])
    assert_type(archive.label_surface(), list[isospan.LabelSurface])
    assert_type(archive.save_label_surface("all.glb"), dict[str, Any])


def of_archives() -> None:
    assert_type(isospan.reduce("scan.nrrd", "scan.isospan", target_rms="1%"), isospan.Archive)
    assert_type(isospan.plan("scan.nrrd", "scan.isospan", size="5%"), dict[str, Any])
    assert_type(isospan.append("scan.isospan", "next.nrrd", times=[1.0]), isospan.Archive)
    with isospan.open("scan.isospan", time=0.5) as archive:
        assert_type(archive, isospan.Archive)


def of_mistakes(archive: isospan.Archive) -> None:
    archive.surface(1.5, rio="0:9,:,:")  # type: ignore[call-overload]
    isospan.reduce("scan.nrrd", "scan.isospan", fractoin=0.5)  # type: ignore[call-arg]
    isospan.open(5)  # type: ignore[arg-type]
