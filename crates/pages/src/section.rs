//! Section `[serve]` of the configuration: address of the pages and access rules.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use serde::Deserialize;

use super::access::{self, Access};
use super::tls;
use wingd_base::fault::Fault;

/// Section `[serve]` of the configuration.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServeConfig {
    /// Address and port, `HOST:PORT`.
    pub listen: String,
    /// File with a token that every request must carry; required beyond the loopback interface.
    pub token_file: Option<PathBuf>,
    /// Names by which clients may address this machine, in addition to its IP addresses and localhost.
    #[serde(default)]
    pub hosts: Vec<String>,
    /// Certificate in PEM; with `key`, pages are served over TLS only.
    pub certificate: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    pub key: Option<PathBuf>,
}

impl ServeConfig {
    /// Returns the file paths of the section, to be made absolute.
    pub fn file_paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        [&mut self.token_file, &mut self.certificate, &mut self.key]
            .into_iter()
            .flatten()
    }

    /// Returns a sentence for each secret that every user of this machine can read, and for a certificate that is not valid
    /// now.
    pub fn warnings(&self) -> Vec<String> {
        let secrets = [&self.token_file, &self.key].into_iter().flatten();
        let exposed = secrets.filter_map(|file| access::exposure_warning(file));
        let certificate = self.certificate.as_deref().and_then(tls::validity_warning);
        exposed.chain(certificate).collect()
    }

    /// Resolves the listening address and the access rules, or returns every error. `place` gives file and location of a
    /// key.
    pub fn resolve(
        &self,
        place: impl Fn(&str) -> (PathBuf, String),
    ) -> Result<(SocketAddr, Access), Vec<Fault>> {
        let mut faults = Vec::new();
        let mut report = |key: &str, problem: String, remedy: String| {
            let (file, place) = place(key);
            faults.push(Fault::new(file, place, problem, remedy));
        };
        let address = resolve_address(&self.listen).map_err(|why| {
            report(
                "listen",
                format!("\"{}\": {why}", self.listen),
                "give HOST:PORT, for example 127.0.0.1:8080".into(),
            );
        });
        let token = self.token_file.as_deref().and_then(|file| {
            let read = access::read_token(file);
            read.map_err(|(problem, remedy)| {
                report(
                    "token_file",
                    format!("{} {problem}", file.display()),
                    remedy,
                )
            })
            .ok()
        });
        if self.token_file.is_none() && address.is_ok_and(|address| !address.ip().is_loopback()) {
            let problem = format!(
                "{}: everybody on that network could read the store",
                self.listen
            );
            report(
                "listen",
                problem,
                "add a token (token_file, --token-file FILE), or listen on 127.0.0.1".into(),
            );
        }
        let tls = match (&self.certificate, &self.key) {
            (Some(certificate), Some(key)) => tls::tls_acceptor(certificate, key)
                .map_err(|(file, (problem, remedy))| {
                    report(
                        "certificate",
                        format!("{} {problem}", file.display()),
                        remedy,
                    )
                })
                .ok(),
            (None, None) => None,
            _ => {
                let remedy = "give both or neither";
                report(
                    "certificate",
                    "certificate and key must be given together".into(),
                    remedy.into(),
                );
                None
            }
        };
        match address {
            Ok(address) if faults.is_empty() => Ok((
                address,
                Access::new(token.as_deref(), self.hosts.clone()).with_tls(tls),
            )),
            _ => Err(faults),
        }
    }
}

/// Resolves a name or IP address with a port. If there are several addresses, prefers IPv4, which every browser tries.
///
/// # Errors
/// Returns an error if the text is not `HOST:PORT` or the name cannot be resolved.
pub fn resolve_address(text: &str) -> Result<SocketAddr, ListenAddressError> {
    let all: Vec<SocketAddr> = text.to_socket_addrs()?.collect();
    let first = all.iter().find(|a| a.is_ipv4()).or(all.first());
    first.copied().ok_or(ListenAddressError::Unknown)
}

/// Error for a text that is not an address to listen on.
#[derive(Debug, thiserror::Error)]
pub enum ListenAddressError {
    /// The text is not a name with a port, or the name cannot be looked up.
    #[error(transparent)]
    Unreadable(#[from] std::io::Error),
    /// The name has no address.
    #[error("has no address")]
    Unknown,
}
