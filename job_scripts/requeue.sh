#!/usr/bin/env bash
# A test that takes longer than a job may:  sbatch requeue.sh case.yaml [options of the command]
# Before the time is up SLURM sends USR1 to this script, which hands it to the run. The run writes its checkpoint and ends with status 4,
# the job goes back into the queue, and the next one goes on from there. So it does after a node has failed.
# IMIC3D_COMMAND=loop for the loop: these two can be resumed.
#SBATCH --job-name=imic3d
#SBATCH --nodes=1
#SBATCH --ntasks-per-node=8
#SBATCH --cpus-per-task=1
#SBATCH --time=04:00:00
#SBATCH --signal=B:USR1@300
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%j.log
set -uo pipefail

export OMP_NUM_THREADS="${SLURM_CPUS_PER_TASK:-1}" OMP_PLACES=cores OMP_PROC_BIND=close OPENBLAS_NUM_THREADS=1

mpirun -n "$SLURM_NTASKS" --map-by "slot:PE=$OMP_NUM_THREADS" --bind-to core "${IMIC3D:-imic3d}" "${IMIC3D_COMMAND:-identify}" "$@" --resume &
run=$!
asked=0
trap 'asked=1; kill -USR1 "$run"' USR1

# A signal cuts `wait` short: it is asked again for the status of the run.
while true; do
  status=0
  wait "$run" || status=$?
  [ "$asked" -eq 1 ] || break
  asked=0
done

if [ "$status" -eq 4 ]; then
  echo "stopped before the time was up: back into the queue"
  scontrol requeue "$SLURM_JOB_ID"
fi
exit "$status"
