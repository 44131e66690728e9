#!/bin/bash
# A Dask cluster within a Slurm allocation does a planned reduction: sbatch --nodes=4 tools/dask/in_slurm.sh scan.isospan [arguments of reduce.py]
# DASK_ENV names the folder of the Python environment. Without Dask the same is: srun isospan work scan.isospan --shard $SLURM_PROCID/$SLURM_NTASKS
#SBATCH --ntasks-per-node=1
#SBATCH --open-mode=append
set -euo pipefail
env=${DASK_ENV:?the folder of a Python environment with distributed}
# A script that sbatch runs is a copy elsewhere.
tools=${ISOSPAN_TOOLS:-$SLURM_SUBMIT_DIR/tools}
file=$PWD/dask-$SLURM_JOB_ID.json
trap 'kill $(jobs -p) 2>/dev/null; rm -f "$file"' EXIT

DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL=${WORKER_TTL:-60s} "$env/bin/dask" scheduler --scheduler-file "$file" --port 0 --no-dashboard &
srun "$env/bin/dask" worker --scheduler-file "$file" --nthreads 1 --no-dashboard &
"$env/bin/python" "$tools/dask/reduce.py" "$@" --scheduler-file "$file"
