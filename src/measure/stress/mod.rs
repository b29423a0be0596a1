//! From the curve of a bent wing to load and wear (docs/stress.md): the change of the bending moment against ground, its
//! extremes and exceedances, cycles by rainflow, relative damage.
//!
//! | file | from | to |
//! |---|---|---|
//! | `moment` | curvature with covariance, bending stiffness | moment with its standard deviation |
//! | `rainflow` | a history | cycles (ASTM E1049-85, 5.4.4) |
//! | `sampling` | times of the frames | whether and where cycles can be told |
//! | `wear` | moments over time | extremes, exceedances, ground-air-ground cycle, damage |

mod moment;
pub mod rainflow;
mod sampling;
mod wear;

pub use moment::{Curvature, Moment, Section, USUAL_STEPS, bending_length_m};
pub use sampling::{SAMPLES_PER_PERIOD, Sampling, USUAL_BENDING_HZ, Unseen, sampling};
pub use wear::{
    Damage, Exceedance, Goodman, GroundAirGround, OverAFlight, damage, exceedances, extreme,
    ground_air_ground, over_a_flight,
};
