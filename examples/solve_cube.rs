//! Solves a cube and checks the solutions. The cube is given as turns from the solved cube, or as
//! its 54 stickers.
//!
//!     cargo run --release -p rubik-robot-solver --example solve_cube -- "R U2 F' L D"
//!
//! Without an argument the program solves a random one of all 4.3e19 states.

use rubik_robot_solver::cube::{Cube, Facelets, format_turns, parse_turns};
use rubik_robot_solver::{Budget, Solution, Tables, solve};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let cube = match std::env::args().nth(1) {
        Some(text) => parse(&text)?,
        None => Cube::scrambled(2007),
    };
    println!("cube:  {}", Facelets::from(&cube));
    for Solution { turns, nodes, proven } in solutions(&cube) {
        let proven = if proven { ", and none is shorter" } else { "" };
        println!("{:2} turns, {nodes} states{proven}: {}", turns.len(), format_turns(&turns));
        assert!(cube.apply_all(&turns).is_solved());
    }
    Ok(())
}

/// Solves a cube with three budgets of states. The first solution takes about a millisecond; a
/// larger budget finds a shorter one.
pub(crate) fn solutions(cube: &Cube) -> [Solution; 3] {
    // A program that solves many cubes builds the tables once, which takes about half a second.
    let tables = Tables::build();
    [0, 100_000, 10_000_000].map(|nodes| solve(cube, &tables, &Budget { nodes, max_length: 0 }))
}

/// Parses a cube: 54 letters in the order URFDLB, or turns that lead to it.
pub(crate) fn parse(text: &str) -> Result<Cube, Box<dyn Error>> {
    if text.len() == 54 {
        return Ok(Cube::try_from(text.parse::<Facelets>()?)?);
    }
    Ok(Cube::SOLVED.apply_all(&parse_turns(text)?))
}
