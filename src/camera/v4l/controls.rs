//! Camera controls by id: set, read back, compared. They are not enumerated, as the binding cannot handle unknown control
//! types.

use std::collections::BTreeMap;

use serde_json::{Map, Value};
use v4l::Device;
use v4l::control;

/// Names as printed by `v4l2-ctl`, in the order in which they are set: the automatic modes first, since they lock the
/// values they govern.
const KNOWN: [(&str, u32); 17] = [
    ("auto_exposure", 0x009a_0901),
    ("exposure_dynamic_framerate", 0x009a_0903),
    ("focus_automatic_continuous", 0x009a_090c),
    ("white_balance_automatic", 0x0098_090c),
    ("autogain", 0x0098_0912),
    ("exposure_time_absolute", 0x009a_0902),
    ("exposure", 0x0098_0911),
    ("gain", 0x0098_0913),
    ("analogue_gain", 0x009e_0903),
    ("focus_absolute", 0x009a_090a),
    ("zoom_absolute", 0x009a_090d),
    ("white_balance_temperature", 0x0098_091a),
    ("power_line_frequency", 0x0098_0918),
    ("brightness", 0x0098_0900),
    ("contrast", 0x0098_0901),
    ("sharpness", 0x0098_091b),
    ("backlight_compensation", 0x0098_091c),
];

/// Returns position in the setting order and id of a control given by name or as `0x…`.
pub fn control_id(name: &str) -> Option<(usize, u32)> {
    let known = KNOWN.iter().position(|(known, _)| *known == name);
    known.map(|place| (place, KNOWN[place].1)).or_else(|| {
        let digits = name.strip_prefix("0x")?;
        Some((KNOWN.len(), u32::from_str_radix(digits, 16).ok()?))
    })
}

/// Returns the known names, for messages.
pub fn control_names() -> String {
    KNOWN.map(|(name, _)| name).join(", ")
}

/// Sets every control and reads it back; returns the values in force, and a warning for each that differs.
pub fn apply_controls(
    device: &Device,
    wanted: &BTreeMap<String, i64>,
) -> (Map<String, Value>, Vec<String>) {
    let mut order: Vec<_> = wanted
        .iter()
        .filter_map(|(name, value)| Some((control_id(name)?, name, *value)))
        .collect();
    order.sort();
    let mut warnings = Vec::new();
    for ((_, id), name, value) in &order {
        let control = control::Control {
            id: *id,
            value: control::Value::Integer(*value),
        };
        if let Err(error) = device.set_control(control) {
            warnings.push(format!("control {name} cannot be set to {value}: {error}"));
        }
    }
    let (settings, drift) = read_back(device, wanted);
    warnings.extend(drift);
    (settings, warnings)
}

/// Sets the controls again if any differs: a camera may lose its settings, for example by a brown-out.
pub fn restore_controls(
    device: &Device,
    wanted: &BTreeMap<String, i64>,
) -> (Map<String, Value>, Vec<String>) {
    let (settings, mut drift) = read_back(device, wanted);
    if drift.is_empty() {
        return (settings, drift);
    }
    let (settings, still) = apply_controls(device, wanted);
    drift.extend(still);
    (settings, drift)
}

/// Returns the values in force, and a warning for each that differs.
fn read_back(device: &Device, wanted: &BTreeMap<String, i64>) -> (Map<String, Value>, Vec<String>) {
    let mut settings = Map::new();
    let mut warnings = Vec::new();
    for (name, value) in wanted {
        let Some((_, id)) = control_id(name) else {
            continue;
        };
        match read_control(device, id) {
            Ok(now) => {
                if now != *value {
                    warnings.push(format!("control {name} is {now}, wanted {value}"));
                }
                settings.insert(name.clone(), now.into());
            }
            Err(error) => warnings.push(format!("control {name} cannot be read: {error}")),
        }
    }
    (settings, warnings)
}

fn read_control(device: &Device, id: u32) -> std::io::Result<i64> {
    match device.control(id)?.value {
        control::Value::Integer(value) => Ok(value),
        control::Value::Boolean(value) => Ok(i64::from(value)),
        _ => Err(std::io::Error::other("it is not a number")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn automatic_modes_are_set_before_the_values_they_control() {
        let place = |name: &str| control_id(name).map(|(place, _)| place);
        assert!(place("auto_exposure") < place("exposure_time_absolute"));
        assert!(place("focus_automatic_continuous") < place("focus_absolute"));
        assert!(place("white_balance_automatic") < place("white_balance_temperature"));
        assert_eq!(
            control_id("0x009a0902").map(|(_, id)| id),
            control_id("exposure_time_absolute").map(|(_, id)| id)
        );
        assert_eq!(control_id("no_such"), None);
        assert_eq!(control_id("0xzz"), None);
    }
}
