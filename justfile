# The commands of a day; `just` lists them. Each works without `just`, too.

_default:
    @just --list

# Format, lints, unit tests with checked arithmetic, architecture, tidy: before every commit
quick:
    .ci/quick

# All that a change must pass
run:
    .ci/run

# The figures of the README, in parts of an hour at most that can be named: `just long missions faults`
long *PARTS:
    .ci/long {{PARTS}}

# Does this build do what the golden file has? `just hash full OLD NEW` compares two builds in all they do
hash *ARGS='quick':
    scripts/hash {{ARGS}}

# Lengths of functions, arguments, circles: `just measure 97c3ae0 .` for two trees side by side
measure *TREES='.':
    scripts/measure {{TREES}}

# The documentation of all items, private ones too, with its links checked
doc:
    RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --workspace --document-private-items

# One whole mission, in the browser
mission *ARGS:
    cargo run --release -- run scenarios/solve.toml --ui web {{ARGS}}
