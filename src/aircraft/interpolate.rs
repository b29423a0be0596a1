//! A quantity at an instant between its time tags, with what may lie between them in its standard deviation.

use super::Quantity;

/// Farthest that the nearest tag may be, s.
const NEAREST_S: f64 = 5.0;
/// Tags farther away tell nothing of how the quantity changes, s.
const NEIGHBOUR_S: f64 = 60.0;
/// A value apart from its neighbours by more of the instrument's standard deviations, and by more than so many times the usual
/// bend, contradicts them.
const CONTRADICTS: (f64, f64) = (3.0, 10.0);

/// Tag, s, and value.
type Point = (f64, f64);

/// What is told of an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Interpolated {
    pub value: f64,
    /// Change per second there.
    pub rate: f64,
    /// Of what is between the tags.
    pub sigma: f64,
    /// To the nearest tag, s.
    pub apart_s: f64,
}

/// `before` and `after` have the tags on both sides, the nearest first. `None` where none is near.
pub(super) fn at(
    quantity: Quantity,
    time_s: f64,
    before: impl Iterator<Item = Point>,
    after: impl Iterator<Item = Point>,
) -> Option<Interpolated> {
    let two = |points: &mut dyn Iterator<Item = Point>| -> Vec<Point> {
        points.take_while(|(t, _)| (t - time_s).abs() <= NEIGHBOUR_S).take(2).collect()
    };
    let (before, after) = (two(&mut { before }), two(&mut { after }));
    let sides = [&before, &after].into_iter().filter_map(|side| side.first());
    let apart_s = sides.map(|(t, _)| (t - time_s).abs()).reduce(f64::min)?;
    if apart_s > NEAREST_S {
        return None;
    }
    let told = match (before.as_slice(), after.as_slice()) {
        ([b, ..], [a, ..]) => bridged(quantity, time_s, (*b, *a), (before.get(1), after.get(1))),
        ([last, rest @ ..], []) | ([], [last, rest @ ..]) => held(quantity, time_s, *last, rest.first()),
        ([], []) => return None,
    };
    Some(Interpolated { apart_s, ..told })
}

/// Linear between the nearest tags.
fn bridged(
    quantity: Quantity,
    time_s: f64,
    (b, a): (Point, Point),
    outer: (Option<&Point>, Option<&Point>),
) -> Interpolated {
    let motion = quantity.motion();
    let rate = rate(b, a);
    let value = b.1 + rate * (time_s - b.0);
    let corners = [outer.0.map(|far| Corner::of(*far, b, a)), outer.1.map(|far| Corner::of(b, a, *far))];
    let corners: Vec<Corner> = corners.into_iter().flatten().collect();
    let bend = corners.iter().map(|c| c.bend.abs()).fold(0.0, f64::max).hypot(motion.bend);
    let between = 0.5 * bend * (time_s - b.0) * (a.0 - time_s);
    let most = motion.spread.hypot(a.1 - b.1);
    let allowed = |corner: &Corner| {
        CONTRADICTS.0 * quantity.sigma(value) + CONTRADICTS.1 * motion.bend * corner.apart_per_bend
    };
    let contradicts = corners.iter().filter(|c| c.apart > allowed(c)).map(|c| c.apart).fold(0.0, f64::max);
    Interpolated { value, rate, sigma: between.min(most).hypot(contradicts), apart_s: 0.0 }
}

/// The nearest, with what the change over the time to it may be: that of the tags before, or the usual one.
fn held(quantity: Quantity, time_s: f64, last: Point, next: Option<&Point>) -> Interpolated {
    let motion = quantity.motion();
    let apart_s = (time_s - last.0).abs();
    let (value, most) = (last.1, motion.spread.hypot(next.map_or(0.0, |next| next.1 - last.1)));
    let Some(next) = next else {
        return Interpolated { value, rate: motion.rate, sigma: (motion.rate * apart_s).min(most), apart_s };
    };
    let rate = rate(last, *next);
    // The rate is that of the middle between the two tags.
    let turned = motion.bend * apart_s * 0.5 * (apart_s + (next.0 - last.0).abs());
    Interpolated { value, rate, sigma: (rate * apart_s).hypot(turned.min(most)), apart_s }
}

fn rate(a: Point, b: Point) -> f64 {
    (b.1 - a.1) / (b.0 - a.0)
}

/// Three tags in a row.
struct Corner {
    /// Change of the rate per second.
    bend: f64,
    /// How far the one between is from the line through the others.
    apart: f64,
    /// The same for a bend of 1.
    apart_per_bend: f64,
}

impl Corner {
    fn of(a: Point, b: Point, c: Point) -> Self {
        let bend = 2.0 * (rate(b, c) - rate(a, b)) / (c.0 - a.0);
        let apart_per_bend = 0.5 * (b.0 - a.0) * (c.0 - b.0);
        Self { bend, apart: (bend * apart_per_bend).abs(), apart_per_bend }
    }
}
