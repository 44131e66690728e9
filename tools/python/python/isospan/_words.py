"""What users may write for a number, a share, a step: as on the command line, or as NumPy has it."""

from __future__ import annotations

import math
import operator
import os
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex, Union

import numpy as np

from . import _isospan
from ._errors import UsageError

if TYPE_CHECKING:
    PathLike = os.PathLike[str] | str

#: A number, of Python or of NumPy.
Number = SupportsFloat
#: A whole number, of Python or of NumPy.
Whole = SupportsIndex
#: A number, or a text such as "50%".
Share = Union[SupportsFloat, str]
#: A step by its number or the name of its field, or by both where it has several fields.
Which = Union[SupportsIndex, str, tuple[SupportsIndex, str]]


def number(value: Any, name: str) -> float:
    """A number as float."""
    if isinstance(value, (str, bytes)) or not hasattr(value, "__float__") or np.ndim(value) > 0:
        raise UsageError(f"{name} is a number, not {value!r}")
    return float(value)


def whole(value: Any, name: str) -> int:
    """A whole number, not negative, as int."""
    try:
        found = operator.index(value)
    except TypeError:
        found = -1
    if found < 0:
        raise UsageError(f"{name} is a whole number from 0, not {value!r}")
    return found


def moment(step: Which | None, time: Number | None) -> tuple[Any, float | None]:
    """A step and a time, of which at most one is given."""
    return _step(step), None if time is None else number(time, "time")


def _step(step: Any) -> Any:
    if step is None or isinstance(step, str):
        return None if step is None else str(step)
    if isinstance(step, tuple) and len(step) == 2 and isinstance(step[1], str):
        return whole(step[0], "the number of a step"), str(step[1])
    try:
        return whole(step, "step")
    except UsageError:
        raise UsageError(
            "step is a number from 0, the name of a field, or a pair of both, "
            f"not {step!r}"
        ) from None


def isovalue(value: Share, range: Any) -> float:
    """An isovalue; "50%" is half-way from the least value to the largest of a range."""
    if isinstance(value, str):
        return _isospan.isovalue(value, range() if value.rstrip().endswith("%") else None)
    return number(value, "an isovalue")


def share(value: Share | None, name: str) -> float | None:
    """A share as a part of 1: 0.1, "10%" or "1/10"."""
    if value is None:
        return None
    return _isospan.share(value, name) if isinstance(value, str) else number(value, name)


def length(value: Share | None, name: str, diagonal: Any) -> float | None:
    """A length in world units, or a text such as "0.1%", of the diagonal of the domain."""
    if value is None or not isinstance(value, str):
        return None if value is None else number(value, name)
    text = value.strip()
    try:
        part = float(text.removesuffix("%"))
    except ValueError:
        part = math.nan
    if not part > 0:
        raise UsageError(f"{name} is a length above 0, as 0.5, or a share as \"0.1%\", not {value!r}")
    return part / 100 * diagonal() if text.endswith("%") else part
