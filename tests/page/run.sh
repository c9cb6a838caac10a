#!/bin/sh
# Tests the operator's page in a real browser, on live runs: every button, a question, a corrected
# sticker, the frame rate, and screenshots at desktop and phone widths.
# Usage: tests/page/run.sh [folder for the screenshots]
# Needs node, npm and chromium. In CI, as root, Debian's packages are installed. Elsewhere a missing
# program is reported and the test passes.
#   ONLY=mission,question   runs only these parts     LEAST_RATE=10   least frames per second in 3-D
#   RUBIK_ROBOT, CHROMIUM   paths of other programs   KEEP=1          keeps the recordings
#   ASSETS=1   takes the files of the page from src/web/assets, without another build
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=${TMPDIR:-/tmp}/rubik-robot-page
pictures=${1:-$work/pictures}
# skip WHY: ends the script without an error, and tells CI's list what was not checked.
skip() {
    printf '\n*** SKIPPED: the page was NOT tried in a browser: %s\n\n' "$1" >&2
    echo "the page in a browser: $1" >> "${SKIPPED:-/dev/null}"
    exit 0
}
chromium_of() { echo "${CHROMIUM:-$(command -v chromium || command -v chromium-browser || true)}"; }

missing=
[ -n "$(chromium_of)" ] || missing="$missing chromium"
command -v node >/dev/null || missing="$missing nodejs"
command -v npm >/dev/null || missing="$missing npm"
if [ -n "$missing" ]; then
    [ "${CI:-}" = true ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null ||
        skip "there is no$missing (Debian: apt-get install$missing)"
    echo "installs$missing" >&2
    # shellcheck disable=SC2086  # $missing is a list of words
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing; } \
        >/dev/null || skip "apt-get cannot install$missing"
fi
mkdir -p "$work" "$pictures"
pictures=$(cd "$pictures" && pwd)
if [ ! -d "$work/node_modules/playwright-core" ] || [ ! -d "$work/node_modules/axe-core" ]; then
    npm install --silent --no-audit --no-fund --prefix "$work" playwright-core@1 axe-core@4 >/dev/null 2>&1 ||
        skip "npm cannot fetch playwright-core and axe-core"
fi
if [ -z "${RUBIK_ROBOT:-}" ]; then
    (cd "$root" && cargo build --release --quiet)
    RUBIK_ROBOT=${CARGO_TARGET_DIR:-$root/target}/release/rubik-robot
fi
cd "$root"
exec node "$here/page.mjs" "$work/node_modules/playwright-core/index.mjs" "$(chromium_of)" "$RUBIK_ROBOT" "$pictures"
