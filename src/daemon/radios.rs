//! Radio transmitters of the machine, as the kernel shows them under `/sys`: in the cabin they are off.

use std::path::{Path, PathBuf};

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

fn read_attribute(folder: &Path, file: &str) -> Option<String> {
    std::fs::read_to_string(folder.join(file))
        .ok()
        .map(|text| text.trim().to_owned())
}

/// Lists the transmitters that the kernel can block.
pub fn list_radios(sys: &Path) -> Vec<Radio> {
    let radio = |folder: &PathBuf| {
        let is = |file: &str| read_attribute(folder, file).as_deref() == Some("1");
        let blocked = is("soft") || is("hard");
        Some(Radio {
            name: read_attribute(folder, "name")?,
            kind: read_attribute(folder, "type")?,
            blocked,
        })
    };
    let entries = std::fs::read_dir(sys.join("class/rfkill"));
    let mut folders: Vec<PathBuf> = entries
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .collect();
    folders.sort();
    folders.iter().filter_map(radio).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_radio_is_blocked_by_either_switch() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(list_radios(dir.path()), []);
        for (folder, values) in [
            ("rfkill0", ["phy0", "wlan", "0", "0"]),
            ("rfkill1", ["hci0", "bluetooth", "1", "0"]),
        ] {
            let path = dir.path().join("class/rfkill").join(folder);
            std::fs::create_dir_all(&path).unwrap();
            for (file, text) in ["name", "type", "soft", "hard"].iter().zip(values) {
                std::fs::write(path.join(file), format!("{text}\n")).unwrap();
            }
        }
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
}
