"""Reductions on the workers of a Dask cluster.

    from distributed import Client
    import isospan.dask

    with Client("tcp://head:8786"):
        archive = isospan.dask.reduce("scan.nrrd", "scan.isospan")

The archive has the bytes of that of ``isospan.reduce``. Source, archive and the folder of the plan
lie in places that all workers see, and isospan is installed on the workers. A part may be made
twice at one time: a worker that is killed or freezes costs no more than its part.
"""

from __future__ import annotations

import inspect
import os
from typing import TYPE_CHECKING, Any

from distributed import Client, as_completed, get_client

from . import _isospan
from ._archive import Archive, _machine, place
from ._errors import UsageError
from ._progress import Progress, Reporter
from ._reduce import _arguments, _is_path, _paths
from ._reduce import reduce as _reduce_here

if TYPE_CHECKING:
    from ._archive import PathLike, Size

#: Shards for each thread of the cluster: so that a slow one is not waited for long.
_SHARDS_A_THREAD = 4


def reduce(
    source: Any,
    out: PathLike,
    *,
    client: Client | None = None,
    shards: int | None = None,
    threads: int = 1,
    memory: Size | None = None,
    scratch: PathLike | None = None,
    retries: int = 3,
    force: bool = False,
    progress: Progress = None,
    **choices: Any,
) -> Archive:
    """Reduces a file, or the files of a series, on a cluster, and returns the archive, opened.

    source: a path that all workers see, or a list of them. choices: as for :func:`isospan.reduce`.
        A target may take several reductions, one after another.
    client: the cluster; the current client if not given. shards: parts of the work; four for each
        thread.
    threads, memory, scratch: of a part, on its worker. retries: how often a part that failed is
        done again.
    progress: as for :func:`isospan.reduce`; the parts are a stage, "shards".

    A run that was stopped goes on where it was: the plan in ``out + ".work"`` is taken up again.
    """
    if not _is_path(source):
        raise UsageError("workers read a file: save the array first, or call isospan.reduce")
    known = inspect.signature(_reduce_here).parameters
    for name in choices:
        if name not in known or name in ("source", "out", "name"):
            raise TypeError(f"reduce() got an unexpected keyword argument {name!r}")
    client = client or _current()
    # Workers have working folders of their own.
    out = place(out)
    shards = shards or _SHARDS_A_THREAD * max(1, sum(client.nthreads().values()))
    defaults = {n: p.default for n, p in known.items() if n in ("measure",)}
    here = {"threads": 0, "memory": None, "scratch": scratch, "force": force}
    arguments = _arguments(
        "reduce", [f"--output={out}"], _paths(source), {**defaults, **choices, **here}
    )
    machine = _machine(threads, memory, scratch)
    with Reporter(progress) as callback:
        report = _isospan.plan(arguments, shards, callback)
        # A target takes several tries; a commit reports the plan of the next one.
        while "plan" in report:
            state = _isospan.status(out)
            tasks = [
                client.submit(
                    _isospan.work, out, f"{n}/{state['shards']}", machine, retries=retries, pure=False
                )
                for n in state["missing_shards"]
            ]
            try:
                _wait(tasks, callback)
            finally:
                client.cancel(tasks)
            report = _isospan.commit(out, _machine(0, None, scratch), callback)
            report = report.get("next", report)
    archive = Archive(out)
    archive.report = report
    return archive


def _current() -> Client:
    try:
        return get_client()
    except ValueError as error:
        raise UsageError("there is no cluster: start a distributed.Client, or give one") from error


def _wait(tasks: list[Any], callback: Any) -> None:
    if callback is not None:
        callback("shards", 0, len(tasks), "shards")
    for done, task in enumerate(as_completed(tasks), start=1):
        task.result()
        if callback is not None:
            callback("shards", done, len(tasks), "shards")
