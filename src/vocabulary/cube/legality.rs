//! The check whether stickers form a cube that can be solved: `Cube::try_from(Facelets)`.
//!
//! - in: facelets; [`Facelets::normalised`] first rotates those that were read in another
//!   orientation
//! - out: the cube, or an [`ImpossibleCube`] that names the fault and, where it can be known, the
//!   piece
//!
//! | fault | place |
//! |---|---|
//! | count of a colour, centres, colours that no piece has, a piece twice | always known |
//! | flipped edge, twisted corner, two swapped pieces | known only if [`mostly_home`] |
//!
//! On a scrambled cube any edge may be the flipped one, so a fault of the second row has a known
//! place only if at least half the pieces are at home.

use super::cubies::{CORNER_FACELETS, EDGE_FACELETS, odd};
use super::{CORNERS, Cube, EDGES, Face, FaceletPlace, Facelets, Rotation24};
use std::fmt;

/// Position or piece, named by the letters of its faces.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Piece {
    faces: [Option<Face>; 3],
}

impl Piece {
    /// Makes the name of the piece or position with these two or three faces.
    pub(super) fn of(faces: &[Face]) -> Self {
        Self { faces: std::array::from_fn(|i| faces.get(i).copied()) }
    }
}

impl fmt::Display for Piece {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.faces.iter().flatten().try_for_each(|face| write!(f, "{}", face.letter()))
    }
}

impl fmt::Debug for Piece {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Reason why stickers do not form a cube that can be solved.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Cube, Facelets};
///
/// // A corner that is twisted in its place: its stickers are U9, R1 and F3.
/// let mut letters: Vec<char> = Facelets::solved().to_string().chars().collect();
/// letters.swap(8, 9);
/// letters.swap(9, 20);
/// let twisted: Facelets = letters.iter().collect::<String>().parse()?;
///
/// let reason = Cube::try_from(twisted).unwrap_err();
/// assert_eq!(reason.kind(), "corner-twisted");
/// assert!(reason.to_string().starts_with("corner URF is twisted"));
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseFacelets>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ImpossibleCube {
    /// A colour occurs more or less than nine times.
    #[error("{count} stickers have the colour of face {}, not 9", colour.letter())]
    ColourCount {
        /// The face whose centre has this colour on a solved cube.
        colour: Face,
        /// Number of stickers with this colour.
        count: usize,
    },
    /// Two centres have the same colour.
    #[error(
        "the centres of {} and {} both have the colour of face {}",
        first.letter(), second.letter(), colour.letter()
    )]
    CentreTwice {
        /// Colour of both centres.
        colour: Face,
        /// Face of the first centre.
        first: Face,
        /// Face of the second centre.
        second: Face,
    },
    /// The centres have six colours, but in an arrangement that no cube has in any orientation:
    /// opposite colours are neighbours, or the cube is mirrored.
    #[error(
        "no cube has its six centres in this arrangement: opposite colours are neighbours, or the \
         cube is mirrored"
    )]
    CentresMisplaced,
    /// The centres are those of a cube in another orientation: see [`Facelets::normalised`].
    #[error(
        "the centre of {} has colour {}: the cube is given in another orientation",
        face.letter(), colour.letter()
    )]
    CentreElsewhere {
        /// Face of the centre.
        face: Face,
        /// Colour of the centre.
        colour: Face,
    },
    /// A position has colours that no piece has.
    #[error("position {position} has colours {colours}: no piece has these colours in this order")]
    NoSuchPiece {
        /// Position of the colours.
        position: Piece,
        /// Colours at the position, in the order of its letters.
        colours: Piece,
    },
    /// A piece occurs twice.
    #[error("piece {piece} is in two places: {first} and {second}")]
    PieceTwice {
        /// Piece that occurs twice.
        piece: Piece,
        /// First position of the piece.
        first: Piece,
        /// Second position of the piece.
        second: Piece,
    },
    /// The number of flipped edges is odd.
    #[error("{}", odd_one(*edge, "edge", "flipped"))]
    EdgeFlipped {
        /// Edge at home that is flipped, if only one edge can be meant.
        edge: Option<Piece>,
    },
    /// The twists of the corners do not add up to whole turns.
    #[error("{}", odd_one(
        *corner,
        "corner",
        if *clockwise { "twisted clockwise" } else { "twisted anticlockwise" }
    ))]
    CornerTwisted {
        /// Corner at home that is twisted, if only one corner can be meant.
        corner: Option<Piece>,
        /// Whether the twist is clockwise, seen from outside.
        clockwise: bool,
    },
    /// The permutation of the pieces is odd.
    #[error("{}", match pieces {
        Some((a, b)) => format!("pieces {a} and {b} are swapped"),
        None => "two pieces are swapped: \
                 they can be any two corners or any two edges".to_owned(),
    })]
    Swapped {
        /// Pieces in each other's home, if only one pair can be meant.
        pieces: Option<(Piece, Piece)>,
    },
}

/// Describes a flipped or twisted piece. `kind` is "edge" or "corner"; `how` says in which way the
/// piece is wrong.
fn odd_one(piece: Option<Piece>, kind: &str, how: &str) -> String {
    match piece {
        Some(piece) => format!("{kind} {piece} is {how} in its place"),
        None => format!("one {kind} is {how} in its place: it can be any {kind}"),
    }
}

impl ImpossibleCube {
    /// Returns the kind of the fault as a fixed word such as `colour-count`, for programs.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::ColourCount { .. } => "colour-count",
            Self::CentreTwice { .. } => "centre-twice",
            Self::CentresMisplaced => "centres-misplaced",
            Self::CentreElsewhere { .. } => "centre-elsewhere",
            Self::NoSuchPiece { .. } => "no-such-piece",
            Self::PieceTwice { .. } => "piece-twice",
            Self::EdgeFlipped { .. } => "edge-flipped",
            Self::CornerTwisted { .. } => "corner-twisted",
            Self::Swapped { .. } => "swapped",
        }
    }

    /// Returns the names of the positions, stickers or pieces that are at fault; none if the
    /// stickers do not show which ones are.
    #[must_use]
    pub fn places(&self) -> Vec<String> {
        let centre = |f: Face| FaceletPlace { face: f, row: 1, col: 1 }.to_string();
        match self {
            Self::ColourCount { colour, .. } => vec![colour.letter().to_string()],
            Self::CentreTwice { first, second, .. } => vec![centre(*first), centre(*second)],
            Self::CentresMisplaced => Vec::new(),
            Self::CentreElsewhere { face, .. } => vec![centre(*face)],
            Self::NoSuchPiece { position, .. } => vec![position.to_string()],
            Self::PieceTwice { first, second, .. } => vec![first.to_string(), second.to_string()],
            Self::EdgeFlipped { edge: piece } | Self::CornerTwisted { corner: piece, .. } => {
                piece.iter().map(Piece::to_string).collect()
            }
            Self::Swapped { pieces } => {
                pieces.iter().flat_map(|(a, b)| [a.to_string(), b.to_string()]).collect()
            }
        }
    }
}

impl TryFrom<Facelets> for Cube {
    type Error = ImpossibleCube;

    /// Returns the cube that has these stickers.
    ///
    /// # Errors
    /// The first reason why the stickers do not form a cube that can be solved.
    fn try_from(facelets: Facelets) -> Result<Self, ImpossibleCube> {
        // From here on the pieces can be compared by colour, since each face has the colour of its
        // own centre.
        check_colours(&facelets)?;
        let mut cube = Self::SOLVED;
        let corners = pieces(&facelets, &CORNERS, &CORNER_FACELETS)?;
        let edges = pieces(&facelets, &EDGES, &EDGE_FACELETS)?;
        for (i, (piece, twist)) in corners.into_iter().enumerate() {
            (cube.corners[i], cube.twists[i]) = (piece as u8, twist as u8);
        }
        for (i, (piece, flip)) in edges.into_iter().enumerate() {
            (cube.edges[i], cube.flips[i]) = (piece as u8, flip as u8);
        }
        check_sums(&cube)?;
        Ok(cube)
    }
}

impl Cube {
    /// Makes a cube from stickers that are known to be possible.
    #[must_use]
    pub fn from_possible(facelets: &Facelets) -> Self {
        // Impossible stickers would give a meaningless cube instead of a panic.
        let corners = pieces(facelets, &CORNERS, &CORNER_FACELETS).unwrap_or_default();
        let edges = pieces(facelets, &EDGES, &EDGE_FACELETS).unwrap_or_default();
        Self {
            corners: corners.map(|(piece, _)| piece as u8),
            twists: corners.map(|(_, turn)| turn as u8),
            edges: edges.map(|(piece, _)| piece as u8),
            flips: edges.map(|(_, turn)| turn as u8),
        }
    }
}

impl Facelets {
    /// Converts stickers that were read in any orientation into the frame in which each centre has
    /// the colour of its own face. Returns them with the rotation that takes directions of the old
    /// frame to the new frame.
    ///
    /// # Errors
    /// If the centres are not six colours in one of the 24 orientations of a cube.
    pub fn normalised(&self) -> Result<(Self, Rotation24), ImpossibleCube> {
        let centres = Face::ALL.map(|f| self.colour(f.index() * 9 + 4));
        for (i, first) in Face::ALL.iter().enumerate() {
            // This fault has its own report, because the search of a rotation could not name the
            // two faces.
            if let Some(j) = (i + 1..6).find(|&j| centres[i] == centres[j]) {
                return Err(ImpossibleCube::CentreTwice {
                    colour: centres[i],
                    first: *first,
                    second: Face::ALL[j],
                });
            }
        }
        let rotation = Rotation24::all()
            .find(|r| Face::ALL.iter().zip(centres).all(|(&f, c)| r.face(f) == c))
            .ok_or(ImpossibleCube::CentresMisplaced)?;
        Ok((self.rotated(rotation), rotation))
    }

    /// Renames the colours of a cube that stays in place: each colour is named by the face on whose
    /// centre it is. A cube after slices and rotations becomes one that face turns can make.
    ///
    /// # Errors
    /// The errors of [`Facelets::normalised`].
    pub fn named_by_position(&self) -> Result<Self, ImpossibleCube> {
        let (_, rotation) = self.normalised()?;
        // The rotation takes each face to the one that has the name of its centre's colour.
        let back = rotation.inverse();
        Ok(Self::from_faces(std::array::from_fn(|i| back.face(self.colour(i)))))
    }
}

/// Checks that each centre has the colour of its own face and that each colour occurs nine times.
fn check_colours(facelets: &Facelets) -> Result<(), ImpossibleCube> {
    // The centres come first: on a cube in another orientation every piece would seem misplaced.
    facelets.normalised()?;
    for face in Face::ALL {
        let colour = facelets.colour(face.index() * 9 + 4);
        if colour != face {
            return Err(ImpossibleCube::CentreElsewhere { face, colour });
        }
        let count = (0..54).filter(|&i| facelets.colour(i) == face).count();
        if count != 9 {
            return Err(ImpossibleCube::ColourCount { colour: face, count });
        }
    }
    Ok(())
}

/// Returns, for each position, the index of the piece that its stickers show and the twist or flip
/// of that piece. `all` has the colours of each piece, `places` the stickers of each position.
fn pieces<const N: usize, const P: usize>(
    facelets: &Facelets,
    all: &[[Face; N]; P],
    places: &[[usize; N]; P],
) -> Result<[(usize, usize); P], ImpossibleCube> {
    let mut found = [(0, 0); P];
    let mut position_of = [None; P];
    for (i, stickers) in places.iter().enumerate() {
        let position = Piece::of(&all[i]);
        let colours = stickers.map(|p| facelets.colour(p));
        let (piece, turn) = find(all, colours)
            .ok_or(ImpossibleCube::NoSuchPiece { position, colours: Piece::of(&colours) })?;
        if let Some(first) = position_of[piece].replace(position) {
            let piece = Piece::of(&all[piece]);
            return Err(ImpossibleCube::PieceTwice { piece, first, second: position });
        }
        found[i] = (piece, turn);
    }
    Ok(found)
}

/// Finds the piece with these colours in this cyclic order; `None` if there is none. Returns its
/// index and its twist or flip: the position among `colours` of the piece's first colour.
fn find<const N: usize>(pieces: &[[Face; N]], colours: [Face; N]) -> Option<(usize, usize)> {
    (0..N).find_map(|turn| {
        let mut straight = colours;
        straight.rotate_left(turn);
        pieces.iter().position(|p| *p == straight).map(|piece| (piece, turn))
    })
}

/// Checks the sums that turns do not change: flips, twists, and the parity of the permutation.
/// Names the wrong piece or pair if only one can be meant.
fn check_sums(cube: &Cube) -> Result<(), ImpossibleCube> {
    // A turn flips an even number of edges.
    if cube.flips.iter().sum::<u8>() % 2 == 1 {
        let flipped = |i: &usize| usize::from(cube.edges[*i]) == *i && cube.flips[*i] == 1;
        let edge = only((0..12).filter(flipped)).filter(|_| mostly_home(cube));
        return Err(ImpossibleCube::EdgeFlipped { edge: edge.map(|i| Piece::of(&EDGES[i])) });
    }
    // A turn keeps the sum of the twists a multiple of 3.
    let excess = cube.twists.iter().sum::<u8>() % 3;
    if excess != 0 {
        // A single twisted corner has the whole excess.
        let twisted = |i: &usize| usize::from(cube.corners[*i]) == *i && cube.twists[*i] == excess;
        let corner = only((0..8).filter(twisted)).filter(|_| mostly_home(cube));
        let corner = corner.map(|i| Piece::of(&CORNERS[i]));
        return Err(ImpossibleCube::CornerTwisted { corner, clockwise: excess == 1 });
    }
    // A quarter turn is an odd permutation of both corners and edges.
    if odd(&cube.corners) != odd(&cube.edges) {
        let pairs = exchanged(&cube.corners)
            .map(|(a, b)| (Piece::of(&CORNERS[a]), Piece::of(&CORNERS[b])))
            .chain(
                exchanged(&cube.edges).map(|(a, b)| (Piece::of(&EDGES[a]), Piece::of(&EDGES[b]))),
            );
        return Err(ImpossibleCube::Swapped { pieces: only(pairs).filter(|_| mostly_home(cube)) });
    }
    Ok(())
}

/// Checks whether at least half of the 20 pieces are at home: in their place, neither flipped nor
/// twisted. Then a single piece that is wrong in its place is taken for the fault. A scrambled cube
/// has only about one piece at home, and a piece in its place may be flipped or twisted by turns.
fn mostly_home(cube: &Cube) -> bool {
    let corners = (0..8).filter(|&i| usize::from(cube.corners[i]) == i && cube.twists[i] == 0);
    let edges = (0..12).filter(|&i| usize::from(cube.edges[i]) == i && cube.flips[i] == 0);
    corners.count() + edges.count() >= 10
}

/// Returns the pairs of pieces that are in each other's place. `order` has the piece at each
/// position.
fn exchanged(order: &[u8]) -> impl Iterator<Item = (usize, usize)> {
    (0..order.len()).filter_map(|i| {
        let other = usize::from(order[i]);
        (other > i && usize::from(order[other]) == i).then_some((i, other))
    })
}

/// Returns the item if there is exactly one.
fn only<T>(mut items: impl Iterator<Item = T>) -> Option<T> {
    items.next().filter(|_| items.next().is_none())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::parse_turns;
    use proptest::prelude::*;

    /// Returns the solved cube after swaps of the stickers of each pair, in this order.
    fn swapped(pairs: &[(usize, usize)]) -> Facelets {
        let mut colours = *Facelets::solved().colours();
        for &(a, b) in pairs {
            colours.swap(a, b);
        }
        Facelets::try_from(colours).unwrap()
    }

    /// Stickers 8, 9 and 20 are those of the corner URF, 5 and 10 those of the edge UR, 7 and 19
    /// those of the edge UF.
    #[test]
    fn each_impossible_cube_has_its_reason() {
        let reason = |facelets: Facelets| Cube::try_from(facelets).unwrap_err().to_string();

        let mut nine = *Facelets::solved().colours();
        nine[0] = 1;
        assert_eq!(
            reason(Facelets::try_from(nine).unwrap()),
            "8 stickers have the colour of face U, not 9"
        );
        nine[4] = 1;
        assert_eq!(
            reason(Facelets::try_from(nine).unwrap()),
            "the centres of U and R both have the colour of face R"
        );
        assert_eq!(
            reason(swapped(&[(8, 20)])),
            "position URF has colours FRU: no piece has these colours in this order"
        );
        // The sticker F of UF gets the colour of R, so piece UR occurs twice.
        assert_eq!(reason(swapped(&[(10, 19), (10, 12)])), "piece UR is in two places: UR and UF");
        assert_eq!(reason(swapped(&[(7, 19)])), "edge UF is flipped in its place");
        assert_eq!(
            reason(swapped(&[(8, 9), (9, 20)])),
            "corner URF is twisted anticlockwise in its place"
        );
        assert_eq!(
            reason(swapped(&[(8, 20), (9, 20)])),
            "corner URF is twisted clockwise in its place"
        );
        assert_eq!(reason(swapped(&[(10, 19)])), "pieces UR and UF are swapped");
    }

    #[test]
    fn error_of_impossible_scrambled_cube_names_no_piece() {
        let turns = parse_turns("R U2 F' L D B2 R' U F D2 L' B").unwrap();
        // The stickers are those of the edge UF, of the corner URF, and of both edges UR and UF.
        for (pairs, message) in [
            (&[(7, 19)][..], "one edge is flipped in its place: it can be any edge"),
            (
                &[(8, 9), (9, 20)],
                "one corner is twisted anticlockwise in its place: it can be any corner",
            ),
            (&[(10, 19)], "two pieces are swapped: they can be any two corners or any two edges"),
        ] {
            let scrambled = turns.iter().fold(swapped(pairs), |f, &t| f.turned(t));

            let reason = Cube::try_from(scrambled).unwrap_err();

            assert_eq!(reason.to_string(), message);
            assert!(reason.places().is_empty());
        }
    }

    #[test]
    fn error_of_rotated_cube_names_a_centre() {
        let turned = Facelets::solved().rotated(crate::cube::Rotation24::quarter(Face::U));

        assert_eq!(
            Cube::try_from(turned),
            Err(ImpossibleCube::CentreElsewhere { face: Face::R, colour: Face::B })
        );
    }

    #[test]
    fn reading_in_any_orientation_is_normalised() {
        let scrambled = Facelets::from(&Cube::scrambled(7));

        for rotation in Rotation24::all() {
            let reading = scrambled.rotated(rotation);
            let (home, back) = reading.normalised().unwrap();

            assert_eq!(home, scrambled);
            assert_eq!(back, rotation.inverse());
        }
    }

    #[test]
    fn stickers_relabelled_by_centres_form_a_legal_cube() {
        let scrambled = Facelets::from(&Cube::scrambled(7));
        for rotation in Rotation24::all() {
            let named = scrambled.rotated(rotation).named_by_position().unwrap();

            assert!(Cube::try_from(named).is_ok());
            assert_eq!(named.is_solved(), scrambled.is_solved());
        }
        // A slice moves the centres. By the names of the new centres, the two outer layers turned
        // the other way.
        let slice =
            crate::cube::after_moves(&Facelets::solved(), &crate::cube::parse_moves("M").unwrap());
        let outer =
            parse_turns("L' R").unwrap().iter().fold(Facelets::solved(), |f, &t| f.turned(t));
        assert_eq!(slice.named_by_position().unwrap(), outer);
    }

    #[test]
    fn mirrored_cube_is_refused_for_its_centres() {
        let mut colours = *Facelets::solved().colours();
        // The colours of R and L are exchanged.
        colours[9..18].fill(4);
        colours[36..45].fill(1);

        let answer = Facelets::try_from(colours).unwrap().normalised();

        assert_eq!(answer, Err(ImpossibleCube::CentresMisplaced));
    }

    proptest! {
        /// The stickers are drawn at random, or those of a possible cube with up to four changes.
        #[test]
        fn any_stickers_give_cube_or_reason(
            colours in prop::array::uniform32(0..6u8), more in prop::array::uniform22(0..6u8),
            seed: u64, changes in prop::collection::vec((0..54usize, 0..6u8), 0..5),
        ) {
            let all: Vec<u8> = colours.into_iter().chain(more).collect();
            let drawn = Facelets::try_from(<[u8; 54]>::try_from(all).unwrap()).unwrap();
            let possible = Facelets::from(&Cube::scrambled(seed));
            let mut colours = *possible.colours();
            for (sticker, colour) in changes {
                colours[sticker] = colour;
            }
            let changed = Facelets::try_from(colours).unwrap();
            prop_assert!(changed != possible || Cube::try_from(changed).is_ok());
            for facelets in [drawn, changed] {
                match Cube::try_from(facelets) {
                    Ok(cube) => prop_assert_eq!(Facelets::from(&cube), facelets),
                    Err(reason) => prop_assert!(
                        !reason.to_string().is_empty() && !reason.kind().is_empty()
                    ),
                }
            }
        }
    }
}
