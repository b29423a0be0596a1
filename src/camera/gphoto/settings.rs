//! A camera's settings are read by name, set where they differ, and read back.

use std::collections::BTreeMap;

use gphoto2::Camera;
use gphoto2::widget::Widget;
use serde_json::{Map, Value};

/// Always recorded where the camera has them.
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

/// Sets what differs from `wanted`; settings in force, and a warning for each that is not as wanted.
pub fn apply(camera: &Camera, wanted: &BTreeMap<String, String>) -> (Map<String, Value>, Vec<String>) {
    let mut settings = Map::new();
    let mut warnings = Vec::new();
    for (name, value) in wanted {
        match set(camera, name, value) {
            Ok(now) => {
                settings.insert(name.clone(), now.into());
            }
            Err(why) => warnings.push(why.to_string()),
        }
    }
    for name in RECORDED {
        if let (false, Ok(widget)) = (settings.contains_key(name), camera.config_key::<Widget>(name).wait()) {
            settings.insert(name.to_owned(), text(&widget).into());
        }
    }
    (settings, warnings)
}

/// Why a setting is not as wanted: a warning for the operator.
#[derive(Debug, thiserror::Error)]
enum Unset {
    #[error("the camera has no setting {0} ({1})")]
    Unknown(String, gphoto2::Error),
    #[error("setting {name} is {now}, and cannot be set to {wanted}: {why}{}", hint(.name))]
    Refused { name: String, now: String, wanted: String, why: Unfit },
    #[error("setting {0}: {1}")]
    Unread(String, gphoto2::Error),
    #[error("setting {name} is {now}, wanted {wanted}{}", hint(.name))]
    Other { name: String, now: String, wanted: String },
}

/// Why a setting does not take a value.
#[derive(Debug, thiserror::Error)]
enum Unfit {
    #[error(transparent)]
    Camera(#[from] gphoto2::Error),
    #[error("it takes a number")]
    NoNumber,
    #[error("it takes one of: {0}")]
    NoChoice(String),
    #[error("it is not a setting")]
    NoSetting,
}

/// The value in force after the attempt.
///
/// # Errors
/// Where it is not the wanted one.
fn set(camera: &Camera, name: &str, value: &str) -> Result<String, Unset> {
    let read = || camera.config_key::<Widget>(name).wait();
    let widget = read().map_err(|error| Unset::Unknown(name.to_owned(), error))?;
    if same(&text(&widget), value) {
        return Ok(text(&widget));
    }
    let (name, wanted) = (name.to_owned(), value.to_owned());
    if let Err(why) = change(&widget, value).and_then(|()| Ok(camera.set_config(&widget).wait()?)) {
        return Err(Unset::Refused { name, now: text(&widget), wanted, why });
    }
    let now = read().map(|widget| text(&widget)).map_err(|error| Unset::Unread(name.clone(), error))?;
    if same(&now, value) { Ok(now) } else { Err(Unset::Other { name, now, wanted }) }
}

fn hint(name: &str) -> &'static str {
    match name {
        "focusmode" => "; set the switch on the lens or body to M",
        "f-number" | "aperture" | "shutterspeed" | "iso" | "expprogram" => "; set the mode dial to M",
        _ => "",
    }
}

fn same(now: &str, wanted: &str) -> bool {
    now.trim().eq_ignore_ascii_case(wanted.trim())
}

fn text(widget: &Widget) -> String {
    match widget {
        Widget::Text(widget) => widget.value(),
        Widget::Range(widget) => widget.value().to_string(),
        Widget::Toggle(widget) => {
            widget.toggled().map_or("unknown", |on| if on { "1" } else { "0" }).to_owned()
        }
        Widget::Radio(widget) => widget.choice(),
        Widget::Date(widget) => widget.timestamp().to_string(),
        _ => String::new(),
    }
}

fn change(widget: &Widget, value: &str) -> Result<(), Unfit> {
    match widget {
        Widget::Text(widget) => Ok(widget.set_value(value)?),
        Widget::Range(widget) => {
            widget.set_value(value.parse().map_err(|_| Unfit::NoNumber)?);
            Ok(())
        }
        Widget::Toggle(widget) => {
            widget.set_toggled(matches!(value, "1" | "on" | "true"));
            Ok(())
        }
        Widget::Radio(widget) => {
            let choices: Vec<_> = widget.choices_iter().collect();
            let choice = choices.iter().find(|choice| same(choice, value));
            let choice = choice.ok_or_else(|| Unfit::NoChoice(choices.join(", ")))?;
            Ok(widget.set_choice(choice)?)
        }
        _ => Err(Unfit::NoSetting),
    }
}
