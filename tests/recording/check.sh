#!/bin/sh
# Decodes a recording with the public Python packages and checks counts, types and the cube's final
# state. Also imports it into rerun, and loads the URDF of the cell into mujoco. Prints a notice and
# passes if the packages are not available.
#   tests/recording/check.sh [path of rubik-robot] [recording]
# Without a recording it records a short run. RERUN=0 skips rerun.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
robot=${1:-$here/../../target/release/rubik-robot}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# The packages are installed once and kept between runs.
venv=${TMPDIR:-/tmp}/rubik-robot-venv
# left_out WHAT: tells the reader and CI's list what is not checked.
left_out() {
    printf '\n*** SKIPPED: %s\n\n' "$1" >&2
    echo "$1" >> "${SKIPPED:-/dev/null}"
}
# skip WHAT: the same, and ends the script without an error.
skip() {
    left_out "$1"
    exit 0
}

recording=${2:-}
if [ -z "$recording" ]; then
    recording=$work/run.mcap
    (cd "$here/../.." &&
        "$robot" run scenarios/face_turn.toml --json --record "$recording" >"$work/summary.json")
fi
command -v python3 >/dev/null ||
    skip "there is no python3; the recording was NOT checked by others' readers"
if ! "$venv/bin/python" -c "" 2>/dev/null && ! python3 -m venv --clear "$venv" >/dev/null 2>&1; then
    [ "${CI:-}" = true ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null &&
        apt-get update -qq &&
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv >/dev/null &&
        python3 -m venv --clear "$venv" ||
        skip "python3 -m venv does not work here (Debian: python3-venv); the recording was NOT checked by others' readers"
fi
"$venv/bin/pip" install -q --disable-pip-version-check mcap mcap-ros2-support ||
    skip "mcap and mcap-ros2-support cannot be had from PyPI here; the recording was NOT checked by them"
"$venv/bin/python" "$here/check.py" "$recording"
"$venv/bin/python" "$here/../../examples/read_run.py" "$recording" | tail -2
if "$venv/bin/pip" install -q --disable-pip-version-check pandas matplotlib; then
    "$venv/bin/python" "$here/../../examples/plot_run.py" "$recording" -o "$work/run.png" | tail -1
else
    left_out "pandas and matplotlib cannot be had from PyPI here; the recording was NOT drawn"
fi
(cd "$here/../.." && "$robot" urdf >"$work/cell.urdf")
if "$venv/bin/pip" install -q --disable-pip-version-check mujoco; then
    "$venv/bin/python" "$here/check_urdf.py" "$work/cell.urdf"
else
    left_out "mujoco cannot be had from PyPI here; the URDF was NOT loaded by it"
fi
if [ "${RERUN:-1}" != 1 ]; then
    echo "rerun is left out" >&2
    exit 0
fi
"$venv/bin/pip" install -q --disable-pip-version-check rerun-sdk ||
    skip "rerun-sdk cannot be had from PyPI here; the recording was NOT opened by rerun"
"$venv/bin/python" "$here/check_rerun.py" "$recording"
