//! Places of the facelets in the net of a cube (the unfolded cube), in columns and rows of tiles. A
//! tile is the picture of a facelet.

use ratatui::crossterm::event::KeyCode;

/// Column and row of each face's first tile in the net.
const PLACES: [(usize, usize); 6] = [(3, 0), (6, 3), (3, 3), (3, 6), (0, 3), (9, 3)];

/// Returns the column and the row of a facelet, whose number is in the order URFDLB.
pub(super) fn place(index: usize) -> (usize, usize) {
    let (column, row) = PLACES[index / 9];
    (column + index % 3, row + index % 9 / 3)
}

/// Returns the index of the facelet to which a cursor key leads from the facelet `index`. At the
/// edge of the net the cursor continues at the opposite edge. Other keys lead nowhere.
pub(super) fn neighbour(index: usize, key: KeyCode) -> usize {
    // The net is 12 columns by 9 rows. Modulo these sizes, a step by 11 or 8 is a step back by 1.
    let (dx, dy) = match key {
        KeyCode::Left => (11, 0),
        KeyCode::Right => (1, 0),
        KeyCode::Up => (0, 8),
        KeyCode::Down => (0, 1),
        _ => return index,
    };
    let (mut column, mut row) = place(index);
    // The cursor steps over the empty corners of the net until it meets a tile.
    for _ in 0..12 {
        (column, row) = ((column + dx) % 12, (row + dy) % 9);
        if let Some(found) = (0..54).find(|&i| place(i) == (column, row)) {
            return found;
        }
    }
    index
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cursor_wraps_around_the_net() {
        for (from, key, to, names) in [
            (0, KeyCode::Left, 2, "U1 to U3"),
            (36, KeyCode::Left, 47, "L1 to B3"),
            (47, KeyCode::Right, 36, "B3 to L1"),
            (1, KeyCode::Up, 34, "U2 to D8"),
            (34, KeyCode::Down, 1, "D8 to U2"),
            (51, KeyCode::Down, 45, "B7 to B1"),
            // Within the net the cursor steps to the next tile.
            (20, KeyCode::Right, 9, "F3 to R1"),
            (18, KeyCode::Up, 6, "F1 to U7"),
            (13, KeyCode::Down, 16, "R5 to R8"),
            (20, KeyCode::Enter, 20, "F3 to F3"),
        ] {
            assert_eq!(neighbour(from, key), to, "{names}");
        }
    }
}
