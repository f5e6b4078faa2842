#!/bin/bash
# A data set as a SLURM job array: each task makes a slice, all into one shared folder or bucket.
#
#     sbatch --array=0-19 slurm-array.sh cohort.toml /shared/cohort 10
#
# makes 200 recordings, ten a task. A task that was stopped resumes when it is started again;
# SLURM restarts it automatically after a node has failed (--requeue).
#SBATCH --job-name=vrcaps
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --time=08:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
set -euo pipefail

plan=$1 out=$2 size=$3
first=$((SLURM_ARRAY_TASK_ID * size))
exec vrcaps dataset make "$plan" --out "$out" \
  --units "$first:$((first + size))" --workers "${SLURM_CPUS_PER_TASK:-1}"
