#!/usr/bin/env bash
# A study as a job array of a real Slurm on this machine: four tasks, one killed in its middle, the missing cells submitted again, and a
# table that equals that of one machine bit for bit.
#
# Usage: tests/smoke/slurm.sh PROGRAM
# Needs slurmctld, slurmd, munged and root, as packages slurm-wlm and munge install them; says so and ends where they are missing.
set -euo pipefail

program=$(realpath "$1")
for tool in slurmctld slurmd munged sbatch squeue scancel scontrol; do
  if ! command -v "$tool" >/dev/null; then
    echo "the job array is not tested: $tool is missing (packages slurm-wlm and munge)"
    exit 0
  fi
done
if [ "$(id -u)" != 0 ]; then
  echo "the job array is not tested: a Slurm of its own needs root"
  exit 0
fi

place=$(mktemp -d)
export SLURM_CONF=$place/slurm.conf
daemons=()
finish() {
  for process in "${daemons[@]}"; do kill "$process" 2>/dev/null || true; done
  wait 2>/dev/null || true
  rm -rf "$place"
}
trap finish EXIT
fail() {
  echo "$1" >&2
  tail -n 20 "$place"/*.log "$place"/shared/task-*.log >&2 2>/dev/null || true
  exit 1
}
skip() {
  echo "the job array is not tested: $1"
  tail -n 3 "$place"/*.log 2>/dev/null || true
  exit 0
}
# Waits until a command succeeds, at most a minute.
waited_for() {
  for _ in $(seq 120); do
    if "$@" >/dev/null 2>&1; then return; fi
    sleep 0.5
  done
  return 1
}
until_true() {
  waited_for "$@" || fail "waited in vain for: $*"
}

# munge refuses folders that others may write, and a key that others may read.
chmod 755 "$place"
mkdir -p "$place/munge" "$place/state" "$place/spool"
dd if=/dev/urandom of="$place/munge/key" bs=1024 count=1 2>/dev/null
chmod 700 "$place/munge"
chmod 400 "$place/munge/key"
munged --foreground --force --key-file="$place/munge/key" --socket="$place/munge/socket" --log-file="$place/munge.log" \
  --pid-file="$place/munge/pid" --seed-file="$place/munge/seed" >"$place/munged.log" 2>&1 &
daemons+=($!)

host=$(hostname -s)
cat >"$SLURM_CONF" <<EOF
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
SlurmctldPort=16817
SlurmdPort=16818
AuthType=auth/munge
AuthInfo=socket=$place/munge/socket
CredType=cred/munge
StateSaveLocation=$place/state
SlurmdSpoolDir=$place/spool
SlurmctldPidFile=$place/slurmctld.pid
SlurmdPidFile=$place/slurmd.pid
SlurmctldLogFile=$place/slurmctld.log
SlurmdLogFile=$place/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/builtin
KillWait=2
ReturnToService=2
MpiDefault=none
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=test Nodes=$host Default=YES MaxTime=INFINITE State=UP
EOF
# Some machines, such as containers with few rights, run none of these.
if ! waited_for test -S "$place/munge/socket"; then skip "munged does not start here"; fi
slurmctld -D >"$place/slurmctld.out.log" 2>&1 &
daemons+=($!)
slurmd -D >"$place/slurmd.out.log" 2>&1 &
daemons+=($!)
if ! waited_for sh -c "sinfo -h -o %T | grep -q idle"; then skip "Slurm does not start here"; fi

# Cells of half a second, whose numbers do not depend on time.
cells=(fig2 --quick --estimator gaussian --patch 16 --patches-train 400 --patches-test 60)
cd "$place"
# One thread of each task gives the same numbers as two.
"$program" study run "${cells[@]}" --out alone >alone.txt 2>alone.log
"$program" study sbatch "${cells[@]}" --out shared --shards 4 --cpus 1
# The containers of tests have no memory limits to give.
sed -i '/--mem-per-cpu/d' shared/study.sbatch
job=$(sbatch --parsable shared/study.sbatch)
# One task is killed in its middle: some of its cells are done, others not.
until_true sh -c "squeue -h -r -j $job -t RUNNING | grep -q ."
until_true sh -c "ls shared/cells/*.json | grep -q ."
scancel "${job}_0" 2>/dev/null || true
until_true sh -c "! squeue -h -j $job | grep -q ."
"$program" study missing shared | tee missing.txt
if grep -q 'Nothing is missing' missing.txt; then fail "the killed task left nothing undone"; fi
again=$("$program" study missing shared --sbatch)
echo "$again"
job=$(eval "${again/sbatch/sbatch --parsable}")
until_true sh -c "! squeue -h -j $job | grep -q ."
"$program" study missing shared | grep -q 'Nothing is missing' || fail "cells are missing after the second job"
"$program" study table shared >/dev/null
cmp alone/table.csv shared/table.csv || fail "the table of the array differs from that of one machine"
echo "a job array of four tasks, one killed: the table of $(($(wc -l <shared/table.csv) - 1)) cells equals that of one machine"
