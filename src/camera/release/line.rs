//! GPIO lines for a camera's remote release and for the signal of a failing supply.

use std::path::PathBuf;

use gpiocdev::line::{Info, Offset, Value};
use gpiocdev::request::Builder;
use gpiocdev::{Chip, FoundLine, Request};
use serde::{Deserialize, Serialize};

use crate::camera::CameraError;

/// Returns true if another program holds the line.
fn is_busy(error: &gpiocdev::Error) -> bool {
    use gpiocdev_uapi::{Errno, Error};
    matches!(
        error,
        gpiocdev::Error::Uapi(_, Error::Os(Errno(libc::EBUSY)))
    )
}

/// GPIO line, given by its name or by chip and offset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LineSection {
    /// Name as printed by `gpioinfo`, such as `GPIO17`.
    pub name: Option<String>,
    /// Device of the chip, such as `/dev/gpiochip0`.
    pub chip: Option<PathBuf>,
    /// Number of the line on its chip.
    pub offset: Option<Offset>,
    /// The release is pressed, or the supply fails, while the line is low.
    #[serde(default)]
    pub active_low: bool,
}

impl LineSection {
    /// Returns true if exactly one line is named.
    pub fn is_clear(&self) -> bool {
        matches!(
            (&self.name, &self.chip, self.offset),
            (Some(_), None, None) | (None, Some(_), Some(_))
        )
    }

    fn label(&self) -> String {
        match (&self.name, &self.chip, self.offset) {
            (Some(name), ..) => format!("line {name}"),
            (None, Some(chip), Some(offset)) => format!("line {offset} of {}", chip.display()),
            _ => "a line without a name".to_owned(),
        }
    }

    fn find_gpio_line(&self) -> Result<FoundLine, CameraError> {
        let missing =
            |why: String| CameraError::Refused(format!("{}: {why}; see gpioinfo", self.label()));
        match (&self.name, &self.chip, self.offset) {
            (Some(name), ..) => gpiocdev::find_named_line(name)
                .ok_or_else(|| missing("no such GPIO line".to_owned())),
            (None, Some(chip), Some(offset)) => {
                let info: Info = Chip::from_path(chip)
                    .and_then(|open| open.line_info(offset))
                    .map_err(|error| missing(error.to_string()))?;
                Ok(FoundLine {
                    chip: chip.clone(),
                    info,
                })
            }
            _ => Err(missing("give its name, or chip and offset".to_owned())),
        }
    }
}

/// Requested line, inactive unless set. The kernel releases it on drop.
pub struct GpioLine {
    request: Request,
    label: String,
}

impl GpioLine {
    /// Requests the line as an output, inactive.
    pub fn take(section: &LineSection) -> Result<Self, CameraError> {
        Self::request(section, |builder| builder.as_output(Value::Inactive))
    }

    /// Requests the line as an input.
    pub fn watch(section: &LineSection) -> Result<Self, CameraError> {
        Self::request(section, Builder::as_input)
    }

    fn request(
        section: &LineSection,
        direct: fn(&mut Builder) -> &mut Builder,
    ) -> Result<Self, CameraError> {
        let label = section.label();
        let found = section.find_gpio_line()?;
        if found.info.used {
            return Err(CameraError::Busy(format!(
                "{label} is held by {:?}; stop that program",
                found.info.consumer
            )));
        }
        let mut builder = Request::builder();
        builder.with_found_line(&found).with_consumer("wingd");
        direct(&mut builder);
        if section.active_low {
            builder.as_active_low();
        }
        // Another program may have requested the line since the check above.
        let request = builder.request().map_err(|error| {
            if is_busy(&error) {
                CameraError::Busy(format!("{label}: {error}"))
            } else {
                CameraError::Refused(format!(
                    "{label}: {error}; add the user that runs wingd to the group gpio"
                ))
            }
        })?;
        Ok(Self { request, label })
    }

    /// Sets the line active (pressed) or inactive.
    pub fn set(&self, pressed: bool) -> Result<(), CameraError> {
        let value = if pressed {
            Value::Active
        } else {
            Value::Inactive
        };
        self.request
            .set_lone_value(value)
            .map_err(|error| CameraError::Gone(format!("{}: {error}", self.label)))
    }

    /// Returns true if an input line is active.
    pub fn is_active(&self) -> Result<bool, CameraError> {
        let value = self.request.lone_value();
        value
            .map(|value| value == Value::Active)
            .map_err(|error| CameraError::Gone(format!("{}: {error}", self.label)))
    }
}
