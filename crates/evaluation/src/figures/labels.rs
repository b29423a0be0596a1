//! Placement of labels next to points without overlap.

use nalgebra::{Vector2, vector};

/// Rectangle in px: left, top, right, bottom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelArea(pub [f64; 4]);

impl LabelArea {
    /// Returns whether two rectangles overlap.
    pub fn overlaps(&self, other: &Self) -> bool {
        let ([l, t, r, b], [l2, t2, r2, b2]) = (self.0, other.0);
        l < r2 && l2 < r && t < b2 && t2 < b
    }

    fn is_within(&self, outer: &Self) -> bool {
        let ([l, t, r, b], [l2, t2, r2, b2]) = (self.0, outer.0);
        l >= l2 && t >= t2 && r <= r2 && b <= b2
    }
}

/// Occupied areas of a drawing, for the placement of labels.
#[derive(Clone, Debug)]
pub struct LabelLayout {
    bounds: LabelArea,
    taken: Vec<LabelArea>,
}

impl LabelLayout {
    /// Creates an empty layout within `bounds`.
    pub fn new(bounds: LabelArea) -> Self {
        Self {
            bounds,
            taken: Vec::new(),
        }
    }

    /// Keeps labels away from an area.
    pub fn occupy(&mut self, area: LabelArea) {
        self.taken.push(area);
    }

    /// Places a label of the given size next to an object at `at` with half extents `half`, at least `gap` away. Returns
    /// the top left corner and marks the area as occupied; `None` if there is no room.
    pub fn place(
        &mut self,
        at: Vector2<f64>,
        half: Vector2<f64>,
        size: Vector2<f64>,
        gap: f64,
    ) -> Option<Vector2<f64>> {
        let places = [1.0, 5.0, 10.0, 18.0]
            .into_iter()
            .flat_map(|times| candidate_label_corners(at, half, size, gap * times));
        let area = |p: &Vector2<f64>| LabelArea([p.x, p.y, p.x + size.x, p.y + size.y]);
        let is_free = |p: &Vector2<f64>| {
            let area = area(p);
            area.is_within(&self.bounds) && !self.taken.iter().any(|t| t.overlaps(&area))
        };
        let place = places.into_iter().find(is_free)?;
        self.taken.push(area(&place));
        Some(place)
    }
}

fn candidate_label_corners(
    at: Vector2<f64>,
    half: Vector2<f64>,
    size: Vector2<f64>,
    gap: f64,
) -> [Vector2<f64>; 8] {
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

/// Returns the ends of a leader line: from the outline of an object at `at` to the nearest point of its label.
pub fn leader_line(
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
    use super::*;

    #[test]
    fn labels_of_one_point_do_not_cover_each_other_and_stay_inside() {
        let bounds = LabelArea([0.0, 0.0, 200.0, 200.0]);
        let mut labels = LabelLayout::new(bounds);
        let size = vector![30.0, 10.0];
        let mut placed: Vec<LabelArea> = Vec::new();
        for _ in 0..6 {
            let p = labels
                .place(vector![100.0, 100.0], vector![4.0, 4.0], size, 2.0)
                .unwrap();
            let area = LabelArea([p.x, p.y, p.x + size.x, p.y + size.y]);
            assert!(area.is_within(&bounds) && !placed.iter().any(|other| other.overlaps(&area)));
            placed.push(area);
        }
    }

    #[test]
    fn a_label_without_room_is_omitted() {
        let mut labels = LabelLayout::new(LabelArea([0.0, 0.0, 10.0, 10.0]));
        assert_eq!(
            labels.place(
                vector![5.0, 5.0],
                vector![1.0, 1.0],
                vector![30.0, 5.0],
                1.0
            ),
            None
        );
        assert_eq!(
            labels.place(
                vector![f64::NAN, 5.0],
                vector![1.0, 1.0],
                vector![1.0, 1.0],
                1.0
            ),
            None
        );
    }
}
