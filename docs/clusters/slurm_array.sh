#!/bin/sh
#SBATCH --job-name=rooms --array=0-99 --ntasks=1 --cpus-per-task=16 --mem-per-cpu=2G --time=24:00:00
# A job array without a scheduler of its own: each task builds its share of the shards into one shared folder.
#
#   SHARDS=6400 sbatch docs/clusters/slurm_array.sh rooms.yaml /scratch/rooms.zarr     (datagen plan says how many there are)
#
# When all have ended, `datagen build rooms.yaml /scratch/rooms.zarr` makes what is missing, and the table and cards. A task
# that was killed can be submitted again: shards that are there are kept.
set -eu
first=$((SLURM_ARRAY_TASK_ID * SHARDS / SLURM_ARRAY_TASK_COUNT))
last=$(((SLURM_ARRAY_TASK_ID + 1) * SHARDS / SLURM_ARRAY_TASK_COUNT - 1))
[ "$first" -le "$last" ] || exit 0
exec datagen build "$1" "$2" --workers "$SLURM_CPUS_PER_TASK" --shards "$first-$last" --quiet
