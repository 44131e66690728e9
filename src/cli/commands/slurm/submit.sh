#!/bin/bash
# Submits the shards of @ARCHIVE@ and, behind them, its commit; prints the numbers of both jobs. Written by isospan slurm.
set -euo pipefail
work=$(sbatch --parsable @QUOTED_FOLDER@/work.sh)
# Whatever became of the shards: commit finds out what is missing. One commit of an archive at a time.
commit=$(sbatch --parsable --dependency="afterany:${work%%;*},singleton" @QUOTED_FOLDER@/commit.sh)
echo "${work%%;*} ${commit%%;*}"
