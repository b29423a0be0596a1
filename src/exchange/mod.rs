//! Files exchanged with other programs: cameras of OpenCV, ROS, Kalibr and mrcal; descriptions of calibration boards and
//! their corners measured in images.
//!
//! All cameras count pixels from the centre of the top-left one and use Brown's distortion in OpenCV's order k1 k2 p1 p2 k3,
//! followed by k4 k5 k6 for a rational lens.
//!
//! | file | from | to |
//! |---|---|---|
//! | `format` | name and keys of a file | its format |
//! | `declared` | keys of a camera | rejection of unsupported models, remarks on unknown keys |
//! | `matrix`, `listed` | keys of a camera | numbers as written: [`interior`] |
//! | `interior` | numbers | valid lens, with remarks on unusual values |
//! | `read` | file | camera, unused keys and remarks |
//! | `write` | lens | file |
//! | `keyed` | YAML, XML, Python literal | tree of keys |
//! | `board` | board.toml, Kalibr's target | calibration board |
//! | `corners` | corners measured in images | table, and back |

mod board;
mod corners;
mod declared;
mod format;
mod interior;
mod keyed;
mod listed;
mod matrix;
mod read;
mod write;

pub use board::{DescribedBoard, load_board};
pub use corners::{ImageCorners, read_corners, write_corners};
pub use format::{CameraFormat, output_format};
pub use read::{ReadCamera, read_exchange};
pub use write::{WriteError, write_exchange};
