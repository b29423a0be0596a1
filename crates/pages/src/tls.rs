//! TLS for the pages, with the installation's own certificate.

/// Problem with a file, and its remedy.
pub type FileProblem = (String, String);

#[cfg(feature = "tls")]
mod with_rustls {
    use std::path::{Path, PathBuf};
    use std::sync::Arc;

    use tokio_rustls::rustls::client::WebPkiServerVerifier;
    use tokio_rustls::rustls::client::danger::ServerCertVerifier;
    use tokio_rustls::rustls::crypto::{CryptoProvider, ring};
    use tokio_rustls::rustls::pki_types::pem::PemObject;
    use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
    use tokio_rustls::rustls::{
        CertificateError, ClientConfig, Error, RootCertStore, ServerConfig,
    };
    use tokio_rustls::{TlsAcceptor, TlsConnector};

    use super::FileProblem;
    use wingd_base::regular_file::{MAX_FILE_BYTES, read_regular_file};

    fn crypto_provider() -> Arc<CryptoProvider> {
        Arc::new(ring::default_provider())
    }

    fn read_certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, FileProblem> {
        let remedy = "give a certificate in PEM; docs/operations/flights-to-the-desk.md shows how to make one";
        let bytes = read_regular_file(file, MAX_FILE_BYTES)
            .map_err(|error| (format!("cannot be read ({error})"), remedy.to_owned()))?;
        let read = CertificateDer::pem_slice_iter(&bytes).collect::<Result<Vec<_>, _>>();
        match read {
            Ok(all) if !all.is_empty() => Ok(all),
            Ok(_) => Err(("contains no certificate".to_owned(), remedy.to_owned())),
            Err(error) => Err((
                format!("cannot be read as a certificate ({error})"),
                remedy.to_owned(),
            )),
        }
    }

    /// Creates the server's TLS settings. The error names the file concerned.
    pub fn tls_acceptor(
        certificate: &Path,
        key: &Path,
    ) -> Result<TlsAcceptor, (PathBuf, FileProblem)> {
        let chain = read_certificates(certificate)
            .map_err(|complaint| (certificate.to_owned(), complaint))?;
        let key_problem = |problem: String| {
            let remedy =
                "give the certificate's private key in PEM, readable by the user that runs wingd";
            (key.to_owned(), (problem, remedy.to_owned()))
        };
        let bytes = read_regular_file(key, MAX_FILE_BYTES)
            .map_err(|error| key_problem(format!("cannot be read ({error})")))?;
        let key = PrivateKeyDer::from_pem_slice(&bytes);
        let key =
            key.map_err(|error| key_problem(format!("cannot be read as a private key ({error})")))?;
        let config = ServerConfig::builder_with_provider(crypto_provider())
            .with_safe_default_protocol_versions();
        let config = config
            .map_err(|error| key_problem(error.to_string()))?
            .with_no_client_auth();
        let config = config.with_single_cert(chain, key);
        let mut config = config
            .map_err(|error| key_problem(format!("does not match the certificate ({error})")))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(TlsAcceptor::from(Arc::new(config)))
    }

    /// Returns a sentence if a server's certificate is not valid now, with the dates.
    pub fn validity_warning(certificate: &Path) -> Option<String> {
        let chain = read_certificates(certificate).ok()?;
        let mut roots = RootCertStore::empty();
        roots.add(chain.last()?.clone()).ok()?;
        let verifier =
            WebPkiServerVerifier::builder_with_provider(Arc::new(roots), crypto_provider());
        // Its dates are checked before its issuer and its names, of which nothing is known here.
        let name = ServerName::try_from("localhost").ok()?;
        let verified = verifier.build().ok()?.verify_server_cert(
            chain.first()?,
            &[],
            &name,
            &[],
            UnixTime::now(),
        );
        let problem = validity_problem(&verified.err()?)?;
        Some(format!("{}: {problem}", certificate.display()))
    }

    /// Describes a certificate outside its period of validity, with the dates and the remedy.
    fn validity_problem(error: &Error) -> Option<String> {
        let date = |time: &UnixTime| {
            let stamp = jiff::Timestamp::from_second(i64::try_from(time.as_secs()).ok()?).ok()?;
            Some(stamp.to_string())
        };
        let (now, period, renewal) = match error {
            Error::InvalidCertificate(CertificateError::NotValidYetContext {
                time,
                not_before,
            }) => (
                time,
                format!("begins on {}", date(not_before)?),
                "make the certificate again",
            ),
            Error::InvalidCertificate(CertificateError::ExpiredContext { time, not_after }) => (
                time,
                format!("ended on {}", date(not_after)?),
                "renew the certificate",
            ),
            _ => return None,
        };
        Some(format!(
            "the certificate's validity {period}, and this machine's clock shows {}; correct the clock, or {renewal}",
            date(now)?
        ))
    }

    /// Describes an error of a TLS session that no further attempt removes, with its remedy; `None` for other errors.
    pub fn permanent_problem(error: &std::io::Error) -> Option<String> {
        let error = error.get_ref()?.downcast_ref::<Error>()?;
        if let Some(problem) = validity_problem(error) {
            return Some(problem);
        }
        match error {
            Error::InvalidCertificate(
                CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
            ) => Some(
                "the server's certificate is for another name or address; use the one that it was made for"
                    .to_owned(),
            ),
            Error::InvalidCertificate(other) => Some(format!(
                "the server presents another certificate than --certificate ({other}); give the server's"
            )),
            Error::InvalidMessage(_) => {
                Some("the server does not answer in TLS; give http:// without --certificate".to_owned())
            }
            _ => None,
        }
    }

    /// Creates the client's TLS settings: trusts only this certificate, or one that it signed.
    pub fn tls_connector(certificate: &Path) -> Result<TlsConnector, FileProblem> {
        let mut roots = RootCertStore::empty();
        for one in read_certificates(certificate)? {
            let remedy =
                || "give the server's own certificate, or the one that signed it".to_owned();
            roots
                .add(one)
                .map_err(|error| (format!("cannot be trusted ({error})"), remedy()))?;
        }
        let config = ClientConfig::builder_with_provider(crypto_provider())
            .with_safe_default_protocol_versions();
        let config = config.map_err(|error| (error.to_string(), String::new()))?;
        Ok(TlsConnector::from(Arc::new(
            config.with_root_certificates(roots).with_no_client_auth(),
        )))
    }
}

#[cfg(feature = "tls")]
pub use tokio_rustls::{TlsAcceptor, TlsConnector};
#[cfg(feature = "tls")]
pub use with_rustls::{permanent_problem, tls_acceptor, tls_connector, validity_warning};

#[cfg(not(feature = "tls"))]
mod without {
    use std::path::{Path, PathBuf};

    use super::FileProblem;

    /// Placeholder for the TLS server in a build without TLS.
    #[derive(Clone, Debug)]
    pub enum TlsAcceptor {}
    /// Placeholder for the TLS client in a build without TLS.
    #[derive(Clone, Debug)]
    pub enum TlsConnector {}

    fn missing_tls_problem() -> FileProblem {
        (
            "this wingd was built without TLS".to_owned(),
            "build it with the feature `tls`".to_owned(),
        )
    }

    /// Returns an error: this build has no TLS.
    pub fn tls_acceptor(
        certificate: &Path,
        _: &Path,
    ) -> Result<TlsAcceptor, (PathBuf, FileProblem)> {
        Err((certificate.to_owned(), missing_tls_problem()))
    }

    /// Returns nothing: this build has no TLS.
    pub fn validity_warning(_: &Path) -> Option<String> {
        None
    }

    /// Returns nothing: this build has no TLS.
    pub fn permanent_problem(_: &std::io::Error) -> Option<String> {
        None
    }

    /// Returns an error: this build has no TLS.
    pub fn tls_connector(_: &Path) -> Result<TlsConnector, FileProblem> {
        Err(missing_tls_problem())
    }
}

#[cfg(not(feature = "tls"))]
pub use without::{
    TlsAcceptor, TlsConnector, permanent_problem, tls_acceptor, tls_connector, validity_warning,
};
