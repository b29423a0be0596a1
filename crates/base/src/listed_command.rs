//! List of the commands by purpose, with their examples.

/// Purpose of a command, in the order of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Preparation of an aircraft.
    Prepare,
    /// Recording in flight.
    Record,
    /// Evaluation of images and flights.
    Evaluate,
    /// Store and transfer.
    Transfer,
    /// Demonstration, simulation and help for the shell.
    Utility,
    /// Not listed.
    Hidden,
}

impl Group {
    /// Listed groups with their headings.
    pub const HEADINGS: [(Self, &'static str); 5] = [
        (Self::Prepare, "Prepare an aircraft"),
        (Self::Record, "Record in flight"),
        (Self::Evaluate, "Evaluate"),
        (Self::Transfer, "Store and transfer"),
        (Self::Utility, "Demo and utilities"),
    ];
}

/// Command as the help lists it.
#[derive(Clone, Copy, Debug)]
pub struct ListedCommand {
    /// Name in the source.
    pub identifier: &'static str,
    pub group: Group,
    /// Command lines; a test runs them in the folder that the tutorial creates (docs/tutorial.md).
    pub examples: &'static [&'static str],
}

impl ListedCommand {
    /// Returns the name on the command line: lower case with hyphens.
    pub fn name(&self) -> String {
        let mut name = String::new();
        for c in self.identifier.chars() {
            if c.is_ascii_uppercase() && !name.is_empty() {
                name.push('-');
            }
            name.push(c.to_ascii_lowercase());
        }
        name
    }
}
