//! Rotations from matched directions: two, or many (Arun, Huang and Blostein 1987).

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Returns the rotation that takes `source` to `target`, exact for the plane of both directions and their mean; `None` for
/// parallel directions.
pub(super) fn rotation_from_two(
    source: [&Vector3<f64>; 2],
    target: [&Vector3<f64>; 2],
) -> Option<Rotation3<f64>> {
    let (a, b) = (orthonormal_triad(source)?, orthonormal_triad(target)?);
    Some(Rotation3::from_matrix_unchecked(b * a.transpose()))
}

/// Returns the orthonormal axes of two directions: along their mean, across it in their plane, and normal to the plane.
fn orthonormal_triad([a, b]: [&Vector3<f64>; 2]) -> Option<Matrix3<f64>> {
    let across = a.cross(b);
    if across.norm() < 1e-6 {
        return None;
    }
    let (x, z) = ((a + b).normalize(), across.normalize());
    Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// Returns the weighted least-squares rotation `target_from_source` over (source, target, weight) of unit directions, by
/// Arun's singular value decomposition. The determinant guard excludes a reflection. Returns `None` for fewer than two
/// distinct directions.
pub(super) fn rotation_from_many(
    directions: impl IntoIterator<Item = (Vector3<f64>, Vector3<f64>, f64)>,
) -> Option<Rotation3<f64>> {
    let mut moment = Matrix3::zeros();
    for (source, target, weight) in directions {
        moment += target * source.transpose() * weight;
    }
    let svd = moment.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    if svd.singular_values[1] < 1e-12 * svd.singular_values[0] {
        return None;
    }
    let guard = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    Some(Rotation3::from_matrix_unchecked(u * guard * v_t))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn unit() -> impl Strategy<Value = Vector3<f64>> {
        (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64)
            .prop_map(|(x, y, z)| Vector3::new(x, y, z))
            .prop_filter("not near zero", |v| v.norm() > 0.1)
            .prop_map(|v| v.normalize())
    }

    proptest! {
        #[test]
        fn exact_directions_return_the_rotation(
            axis in unit(), angle in -3.1..3.1f64, a in unit(), b in unit(), c in unit(),
        ) {
            prop_assume!(a.cross(&b).norm() > 0.05);
            let truth = Rotation3::new(axis * angle);
            let two = rotation_from_two([&a, &b], [&(truth * a), &(truth * b)]).unwrap();
            prop_assert!((two.matrix() - truth.matrix()).amax() < 1e-12);
            let many = rotation_from_many([a, b, c].map(|d| (d, truth * d, 1.0))).unwrap();
            prop_assert!((many.matrix() - truth.matrix()).amax() < 1e-9);
        }

        #[test]
        fn a_plane_of_directions_never_gives_a_reflection(angle in 0.1..3.0f64, noise in 0.0..0.02f64) {
            let directions = (0..5).map(|i| {
                let t = 0.1 * f64::from(i);
                let source = Vector3::new(t.sin(), 0.0, t.cos());
                let target = Rotation3::from_axis_angle(&Vector3::x_axis(), angle) * source
                    + Vector3::new(0.0, noise * (f64::from(i) - 2.0), 0.0);
                (source, target.normalize(), 1.0)
            });
            let rotation = rotation_from_many(directions).unwrap();
            prop_assert!((rotation.matrix().determinant() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn parallel_directions_fix_no_rotation() {
        let a = Vector3::x();
        assert!(rotation_from_two([&a, &a], [&a, &a]).is_none());
        assert!(rotation_from_many([(a, a, 1.0), (a, a, 2.0)]).is_none());
    }
}
