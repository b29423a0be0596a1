//! Loads and fatigue from the curve of a bent wing (docs/stress.md): the change of the bending moment relative to the
//! ground, its extremes and exceedances, cycles by rainflow counting, relative damage.
//!
//! | file | from | to |
//! |---|---|---|
//! | `moment` | curvature with covariance, bending stiffness | moment with its standard deviation |
//! | `rainflow` | a history | cycles (ASTM E1049-85, 5.4.4) |
//! | `sampling` | times of the frames | whether and over which time cycles can be counted |
//! | `wear` | moments over time | extremes, exceedances, ground-air-ground cycle, damage |

mod moment;
pub mod rainflow;
mod sampling;
mod wear;

pub use moment::{
    BendingCurvature, BendingMoment, DEFAULT_STEPS, MomentFunction, bending_length_m,
};
pub use sampling::{SAMPLES_PER_PERIOD, Sampling, UnseenFractions, analyse_sampling};
pub use wear::{
    Damage, Exceedance, FlightCycles, GoodmanLine, GroundAirGround, count_exceedances,
    count_flight_cycles, extreme_moment, ground_air_ground, relative_damage,
};
