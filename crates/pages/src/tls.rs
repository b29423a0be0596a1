//! TLS for the pages, with the installation's own certificate.

/// Problem with a file, and its remedy.
pub type FileProblem = (String, String);

#[cfg(feature = "tls")]
mod with_rustls {
    use std::path::{Path, PathBuf};
    use std::sync::Arc;

    use tokio_rustls::rustls::crypto::{CryptoProvider, ring};
    use tokio_rustls::rustls::pki_types::pem::PemObject;
    use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
    use tokio_rustls::rustls::{ClientConfig, RootCertStore, ServerConfig};
    use tokio_rustls::{TlsAcceptor, TlsConnector};

    use super::FileProblem;

    fn crypto_provider() -> Arc<CryptoProvider> {
        Arc::new(ring::default_provider())
    }

    fn read_certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, FileProblem> {
        let remedy = "give a certificate in PEM; docs/operations/flights-to-the-desk.md shows how to make one";
        let read =
            CertificateDer::pem_file_iter(file).and_then(Iterator::collect::<Result<Vec<_>, _>>);
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
        let key = PrivateKeyDer::from_pem_file(key);
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
pub use with_rustls::{tls_acceptor, tls_connector};

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

    /// Returns an error: this build has no TLS.
    pub fn tls_connector(_: &Path) -> Result<TlsConnector, FileProblem> {
        Err(missing_tls_problem())
    }
}

#[cfg(not(feature = "tls"))]
pub use without::{TlsAcceptor, TlsConnector, tls_acceptor, tls_connector};
