#!/bin/bash
#SBATCH --job-name=manywake
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=32
#SBATCH --time=01:00:00
#SBATCH --signal=B:TERM@60
# Train on all nodes of a job, or go on where the job before ended:
#   RUN=runs/mine sbatch examples/slurm.sh --envs 64 --workers 64 --update-period 64 --episodes 1024
# The words are those of manywake train. The package is installed in the same place on all nodes, and the home is shared.
set -euo pipefail
run=${RUN:-runs/cluster}
cpus=${SLURM_CPUS_PER_TASK:-1}
head=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
port=$((20000 + SLURM_JOB_ID % 20000))
trap 'kill $(jobs -p) 2> /dev/null || true' EXIT

ray get-auth-token --generate > /dev/null # so that nobody else can run code on this cluster
export RAY_AUTH_MODE=token
on_head=(srun --overlap --nodes=1 --ntasks=1 --nodelist="$head")
ip=$("${on_head[@]}" hostname --ip-address | awk '{ print $1 }')
"${on_head[@]}" --cpus-per-task="$cpus" \
    ray start --head --node-ip-address="$ip" --port="$port" --num-cpus="$cpus" --block &
first=$!
until ray status --address "$ip:$port" > /dev/null 2>&1; do
    kill -0 "$first" || exit 1 # it did not start: its message is above
    sleep 2
done
if [ "$SLURM_NNODES" -gt 1 ]; then
    others=$((SLURM_NNODES - 1))
    srun --overlap --nodes="$others" --ntasks="$others" --exclude="$head" --cpus-per-task="$cpus" \
        ray start --address="$ip:$port" --num-cpus="$cpus" --block &
fi

if [ -e "$run/settings.json" ]; then
    manywake resume "$run" --engine ray --address "$ip:$port" &
else
    manywake train --run "$run" --engine ray --address "$ip:$port" "$@" &
fi
trainer=$!
trap 'kill -TERM "$trainer"; wait "$trainer"' TERM # a minute before the end: stop in order, resume in the next job
wait "$trainer"
