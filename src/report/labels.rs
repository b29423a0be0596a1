//! This file finds places for texts beside points, so that none covers another.

use nalgebra::{Vector2, vector};

/// A rectangle of px: left, top, right, bottom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area(pub [f64; 4]);

impl Area {
    /// Whether the two have a point in common.
    pub fn meets(&self, other: &Self) -> bool {
        let ([l, t, r, b], [l2, t2, r2, b2]) = (self.0, other.0);
        l < r2 && l2 < r && t < b2 && t2 < b
    }

    fn within(&self, outer: &Self) -> bool {
        let ([l, t, r, b], [l2, t2, r2, b2]) = (self.0, outer.0);
        l >= l2 && t >= t2 && r <= r2 && b <= b2
    }
}

/// What is already occupied in a picture.
#[derive(Clone, Debug)]
pub struct Labels {
    bounds: Area,
    taken: Vec<Area>,
}

impl Labels {
    /// Nothing is occupied within `bounds` yet.
    pub fn new(bounds: Area) -> Self {
        Self { bounds, taken: Vec::new() }
    }

    /// Keeps labels away from an area.
    pub fn occupy(&mut self, area: Area) {
        self.taken.push(area);
    }

    /// Top left corner for a text of this size beside a thing at `at` with half extents `half`,
    /// `gap` away or more; `None` where there is no room. The place found is occupied.
    pub fn place(
        &mut self,
        at: Vector2<f64>,
        half: Vector2<f64>,
        size: Vector2<f64>,
        gap: f64,
    ) -> Option<Vector2<f64>> {
        let places = [1.0, 5.0, 10.0, 18.0].into_iter().flat_map(|times| around(at, half, size, gap * times));
        let area = |p: &Vector2<f64>| Area([p.x, p.y, p.x + size.x, p.y + size.y]);
        let is_free = |p: &Vector2<f64>| {
            let area = area(p);
            area.within(&self.bounds) && !self.taken.iter().any(|t| t.meets(&area))
        };
        let place = places.into_iter().find(is_free)?;
        self.taken.push(area(&place));
        Some(place)
    }
}

fn around(at: Vector2<f64>, half: Vector2<f64>, size: Vector2<f64>, gap: f64) -> [Vector2<f64>; 8] {
    let (right, left) = (at.x + half.x + gap, at.x - half.x - gap - size.x);
    let (above, below) = (at.y - half.y - gap - size.y, at.y + half.y + gap);
    let (centre, half_way) = (at.x - size.x / 2.0, at.y - size.y / 2.0);
    [
        vector![right, half_way],
        vector![left, half_way],
        vector![centre, above],
        vector![centre, below],
        vector![right, above],
        vector![right, below],
        vector![left, above],
        vector![left, below],
    ]
}

/// From the outline of a thing at `at` to the nearest point of a label: the ends of a leader.
pub fn leader(
    at: Vector2<f64>,
    half: Vector2<f64>,
    place: Vector2<f64>,
    size: Vector2<f64>,
) -> [Vector2<f64>; 2] {
    let end = vector![
        at.x.clamp(place.x, place.x + size.x.max(0.0)),
        at.y.clamp(place.y, place.y + size.y.max(0.0))
    ];
    let way = end - at;
    let reach = (way.x / half.x.max(1.0)).hypot(way.y / half.y.max(1.0));
    [at + if reach > 1.0 { way / reach } else { way }, end]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn labels_of_one_point_do_not_cover_each_other_and_stay_inside() {
        let bounds = Area([0.0, 0.0, 200.0, 200.0]);
        let mut labels = Labels::new(bounds);
        let size = vector![30.0, 10.0];
        let mut placed: Vec<Area> = Vec::new();
        for _ in 0..6 {
            let p = labels.place(vector![100.0, 100.0], vector![4.0, 4.0], size, 2.0).unwrap();
            let area = Area([p.x, p.y, p.x + size.x, p.y + size.y]);
            assert!(area.within(&bounds) && !placed.iter().any(|other| other.meets(&area)));
            placed.push(area);
        }
    }

    #[test]
    fn where_there_is_no_room_there_is_no_label() {
        let mut labels = Labels::new(Area([0.0, 0.0, 10.0, 10.0]));
        assert_eq!(labels.place(vector![5.0, 5.0], vector![1.0, 1.0], vector![30.0, 5.0], 1.0), None);
        assert_eq!(labels.place(vector![f64::NAN, 5.0], vector![1.0, 1.0], vector![1.0, 1.0], 1.0), None);
    }
}
