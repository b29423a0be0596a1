//! Interpolation of a quantity between its time tags, with the possible change between them in its standard deviation.

use super::Quantity;

/// Largest distance of the nearest tag, s.
pub const MAX_NEAREST_S: f64 = 5.0;
/// Largest distance of tags from which the change of the quantity is estimated, s.
const MAX_NEIGHBOUR_S: f64 = 60.0;
/// Limits above which a value contradicts its neighbours: in standard deviations of the instrument, and in multiples of the
/// typical change of the rate; both are added.
const CONTRADICTION_LIMITS: (f64, f64) = (3.0, 10.0);

/// Time tag, s, and value.
type TaggedValue = (f64, f64);

/// Interpolated value of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Interpolated {
    pub value: f64,
    /// Change per second.
    pub rate: f64,
    /// Standard deviation of the change between the tags.
    pub sigma: f64,
    /// Time to the nearest tag, s.
    pub apart_s: f64,
}

/// Interpolates a quantity at `time_s`; `before` and `after` have the tags on both sides, the nearest first. `None` if none
/// is near.
pub(super) fn interpolate_at(
    quantity: Quantity,
    time_s: f64,
    before: impl Iterator<Item = TaggedValue>,
    after: impl Iterator<Item = TaggedValue>,
) -> Option<Interpolated> {
    let two = |points: &mut dyn Iterator<Item = TaggedValue>| -> Vec<TaggedValue> {
        points
            .take_while(|(t, _)| (t - time_s).abs() <= MAX_NEIGHBOUR_S)
            .take(2)
            .collect()
    };
    let (before, after) = (two(&mut { before }), two(&mut { after }));
    let sides = [&before, &after]
        .into_iter()
        .filter_map(|side| side.first());
    let apart_s = sides.map(|(t, _)| (t - time_s).abs()).reduce(f64::min)?;
    if apart_s > MAX_NEAREST_S {
        return None;
    }
    let interpolated = match (before.as_slice(), after.as_slice()) {
        ([b, ..], [a, ..]) => {
            interpolate_between(quantity, time_s, (*b, *a), (before.get(1), after.get(1)))
        }
        ([last, rest @ ..], []) | ([], [last, rest @ ..]) => {
            extrapolate(quantity, time_s, *last, rest.first())
        }
        ([], []) => return None,
    };
    Some(Interpolated {
        apart_s,
        ..interpolated
    })
}

/// Interpolates linearly between the nearest tags.
fn interpolate_between(
    quantity: Quantity,
    time_s: f64,
    (b, a): (TaggedValue, TaggedValue),
    outer: (Option<&TaggedValue>, Option<&TaggedValue>),
) -> Interpolated {
    let motion = quantity.motion();
    let rate = rate_between_tags(b, a);
    let value = b.1 + rate * (time_s - b.0);
    let triples = [
        outer.0.map(|far| TagTriple::from_points(*far, b, a)),
        outer.1.map(|far| TagTriple::from_points(b, a, *far)),
    ];
    let triples: Vec<TagTriple> = triples.into_iter().flatten().collect();
    let bend = triples
        .iter()
        .map(|c| c.acceleration.abs())
        .fold(0.0, f64::max)
        .hypot(motion.acceleration);
    let between = 0.5 * bend * (time_s - b.0) * (a.0 - time_s);
    let most = motion.spread.hypot(a.1 - b.1);
    let allowed = |triple: &TagTriple| {
        CONTRADICTION_LIMITS.0 * quantity.sigma(value)
            + CONTRADICTION_LIMITS.1 * motion.acceleration * triple.deviation_per_acceleration
    };
    let contradiction = triples
        .iter()
        .filter(|c| c.deviation > allowed(c))
        .map(|c| c.deviation)
        .fold(0.0, f64::max);
    Interpolated {
        value,
        rate,
        sigma: between.min(most).hypot(contradiction),
        apart_s: 0.0,
    }
}

/// Extends the nearest value, with the possible change since its tag in the standard deviation: from the rate of the tags
/// before it, or else the typical rate.
fn extrapolate(
    quantity: Quantity,
    time_s: f64,
    last: TaggedValue,
    next: Option<&TaggedValue>,
) -> Interpolated {
    let motion = quantity.motion();
    let apart_s = (time_s - last.0).abs();
    let (value, most) = (
        last.1,
        motion
            .spread
            .hypot(next.map_or(0.0, |next| next.1 - last.1)),
    );
    let Some(next) = next else {
        return Interpolated {
            value,
            rate: motion.rate,
            sigma: (motion.rate * apart_s).min(most),
            apart_s,
        };
    };
    let rate = rate_between_tags(last, *next);
    // The rate applies to the middle between the two tags.
    let turned = motion.acceleration * apart_s * 0.5 * (apart_s + (next.0 - last.0).abs());
    Interpolated {
        value,
        rate,
        sigma: (rate * apart_s).hypot(turned.min(most)),
        apart_s,
    }
}

fn rate_between_tags(a: TaggedValue, b: TaggedValue) -> f64 {
    (b.1 - a.1) / (b.0 - a.0)
}

/// Three successive tags.
struct TagTriple {
    /// Change of the rate per second.
    acceleration: f64,
    /// Distance of the middle value from the line through the others.
    deviation: f64,
    /// Distance for an acceleration of 1.
    deviation_per_acceleration: f64,
}

impl TagTriple {
    /// Returns the acceleration over three tagged values and the deviation of the middle one from a straight line.
    fn from_points(a: TaggedValue, b: TaggedValue, c: TaggedValue) -> Self {
        let bend = 2.0 * (rate_between_tags(b, c) - rate_between_tags(a, b)) / (c.0 - a.0);
        let apart_per_bend = 0.5 * (b.0 - a.0) * (c.0 - b.0);
        Self {
            acceleration: bend,
            deviation: (bend * apart_per_bend).abs(),
            deviation_per_acceleration: apart_per_bend,
        }
    }
}
