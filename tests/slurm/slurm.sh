#!/usr/bin/env bash
# One node of Slurm for tests, without systemd and cgroups: slurm.sh start|stop FOLDER.
# As root, with Debian's slurm-wlm and munge. Then: export SLURM_CONF=FOLDER/slurm.conf
set -euo pipefail
verb=$1
mkdir -p "$2"
folder=$(cd "$2" && pwd)
host=$(hostname -s)
# Two ports of one's own for each run: two test runs on one machine must not meet.
port=$((20000 + $$ % 10000 * 2))
memory_mb=$(awk '/MemTotal/ {print int($2 / 1024)}' /proc/meminfo)

start() {
    mkdir -p "$folder"/{state,spool,log}
    chmod 0755 "$folder"
    head -c 1024 /dev/urandom > "$folder/munge.key"
    chmod 0400 "$folder/munge.key"
    munged --force --key-file="$folder/munge.key" --socket="$folder/munge.socket" \
        --pid-file="$folder/munge.pid" --log-file="$folder/log/munge" \
        --seed-file="$folder/munge.seed"
    cat > "$folder/slurm.conf" <<END
ClusterName=tests
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
SlurmdPort=$((port + 1))
SlurmUser=root
AuthType=auth/munge
# Credentials that expire soon let a requeued job start after seconds instead of two minutes.
AuthInfo=socket=$folder/munge.socket,cred_expire=5
CredType=cred/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/log/slurmctld
SlurmdLogFile=$folder/log/slurmd
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MpiDefault=none
ReturnToService=2
SchedulerParameters=sched_interval=2,bf_interval=2,default_queue_depth=100
KillWait=2
MinJobAge=10
MaxArraySize=3
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=$memory_mb State=UNKNOWN
PartitionName=tests Nodes=$host Default=YES MaxTime=60 State=UP
END
    export SLURM_CONF="$folder/slurm.conf"
    slurmctld -c -f "$SLURM_CONF"
    slurmd -c -f "$SLURM_CONF"
    for _ in $(seq 60); do
        if sinfo --noheader --format=%T 2> /dev/null | grep -q idle; then
            exit 0
        fi
        sleep 0.5
    done
    echo "Slurm did not come up:" >&2
    tail -n 20 "$folder"/log/* >&2
    exit 1
}

stop() {
    for daemon in slurmd slurmctld munge; do
        if [ -s "$folder/$daemon.pid" ]; then
            kill "$(cat "$folder/$daemon.pid")" 2> /dev/null || true
        fi
    done
}

"$verb"
