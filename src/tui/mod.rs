//! The operator's terminal face.
