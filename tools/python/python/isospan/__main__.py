"""``python -m isospan`` is the program ``isospan``."""

from ._program import main

main()
