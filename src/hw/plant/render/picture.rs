//! An overview of the whole cell from outside, for the README and the operator.
