#!/usr/bin/env python3
"""Do the shards of a planned reduction with Dask distributed, then commit.

    python3 -m venv dask && dask/bin/pip install distributed
    isospan plan scan.nrrd -o scan.isospan --shards 64
    dask/bin/python tools/dask/reduce.py scan.isospan                             # workers on this machine
    dask/bin/python tools/dask/reduce.py scan.isospan --scheduler tcp://head:8786 # a cluster that runs already
    sbatch tools/dask/in_slurm.sh scan.isospan                                    # a cluster within a Slurm allocation

Each task is one `isospan work --shard I/N`. A shard may run twice at the same time, on any workers, so nothing has to be
known of a worker that is gone: one that was killed is replaced at once, one that is frozen when the scheduler has not heard
of it for `distributed.scheduler.worker-ttl` (set DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL=60s for a scheduler of your own).
A plan with a target takes several tries, each with a commit. Exit code: that of the last `isospan commit`, 3 when shards
are missing.
"""

import argparse
import json
import subprocess
import sys

import dask
from dask.distributed import Client, LocalCluster, as_completed


# The exit code of `isospan commit` when it has planned the next try for a target.
NEXT_TRY = 7


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive", help="the archive that was planned")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", help="address of a scheduler")
    where.add_argument("--scheduler-file", help="file that a scheduler has written")
    where.add_argument("--workers", type=int, default=2, help="workers to start on this machine [2]")
    parser.add_argument("--shards", type=int, help="cut the work into so many parts [as planned]")
    parser.add_argument("--threads", type=int, default=1, help="threads of a shard [1]")
    parser.add_argument("--memory", help="memory of a shard, as 4GiB [half of what a worker may use]")
    parser.add_argument("--scratch", help="folder of a worker for temporary files")
    parser.add_argument("--retries", type=int, default=3, help="how often a shard that failed is tried again [3]")
    parser.add_argument("--ttl", default="30s", help="silence after which a worker started here is given up [30s]")
    parser.add_argument("--isospan", default="isospan", help="the program, on the workers too")
    return parser.parse_args()


def work(command, shard):
    """One shard, on a worker."""
    done = subprocess.run([*command, "--shard", shard], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"shard {shard}: exit code {done.returncode}: {done.stderr.strip()}")
    return done.stdout.strip()


def connect(args):
    if args.scheduler or args.scheduler_file:
        return Client(args.scheduler, scheduler_file=args.scheduler_file)
    dask.config.set({"distributed.scheduler.worker-ttl": args.ttl})
    return Client(LocalCluster(n_workers=args.workers, threads_per_worker=1, dashboard_address=None))


def main():
    args = arguments()
    machine = ["--threads", str(args.threads)]
    machine += ["--memory", args.memory] if args.memory else []
    machine += ["--scratch", args.scratch] if args.scratch else []
    status = [args.isospan, "status", args.archive, "--json"]
    status += ["--shards", str(args.shards)] if args.shards else []
    command = [args.isospan, "work", args.archive, "--quiet", *machine]
    code = NEXT_TRY
    with connect(args) as client:
        while code == NEXT_TRY:
            state = json.loads(subprocess.run(status, check=True, capture_output=True, text=True).stdout)
            shards, missing = state["shards"], state["missing_shards"]
            print(f"{args.archive}: {len(missing)} of {shards} shards to do", flush=True)
            # Not pure: a shard that is asked for again is done again.
            tasks = [client.submit(work, command, f"{i}/{shards}", retries=args.retries, pure=False) for i in missing]
            for task in as_completed(tasks):
                # A failure is told; commit finds out what it means.
                text = task.result() if task.status == "finished" else f"failed: {task.exception()}"
                print(text, flush=True)
            code = subprocess.run([args.isospan, "commit", args.archive, "--quiet", *machine]).returncode
    return code


if __name__ == "__main__":
    sys.exit(main())
