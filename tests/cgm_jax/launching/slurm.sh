#!/usr/bin/env bash
# Runs a command beside a SLURM of two nodes with one core each, all on this machine's loopback, and
# takes it down afterwards. Installs Debian's slurm-wlm where it is missing.
#     slurm.sh COMMAND [ARGUMENT ...]
set -euo pipefail

sudo=""
[ "$(id -u)" = 0 ] || sudo=sudo
if ! command -v slurmctld slurmd >/dev/null; then
    # apt's own sandbox needs a temporary directory that everybody may write to.
    $sudo env TMPDIR=/tmp DEBIAN_FRONTEND=noninteractive sh -c \
        'apt-get update -q && apt-get install -q -y --no-install-recommends slurm-wlm'
fi

directory=$(mktemp -d /tmp/cgm_jax-slurm.XXXXXX)
host=$(hostname -s) port=$((20000 + RANDOM % 10000))
export SLURM_CONF=$directory/slurm.conf
mkdir "$directory/state" "$directory/spool"
cat >"$SLURM_CONF" <<END
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthType=auth/none
CredType=cred/none
# A requeued job waits for its credential to expire, two minutes by default.
AuthInfo=cred_expire=5
StateSaveLocation=$directory/state
SlurmdSpoolDir=$directory/spool/%n
SlurmctldPidFile=$directory/slurmctld.pid
SlurmdPidFile=$directory/slurmd.%n.pid
SlurmctldLogFile=$directory/slurmctld.log
SlurmdLogFile=$directory/slurmd.%n.log
ProctrackType=proctrack/linuxproc
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
ReturnToService=2
SlurmdTimeout=20
KillWait=10
NodeName=n1 NodeHostname=$host NodeAddr=127.0.0.1 Port=$((port + 1)) CPUs=1
NodeName=n2 NodeHostname=$host NodeAddr=127.0.0.1 Port=$((port + 2)) CPUs=1
PartitionName=main Nodes=ALL Default=YES
END

# Ends the process whose id is in a file, and waits for its end: nothing may stay behind.
stop() {
    local pid
    pid=$(cat "$1" 2>/dev/null) || return 0
    kill "$pid" 2>/dev/null || return 0
    for _ in $(seq 100); do
        kill -0 "$pid" 2>/dev/null || return 0
        sleep 0.1
    done
    kill -9 "$pid" 2>/dev/null || true
}

take_down() {
    scancel --me 2>/dev/null || true
    for _ in $(seq 150); do
        [ -z "$(squeue --noheader 2>/dev/null)" ] && break
        sleep 0.2
    done
    for file in "$directory"/slurmd.*.pid "$directory/slurmctld.pid"; do stop "$file"; done
    rm -rf "$directory"
}
trap take_down EXIT
trap 'exit 130' INT TERM HUP

slurmctld
slurmd -N n1
slurmd -N n2
for _ in $(seq 150); do
    [ "$(sinfo --noheader --states=idle --format=%D)" = 2 ] && break
    sleep 0.2
done
"$@"
