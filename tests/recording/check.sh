#!/bin/sh
# Decodes a recording with the public Python packages and checks counts, types and the cube's final state; loads it into
# rerun, too, where that can be had. Skips loudly where PyPI is not there.
#   tests/recording/check.sh [path of rubik-robot] [recording]
# Without a recording a short run is made.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
robot=${1:-$here/../../target/release/rubik-robot}
work=${TMPDIR:-/tmp}/rubik-robot-check.$$
trap 'rm -rf "$work"' EXIT
mkdir -p "$work"
recording=${2:-}
if [ -z "$recording" ]; then
    recording=$work/run.mcap
    (cd "$here/../.." && "$robot" run scenarios/face_turn.toml --json --record "$recording" >"$work/summary.json")
fi
python3 -m venv "$work/venv" || { echo "SKIPPED: python3 -m venv does not work here"; exit 0; }
if ! "$work/venv/bin/pip" install -q mcap mcap-ros2-support; then
    echo "SKIPPED: mcap and mcap-ros2-support cannot be had from PyPI here; the recording was NOT checked by them"
    exit 0
fi
"$work/venv/bin/python" "$here/check.py" "$recording"
"$work/venv/bin/python" "$here/../../examples/read_run.py" "$recording" | tail -2
if [ "${RERUN:-1}" = 1 ] && "$work/venv/bin/pip" install -q rerun-sdk; then
    "$work/venv/bin/rerun" rrd stats --help >/dev/null 2>&1 || true
    "$work/venv/bin/python" "$here/check_rerun.py" "$recording"
else
    echo "SKIPPED: rerun-sdk; the recording was NOT opened by rerun"
fi
