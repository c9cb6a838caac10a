//! Solves a cube and checks the solutions. The cube is given as turns from the solved cube, or as
//! its 54 stickers.
//!
//!     cargo run --release -p rubik-robot-solver --example solve_cube -- "R U2 F' L D"
//!
//! Without an argument the program solves a random one of all 4.3e19 states.

use rubik_robot_solver::cube::{Cube, Facelets, format_turns, parse_turns};
use rubik_robot_solver::{Budget, Tables, solve};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let cube = match std::env::args().nth(1) {
        Some(text) => parse(&text)?,
        None => Cube::scrambled(2007),
    };
    println!("cube:  {}", Facelets::from(&cube));

    // A program that solves many cubes builds the tables once, which takes about half a second.
    let tables = Tables::build();

    // The first solution takes about a millisecond; a larger budget finds a shorter one.
    for nodes in [0, 100_000, 10_000_000] {
        let solution = solve(&cube, &tables, &Budget { nodes, max_length: 0 });
        let turns = format_turns(&solution.turns);
        let proven = if solution.proven { ", and none is shorter" } else { "" };
        println!("{:2} turns, {} states{proven}: {turns}", solution.turns.len(), solution.nodes);
        assert!(cube.apply_all(&solution.turns).is_solved());
    }
    Ok(())
}

/// Parses a cube: 54 letters in the order URFDLB, or turns that lead to it.
fn parse(text: &str) -> Result<Cube, Box<dyn Error>> {
    if text.len() == 54 {
        return Ok(Cube::try_from(text.parse::<Facelets>()?)?);
    }
    Ok(Cube::SOLVED.apply_all(&parse_turns(text)?))
}
