//! Camera settings: read by name, set if they differ, and read back.

use std::collections::BTreeMap;

use gphoto2::Camera;
use gphoto2::widget::Widget;
use serde_json::{Map, Value};

/// Settings that are always recorded if the camera has them.
const RECORDED: [&str; 14] = [
    "serialnumber",
    "lensname",
    "focallength",
    "batterylevel",
    "focusmode",
    "f-number",
    "aperture",
    "shutterspeed",
    "iso",
    "imageformat",
    "imagequality",
    "capturetarget",
    "whitebalance",
    "expprogram",
];

/// Sets the settings that differ from `wanted`; returns those in force, and a warning for each that still differs.
pub fn apply_settings(
    camera: &Camera,
    wanted: &BTreeMap<String, String>,
) -> (Map<String, Value>, Vec<String>) {
    let mut settings = Map::new();
    let mut warnings = Vec::new();
    for (name, value) in wanted {
        match set_setting(camera, name, value) {
            Ok(now) => {
                settings.insert(name.clone(), now.into());
            }
            Err(why) => warnings.push(why.to_string()),
        }
    }
    for name in RECORDED {
        if let (false, Ok(widget)) = (
            settings.contains_key(name),
            camera.config_key::<Widget>(name).wait(),
        ) {
            settings.insert(name.to_owned(), widget_text(&widget).into());
        }
    }
    (settings, warnings)
}

/// Reason why a setting differs from the configuration: a warning for the operator.
#[derive(Debug, thiserror::Error)]
enum SettingError {
    #[error("the camera has no setting {0} ({1})")]
    Unknown(String, gphoto2::Error),
    #[error("setting {name} is {now}, and cannot be set to {wanted}: {why}{}", unset_setting_hint(.name))]
    Refused {
        name: String,
        now: String,
        wanted: String,
        why: ValueError,
    },
    #[error("setting {0}: {1}")]
    Unreadable(String, gphoto2::Error),
    #[error("setting {name} is {now}, wanted {wanted}{}", unset_setting_hint(.name))]
    NotApplied {
        name: String,
        now: String,
        wanted: String,
    },
}

/// Reason why a setting does not accept a value.
#[derive(Debug, thiserror::Error)]
enum ValueError {
    #[error(transparent)]
    Camera(#[from] gphoto2::Error),
    #[error("it requires a number")]
    NoNumber,
    #[error("it requires one of: {0}")]
    NoChoice(String),
    #[error("it is not a setting")]
    NoSetting,
}

/// Sets a setting and returns the value in force.
///
/// # Errors
/// Returns an error if it differs from the wanted one.
fn set_setting(camera: &Camera, name: &str, value: &str) -> Result<String, SettingError> {
    let read = || camera.config_key::<Widget>(name).wait();
    let widget = read().map_err(|error| SettingError::Unknown(name.to_owned(), error))?;
    if is_same_setting(&widget_text(&widget), value) {
        return Ok(widget_text(&widget));
    }
    let (name, wanted) = (name.to_owned(), value.to_owned());
    if let Err(why) =
        set_widget_value(&widget, value).and_then(|()| Ok(camera.set_config(&widget).wait()?))
    {
        return Err(SettingError::Refused {
            name,
            now: widget_text(&widget),
            wanted,
            why,
        });
    }
    let now = read()
        .map(|widget| widget_text(&widget))
        .map_err(|error| SettingError::Unreadable(name.clone(), error))?;
    if is_same_setting(&now, value) {
        Ok(now)
    } else {
        Err(SettingError::NotApplied { name, now, wanted })
    }
}

fn unset_setting_hint(name: &str) -> &'static str {
    match name {
        "focusmode" => "; set the switch on the lens or body to M",
        "f-number" | "aperture" | "shutterspeed" | "iso" | "expprogram" => {
            "; set the mode dial to M"
        }
        _ => "",
    }
}

fn is_same_setting(now: &str, wanted: &str) -> bool {
    now.trim().eq_ignore_ascii_case(wanted.trim())
}

fn widget_text(widget: &Widget) -> String {
    match widget {
        Widget::Text(widget) => widget.value(),
        Widget::Range(widget) => widget.value().to_string(),
        Widget::Toggle(widget) => widget
            .toggled()
            .map_or("unknown", |on| if on { "1" } else { "0" })
            .to_owned(),
        Widget::Radio(widget) => widget.choice(),
        Widget::Date(widget) => widget.timestamp().to_string(),
        _ => String::new(),
    }
}

fn set_widget_value(widget: &Widget, value: &str) -> Result<(), ValueError> {
    match widget {
        Widget::Text(widget) => Ok(widget.set_value(value)?),
        Widget::Range(widget) => {
            widget.set_value(value.parse().map_err(|_| ValueError::NoNumber)?);
            Ok(())
        }
        Widget::Toggle(widget) => {
            widget.set_toggled(matches!(value, "1" | "on" | "true"));
            Ok(())
        }
        Widget::Radio(widget) => {
            let choices: Vec<_> = widget.choices_iter().collect();
            let choice = choices.iter().find(|choice| is_same_setting(choice, value));
            let choice = choice.ok_or_else(|| ValueError::NoChoice(choices.join(", ")))?;
            Ok(widget.set_choice(choice)?)
        }
        _ => Err(ValueError::NoSetting),
    }
}
