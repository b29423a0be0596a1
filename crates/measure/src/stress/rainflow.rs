//! Rainflow counting by ASTM E1049-85 (2017), 5.4.4, for a history that is not repeated.

/// A load cycle, or half of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadCycle {
    /// Range from the lowest point to the highest.
    pub range: f64,
    /// Mean of the lowest and the highest point.
    pub mean: f64,
    /// Number of cycles: 1, or 0.5 for a half cycle.
    pub count: f64,
    /// Indices of both points in the history.
    pub ends: [usize; 2],
}

impl LoadCycle {
    fn new(a: (usize, f64), b: (usize, f64), count: f64) -> Self {
        Self {
            range: (a.1 - b.1).abs(),
            mean: 0.5 * (a.1 + b.1),
            count,
            ends: [a.0, b.0],
        }
    }
}

/// Returns the first point, the last, and all turning points between them; a plateau turns at its first point.
pub fn find_reversals(history: &[f64]) -> Vec<(usize, f64)> {
    let mut turns: Vec<(usize, f64)> = Vec::new();
    for (at, &value) in history.iter().enumerate() {
        match turns.as_slice() {
            [.., (_, last)] if value == *last => {}
            [.., (_, before), (_, last)] if (value > *last) == (last > before) => {
                turns.pop();
                turns.push((at, value));
            }
            _ => turns.push((at, value)),
        }
    }
    turns
}

/// Counts the cycles of a history of finite numbers, in the order in which they close; the open rest counts as half cycles.
pub fn count_cycles(history: &[f64]) -> Vec<LoadCycle> {
    let mut open: Vec<(usize, f64)> = Vec::new();
    let mut found = Vec::new();
    for point in find_reversals(history) {
        open.push(point);
        while let [.., a, b, c] = open.as_slice() {
            let (a, b, c) = (*a, *b, *c);
            if (c.1 - b.1).abs() < (b.1 - a.1).abs() {
                break;
            }
            if open.len() == 3 {
                // The range contains the starting point: half a cycle, and the start moves on.
                found.push(LoadCycle::new(a, b, 0.5));
                open.remove(0);
            } else {
                found.push(LoadCycle::new(a, b, 1.0));
                open.truncate(open.len() - 3);
                open.push(c);
            }
        }
    }
    found.extend(
        open.iter()
            .zip(open.iter().skip(1))
            .map(|(a, b)| LoadCycle::new(*a, *b, 0.5)),
    );
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reproduces the example of the standard's figure 6.
    #[test]
    fn the_standards_example() {
        let history = [-2.0, 1.0, -3.0, 5.0, -1.0, 3.0, -4.0, 4.0, -2.0];
        let mut found: Vec<(f64, f64)> = count_cycles(&history)
            .iter()
            .map(|c| (c.range, c.count))
            .collect();
        found.sort_by(|a, b| a.partial_cmp(b).unwrap());
        let expected = [
            (3.0, 0.5),
            (4.0, 0.5),
            (4.0, 1.0),
            (6.0, 0.5),
            (8.0, 0.5),
            (8.0, 0.5),
            (9.0, 0.5),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn a_history_without_a_turn_is_half_a_cycle_and_one_without_a_change_none() {
        assert_eq!(
            count_cycles(&[0.0, 1.0, 1.0, 2.0]),
            [LoadCycle {
                range: 2.0,
                mean: 1.0,
                count: 0.5,
                ends: [0, 3]
            }]
        );
        for none in [&[][..], &[1.0], &[1.0, 1.0, 1.0]] {
            assert_eq!(count_cycles(none), []);
        }
    }

    proptest::proptest! {
        #[test]
        fn every_range_is_counted_once(history in proptest::collection::vec(-10i32..10, 0..60)) {
            let history: Vec<f64> = history.into_iter().map(f64::from).collect();
            let turns = find_reversals(&history).len();
            let halves: f64 = count_cycles(&history).iter().map(|c| 2.0 * c.count).sum();
            proptest::prop_assert_eq!(halves, turns.saturating_sub(1) as f64);
        }
    }
}
