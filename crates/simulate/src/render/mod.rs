//! Frames of a wing with known truth, for tests, benches, `simulate` and `demo`.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | beam | load, given tip deflection | slopes, twist | `beam` |
//! | wing | planform, slopes | skin in space | `wing` |
//! | trace | ray | first point of the skin | `trace` |
//! | clutter, markers | point of the skin | reflectance | `clutter`, `markers` |
//! | light | point, normal | radiance | `light` |
//! | picture | camera | radiance of every pixel, anti-aliased | `picture` |
//! | sensor | radiance | grey values | `sensor` |
//! | board | camera, board's pose and bow | image of a checkerboard | `board` |
//! | gusts | seed, duration | deflection over time | `gusts` |
//! | scene, truth | seed, shot | frame; result of a perfect measurement | `scene`, `truth` |

mod beam;
mod board;
mod clutter;
mod fit_scene;
mod gusts;
mod layout;
mod light;
mod markers;
mod picture;
mod random;
mod sampled_aircraft;
mod scene;
mod sensor;
mod tile;
mod trace;
mod truth;
mod wing;

pub use beam::{BentBeam, CantileverBeam, LoadShape};
pub use board::RenderedBoard;
pub use fit_scene::FitFault;
pub use gusts::{BendingMode, GustSeries};
pub use layout::SceneOptions;
pub use light::Light;
pub use markers::SceneMarker;
pub use random::SeededRandom;
pub use sampled_aircraft::SampledAircraft;
pub use scene::{Scene, SceneShot};
pub use sensor::SensorModel;
pub use truth::{FrameTruth, MarkerTruth};
pub use wing::{DeformedWing, LinearTaper, SceneMotion, SceneSide, SceneState, SceneWing};
