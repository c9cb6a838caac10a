//! The pruning tables of the two-phase search.
//!
//! | set | phase 1 | phase 2 | memory |
//! |---|---|---|---|
//! | default | two bits a state | three bounds | 58 MB |
//! | large | three bytes a state | the same bounds, and corners with eight edges | 496 MB |
//!
//! [`Tables::build`] builds the default set in memory in under a second; [`Tables::with`] takes the
//! bytes of either set, for example from files.

use super::phase1::{self, FaceCases, Frames, Near, Small, Wide};
use super::phase2::{self, Bounds, Orders};
use super::table::{InTurn, TableSpec, Workers};
use std::fmt;
use std::sync::Arc;

/// Bytes of a table, in memory or in a mapped file.
pub type Bytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// All tables of the two-phase search. A program builds them once and shares them among searches.
///
/// ```
/// use rubik_robot_solver::Tables;
/// use rubik_robot_solver::table::InTurn;
/// use rubik_robot_solver::tables::Bytes;
/// use std::sync::Arc;
///
/// // A program may keep the bytes of each table in a file and take them from there.
/// let bytes = Tables::DEFAULT.map(|spec| (spec.build)(&InTurn, &|_| ()));
/// assert!(bytes.iter().zip(Tables::DEFAULT).all(|(bytes, spec)| bytes.len() == spec.bytes));
/// let bytes_of_files = bytes.iter().map(Vec::len).sum();
/// let kept = Tables::with(&bytes.map(|bytes| Arc::new(bytes) as Bytes));
/// assert!(kept.size() > bytes_of_files);
/// ```
pub struct Tables {
    pub(super) frames: Frames,
    pub(super) faces: FaceCases,
    pub(super) orders: Orders,
    phase1: Phase1,
    phase2: Bytes,
    eight: Option<Bytes>,
}

/// Table of phase 1 as the set owns it: [`phase1::NEAR`] with two small tables, or
/// [`phase1::WIDE_TABLE`].
enum Phase1 {
    Near { small: Small, table: Bytes },
    Wide(Bytes),
}

/// Look-up in the table of phase 1 that the set has.
pub(super) enum Phase1Table<'a> {
    Near(Near<'a>),
    Wide(Wide<'a>),
}

impl Tables {
    /// The tables of the default set.
    pub const DEFAULT: [&'static TableSpec; 2] = [&phase1::NEAR, &phase2::BOUNDS];
    /// The tables of the large set.
    pub const LARGE: [&'static TableSpec; 3] =
        [&phase1::WIDE_TABLE, &phase2::BOUNDS, &phase2::EIGHT];

    /// Builds the default set of tables for the two-phase search, with one worker.
    #[must_use]
    pub fn build() -> Self {
        Self::build_with(&InTurn)
    }

    /// Builds the default set of tables for the two-phase search, with several workers.
    #[must_use]
    pub fn build_with(workers: &dyn Workers) -> Self {
        let (frames, orders) = (Frames::build(), Orders::build());
        let table = phase1::near(&frames, workers, &|_| ());
        let phase2 = phase2::build(&orders, workers, &|_| ());
        let phase1 = Phase1::Near { small: Small::build(&frames), table: Arc::new(table) };
        Self {
            frames,
            faces: FaceCases::build(),
            orders,
            phase1,
            phase2: Arc::new(phase2),
            eight: None,
        }
    }

    /// Makes the set from tables that were built before: those of [`Tables::DEFAULT`] or
    /// [`Tables::LARGE`], in the order of that list.
    ///
    /// # Panics
    /// Panics if the sizes are those of neither set: the caller checks the tables that it keeps.
    #[must_use]
    pub fn with(tables: &[Bytes]) -> Self {
        // The sizes identify the set because no two tables have equal sizes.
        let sizes: Vec<usize> = tables.iter().map(|t| (**t).as_ref().len()).collect();
        let large = sizes == Self::LARGE.map(|spec| spec.bytes);
        let known = large || sizes == Self::DEFAULT.map(|spec| spec.bytes);
        assert!(known, "tables of {sizes:?} bytes are neither the default nor the large set");
        let frames = Frames::build();
        let table = Arc::clone(&tables[0]);
        let phase1 = if large {
            Phase1::Wide(table)
        } else {
            Phase1::Near { small: Small::build(&frames), table }
        };
        let (faces, orders) = (FaceCases::build(), Orders::build());
        let (phase2, eight) = (Arc::clone(&tables[1]), tables.get(2).cloned());
        Self { frames, faces, orders, phase1, phase2, eight }
    }

    /// Returns the size of all tables of the set (bytes).
    #[must_use]
    pub fn size(&self) -> usize {
        let phase1 = match &self.phase1 {
            Phase1::Near { small, table } => small.bytes() + (**table).as_ref().len(),
            Phase1::Wide(table) => (**table).as_ref().len(),
        };
        let eight = self.eight.as_ref().map_or(0, |table| (**table).as_ref().len());
        let phase2 = (*self.phase2).as_ref().len() + eight;
        self.frames.bytes() + self.orders.bytes() + phase1 + phase2
    }

    /// Returns the look-up in the table of phase 1, with the moves that it needs.
    pub(super) fn phase1_table(&self) -> Phase1Table<'_> {
        let (frames, faces) = (&self.frames, &self.faces);
        match &self.phase1 {
            Phase1::Near { small, table } => {
                Phase1Table::Near(Near { frames, faces, small, table: (**table).as_ref() })
            }
            Phase1::Wide(table) => {
                Phase1Table::Wide(Wide { frames, faces, table: (**table).as_ref() })
            }
        }
    }

    /// Returns the look-up in the tables of phase 2.
    pub(super) fn bounds(&self) -> Bounds<'_> {
        Bounds {
            orders: &self.orders,
            table: (*self.phase2).as_ref(),
            eight: self.eight.as_ref().map(|table| (**table).as_ref()),
        }
    }
}

impl fmt::Debug for Tables {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Tables({} bytes)", self.size())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::sync::LazyLock;

    /// Default set, built once for all tests.
    pub(crate) static TABLES: LazyLock<Tables> = LazyLock::new(Tables::build);

    #[test]
    fn default_tables_pass_verification_but_corrupted_table_fails() {
        let phase1_table = TABLES.phase1_table();
        let Phase1Table::Near(near) = phase1_table else { panic!("not the default set") };

        assert!((phase1::NEAR.verify)(near.table, &InTurn).is_ok());
        assert!((phase2::BOUNDS.verify)(TABLES.bounds().table, &InTurn).is_ok());
        let corrupted = |spec: &TableSpec, table: &[u8]| {
            let mut broken = table.to_vec();
            broken[table.len() / 2] ^= 1;
            (spec.verify)(&broken, &InTurn)
        };
        assert!(corrupted(&phase1::NEAR, near.table).is_err());
        assert!(corrupted(&phase2::BOUNDS, TABLES.bounds().table).is_err());
    }

    #[test]
    fn default_tables_fit_into_64_mib() {
        let stored: usize = Tables::DEFAULT.iter().map(|spec| spec.bytes).sum();
        assert!((stored..64 << 20).contains(&TABLES.size()), "{} bytes", TABLES.size());
    }
}
