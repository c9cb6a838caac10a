//! The solver and the planner: `cargo bench --bench solver`. Cubes are drawn from fixed seeds.

#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{Criterion, criterion_group, criterion_main};
use rubik_robot::cube::{Axis, Cube, Face};
use rubik_robot::motion::Depth;
use rubik_robot::solver::{Budget, Tables, candidates, solve};
use rubik_robot::tasks::cube::hold::{Grip, Hand, Hold};
use rubik_robot::tasks::cube::plan::{Everywhere, Rule, Terms, plan};
use std::hint::black_box;

fn solver(c: &mut Criterion) {
    let tables = Tables::build();
    let cubes: Vec<Cube> = (0..1000).map(Cube::scrambled).collect();

    for (name, budget) in [
        ("first solution", Budget::FIRST),
        ("at most 21 turns", Budget { nodes: u64::MAX, max_length: 21 }),
        ("at most 20 turns", Budget { nodes: u64::MAX, max_length: 20 }),
        ("100,000 nodes", Budget { nodes: 100_000, max_length: 0 }),
    ] {
        let mut next = cubes.iter().cycle();
        c.bench_function(name, |b| {
            b.iter(|| solve(black_box(next.next().unwrap_or(&cubes[0])), &tables, &budget));
        });
    }
}

fn planner(c: &mut Criterion) {
    let tables = Tables::build();
    let budget = Budget { nodes: 500_000, max_length: 20 };
    let list = candidates(&Cube::scrambled(1), &tables, &budget, 24);
    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
    let start = (Hand::Track, Grip { hold, half_roll: false });
    for rule in [Rule::Original, Rule::Strict, Rule::Clearance] {
        c.bench_function(&format!("plan of 24 candidates, {rule:?}"), |b| {
            b.iter(|| plan(black_box(&list), start, &Terms::of(rule), &Everywhere));
        });
    }
}

fn tables(c: &mut Criterion) {
    let mut group = c.benchmark_group("tables");
    group.sample_size(10).bench_function("build", |b| b.iter(Tables::build));
    group.finish();
}

criterion_group!(benches, solver, planner, tables);
criterion_main!(benches);
