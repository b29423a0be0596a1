//! The parameters of a solution are written under their names, each with its standard deviation.

use serde::{Deserialize, Deserializer, Serialize};

/// A value with its standard deviation, in the unit that the field's name bears.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The value; what is not finite is written as `null` and read as NaN.
    #[serde(deserialize_with = "or_nan")]
    pub value: f64,
    /// `null` for a parameter that was held fixed.
    pub sigma: Option<f64>,
}

fn or_nan<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(input)?.unwrap_or(f64::NAN))
}

/// The model's parameters; those that a method does not have are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Model {
    /// Coefficients of the curvature along the span, 1/m.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub curvature_per_m: Vec<Measured>,
    /// Coefficients of the twist, nose up positive, degrees; an empty list, written as `null`, where it is not known which
    /// way the nose points.
    #[serde(with = "terms", skip_serializing_if = "Option::is_none")]
    pub twist_deg: Option<Vec<Measured>>,
    /// Rotation of the mounting against the ground frames', about the camera's axes, degrees.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mount_rotation_deg: Vec<Measured>,
    /// The published parabola, fitted to the curve where the method is spatial, 1/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub a_per_m: Option<Measured>,
    /// How much higher the bending axis lies than stated, mean along the span, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis_raise_m: Option<Measured>,
    /// How far the shapes of a flight's frames depart from each other, a share.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape_departure: Option<Measured>,
    /// Rotation of the mounting between two frames of a flight, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount_drift_deg: Option<Measured>,
}

/// One number of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    /// The parameter's name.
    pub name: &'static str,
    /// Which one of a list, from 0.
    pub index: Option<usize>,
    /// `None` for a parameter that could not be determined.
    pub measured: Option<Measured>,
}

impl Model {
    /// Every number, in the order written.
    pub fn terms(&self) -> Vec<Term> {
        let single = |name, one: Option<Measured>| {
            one.map(|one| Term { name, index: None, measured: Some(one) }).into_iter().collect::<Vec<_>>()
        };
        let twist = match self.twist_deg.as_deref() {
            None => vec![],
            Some([]) => vec![Term { name: "twist_deg", index: None, measured: None }],
            Some([one]) => single("twist_deg", Some(*one)),
            Some(many) => list("twist_deg", many),
        };
        [
            list("curvature_per_m", &self.curvature_per_m),
            twist,
            list("mount_rotation_deg", &self.mount_rotation_deg),
            single("a_per_m", self.a_per_m),
            single("axis_raise_m", self.axis_raise_m),
            single("shape_departure", self.shape_departure),
            single("mount_drift_deg", self.mount_drift_deg),
        ]
        .concat()
    }
}

fn list(name: &'static str, values: &[Measured]) -> Vec<Term> {
    let term = |(k, one): (usize, &Measured)| Term { name, index: Some(k), measured: Some(*one) };
    values.iter().enumerate().map(term).collect()
}

/// A list as it is written: `null` for none, one value bare.
mod terms {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Measured;

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Written {
        One(Measured),
        Many(Vec<Measured>),
    }

    pub fn serialize<S: Serializer>(terms: &Option<Vec<Measured>>, output: S) -> Result<S::Ok, S::Error> {
        match terms.as_deref() {
            None | Some([]) => output.serialize_none(),
            Some([one]) => one.serialize(output),
            Some(many) => many.serialize(output),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(input: D) -> Result<Option<Vec<Measured>>, D::Error> {
        Ok(Some(match Option::deserialize(input)? {
            None => vec![],
            Some(Written::One(one)) => vec![one],
            Some(Written::Many(many)) => many,
        }))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_is_written_reads_back_and_is_written_alike() {
        let texts = [
            r#"{}"#,
            r#"{"a_per_m":{"value":0.002,"sigma":1e-6}}"#,
            r#"{"curvature_per_m":[{"value":0.1,"sigma":null}],"twist_deg":null,"axis_raise_m":{"value":null,"sigma":0.1}}"#,
            r#"{"twist_deg":{"value":1.5,"sigma":0.2},"shape_departure":{"value":0.01,"sigma":null}}"#,
            r#"{"twist_deg":[{"value":1.5,"sigma":0.2},{"value":1.0,"sigma":0.2}]}"#,
        ];
        for text in texts {
            let model: Model = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&model).unwrap(), text);
        }
        let hidden: Model = serde_json::from_str(texts[2]).unwrap();
        let names: Vec<_> = hidden.terms().iter().map(|term| (term.name, term.index)).collect();
        assert_eq!(names, [("curvature_per_m", Some(0)), ("twist_deg", None), ("axis_raise_m", None)]);
    }
}
