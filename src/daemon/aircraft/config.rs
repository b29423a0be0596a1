//! `[live.aircraft_data]` of the configuration says where the lines come from, and what stands in them.

use std::net::SocketAddr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::aircraft::{Column, Kind, Layout};
use crate::installation::KeyFault;

/// `[live.aircraft_data]` of the configuration: where the lines come from, and what stands in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AircraftConfig {
    /// Datagrams to this address and port of ours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub udp: Option<SocketAddr>,
    /// Or a server that sends lines: `host:port`; of several the one that answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tcp: Option<Servers>,
    /// A feed that brings no line for so long is taken for dead: a server is called again.
    #[serde(default = "idle", with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub idle: Duration,
    /// Said to that server once it is connected, a line each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub subscribe: Vec<String>,
    /// `iwg1` or `text`.
    #[serde(default)]
    pub format: Kind,
    /// Of text: lines without this first field are recorded and not read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begins_with: Option<String>,
    /// Of text: between the fields.
    #[serde(default = "comma")]
    pub separator: char,
    /// Of text: the time tag's field, from 1.
    #[serde(default = "first")]
    pub time_field: usize,
    /// Fields that are taken; of IWG1 the platform's own, from 34.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub column: Vec<Column>,
}

/// One place, or several.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Servers {
    /// `"host:port"`.
    One(String),
    /// `["host:port", "host:port"]`, called in turn.
    InTurn(Vec<String>),
}

impl Servers {
    /// In the order in which they are called.
    pub fn places(&self) -> &[String] {
        match self {
            Self::One(place) => std::slice::from_ref(place),
            Self::InTurn(places) => places,
        }
    }

    fn are_places(&self) -> bool {
        let is_place = |place: &String| {
            place.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
        };
        !self.places().is_empty() && self.places().iter().all(is_place)
    }
}

/// Feeds send once a second, slow ones every ten.
fn idle() -> Duration {
    Duration::from_secs(20)
}

fn comma() -> char {
    ','
}

fn first() -> usize {
    1
}

impl AircraftConfig {
    /// Every fault, at its key of the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        let mut fault = |key: &str, problem: &str, mend: &str| {
            faults.push(KeyFault::new(format!("live.aircraft_data.{key}"), problem, mend));
        };
        match (&self.udp, &self.tcp) {
            (Some(_), Some(_)) => fault("tcp", "is given beside udp", "give one of the two"),
            (None, None) => fault("udp", "is missing", "give udp = \"0.0.0.0:7071\" or tcp = \"host:port\""),
            (None, Some(servers)) if !servers.are_places() => {
                fault("tcp", "is no host and port", "write it as \"192.168.1.20:4711\"");
            }
            _ => {}
        }
        if self.tcp.is_none() && !self.subscribe.is_empty() {
            fault("subscribe", "is for tcp", "leave it out with udp");
        }
        if self.idle.is_zero() {
            fault("idle", "must be longer than 0", "give for example \"20s\"");
        }
        if self.time_field == 0 || self.column.iter().any(|c| c.field == 0) {
            fault("column", "counts fields from 0", "count from 1");
        }
        if self.format == Kind::Text && self.column.is_empty() {
            fault("column", "is missing", "say which field of the text is which quantity");
        }
        if self.format == Kind::Iwg1 && self.column.iter().any(|c| c.field <= 2) {
            fault("column", "takes IWG1's keyword or time", "a platform's own fields begin at 34");
        }
        if self.column.iter().any(|c| !(c.scale.is_finite() && c.scale != 0.0 && c.offset.is_finite())) {
            fault("column", "has a scale of 0 or no number", "give finite numbers");
        }
        faults
    }

    /// Where the fields stand.
    pub fn layout(&self) -> Layout {
        match self.format {
            Kind::Iwg1 => Layout::iwg1(&self.column),
            Kind::Text => Layout {
                begins_with: self.begins_with.clone(),
                ..Layout::text(self.separator, self.time_field, self.column.clone())
            },
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let read = |text: &str| toml::from_str::<AircraftConfig>(text);
        let iwg1 = "udp = '0.0.0.0:7071'\n[[column]]\nfield = 34\nquantity = 'weight_kg'\n";
        let config = read(iwg1).unwrap();
        assert_eq!((config.faults(), config.layout().time_field), (vec![], 2));
        let text = "tcp = 'acars:4711'\nformat = 'text'\ntime_field = 2\nsubscribe = ['add,mach']\n[[column]]\nfield = 3\nquantity = 'mach'\n";
        assert_eq!(read(text).unwrap().faults(), []);
        let bad = "udp = '0.0.0.0:7071'\ntcp = 'nowhere'\nsubscribe = []\nformat = 'text'\ntime_field = 0\n";
        let faults = read(bad).unwrap().faults();
        let keys: Vec<&str> = faults.iter().map(|f| f.key.as_str()).collect();
        let expected = ["live.aircraft_data.tcp", "live.aircraft_data.column", "live.aircraft_data.column"];
        assert_eq!(keys, expected, "{faults:?}");
        assert!(read("udp = '0.0.0.0:7071'\nprot = 1\n").is_err());
        let two = read("tcp = ['a:4711', 'a:4712']\nidle = '60s'\n").unwrap();
        assert_eq!((two.faults(), two.tcp.unwrap().places().len(), two.idle.as_secs()), (vec![], 2, 60));
        assert_eq!(read("tcp = []\nidle = '0s'\n").unwrap().faults().len(), 2);
    }
}
