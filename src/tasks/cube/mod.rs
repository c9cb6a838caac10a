//! The Rubik's cube task of Zieliński et al. (2007).

pub mod hold;
