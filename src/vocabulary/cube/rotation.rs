//! The 24 rotations of a cube onto itself.
//!
//! A rotation gives the orientation in which a cube was read, or that of one gripper relative to
//! the other.

use super::{Axis, Face};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::fmt;
use std::sync::LazyLock;

/// Rotation that maps a cube onto itself.
///
/// Its index is 4 x (index of the face to which U moves) + (position of the face to which R moves
/// among the four faces around that one, in the order of [`Face::ALL`]). 0 is the identity.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Face, Rotation24};
///
/// // A turn of the whole cube, clockwise as seen from above, moves the front to the left.
/// let turn = Rotation24::quarter(Face::U);
/// assert_eq!(turn.face(Face::F), Face::L);
/// assert_eq!(turn.after(turn), turn.inverse().after(turn.inverse()));
/// assert_eq!(Rotation24::all().count(), 24);
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Rotation24(u8);

/// Face to which each face moves, for each rotation.
static FACES: LazyLock<[[Face; 6]; 24]> = LazyLock::new(|| {
    std::array::from_fn(|index| {
        let up = Face::ALL[index / 4];
        let mut around = Face::ALL.into_iter().filter(|f| f.axis() != up.axis());
        let right = around.nth(index % 4).unwrap_or(up);
        // B = U x R, since y = z x x.
        let back = face_towards(&up.normal().cross(&right.normal()));
        // The order is that of Face::ALL: U R F D L B.
        [up, right, back.opposite(), up.opposite(), right.opposite(), back]
    })
});

/// Index of the product a * b of any two rotations: first b, then a.
static PRODUCTS: LazyLock<[[u8; 24]; 24]> = LazyLock::new(|| {
    std::array::from_fn(|a| {
        std::array::from_fn(|b| {
            let through = |f: Face| FACES[a][FACES[b][f.index()].index()];
            // The images of two adjacent faces determine a rotation.
            let product = Rotation24::all().find(|r| {
                r.face(Face::U) == through(Face::U) && r.face(Face::R) == through(Face::R)
            });
            product.map_or(0, |r| r.0)
        })
    })
});

/// Returns the face whose normal is nearest to a direction.
fn face_towards(direction: &Vector3<f64>) -> Face {
    let mut nearest = Face::U;
    for face in Face::ALL {
        if face.normal().dot(direction) > nearest.normal().dot(direction) {
            nearest = face;
        }
    }
    nearest
}

impl Rotation24 {
    /// Identity.
    pub const IDENTITY: Self = Self(0);

    /// Returns all rotations in the order of their indices.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..24).map(Self)
    }

    /// Returns the index, 0..24.
    #[must_use]
    pub fn index(self) -> usize {
        usize::from(self.0)
    }

    /// Returns the rotation with this index; `None` if the index is 24 or more.
    #[must_use]
    pub fn from_index(index: usize) -> Option<Self> {
        (index < 24).then_some(Self(index as u8))
    }

    /// Finds the one of the 24 rotations that is nearest to `rotation`.
    ///
    /// ```
    /// use nalgebra::UnitQuaternion;
    /// use rubik_robot_vocabulary::cube::Rotation24;
    ///
    /// // A tilt of 0.3 rad is nearer to no rotation than to a quarter turn.
    /// let tilt = UnitQuaternion::from_euler_angles(0.3, 0.0, 0.0);
    /// assert_eq!(Rotation24::nearest(&tilt), Rotation24::IDENTITY);
    /// ```
    #[must_use]
    pub fn nearest(rotation: &UnitQuaternion<f64>) -> Self {
        // The directions of U and R determine the rotation; the sum of their cosines measures how
        // well they match.
        let likeness = |r: &Self| {
            let (up, right) = (Vector3::z(), Vector3::x());
            r.face(Face::U).normal().dot(&(rotation * up))
                + r.face(Face::R).normal().dot(&(rotation * right))
        };
        let mut best = Self::IDENTITY;
        for candidate in Self::all() {
            if likeness(&candidate) > likeness(&best) {
                best = candidate;
            }
        }
        best
    }

    /// Returns the quarter turn of the whole cube, clockwise as seen from outside of `face`.
    #[must_use]
    pub fn quarter(face: Face) -> Self {
        let axis = nalgebra::Unit::new_unchecked(face.normal());
        // Clockwise as seen against the normal is a negative angle about it.
        Self::nearest(&UnitQuaternion::from_axis_angle(&axis, -std::f64::consts::FRAC_PI_2))
    }

    /// Returns the face to which a face moves.
    #[must_use]
    pub fn face(self, face: Face) -> Face {
        FACES[self.index()][face.index()]
    }

    /// Returns the axis to which an axis moves, without its sense.
    #[must_use]
    pub fn axis(self, axis: Axis) -> Axis {
        self.face(axis.positive_face()).axis()
    }

    /// Returns the cell to which the cubie at `cell` moves (components -1, 0, 1 along x, y, z).
    #[must_use]
    pub fn cell(self, cell: [i8; 3]) -> [i8; 3] {
        let mut moved = [0; 3];
        for (axis, along) in Axis::ALL.into_iter().zip(cell) {
            let face = self.face(axis.positive_face());
            let at = face.axis();
            moved[at as usize] = if face == at.positive_face() { along } else { -along };
        }
        moved
    }

    /// Returns the product: the rotation `other`, followed by this one.
    #[must_use]
    pub fn after(self, other: Self) -> Self {
        Self(PRODUCTS[self.index()][other.index()])
    }

    /// Returns the inverse rotation.
    #[must_use]
    pub fn inverse(self) -> Self {
        Self::all().find(|r| r.after(self) == Self::IDENTITY).unwrap_or(self)
    }

    /// Returns the rotation as a quaternion.
    #[must_use]
    pub fn quaternion(self) -> UnitQuaternion<f64> {
        let columns = [Face::R, Face::B, Face::U].map(|f| self.face(f).normal());
        let matrix = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&columns));
        UnitQuaternion::from_rotation_matrix(&matrix)
    }
}

impl fmt::Debug for Rotation24 {
    /// Writes the index and the faces to which U and R move.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (up, right) = (self.face(Face::U).letter(), self.face(Face::R).letter());
        write!(f, "Rotation24({}: U to {up}, R to {right})", self.0)
    }
}

/// Returns the 24 rotations in the order of [`Rotation24`].
#[must_use]
pub fn rotations() -> [UnitQuaternion<f64>; 24] {
    std::array::from_fn(|i| Rotation24(i as u8).quaternion())
}

/// Returns the index of the one of the 24 rotations of a cube that is nearest to `rotation`.
#[must_use]
pub fn rotation_index(rotation: &UnitQuaternion<f64>) -> usize {
    Rotation24::nearest(rotation).index()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rotations_form_a_group_of_24() {
        let mut seen: Vec<[Face; 6]> = FACES.to_vec();
        seen.sort_unstable();
        seen.dedup();

        assert_eq!(seen.len(), 24);
        for a in Rotation24::all() {
            assert_eq!(a.after(a.inverse()), Rotation24::IDENTITY);
            for b in Rotation24::all() {
                let difference =
                    a.quaternion() * b.quaternion() * a.after(b).quaternion().inverse();
                assert!(difference.angle() < 1e-9);
            }
        }
    }

    #[test]
    fn rotation_index_inverts_list_of_rotations() {
        for (index, rotation) in rotations().iter().enumerate() {
            assert_eq!(rotation_index(rotation), index);
        }
    }

    #[test]
    fn rotation_moves_faces_axes_and_cells_consistently() {
        for r in Rotation24::all() {
            for face in Face::ALL {
                let moved = r.quaternion() * face.normal();
                assert!((moved - r.face(face).normal()).norm() < 1e-12);
                assert_eq!(r.axis(face.axis()), r.face(face).axis());
            }
            for index in 0..27_i8 {
                let cell = [index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1];
                let moved = r.quaternion() * Vector3::from(cell.map(f64::from));
                let wanted = [0, 1, 2].map(|k: usize| moved[k].round() as i8);
                assert_eq!(r.cell(cell), wanted, "{r:?} of {cell:?}");
            }
        }
    }

    #[test]
    fn clockwise_about_up_takes_front_to_left() {
        assert_eq!(Rotation24::quarter(Face::U).face(Face::F), Face::L);
        assert_eq!(Rotation24::quarter(Face::R).face(Face::F), Face::U);
    }
}
