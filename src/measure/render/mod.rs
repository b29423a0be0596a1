//! Frames of a wing with known truth, for tests, benches, `simulate` and `demo`.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | beam | load, wanted tip deflection | slopes, twist | `beam` |
//! | wing | planform, slopes | skin in space | `wing` |
//! | trace | ray | first point of the skin | `trace` |
//! | decals, markers | point of the skin | reflectance | `decals`, `markers` |
//! | light | point, normal | radiance | `light` |
//! | picture | camera | radiance of every pixel, anti-aliased | `picture` |
//! | sensor | radiance | grey values | `sensor` |
//! | board | camera, board's place and bow | picture of a checkerboard | `board` |
//! | scene, truth | seed, shot | all of it; what a perfect measurement would say | `scene`, `truth` |

mod beam;
mod board;
mod decals;
mod drawn;
mod fitted;
mod layout;
mod light;
mod markers;
mod picture;
mod random;
mod scene;
mod sensor;
mod tile;
mod trace;
mod truth;
mod wing;

pub use beam::{CantileverBeam, BentBeam, LoadShape};
pub use board::RenderedBoard;
pub use drawn::SampledAircraft;
pub use fitted::FitFault;
pub use layout::SceneOptions;
pub use light::Light;
pub use markers::SceneMarker;
pub use random::SeededRandom;
pub use scene::{Scene, SceneShot};
pub use sensor::SensorModel;
pub use truth::{FrameTruth, MarkerTruth};
pub use wing::{LinearTaper, SceneMotion, DeformedWing, SceneSide, SceneState, SceneWing};
