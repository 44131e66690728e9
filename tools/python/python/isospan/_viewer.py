"""The viewer of an archive: ``isospan view`` in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
import weakref
from html import escape

from ._errors import Error


class Viewer:
    """A page that shows an archive, served to this machine. It is a context manager.

    Who has the address can see the archive.
    """

    #: The address of the page.
    url: str

    def __init__(self, path: str, *, port: int, browser: bool) -> None:
        command = [sys.executable, "-m", "isospan", "view", "--json", f"--port={port}"]
        command += [*(["--open"] if browser else []), "--", path]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._end = weakref.finalize(self, _stop, self._process)
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            _, said = self._process.communicate()
            text = said.strip().removeprefix("isospan: error: ")
            raise Error._of(text or "the viewer has ended", self._process.returncode)
        self.url = json.loads(line)["url"]

    def close(self) -> None:
        """Ends the server."""
        self._end()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "" if self._end.alive else ", closed"
        return f"<isospan.Viewer at {self.url}{state}>"

    def _repr_html_(self) -> str:
        return f"<iframe src='{escape(self.url)}' width='100%' height='600'></iframe>"


def _stop(process: subprocess.Popen[str]) -> None:
    process.terminate()
    process.communicate()
