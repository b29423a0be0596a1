//! `[live.aircraft_data]` of the configuration: source of the lines, and the meaning of their fields.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use wingd_base::fault::KeyFault;
use wingd_evaluation::aircraft::{Layout, LineFormat, QuantityColumn};

/// `[live.aircraft_data]` of the configuration: source of the lines, and the meaning of their fields.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AircraftConfig {
    /// Local address and port that receive datagrams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub udp: Option<SocketAddr>,
    /// Addresses of the senders whose datagrams are recorded; empty: any sender.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub senders: Vec<IpAddr>,
    /// Server that sends lines, `host:port`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tcp: Option<String>,
    /// Time without a line after which the feed counts as dead and the server is called again.
    #[serde(
        default = "default_idle",
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required"
    )]
    pub idle: Duration,
    /// Lines to send to the server after connecting.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub subscribe: Vec<String>,
    /// Line format: `iwg1` or `text`.
    #[serde(default)]
    pub format: LineFormat,
    /// Required first field of text lines; other lines are recorded but not parsed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begins_with: Option<String>,
    /// Separator between the fields of text lines.
    #[serde(default = "default_separator")]
    pub separator: char,
    /// Field number of the time tag in text lines, from 1.
    #[serde(default = "default_time_field")]
    pub time_field: usize,
    /// Fields to use; for IWG1 the platform's own fields, from 34.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub column: Vec<QuantityColumn>,
}

fn is_host_and_port(server: &str) -> bool {
    let parts = server.rsplit_once(':');
    parts.is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
}

/// Default of `idle`: feeds send once per second, slow ones every ten seconds.
fn default_idle() -> Duration {
    Duration::from_secs(20)
}

fn default_separator() -> char {
    ','
}

fn default_time_field() -> usize {
    1
}

impl AircraftConfig {
    /// Returns every invalid setting, with its key in the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        let mut fault = |key: &str, problem: &str, remedy: &str| {
            faults.push(KeyFault::new(
                format!("live.aircraft_data.{key}"),
                problem,
                remedy,
            ));
        };
        match (&self.udp, &self.tcp) {
            (Some(_), Some(_)) => {
                fault("tcp", "is given together with udp", "remove one of the two")
            }
            (None, None) => fault(
                "udp",
                "is missing",
                "give udp = \"0.0.0.0:7071\" or tcp = \"host:port\"",
            ),
            (None, Some(server)) if !is_host_and_port(server) => {
                fault(
                    "tcp",
                    "is not host:port",
                    "write it as \"192.168.1.20:4711\"",
                );
            }
            _ => {}
        }
        if self.tcp.is_none() && !self.subscribe.is_empty() {
            fault(
                "subscribe",
                "is only for tcp",
                "remove it, or give tcp instead of udp",
            );
        }
        if self.udp.is_none() && !self.senders.is_empty() {
            fault(
                "senders",
                "is only for udp",
                "remove it, or give udp instead of tcp",
            );
        }
        if self.idle.is_zero() {
            fault("idle", "must be longer than 0", "give for example \"20s\"");
        }
        if self.time_field == 0 || self.column.iter().any(|c| c.field == 0) {
            fault(
                "column",
                "or time_field has a field number 0",
                "count fields from 1",
            );
        }
        if self.format == LineFormat::Text && self.column.is_empty() {
            fault(
                "column",
                "is missing",
                "give the quantity of each field of the text",
            );
        }
        if self.format == LineFormat::Iwg1 && self.column.iter().any(|c| c.field <= 2) {
            fault(
                "column",
                "uses IWG1's keyword or time field",
                "use the platform's own fields, from 34",
            );
        }
        if self
            .column
            .iter()
            .any(|c| !(c.scale.is_finite() && c.scale != 0.0 && c.offset.is_finite()))
        {
            fault(
                "column",
                "has a scale of 0, or a scale or offset that is not finite",
                "correct it",
            );
        }
        faults
    }

    /// Returns the layout of a line.
    pub fn layout(&self) -> Layout {
        match self.format {
            LineFormat::Iwg1 => Layout::iwg1(&self.column),
            LineFormat::Text => Layout {
                begins_with: self.begins_with.clone(),
                ..Layout::separated(self.separator, self.time_field, self.column.clone())
            },
        }
    }
}

#[cfg(test)]
mod tests {
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
        let expected = [
            "live.aircraft_data.tcp",
            "live.aircraft_data.column",
            "live.aircraft_data.column",
        ];
        assert_eq!(keys, expected, "{faults:?}");
        assert!(read("udp = '0.0.0.0:7071'\nprot = 1\n").is_err());
        assert!(read("tcp = ['a:4711', 'a:4712']\n").is_err());
        assert_eq!(
            read("tcp = 'a:4711x'\nidle = '0s'\n")
                .unwrap()
                .faults()
                .len(),
            2
        );
    }
}
