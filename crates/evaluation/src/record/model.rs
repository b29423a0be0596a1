//! Estimated model parameters, written under their names with their standard deviations.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::json_fields;
use wingd_measure::observation::Estimate;

/// Model parameters; those that a method does not have are omitted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Model {
    /// Coefficients of the curvature along the span, 1/m.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub curvature_per_m: Vec<Estimate>,
    /// Coefficients of the twist, nose up positive, degrees; an empty list, written as `null`, if the direction of the nose
    /// is not known.
    #[serde(with = "terms", skip_serializing_if = "Option::is_none")]
    pub twist_deg: Option<Vec<Estimate>>,
    /// Rotation of the mounting relative to the ground frames, about the camera's axes, degrees.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mount_rotation_deg: Vec<Estimate>,
    /// Coefficient of the published parabola, 1/m; with the spatial method it is fitted to the curve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub a_per_m: Option<Estimate>,
    /// Height of the bending axis above the configured one, mean along the span, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis_raise_m: Option<Estimate>,
    /// Relative departure of the deflection shapes of a flight's frames from each other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape_departure: Option<Estimate>,
    /// Rotation of the mounting between two frames of a flight, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount_drift_deg: Option<Estimate>,
}

/// Single number of the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// Name of the parameter.
    pub name: String,
    /// Index in a list, from 0; `None` for a scalar.
    pub index: Option<usize>,
    /// Value and standard deviation; `None` for a parameter that could not be determined.
    pub estimate: Option<Estimate>,
}

impl Model {
    /// Lists all numbers in the order in which they are written.
    pub fn terms(&self) -> Vec<Term> {
        let estimate = |value: Value| serde_json::from_value(value).ok();
        let terms = |(name, value): (String, Value)| match value {
            Value::Array(list) => {
                let term = |(k, value)| Term {
                    name: name.clone(),
                    index: Some(k),
                    estimate: estimate(value),
                };
                list.into_iter().enumerate().map(term).collect()
            }
            value => vec![Term {
                name,
                index: None,
                estimate: estimate(value),
            }],
        };
        json_fields(self).into_iter().flat_map(terms).collect()
    }
}

/// Serialization of a list of terms: `null` for an empty one, one value without brackets.
mod terms {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use wingd_measure::observation::Estimate;

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum WrittenTerms {
        One(Estimate),
        Many(Vec<Estimate>),
    }

    /// Writes one term as an object, several as an array, none as `null`.
    pub fn serialize<S: Serializer>(
        terms: &Option<Vec<Estimate>>,
        output: S,
    ) -> Result<S::Ok, S::Error> {
        match terms.as_deref() {
            None | Some([]) => output.serialize_none(),
            Some([one]) => one.serialize(output),
            Some(many) => many.serialize(output),
        }
    }

    /// Reads terms as written by [`serialize`].
    pub fn deserialize<'de, D: Deserializer<'de>>(
        input: D,
    ) -> Result<Option<Vec<Estimate>>, D::Error> {
        Ok(Some(match Option::deserialize(input)? {
            None => vec![],
            Some(WrittenTerms::One(one)) => vec![one],
            Some(WrittenTerms::Many(many)) => many,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_reads_back_and_is_written_identically() {
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
        let terms = hidden.terms();
        let names: Vec<_> = terms
            .iter()
            .map(|term| (term.name.as_str(), term.index))
            .collect();
        assert_eq!(
            names,
            [
                ("curvature_per_m", Some(0)),
                ("twist_deg", None),
                ("axis_raise_m", None)
            ]
        );
    }
}
