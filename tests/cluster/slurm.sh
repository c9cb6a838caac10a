#!/usr/bin/env bash
# Performs a campaign as a job array of a real Slurm on this machine, and compares the merged shards
# with the campaign of one process.
#
#   tests/cluster/slurm.sh ROBOT FOLDER
#
# ROBOT is the program, FOLDER an existing folder for all files. munged, slurmctld and slurmd are
# started with a configuration and sockets of their own in FOLDER, on ports of their own, and end
# with the script. They need root, and the packages slurm-wlm and munge of Debian, which the script
# installs if they are missing. Without them it prints NOT CHECKED and exits with 0.
#
# Two of the eight tasks are disturbed half-way: `scontrol requeue` interrupts one, and the other
# one's campaign is killed, and requeued then.
set -euo pipefail
robot=$(realpath "$1")
folder=$(realpath "$2")
cd "$(dirname "$0")/../.."
shards=8 runs=${SLURM_RUNS:-48}

unchecked() {
    echo "NOT CHECKED: $*"
    exit 0
}
[ "$(id -u)" = 0 ] || unchecked "slurmctld and slurmd need root"
# Debian has the daemons in /usr/sbin.
PATH=$PATH:/usr/sbin
# complete: checks that all three daemons are installed.
complete() {
    local daemon
    for daemon in slurmctld slurmd munged; do
        command -v "$daemon" > /dev/null || return 1
    done
}
if ! complete; then
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y \
        --no-install-recommends slurm-wlm munge; } > "$folder/apt.log" 2>&1 \
        || unchecked "the packages slurm-wlm and munge cannot be installed: $folder/apt.log"
fi

# ---- the cluster: one node, with as many tasks at a time as there are cores ----

state=$(mktemp -d /tmp/slurm-XXXXXX)
pids=()
# over: ends the daemons that this script has started. The processes of tasks end with slurmd's
# cancelled jobs.
over() {
    local code=$?
    scancel --full --user=root > /dev/null 2>&1 || true
    for _ in $(seq 50); do
        [ -n "$(squeue --noheader 2> /dev/null)" ] || break
        sleep 0.2
    done
    kill "${pids[@]}" 2> /dev/null || true
    wait 2> /dev/null || true
    cp "$state"/*.log "$folder/" 2> /dev/null || true
    rm -rf "$state"
    exit "$code"
}
# Set before the trap, so that it cancels no job of another cluster.
export SLURM_CONF=$state/slurm.conf
trap over EXIT

host=$(hostname -s)
cat > "$SLURM_CONF" << END
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmdPort=16818
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$state/munge.socket
CredType=cred/munge
StateSaveLocation=$state/ctld
SlurmdSpoolDir=$state/d
SlurmctldPidFile=$state/slurmctld.pid
SlurmdPidFile=$state/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=2,bf_interval=2
KillWait=5
ReturnToService=2
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SlurmdParameters=config_overrides
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=1000000 State=UNKNOWN
PartitionName=test Nodes=$host Default=YES MaxTime=INFINITE State=UP
END
mkdir "$state/ctld" "$state/d" "$state/key"
chmod 700 "$state/key"
# A key of this test alone; munged accepts no key that others can read.
(umask 077 && head -c 1024 /dev/urandom > "$state/key/munge.key")
munged --foreground --force --key-file "$state/key/munge.key" --socket "$state/munge.socket" \
    --pid-file "$state/munged.pid" --seed-file "$state/munged.seed" > "$state/munged.log" 2>&1 &
pids+=($!)
for _ in $(seq 50); do [ -S "$state/munge.socket" ] && break; sleep 0.1; done
slurmctld -D > "$state/slurmctld.log" 2>&1 &
pids+=($!)
slurmd -D -N "$host" > "$state/slurmd.log" 2>&1 &
pids+=($!)
for _ in $(seq 300); do
    [ "$(sinfo --noheader --format=%T 2> /dev/null)" = idle ] && break
    sleep 0.2
done
echo "$(sinfo --version), munge $(munged --version | sed 's/^munge-\([^ ]*\).*/\1/')," \
    "$(sinfo --noheader --format='%D node, %c cores, %T')"

# ---- helpers ----

failures=0
# must NAME COMMAND...: counts a command that fails.
must() {
    local name=$1
    shift
    if "$@" > /dev/null; then echo "- $name"; else
        echo "- FAILED: $name"
        failures=$((failures + 1))
    fi
}
# results K: prints the number of results of shard K; a line of the file is a result or a header.
results() {
    cat "$folder/shards/shard-$1-of-$shards.jsonl" 2> /dev/null | grep -c '"verdict"' || true
}
# half SHARD: waits until the shard has a result, and checks that runs are left.
half() {
    for _ in $(seq 1200); do
        [ "$(results "$1")" -lt 1 ] || break
        sleep 0.05
    done
    [ "$(results "$1")" -ge 1 ] && [ "$(results "$1")" -lt $((runs / shards)) ]
}
# ended: waits until no job is left. A requeued job would wait for two minutes before it starts.
ended() {
    local job
    for _ in $(seq 3000); do
        [ -n "$(squeue --noheader)" ] || return 0
        for job in $(squeue --noheader --states=PENDING --format=%i,%r | grep BeginTime); do
            scontrol update "JobId=${job%,*}" StartTime=now > /dev/null 2>&1 || true
        done
        sleep 0.2
    done
    return 1
}
# log JOB TASK: prints the output of a task.
log() { cat "$folder/campaign-$1-$2.log"; }

# ---- the campaign, with two disturbed tasks ----

rm -rf "$folder/shards" "$folder"/campaign-*.log
export RUBIK_ROBOT=$robot
array() {
    sbatch --parsable --output="$folder/campaign-%A-%a.log" "$@"
}
job=$(array --array=1-$shards packaging/slurm/campaign.sbatch "$folder/shards" \
    scenarios/face_turn.toml --runs "$runs")
must "task 1 is half done when it is requeued" half 1
must "the running task is requeued" scontrol requeue "${job}_1"
must "task 2 is half done when its campaign is killed" half 2
# The variable of the task tells its campaign from those of the other tasks.
killed=""
for pid in $(pgrep -f "campaign scenarios/face_turn.toml .*--state $folder/shards"); do
    if tr '\0' '\n' < "/proc/$pid/environ" | grep -qx SLURM_ARRAY_TASK_ID=2; then killed=$pid; fi
done
kill -9 "$killed"
for _ in $(seq 100); do
    [ -n "$(squeue --noheader --states=RUNNING --jobs="${job}_2" 2> /dev/null)" ] || break
    sleep 0.1
done
"$robot" campaign status "$folder/shards" > "$folder/status-half" || echo "exit code $?" \
    >> "$folder/status-half"
must "the killed task is requeued" scontrol requeue "${job}_2"
must "all tasks end" ended
for task in 1 2; do
    must "task $task continues its own file" \
        grep "shard-$task-of-$shards.jsonl: has .* runs, the campaign continues" \
        "$folder/campaign-$job-$task.log"
done

# ---- the results ----

must "all runs have a result" "$robot" campaign status "$folder/shards"
"$robot" campaign merge "$folder/shards" --json 2> "$folder/merge.log" | tail -n 1 \
    > "$folder/merged.json"
"$robot" campaign scenarios/face_turn.toml --runs "$runs" --json 2> "$folder/whole.log" | tail -n 1 \
    > "$folder/whole.json"
must "the merged object equals that of one process bit for bit" \
    cmp "$folder/merged.json" "$folder/whole.json"

# ---- arrays with a first index, a step and gaps ----

stepped=$(array --array=3-9:2 packaging/slurm/campaign.sbatch "$folder/stepped" \
    scenarios/idle.toml --set idle.time_s=1 --runs 4)
gaps=$(array --array=1,2,5 packaging/slurm/campaign.sbatch "$folder/gaps" scenarios/idle.toml --runs 4)
must "all tasks of both arrays end" ended
must "an array 3-9:2 has shards 1 to 4" "$robot" campaign status "$folder/stepped"
for task in 1 2 5; do
    must "task $task of an array with gaps is refused" \
        grep "the job array has gaps: 3 tasks" "$folder/campaign-$gaps-$task.log"
done
[ "$failures" = 0 ] || log "$stepped" 3

echo
echo 'When the second task is killed:'
echo
sed 's/^/    /' "$folder/status-half"
echo
echo "At the end (\`campaign status shards/ --plan 10000 --cores 500\`):"
echo
"$robot" campaign status "$folder/shards" --plan 10000 --cores 500 | sed 's/^/    /'
exit $((failures > 0))
