#!/usr/bin/env bash
# One test on one node:  sbatch single_node.sh case.yaml [options of the command]
# Ranks and threads are asked for here or on sbatch's command line; IMIC3D names the program if it is not on the PATH, IMIC3D_COMMAND
# another command than identify: IMIC3D_COMMAND=loop sbatch single_node.sh case.yaml
#SBATCH --job-name=imic3d
#SBATCH --nodes=1
#SBATCH --ntasks-per-node=8
#SBATCH --cpus-per-task=1
#SBATCH --time=04:00:00
#SBATCH --output=%x-%j.log
set -euo pipefail

# Each rank has its own cores, each of its threads one of them. The linear algebra within a rank is not threaded.
export OMP_NUM_THREADS="${SLURM_CPUS_PER_TASK:-1}" OMP_PLACES=cores OMP_PROC_BIND=close OPENBLAS_NUM_THREADS=1

mpirun -n "$SLURM_NTASKS" --map-by "slot:PE=$OMP_NUM_THREADS" --bind-to core "${IMIC3D:-imic3d}" "${IMIC3D_COMMAND:-identify}" "$@"
