//! Memory that the service may use: the limits of its control group and of the machine.

use std::fs::read_to_string;
use std::path::Path;

/// Memory of the recorder apart from `ring_mb`, MB: decoding and solving live at 20 Hz, a report, the page's answers.
const BASE_MB: u64 = 250;
/// Unit files of the service and their overrides, in the order in which the service manager reads them.
const UNITS: [&str; 3] = [
    "usr/lib/systemd/system/wingd.service",
    "etc/systemd/system/wingd.service",
    "etc/systemd/system/wingd.service.d",
];

/// Returns the limit of this process, MB: the lowest of its control groups and of the machine's memory. `root` is `/`.
pub fn process_limit_mb(root: &Path) -> Option<u64> {
    let groups = read_to_string(root.join("proc/self/cgroup")).unwrap_or_default();
    let limits = groups.lines().filter_map(|line| {
        let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
        let (mount, file) = match controllers {
            "" => ("sys/fs/cgroup", "memory.max"),
            "memory" => ("sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            _ => return None,
        };
        let top = root.join(mount);
        let group = top.join(path.trim_start_matches('/'));
        let groups = group
            .ancestors()
            .take_while(|group| group.starts_with(&top));
        groups
            .filter_map(|group| {
                read_to_string(group.join(file))
                    .ok()?
                    .trim()
                    .parse::<u64>()
                    .ok()
            })
            .min()
    });
    limits
        .map(|bytes| bytes / 1_000_000)
        .chain(machine_memory_mb(root))
        .min()
}

fn machine_memory_mb(root: &Path) -> Option<u64> {
    let text = read_to_string(root.join("proc/meminfo")).ok()?;
    let kib: u64 = text
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:"))?
        .trim()
        .trim_end_matches(" kB")
        .parse()
        .ok()?;
    Some(kib * 1024 / 1_000_000)
}

/// Unit file of the service as it is installed.
const SHIPPED_UNIT: &str = include_str!("../../systemd/wingd.service");

/// Returns the limit that the installed unit files set for the service, or else the one that will be installed, MB: the last
/// `MemoryMax=` in megabytes.
fn unit_limit_mb(root: &Path) -> Option<u64> {
    let files = UNITS.iter().map(|unit| root.join(unit)).flat_map(|path| {
        let mut inside: Vec<_> = std::fs::read_dir(&path)
            .into_iter()
            .flatten()
            .flatten()
            .map(|e| e.path())
            .collect();
        inside.sort();
        if inside.is_empty() {
            vec![path]
        } else {
            inside
        }
    });
    let mut texts: Vec<String> = files.filter_map(|file| read_to_string(file).ok()).collect();
    if texts.is_empty() {
        texts.push(SHIPPED_UNIT.to_owned());
    }
    let mut values = texts
        .iter()
        .flat_map(|text| text.lines())
        .filter_map(|line| line.trim().strip_prefix("MemoryMax="));
    values.next_back()?.trim().strip_suffix('M')?.parse().ok()
}

/// Returns the limit of the service, MB: of this process, or of the service on this machine.
pub fn service_limit_mb(root: &Path) -> Option<u64> {
    process_limit_mb(root)
        .into_iter()
        .chain(unit_limit_mb(root))
        .min()
}

/// Returns the largest `ring_mb` that fits into a limit, MB.
pub fn largest_ring_mb(limit_mb: u64) -> u32 {
    u32::try_from(limit_mb.saturating_sub(BASE_MB)).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_limit_counts() {
        let dir = tempfile::tempdir().unwrap();
        let write = |file: &str, text: &str| {
            let path = dir.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        assert_eq!(service_limit_mb(dir.path()), Some(512), "not installed yet");
        write(
            "proc/meminfo",
            "MemTotal:        2000000 kB\nMemFree: 1 kB\n",
        );
        assert_eq!(process_limit_mb(dir.path()), Some(2048));
        write(
            "proc/self/cgroup",
            "1:name=systemd:/\n0::/system.slice/wingd.service\n",
        );
        write(
            "sys/fs/cgroup/system.slice/wingd.service/memory.max",
            "max\n",
        );
        write("sys/fs/cgroup/system.slice/memory.max", "1000000000\n");
        assert_eq!(process_limit_mb(dir.path()), Some(1000));
        write(
            "usr/lib/systemd/system/wingd.service",
            "[Service]\nMemoryMax=512M\n",
        );
        assert_eq!(service_limit_mb(dir.path()), Some(512));
        write(
            "etc/systemd/system/wingd.service.d/more.conf",
            "[Service]\nMemoryMax=900M\n",
        );
        assert_eq!(
            (service_limit_mb(dir.path()), largest_ring_mb(512)),
            (Some(900), 262)
        );
    }
}
