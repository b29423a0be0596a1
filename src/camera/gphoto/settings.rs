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
            Err(warning) => warnings.push(warning),
        }
    }
    for name in RECORDED {
        if let (false, Ok(widget)) = (settings.contains_key(name), camera.config_key::<Widget>(name).wait()) {
            settings.insert(name.to_owned(), text(&widget).into());
        }
    }
    (settings, warnings)
}

/// The value in force after the attempt; where it is not the wanted one, a warning.
fn set(camera: &Camera, name: &str, value: &str) -> Result<String, String> {
    let read = || camera.config_key::<Widget>(name).wait();
    let widget = read().map_err(|error| format!("the camera has no setting {name} ({error})"))?;
    if same(&text(&widget), value) {
        return Ok(text(&widget));
    }
    change(&widget, value)
        .and_then(|()| camera.set_config(&widget).wait().map_err(|error| error.to_string()))
        .map_err(|why| {
            format!("setting {name} is {}, and cannot be set to {value}: {why}{}", text(&widget), hint(name))
        })?;
    let now = read().map(|widget| text(&widget)).map_err(|error| format!("setting {name}: {error}"))?;
    match same(&now, value) {
        true => Ok(now),
        false => Err(format!("setting {name} is {now}, wanted {value}{}", hint(name))),
    }
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

fn change(widget: &Widget, value: &str) -> Result<(), String> {
    match widget {
        Widget::Text(widget) => widget.set_value(value).map_err(|error| error.to_string()),
        Widget::Range(widget) => {
            widget.set_value(value.parse().map_err(|_| "it takes a number".to_owned())?);
            Ok(())
        }
        Widget::Toggle(widget) => {
            widget.set_toggled(matches!(value, "1" | "on" | "true"));
            Ok(())
        }
        Widget::Radio(widget) => {
            let choices: Vec<_> = widget.choices_iter().collect();
            let choice = choices.iter().find(|choice| same(choice, value));
            let choice = choice.ok_or_else(|| format!("it takes one of: {}", choices.join(", ")))?;
            widget.set_choice(choice).map_err(|error| error.to_string())
        }
        _ => Err("it is not a setting".to_owned()),
    }
}
