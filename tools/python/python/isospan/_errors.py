"""Exceptions: one class for each kind of error, with what the error knows as attributes."""

from __future__ import annotations

import errno
import os
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
        system = None
        if isinstance(self, OSError):
            system = self.errno, self.strerror, self.filename
        return _again, (type(self), self.args, dict(self.__dict__), system)


def _again(kind: type[Error], args: tuple, about: dict, system: tuple | None = None) -> Error:
    error = kind(*args)
    error.__dict__.update(about)
    return error if system is None else _as_of_system(error, *system)


class UsageError(Error, ValueError):
    """Arguments that contradict each other, or the input."""


class NoSuchError(UsageError, KeyError):
    """A step, a time or a field is asked for that is not there."""


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


class MissingInputError(BadInputError, FileNotFoundError):
    """There is no input or archive of this name."""

    @classmethod
    def _of(cls, message: str, exit_code: int, /, **about: Any) -> Error:
        error = super()._of(message, exit_code, **about)
        return _as_of_system(error, errno.ENOENT, os.strerror(errno.ENOENT), about["file"])


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

    It is the built-in exception of its kind too: FileNotFoundError, PermissionError and so on.

    ``doing``: what was being done; ``file``, and ``filename``: the file; ``reason``, and ``strerror``:
    why not; ``errno``: the system's number.
    """

    doing: str
    file: str
    reason: str

    @classmethod
    def _of(cls, message: str, exit_code: int, /, **about: Any) -> Error:
        number = about["errno"]
        kind = cls if number is None else _FILE_ERRORS.get(type(OSError(number, "")), cls)
        if kind is not cls:
            return kind._of(message, exit_code, **about)
        error = super()._of(message, exit_code, **about)
        return _as_of_system(error, number, about["reason"], about["file"])


def _as_of_system(error: Any, number: int | None, reason: str, file: Any) -> Any:
    """Gives an exception what those of the system have."""
    error.errno, error.strerror, error.filename = number, reason, os.fspath(file)
    return error


class MissingFileError(FileError, FileNotFoundError):
    """A file or a folder is not there."""


class ForbiddenFileError(FileError, PermissionError):
    """The user may not do that with a file."""


class ExistingFileError(FileError, FileExistsError):
    """There is a file or a folder already."""


class IsFolderError(FileError, IsADirectoryError):
    """A folder is where a file should be."""


class NoFolderError(FileError, NotADirectoryError):
    """A file is where a folder should be."""


_FILE_ERRORS = {kind.__bases__[1]: kind for kind in FileError.__subclasses__()}


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
