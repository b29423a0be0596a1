//! Rendered frames of a wing and images of a board, with their truth, and the command that writes them.
//!
//! It knows the lens and the installation, and nothing of detection and adjustment: it is the truth that they are tested
//! against. `README.md` lists where to begin.

pub mod command;
pub mod render;
pub mod set;
