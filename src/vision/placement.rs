//! Placements of the six pictures of a cube's faces: the order of the pictures, the turn of each
//! one, and whether all are mirrored.
//!
//! Colours that make no cube in the given placement may make exactly one in another. The search
//! enumerates all placements, except those that differ only by a rotation of the whole cube. It
//! adds face after face. The edges and corners that a face completes must be pieces of a cube.
//! Colours that do not fit a piece add to the cost, up to a budget.
//!
//! - in: the cost of each class for each facelet, as given; a class is the colour of a centre
//! - out: the placements of least cost, each rotated so that it is as near to the given one as
//!   possible
//! - source: own work; branch and bound

use super::likeliest::{CORNER_FACELETS, EDGE_FACELETS};
use crate::cube::{CORNERS, EDGES, Face, Rotation24, facelet_at, facelet_place};
use std::fmt;

/// Greatest cost of the colours that do not fit a piece, in -2 log likelihood. It allows for two
/// facelets with reflections.
const BUDGET: f64 = 100.0;

/// Greatest number of placements that are returned.
const MOST: usize = 24;

/// Placement of the six pictures of a cube's faces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placement {
    /// For each face (URFDLB) the number of the picture that shows it, and the number of clockwise
    /// quarter turns by which this picture is turned.
    shown: [(usize, usize); 6],
    /// Whether the left and the right of each picture are exchanged.
    mirrored: bool,
}

impl Placement {
    /// Placement as given: the pictures in the order URFDLB, upright.
    const GIVEN: Self =
        Self { shown: [(0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (5, 0)], mirrored: false };

    /// Returns the number of the tile in the pictures (9 times the picture plus the tile in reading
    /// order, 0..54) that shows a facelet of the cube (0..54).
    fn source(&self, facelet: usize) -> usize {
        let (picture, quarters) = self.shown[facelet / 9];
        let mut place = (facelet % 9 / 3, facelet % 3);
        for _ in 0..quarters {
            place = (place.1, 2 - place.0);
        }
        if self.mirrored {
            place.1 = 2 - place.1;
        }
        9 * picture + 3 * place.0 + place.1
    }

    /// Returns the values of the pictures' tiles in the order of the cube's facelets.
    #[must_use]
    pub(super) fn put_right<T: Copy>(&self, given: &[T; 54]) -> [T; 54] {
        std::array::from_fn(|facelet| given[self.source(facelet)])
    }

    /// Returns the placement that shows the same cube after a rotation of the whole cube.
    fn rotated(&self, rotation: Rotation24) -> Self {
        let back = rotation.inverse();
        // The facelet that a rotation brings to this place.
        let from = |facelet: usize| {
            let place = facelet_place(facelet);
            facelet_at(back.cell(place.cell()), back.face(place.face))
        };
        let shown = std::array::from_fn(|face| {
            let source = |tile: usize| self.source(from(9 * face + tile));
            let picture = source(4) / 9;
            // Only one of the four turns brings the first tile and its neighbour to their places.
            let quarters = (0..4).find(|&quarters| {
                let mut shown = Self::GIVEN.shown;
                shown[face] = (picture, quarters);
                let one = Self { shown, mirrored: self.mirrored };
                [0, 1].iter().all(|&tile| one.source(9 * face + tile) == source(tile))
            });
            (picture, quarters.unwrap_or(0))
        });
        Self { shown, mirrored: self.mirrored }
    }

    /// Returns the placement of the same cube that differs from the given one in the fewest
    /// pictures.
    fn nearest_to_given(&self) -> Self {
        // With equally many changes, the placement with more turned and fewer exchanged pictures is
        // preferred, since turned ones are more common.
        let moved = |placement: &Self| {
            placement.shown.iter().enumerate().filter(|(face, shown)| shown.0 != *face).count()
        };
        Rotation24::all()
            .map(|rotation| self.rotated(rotation))
            .min_by_key(|placement| (placement.changes(), moved(placement)))
            .unwrap_or(Self::GIVEN)
    }

    /// Returns the number of faults: the pictures that are turned or in another place, plus one if
    /// all are mirrored.
    pub(super) fn changes(&self) -> usize {
        let differs = self.shown.iter().zip(&Self::GIVEN.shown).filter(|(a, b)| a != b).count();
        differs + usize::from(self.mirrored)
    }
}

impl fmt::Display for Placement {
    /// Writes the faults of the placement, separated by semicolons, for example "the picture of
    /// face F is turned clockwise by a quarter".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut faults = Vec::new();
        if self.mirrored {
            faults.push("every picture is mirrored".to_owned());
        }
        let letter = |picture: usize| Face::ALL[picture].letter();
        for (face, &(picture, quarters)) in self.shown.iter().enumerate() {
            let turn = match quarters {
                1 => "turned clockwise by a quarter",
                2 => "upside down",
                3 => "turned anticlockwise by a quarter",
                _ => "",
            };
            let other = self.shown[picture].0 == face;
            let fault = match (picture == face, turn) {
                (true, "") => continue,
                (true, turn) => format!("the picture of face {} is {turn}", letter(face)),
                // Two upright pictures that are exchanged are reported together, once.
                (false, "") if other && self.shown[picture].1 == 0 => {
                    if picture < face {
                        continue;
                    }
                    format!(
                        "the pictures of faces {} and {} are exchanged",
                        letter(face),
                        letter(picture)
                    )
                }
                (false, "") => {
                    format!(
                        "the picture given as face {} shows face {}",
                        letter(picture),
                        letter(face)
                    )
                }
                (false, turn) => format!(
                    "the picture given as face {} shows face {} and is {turn}",
                    letter(picture),
                    letter(face)
                ),
            };
            faults.push(fault);
        }
        f.write_str(&faults.join("; "))
    }
}

/// Finds the placements under which the facelets can be the pieces of a cube, the cheapest first.
/// Each cube is found in one placement only. `costs` is the cost of each class for each facelet as
/// given, in -2 log likelihood.
pub(super) fn placements(costs: &[[f64; 6]; 54]) -> Vec<Placement> {
    let least = |c: &[f64; 6]| c.iter().copied().fold(f64::INFINITY, f64::min);
    let excess = costs.map(|c| c.map(|cost| cost - least(&c)));
    let mut search = Search { excess, found: Vec::new() };
    for mirrored in [false, true] {
        // A rotation of the cube can bring any picture upright to the first place, so the first
        // picture stays there.
        let mut placement = Placement { mirrored, ..Placement::GIVEN };
        search.order(&mut placement, 1);
    }
    search.found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    search.found.iter().map(|found| found.placement.nearest_to_given()).collect()
}

/// Placement that was found.
struct Found {
    /// Cost of the colours that do not fit a piece, in -2 log likelihood.
    cost: f64,
    placement: Placement,
    /// Face to which the likeliest colour of each of the cube's facelets belongs.
    read: [usize; 54],
}

/// Search for placements.
struct Search {
    /// Cost of each class beyond that of the cheapest class, for each facelet as given.
    excess: [[f64; 6]; 54],
    /// Cheapest placements so far.
    found: Vec<Found>,
}

impl Search {
    /// Tries all orders of the pictures in the places from `place` on, and all turns with each.
    fn order(&mut self, placement: &mut Placement, place: usize) {
        if place == 6 {
            self.turn(placement, 1, 0.0);
            return;
        }
        for other in place..6 {
            placement.shown.swap(place, other);
            self.order(placement, place + 1);
            placement.shown.swap(place, other);
        }
    }

    /// Tries all turns of the pictures from `face` on. `cost` is that of the pieces before it.
    fn turn(&mut self, placement: &mut Placement, face: usize, cost: f64) {
        if face == 6 {
            self.keep(placement, cost);
            return;
        }
        for quarters in 0..4 {
            placement.shown[face].1 = quarters;
            let cost = cost + self.pieces(placement, face);
            if cost <= self.limit() {
                self.turn(placement, face + 1, cost);
            }
        }
        placement.shown[face].1 = 0;
    }

    /// Returns the cost above which a placement is not kept: that of the worst one kept so far, or
    /// [`BUDGET`] while there are fewer than [`MOST`].
    fn limit(&self) -> f64 {
        let full = self.found.len() >= MOST;
        let worst = self.found.iter().map(|found| found.cost).fold(0.0, f64::max);
        if full { worst } else { BUDGET }
    }

    /// Keeps a complete placement, unless a kept one shows the same cube. If there are [`MOST`]
    /// already, it replaces the costliest one.
    fn keep(&mut self, placement: &Placement, cost: f64) {
        let read = std::array::from_fn(|facelet| {
            let costs = &self.excess[placement.source(facelet)];
            let class = (0..6).fold(0, |best, c| if costs[c] < costs[best] { c } else { best });
            // The class is replaced by the face whose centre has it.
            placement.shown.iter().position(|shown| shown.0 == class).unwrap_or(0)
        });
        // A face may look the same after a turn, so two placements may show the same cube.
        if self.found.iter().any(|found| found.read == read) {
            return;
        }
        if self.found.len() >= MOST {
            let worst =
                (0..MOST).max_by(|&a, &b| self.found[a].cost.total_cmp(&self.found[b].cost));
            self.found.swap_remove(worst.unwrap_or(0));
        }
        self.found.push(Found { cost, placement: placement.clone(), read });
    }

    /// Returns the least cost of the edges and corners that `face` completes: those of which it is
    /// the last face in the order URFDLB.
    fn pieces(&self, placement: &Placement, face: usize) -> f64 {
        let class = |of: Face| placement.shown[of.index()].0;
        let completed =
            |places: &[usize]| places.iter().map(|&facelet| facelet / 9).max() == Some(face);
        let mut cost = 0.0;
        for places in EDGE_FACELETS.iter().filter(|places| completed(*places)) {
            cost += self.piece(placement, places, EDGES.map(|piece| piece.map(class)));
        }
        for places in CORNER_FACELETS.iter().filter(|places| completed(*places)) {
            cost += self.piece(placement, places, CORNERS.map(|piece| piece.map(class)));
        }
        cost
    }

    /// Returns the cost of the cheapest piece at these facelets, in any of its orientations.
    fn piece<const N: usize, const K: usize>(
        &self,
        placement: &Placement,
        places: &[usize; K],
        pieces: [[usize; K]; N],
    ) -> f64 {
        let seen = places.map(|facelet| &self.excess[placement.source(facelet)]);
        let mut least = f64::INFINITY;
        for piece in pieces {
            for turn in 0..K {
                let cost = (0..K).map(|k| seen[(k + turn) % K][piece[k]]).sum();
                least = least.min(cost);
            }
        }
        least
    }
}
