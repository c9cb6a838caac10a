//! The Rubik's cube task of Zieliński et al. (2007).

pub mod hold;
pub mod identify;
pub mod plan;
pub mod replay;
