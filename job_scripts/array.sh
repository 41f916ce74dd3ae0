#!/usr/bin/env bash
# Many tests, one a task:  sbatch --array=1-"$(wc -l < cases.txt)" array.sh cases.txt [options of the command]
# cases.txt has one case file a line; each writes to the folder that it names. IMIC3D_COMMAND names another command than identify.
#SBATCH --job-name=imic3d
#SBATCH --array=1-1
#SBATCH --nodes=1
#SBATCH --ntasks-per-node=4
#SBATCH --cpus-per-task=1
#SBATCH --time=02:00:00
#SBATCH --output=%x-%A_%a.log
set -euo pipefail

list="$1"
shift
case="$(sed -n "${SLURM_ARRAY_TASK_ID}p" "$list")"
[ -n "$case" ] || { echo "$list has no line $SLURM_ARRAY_TASK_ID" >&2; exit 2; }

export OMP_NUM_THREADS="${SLURM_CPUS_PER_TASK:-1}" OMP_PLACES=cores OMP_PROC_BIND=close OPENBLAS_NUM_THREADS=1

mpirun -n "$SLURM_NTASKS" --map-by "slot:PE=$OMP_NUM_THREADS" --bind-to core "${IMIC3D:-imic3d}" "${IMIC3D_COMMAND:-identify}" "$case" "$@"
