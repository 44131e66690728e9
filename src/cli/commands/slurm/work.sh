#!/bin/bash
# A shard of @ARCHIVE@ for each task of a job array. Written by isospan slurm; may be submitted again at any time.
#SBATCH --job-name=@JOB@
#SBATCH --array=@ARRAY@
#SBATCH --cpus-per-task=@THREADS@
#SBATCH --mem=@MEM@M
#SBATCH --time=@MINUTES@
#SBATCH --requeue
#SBATCH --open-mode=append
# In time before the limit: the program stops after the chunks in flight, and whoever runs the shard next goes on.
#SBATCH --signal=B:TERM@@GRACE@
#SBATCH --output="@FOLDER@/work-%a.log"
@OPTIONS@
# In the place of this shell, so that signals reach the program.
exec @PROGRAM@ work @QUOTED@ --shard "$SLURM_ARRAY_TASK_ID/@SHARDS@" --threads @THREADS@ --memory @MEMORY@@SCRATCH@
