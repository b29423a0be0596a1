//! Assignment of frames to mountings of the camera: `image,mounting`.

use std::collections::BTreeMap;
use std::path::Path;

use super::Reader;
use crate::installation::read_table;
use wingd_base::fault::Fault;
use wingd_measure::adjust::Mounting;

const COLUMNS: [&str; 2] = ["image", "mounting"];
/// Name of the mounting of the ground frames.
const GROUND_MOUNTING: &str = "ground";

/// Mountings of frames, by the frames' names in results.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Mountings {
    by_image: BTreeMap<String, Mounting>,
}

impl Mountings {
    /// Returns a frame's mounting; its name may have more or less of the path than that in the file.
    pub fn find(&self, image: &str) -> Option<Mounting> {
        let ends = |long: &str, short: &str| {
            long.strip_suffix(short)
                .is_some_and(|rest| rest.is_empty() || rest.ends_with('/'))
        };
        let matches = |name: &&String| ends(name, image) || ends(image, name);
        let mut found = self.by_image.iter().filter(|(name, _)| matches(name));
        match (self.by_image.get(image), found.next(), found.next()) {
            (Some(mounting), ..) | (None, Some((_, mounting)), None) => Some(*mounting),
            _ => None,
        }
    }
}

/// Reads the mounting of each frame. `ground` is the mounting of the ground frames: the camera was not removed.
pub fn read_mountings(file: &Path) -> Result<Mountings, Vec<Fault>> {
    Reader::read_file(file, parse_mountings)
}

fn parse_mountings(reader: &mut Reader, name: &Path) -> Option<Mountings> {
    let (_, lines) = read_table(
        reader,
        name,
        "name a file with the columns image,mounting",
        COLUMNS,
        &[],
    )?;
    let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
    let mut mountings = Mountings::default();
    for line in lines {
        let [image, mounting] = &line.cells;
        if image.is_empty() || mounting.is_empty() {
            let remedy = "give every frame the name of its mounting, ground if the camera was not removed since the ground frames";
            line.fault(reader, "has an empty cell", remedy);
            continue;
        }
        if mounting != GROUND_MOUNTING && mounting.eq_ignore_ascii_case(GROUND_MOUNTING) {
            let remedy = "write ground in lower case, or give this mounting another name";
            line.cell_fault(reader, 1, format!("is \"{mounting}\""), remedy);
        }
        let next = numbers.len();
        let assigned = match mounting.as_str() {
            GROUND_MOUNTING => Mounting::Ground,
            _ => Mounting::Numbered(*numbers.entry(mounting.clone()).or_insert(next)),
        };
        if mountings.by_image.insert(image.clone(), assigned).is_some() {
            line.cell_fault(
                reader,
                0,
                format!("\"{image}\" occurs twice"),
                "keep one line per frame",
            );
        }
    }
    Some(mountings)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn mountings(text: &str) -> Result<Mountings, Vec<Fault>> {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("mountings.csv");
        std::fs::write(&file, text).unwrap();
        read_mountings(&file)
    }

    #[test]
    fn frames_are_found_by_any_part_of_their_path() {
        let read =
            mountings("image,mounting\na/1.jpg,x\nb/1.jpg,y\n2.jpg,ground\nc/3.jpg,x\n").unwrap();
        assert_eq!(read.find("a/1.jpg"), Some(Mounting::Numbered(0)));
        assert_eq!(read.find("flights/b/1.jpg"), Some(Mounting::Numbered(1)));
        assert_eq!(read.find("1.jpg"), None, "two have that name");
        assert_eq!(read.find("a/2.jpg"), Some(Mounting::Ground));
        assert_eq!(read.find("3.jpg"), Some(Mounting::Numbered(0)));
        assert_eq!(read.find("13.jpg"), None);
    }

    #[test]
    fn a_duplicate_frame_and_an_empty_cell_are_named() {
        let faults = mountings("image,mounting\n1.jpg,x\n1.jpg,y\n2.jpg,\n").unwrap_err();
        let capital = mountings("image,mounting\n1.jpg,Ground\n").unwrap_err();
        assert!(capital[0].problem.contains("Ground") && capital[0].remedy.contains("lower case"));
        assert_eq!(faults.len(), 2);
        assert!(faults[0].place.contains("line 3") && faults[1].place.contains("line 4"));
    }
}
