# Everyday commands; `just` lists them. Each of them also works without `just`.

_default:
    @just --list

# Checks before every commit: format, lints, unit tests with checked arithmetic, architecture, tidy
quick:
    .ci/quick

# Checks that every change must pass
run:
    .ci/run

# Measures the figures of the documentation, all or by part: `just long missions faults`
long *PARTS:
    .ci/long {{PARTS}}

# Measures parts of the figures and writes docs/figures.md and the README's table: `just figures turns`
figures *PARTS:
    scripts/figures {{PARTS}}

# Compares this build with the golden file; `just hash full OLD NEW` compares two builds thoroughly
hash *ARGS='quick':
    scripts/hash {{ARGS}}

# Measures lengths of functions, arguments, circles; `just measure 97c3ae0 .` compares two trees
measure *TREES='.':
    scripts/measure {{TREES}}

# Builds the documentation of all items, private ones included, and checks its links
doc:
    RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --workspace --document-private-items

# Runs a whole mission, shown in the browser
mission *ARGS:
    cargo run --release -- run scenarios/solve.toml --ui web {{ARGS}}
