"""How far work is: a callback, or bars of tqdm."""

from __future__ import annotations

from typing import Any, Callable, Union

Callback = Callable[[str, int, int, str], Any]
Progress = Union[bool, None, Callback]


class _Bars:
    """A bar of tqdm for each stage."""

    def __init__(self) -> None:
        try:
            from tqdm.auto import tqdm
        except ImportError as error:
            raise ImportError("progress=True draws bars with tqdm: pip install tqdm") from error
        self._tqdm, self._stage = tqdm, ("", 0)
        self._bar: Any = None

    def __call__(self, stage: str, done: int, total: int, unit: str) -> None:
        if self._bar is None or (stage, total) != self._stage or done < self._bar.n:
            self.close()
            self._stage = (stage, total)
            self._bar = self._tqdm(
                total=total or None, desc=stage, unit=f" {unit}", unit_scale=True
            )
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


class Reporter:
    """A context manager whose value is a callback, or None."""

    def __init__(self, progress: Progress) -> None:
        self._bars = _Bars() if progress is True else None
        self._callback = self._bars if isinstance(progress, bool) else progress

    def __enter__(self) -> Callback | None:
        return self._callback

    def __exit__(self, *error: object) -> None:
        if self._bars is not None:
            self._bars.close()
