#!/usr/bin/env bash
# One test on many nodes:  sbatch many_nodes.sh case.yaml [options of the command]
# Ranks share out simulations, elements and frames; the threads of a rank share out pixels. Few threads are best where the simulation
# takes the time, more where memory is short: the record and the images' splines are kept once a rank.
# IMIC3D_COMMAND names another command than identify.
#SBATCH --job-name=imic3d
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=16
#SBATCH --cpus-per-task=2
#SBATCH --exclusive
#SBATCH --time=04:00:00
#SBATCH --output=%x-%j.log
set -euo pipefail

export OMP_NUM_THREADS="${SLURM_CPUS_PER_TASK:-1}" OMP_PLACES=cores OMP_PROC_BIND=close OPENBLAS_NUM_THREADS=1

# As many ranks on every node, each bound to cores of its own; -x hands the variables to the other nodes.
mpirun -n "$SLURM_NTASKS" --map-by "ppr:$SLURM_NTASKS_PER_NODE:node:PE=$OMP_NUM_THREADS" --bind-to core \
  -x OMP_NUM_THREADS -x OMP_PLACES -x OMP_PROC_BIND -x OPENBLAS_NUM_THREADS \
  "${IMIC3D:-imic3d}" "${IMIC3D_COMMAND:-identify}" "$@"
