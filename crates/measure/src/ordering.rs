//! Sorting by a number.

/// Sorts by a number in ascending order; equal ones keep their order.
///
/// The sort itself is compiled once for all types, which a closure that compares would not be.
pub fn sort_by_value<T>(items: &mut Vec<T>, value: impl Fn(&T) -> f64) {
    let mut order: Vec<(f64, usize)> = items.iter().map(value).zip(0..).collect();
    sort_pairs(&mut order);
    let mut moved: Vec<Option<T>> = std::mem::take(items).into_iter().map(Some).collect();
    items.extend(
        order
            .into_iter()
            .filter_map(|(_, place)| moved.get_mut(place)?.take()),
    );
}

#[inline(never)]
fn sort_pairs(order: &mut [(f64, usize)]) {
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
}
