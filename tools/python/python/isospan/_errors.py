"""Exceptions: one class for each kind of error, with what the error knows as attributes."""

from __future__ import annotations

import warnings
from typing import Any


class Error(Exception):
    """Base of all exceptions of isospan.

    ``exit_code`` is the exit code with which the program ``isospan`` ends at this error.
    """

    exit_code: int = 1

    @classmethod
    def _of(cls, message: str, exit_code: int, /, **about: Any) -> Error:
        error = cls(message)
        error.exit_code = exit_code
        for name, value in about.items():
            setattr(error, name, value)
        return error

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> Any:
        return _again, (type(self), self.args, dict(self.__dict__))


def _again(kind: type[Error], args: tuple, about: dict) -> Error:
    error = kind(*args)
    error.__dict__.update(about)
    return error


class UsageError(Error, ValueError):
    """Arguments that contradict each other, or the input."""


class BadInputError(Error, ValueError):
    """An input file or an archive is malformed, cut short, or of a kind that cannot be used.

    ``file``: the file; ``at``: where in it; ``offset``: the byte, where that is known; ``expected``
    and ``got``: what a good file has there, and what was found; ``help``: what to do about it, or "".
    """

    file: str
    at: str
    offset: int | None
    expected: str
    got: str
    help: str


class BudgetError(Error, MemoryError):
    """The work needs more of a resource than it was given.

    ``resource``: "memory" or "disk space"; ``purpose``: what it is for, or ""; ``needed`` and
    ``available``: bytes.
    """

    resource: str
    purpose: str
    needed: int
    available: int


class FileError(Error, OSError):
    """The system refused an operation on a file.

    ``doing``: what was being done; ``file``: the file; ``reason``: why not; ``errno``: the system's
    number.
    """

    doing: str
    file: str
    reason: str


class IncompleteError(Error):
    """Parts of an archive are missing. ``file``: the archive; ``missing``: their names."""

    file: str
    missing: list[str]


class BusyError(Error):
    """Another process writes the archive. ``file``: the archive; ``writer``: who writes it, or
    ""."""

    file: str
    writer: str


class Cancelled(Error):
    """The work was stopped from within; Ctrl-C raises KeyboardInterrupt instead."""


class Notice(UserWarning):
    """Something about an input that its user should know."""


class TargetNotMet(UserWarning):
    """An archive was made, but its error or its size is not within the target that was asked for:
    ``archive.target_met`` is False.

    ``warnings.simplefilter("error", isospan.TargetNotMet)`` makes it an exception.
    """


def _warn(line: str) -> None:
    warnings.warn(line, Notice, stacklevel=3)


def _warn_unmet(line: str) -> None:
    warnings.warn(line, TargetNotMet, stacklevel=3)
