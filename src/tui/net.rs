//! The cube's net: where its tiles stand, in columns and rows of tiles.

use ratatui::crossterm::event::KeyCode;

/// Column and row of each face's first tile in the net.
const PLACES: [(usize, usize); 6] = [(3, 0), (6, 3), (3, 3), (3, 6), (0, 3), (9, 3)];

/// Returns column and row of a facelet, numbered in the order URFDLB.
pub(super) fn place(index: usize) -> (usize, usize) {
    let (column, row) = PLACES[index / 9];
    (column + index % 3, row + index % 9 / 3)
}

/// Returns the tile that a cursor key leads to.
pub(super) fn neighbour(index: usize, key: KeyCode) -> usize {
    let (dx, dy) = match key {
        KeyCode::Left => (11, 0),
        KeyCode::Right => (1, 0),
        KeyCode::Up => (0, 8),
        KeyCode::Down => (0, 1),
        _ => return index,
    };
    let (mut column, mut row) = place(index);
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
    fn the_cursor_wraps_round_the_net() {
        assert_eq!(neighbour(0, KeyCode::Left), 2, "U1 to U3");
        assert_eq!(neighbour(20, KeyCode::Right), 9, "F3 to R1");
        assert_eq!(neighbour(18, KeyCode::Up), 6, "F1 to U7");
    }
}
