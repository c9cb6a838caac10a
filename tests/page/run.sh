#!/bin/sh
# The operator's page in a real browser, on live runs: every button, a question, a corrected sticker, pictures per second,
# and screenshots at desktop and phone widths. Usage: tests/page/run.sh [folder for the screenshots]
# Needs node, npm and chromium (Debian: apt-get install chromium nodejs npm); says so and passes where one is missing.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=${TMPDIR:-/tmp}/rubik-robot-page
pictures=${1:-$work/pictures}
skip() { echo "SKIPPED: the page was not tried in a browser: $1" >&2; exit 0; }

command -v node >/dev/null || skip "there is no node"
command -v npm >/dev/null || skip "there is no npm"
chromium=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || true)}
[ -n "$chromium" ] || skip "there is no chromium"
mkdir -p "$work" "$pictures"
if [ ! -d "$work/node_modules/playwright-core" ]; then
    npm install --silent --no-audit --no-fund --prefix "$work" playwright-core@1 >/dev/null 2>&1 || skip "npm cannot fetch playwright-core"
fi
if [ -z "${RUBIK_ROBOT:-}" ]; then
    (cd "$root" && cargo build --release --quiet)
    RUBIK_ROBOT=${CARGO_TARGET_DIR:-$root/target}/release/rubik-robot
fi
cd "$root"
exec node "$here/page.mjs" "$work/node_modules/playwright-core/index.mjs" "$chromium" "$RUBIK_ROBOT" "$pictures"
