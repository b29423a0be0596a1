//! Calibration boards: their description, `board.toml`, and their corners measured in images.

mod board;
mod corners;

pub use board::{DescribedBoard, load_board};
pub use corners::{ImageCorners, read_corners, write_corners};
