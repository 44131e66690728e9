"""The program ``isospan``, which is the same as the one that is built without Python."""

import os
import signal
import sys

from . import _isospan


def main() -> None:
    """Runs the program on the arguments of the process, and ends the process."""
    # The program does for itself what Python does for Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    code = _isospan.program(["isospan", *sys.argv[1:]])
    # Nothing of Python is left to be done, and a signal that came late is no exception.
    os._exit(code)


if __name__ == "__main__":
    main()
