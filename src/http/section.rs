//! `[serve]` of the configuration says where the page is, and who gets in.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use serde::Deserialize;

use super::access::{self, Access};
use super::tls;
use crate::installation::Fault;

/// `[serve]`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServeConfig {
    /// Address and port.
    pub listen: String,
    /// A token that every request must bring; needed off the loopback.
    pub token_file: Option<PathBuf>,
    /// Names by which clients may call this machine, besides its addresses and localhost.
    #[serde(default)]
    pub hosts: Vec<String>,
    /// PEM; with `key`, pages come by TLS alone.
    pub certificate: Option<PathBuf>,
    /// PEM.
    pub key: Option<PathBuf>,
}

impl ServeConfig {
    /// The files it names.
    pub fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        [&mut self.token_file, &mut self.certificate, &mut self.key].into_iter().flatten()
    }

    /// Where to listen and by which rules; or every fault. `place` tells where a key stands.
    pub fn open(
        &self,
        place: impl Fn(&str) -> (PathBuf, String),
    ) -> Result<(SocketAddr, Access), Vec<Fault>> {
        let mut faults = Vec::new();
        let mut fault = |key: &str, problem: String, mend: String| {
            let (file, place) = place(key);
            faults.push(Fault::new(file, place, problem, mend));
        };
        let address = address(&self.listen).map_err(|why| {
            fault(
                "listen",
                format!("\"{}\": {why}", self.listen),
                "give HOST:PORT, for example 127.0.0.1:8080".into(),
            );
        });
        let token = self.token_file.as_deref().and_then(|file| {
            let read = access::read_token(file);
            read.map_err(|(what, mend)| fault("token_file", format!("{} {what}", file.display()), mend)).ok()
        });
        if self.token_file.is_none() && address.is_ok_and(|address| !address.ip().is_loopback()) {
            let what = format!("{}: everybody on that network could read the store", self.listen);
            fault(
                "listen",
                what,
                "add a token (token_file, --token-file FILE), or listen on 127.0.0.1".into(),
            );
        }
        let tls = match (&self.certificate, &self.key) {
            (Some(certificate), Some(key)) => tls::acceptor(certificate, key)
                .map_err(|(file, (what, mend))| {
                    fault("certificate", format!("{} {what}", file.display()), mend)
                })
                .ok(),
            (None, None) => None,
            _ => {
                let mend = "give both, or neither";
                fault("certificate", "certificate and key belong together".into(), mend.into());
                None
            }
        };
        match address {
            Ok(address) if faults.is_empty() => {
                Ok((address, Access::new(token.as_deref(), self.hosts.clone()).over_tls(tls)))
            }
            _ => Err(faults),
        }
    }
}

/// A name or number with a port; of several addresses an old-style one, which a browser tries in any case.
///
/// # Errors
/// Where it is none, or nobody knows the name.
pub fn address(text: &str) -> Result<SocketAddr, NoAddress> {
    let all: Vec<SocketAddr> = text.to_socket_addrs()?.collect();
    let first = all.iter().find(|a| a.is_ipv4()).or(all.first());
    first.copied().ok_or(NoAddress::Unknown)
}

/// Why a text is no address to listen on.
#[derive(Debug, thiserror::Error)]
pub enum NoAddress {
    /// It is no name with a port, or the name cannot be looked up.
    #[error(transparent)]
    Unreadable(#[from] std::io::Error),
    /// A name without one.
    #[error("has no address")]
    Unknown,
}
