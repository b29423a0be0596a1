//! State of the machine in the cabin, as the kernel shows it under `/sys`: radios, temperatures, power supplies.

use std::path::Path;

/// Mount point of the kernel's sysfs.
pub const SYSFS: &str = "/sys";

/// A radio transmitter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Radio {
    /// The kernel's name, such as `phy0`.
    pub name: String,
    /// Kind: `wlan`, `bluetooth`, `wwan`, …
    pub kind: String,
    /// True if it is blocked, by a switch or by software.
    pub blocked: bool,
}

/// A power supply or battery.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PowerSupply {
    /// The kernel's name, such as `AC` or `BAT0`.
    pub name: String,
    /// State in words: online, status, charge.
    pub description: String,
}

/// Lists names and folders of the devices of a class, sorted.
fn list_class(sys: &Path, name: &str) -> Vec<(String, std::path::PathBuf)> {
    let entries = std::fs::read_dir(sys.join("class").join(name))
        .into_iter()
        .flatten()
        .flatten();
    let mut all: Vec<_> = entries
        .map(|e| (e.file_name().to_string_lossy().into_owned(), e.path()))
        .collect();
    all.sort();
    all
}

fn read_attribute(folder: &Path, file: &str) -> Option<String> {
    std::fs::read_to_string(folder.join(file))
        .ok()
        .map(|text| text.trim().to_owned())
}

/// Lists the transmitters that the kernel can block.
pub fn list_radios(sys: &Path) -> Vec<Radio> {
    let radio = |(name, folder): (String, std::path::PathBuf)| {
        let is = |file: &str| read_attribute(&folder, file).as_deref() == Some("1");
        let blocked = is("soft") || is("hard");
        let name = read_attribute(&folder, "name").unwrap_or(name);
        Some(Radio {
            name,
            kind: read_attribute(&folder, "type")?,
            blocked,
        })
    };
    list_class(sys, "rfkill")
        .into_iter()
        .filter_map(radio)
        .collect()
}

/// Reads the temperatures, degrees Celsius, with the names of the sensors.
pub fn read_temperatures_c(sys: &Path) -> Vec<(String, f64)> {
    let zones = list_class(sys, "thermal")
        .into_iter()
        .filter(|(name, _)| name.starts_with("thermal_zone"));
    let zone = |(name, folder): (String, std::path::PathBuf)| {
        let millidegrees: f64 = read_attribute(&folder, "temp")?.parse().ok()?;
        Some((
            read_attribute(&folder, "type").unwrap_or(name),
            1e-3 * millidegrees,
        ))
    };
    zones.filter_map(zone).collect()
}

/// Lists mains adapters, batteries and USB supplies.
pub fn list_supplies(sys: &Path) -> Vec<PowerSupply> {
    let supply = |(name, folder): (String, std::path::PathBuf)| {
        let online = read_attribute(&folder, "online")
            .map(|o| if o == "0" { "off" } else { "on" }.to_owned());
        let charge = read_attribute(&folder, "capacity").map(|percent| format!("{percent} %"));
        let states: Vec<String> = [online, read_attribute(&folder, "status"), charge]
            .into_iter()
            .flatten()
            .collect();
        PowerSupply {
            name,
            description: states.join(", "),
        }
    };
    list_class(sys, "power_supply")
        .into_iter()
        .map(supply)
        .collect()
}

/// Describes temperatures and supplies in one line for the log; `None` if the kernel reports neither.
pub fn describe_machine(sys: &Path) -> Option<String> {
    let heat = read_temperatures_c(sys)
        .into_iter()
        .map(|(place, celsius)| format!("{place} {celsius:.0} C"));
    let supply = list_supplies(sys)
        .into_iter()
        .map(|supply| format!("{} {}", supply.name, supply.description));
    let all: Vec<String> = heat.chain(supply).collect();
    (!all.is_empty()).then(|| all.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sys(files: &[(&str, &str)]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for (file, text) in files {
            let path = dir.path().join("class").join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, format!("{text}\n")).unwrap();
        }
        dir
    }

    #[test]
    fn a_radio_is_blocked_by_either_switch() {
        let dir = sys(&[
            ("rfkill/rfkill0/name", "phy0"),
            ("rfkill/rfkill0/type", "wlan"),
            ("rfkill/rfkill0/soft", "0"),
            ("rfkill/rfkill0/hard", "0"),
            ("rfkill/rfkill1/name", "hci0"),
            ("rfkill/rfkill1/type", "bluetooth"),
            ("rfkill/rfkill1/soft", "1"),
            ("rfkill/rfkill1/hard", "0"),
        ]);
        let found: Vec<_> = list_radios(dir.path())
            .into_iter()
            .map(|r| (r.name, r.kind, r.blocked))
            .collect();
        let expected = [("phy0", "wlan", false), ("hci0", "bluetooth", true)];
        assert_eq!(
            found,
            expected.map(|(n, k, b)| (n.to_owned(), k.to_owned(), b))
        );
    }

    #[test]
    fn temperatures_and_supply_are_a_line_and_nothing_is_none() {
        let dir = sys(&[
            ("thermal/thermal_zone0/type", "cpu-thermal"),
            ("thermal/thermal_zone0/temp", "61234"),
            ("thermal/cooling_device0/type", "fan"),
            ("power_supply/AC/online", "1"),
            ("power_supply/BAT0/status", "Discharging"),
            ("power_supply/BAT0/capacity", "83"),
        ]);
        let text = describe_machine(dir.path()).unwrap();
        assert_eq!(text, "cpu-thermal 61 C; AC on; BAT0 Discharging, 83 %");
        let empty = sys(&[]);
        assert_eq!(
            (describe_machine(empty.path()), list_radios(empty.path())),
            (None, vec![])
        );
    }
}
