//! The kernel describes the machine in the cabin under `/sys`: its radios, temperatures and supplies.

use std::path::Path;

/// Where the kernel says it.
pub const SYS: &str = "/sys";

/// A transmitter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Radio {
    /// The kernel's name, such as `phy0`.
    pub name: String,
    /// `wlan`, `bluetooth`, `wwan`, …
    pub kind: String,
    /// By switch or by software.
    pub blocked: bool,
}

/// A supply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Supply {
    /// The kernel's name, such as `AC` or `BAT0`.
    pub name: String,
    /// What it says: online, status, charge.
    pub says: String,
}

/// Names and folders of a class of devices, in order.
fn class(sys: &Path, name: &str) -> Vec<(String, std::path::PathBuf)> {
    let entries = std::fs::read_dir(sys.join("class").join(name)).into_iter().flatten().flatten();
    let mut all: Vec<_> = entries.map(|e| (e.file_name().to_string_lossy().into_owned(), e.path())).collect();
    all.sort();
    all
}

fn text(folder: &Path, file: &str) -> Option<String> {
    std::fs::read_to_string(folder.join(file)).ok().map(|text| text.trim().to_owned())
}

/// Every transmitter that the kernel can block.
pub fn radios(sys: &Path) -> Vec<Radio> {
    let radio = |(name, folder): (String, std::path::PathBuf)| {
        let is = |file: &str| text(&folder, file).as_deref() == Some("1");
        let blocked = is("soft") || is("hard");
        let name = text(&folder, "name").unwrap_or(name);
        Some(Radio { name, kind: text(&folder, "type")?, blocked })
    };
    class(sys, "rfkill").into_iter().filter_map(radio).collect()
}

/// Temperatures by the names of their places, degrees Celsius.
pub fn temperatures_c(sys: &Path) -> Vec<(String, f64)> {
    let zones = class(sys, "thermal").into_iter().filter(|(name, _)| name.starts_with("thermal_zone"));
    let zone = |(name, folder): (String, std::path::PathBuf)| {
        let millidegrees: f64 = text(&folder, "temp")?.parse().ok()?;
        Some((text(&folder, "type").unwrap_or(name), 1e-3 * millidegrees))
    };
    zones.filter_map(zone).collect()
}

/// Mains, batteries, USB supplies.
pub fn supplies(sys: &Path) -> Vec<Supply> {
    let supply = |(name, folder): (String, std::path::PathBuf)| {
        let online = text(&folder, "online").map(|o| if o == "0" { "off" } else { "on" }.to_owned());
        let charge = text(&folder, "capacity").map(|percent| format!("{percent} %"));
        let says: Vec<String> = [online, text(&folder, "status"), charge].into_iter().flatten().collect();
        Supply { name, says: says.join(", ") }
    };
    class(sys, "power_supply").into_iter().map(supply).collect()
}

/// Temperatures and supply in a line, for the log; `None` where the kernel says neither.
pub fn line(sys: &Path) -> Option<String> {
    let heat = temperatures_c(sys).into_iter().map(|(place, celsius)| format!("{place} {celsius:.0} C"));
    let supply = supplies(sys).into_iter().map(|supply| format!("{} {}", supply.name, supply.says));
    let all: Vec<String> = heat.chain(supply).collect();
    (!all.is_empty()).then(|| all.join("; "))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
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
        let found: Vec<_> = radios(dir.path()).into_iter().map(|r| (r.name, r.kind, r.blocked)).collect();
        let expected = [("phy0", "wlan", false), ("hci0", "bluetooth", true)];
        assert_eq!(found, expected.map(|(n, k, b)| (n.to_owned(), k.to_owned(), b)));
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
        let said = line(dir.path()).unwrap();
        assert_eq!(said, "cpu-thermal 61 C; AC on; BAT0 Discharging, 83 %");
        let empty = sys(&[]);
        assert_eq!((line(empty.path()), radios(empty.path())), (None, vec![]));
    }
}
