#!/bin/bash
# Puts @ARCHIVE@ together when its shards are done, and submits again what is missing, at most @TRIES@ times in all.
# Written by isospan slurm.
#SBATCH --job-name=@JOB@-commit
#SBATCH --cpus-per-task=@THREADS@
#SBATCH --mem=@MEM@M
#SBATCH --time=@MINUTES@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@@GRACE@
#SBATCH --output="@FOLDER@/commit.log"
@OPTIONS@
set -u
try=${ISOSPAN_TRY:-1}

# A signal of this shell is one of the program that it waits for.
@PROGRAM@ commit @QUOTED@ --threads @THREADS@ --memory @MEMORY@@SCRATCH@ &
program=$!
trap 'kill -TERM $program' TERM
wait "$program"
code=$?
while kill -0 "$program" 2>/dev/null; do wait "$program"; code=$?; done

# 3: segments are missing. 7: the next try for a target is planned. 75: stopped before the time limit. Everything else is final.
case $code in 3 | 75) ;; 7) try=0 ;; *) exit "$code" ;; esac
if [ "$try" -ge @TRIES@ ]; then
    echo "try $try of @TRIES@ was the last; isospan status tells what is missing" >&2
    exit "$code"
fi
missing=$(@PROGRAM@ status @QUOTED@ --missing --as slurm-array --shards @SHARDS@) || exit
after=singleton
if [ -n "$missing" ]; then
    work=$(sbatch --parsable --array="$missing@THROTTLE@" @QUOTED_FOLDER@/work.sh) || exit
    after="afterany:${work%%;*},singleton"
fi
echo "try $try of @TRIES@: shards ${missing:-none} are missing and submitted"
sbatch --parsable --dependency="$after" --export="ALL,ISOSPAN_TRY=$((try + 1))" @QUOTED_FOLDER@/commit.sh || exit
# Not committed yet: the job that was submitted will tell.
exit "$code"
