//! Which mounting of the camera each frame belongs to: `image,mounting`.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Fault, Reader, rows};
use crate::measure::adjust::Mounting;

const COLUMNS: [&str; 2] = ["image", "mounting"];
/// The name of the mounting that the ground frames were taken with.
const OF_THE_GROUND: &str = "ground";

/// The mountings of frames, by the frames' names as they stand in results.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Mountings {
    of: BTreeMap<String, Mounting>,
}

impl Mountings {
    /// A frame's mounting; its name may have more or less of the path than the file's.
    pub fn of(&self, image: &str) -> Option<Mounting> {
        let ends = |long: &str, short: &str| {
            long.strip_suffix(short).is_some_and(|rest| rest.is_empty() || rest.ends_with('/'))
        };
        let like = |name: &&String| ends(name, image) || ends(image, name);
        let mut found = self.of.iter().filter(|(name, _)| like(name));
        match (self.of.get(image), found.next(), found.next()) {
            (Some(mounting), ..) | (None, Some((_, mounting)), None) => Some(*mounting),
            _ => None,
        }
    }
}

/// Reads which frame belongs to which mounting. `ground` names that of the ground frames: the camera stayed.
pub fn read_mountings(file: &Path) -> Result<Mountings, Vec<Fault>> {
    let (mut reader, name) = Reader::of_file(file);
    let found = read(&mut reader, &name);
    found.filter(|_| reader.faults.is_empty()).ok_or_else(|| super::folded(reader.faults))
}

fn read(reader: &mut Reader, name: &Path) -> Option<Mountings> {
    let (file, text) = reader.text(name, "name a file with the columns image,mounting")?;
    let lines = rows::read(reader, &file, &text, COLUMNS, &[])?;
    let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
    let mut mountings = Mountings::default();
    for (line, [image, mounting]) in lines {
        if image.is_empty() || mounting.is_empty() {
            let mend =
                "give every frame the name of its mounting, ground where the camera stayed as on ground";
            reader.fault(&file, &format!("line {line}"), "has an empty cell", mend);
            continue;
        }
        if mounting != OF_THE_GROUND && mounting.eq_ignore_ascii_case(OF_THE_GROUND) {
            let place = format!("line {line}, column mounting");
            let mend = "write ground in small letters, or give another mounting another name";
            reader.fault(&file, &place, format!("is \"{mounting}\""), mend);
        }
        let next = numbers.len();
        let of = match mounting.as_str() {
            OF_THE_GROUND => Mounting::OfTheGround,
            _ => Mounting::Numbered(*numbers.entry(mounting).or_insert(next)),
        };
        if mountings.of.insert(image.clone(), of).is_some() {
            let place = format!("line {line}, column image");
            reader.fault(&file, &place, format!("\"{image}\" stands twice"), "keep one line per frame");
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
    fn frames_are_found_by_as_much_of_their_path_as_is_given() {
        let read = mountings("image,mounting\na/1.jpg,x\nb/1.jpg,y\n2.jpg,ground\nc/3.jpg,x\n").unwrap();
        assert_eq!(read.of("a/1.jpg"), Some(Mounting::Numbered(0)));
        assert_eq!(read.of("flights/b/1.jpg"), Some(Mounting::Numbered(1)));
        assert_eq!(read.of("1.jpg"), None, "two have that name");
        assert_eq!(read.of("a/2.jpg"), Some(Mounting::OfTheGround));
        assert_eq!(read.of("3.jpg"), Some(Mounting::Numbered(0)));
        assert_eq!(read.of("13.jpg"), None);
    }

    #[test]
    fn a_frame_that_stands_twice_and_an_empty_cell_are_named() {
        let faults = mountings("image,mounting\n1.jpg,x\n1.jpg,y\n2.jpg,\n").unwrap_err();
        let capital = mountings("image,mounting\n1.jpg,Ground\n").unwrap_err();
        assert!(capital[0].problem.contains("Ground") && capital[0].remedy.contains("small letters"));
        assert_eq!(faults.len(), 2);
        assert!(faults[0].place.contains("line 3") && faults[1].place.contains("line 4"));
    }
}
