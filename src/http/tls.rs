//! Pages come by TLS with the installation's own certificate.

/// What went wrong with a file, and the mend.
pub type Complaint = (String, String);

#[cfg(feature = "tls")]
mod with_rustls {
    use std::path::{Path, PathBuf};
    use std::sync::Arc;

    use tokio_rustls::rustls::crypto::{CryptoProvider, ring};
    use tokio_rustls::rustls::pki_types::pem::PemObject;
    use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
    use tokio_rustls::rustls::{ClientConfig, RootCertStore, ServerConfig};
    use tokio_rustls::{TlsAcceptor, TlsConnector};

    use super::Complaint;

    fn provider() -> Arc<CryptoProvider> {
        Arc::new(ring::default_provider())
    }

    fn certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, Complaint> {
        let mend = "give a certificate in PEM; docs/operations/flights-to-the-desk.md says how to make one";
        let read = CertificateDer::pem_file_iter(file).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        match read {
            Ok(all) if !all.is_empty() => Ok(all),
            Ok(_) => Err(("holds no certificate".to_owned(), mend.to_owned())),
            Err(error) => Err((format!("cannot be read as certificate ({error})"), mend.to_owned())),
        }
    }

    /// The server's side; the complaint comes with the file that it is of.
    pub fn acceptor(certificate: &Path, key: &Path) -> Result<TlsAcceptor, (PathBuf, Complaint)> {
        let chain = certificates(certificate).map_err(|complaint| (certificate.to_owned(), complaint))?;
        let of_key = |problem: String| {
            let mend = "give the certificate's private key in PEM, readable by the user that runs wingd";
            (key.to_owned(), (problem, mend.to_owned()))
        };
        let key = PrivateKeyDer::from_pem_file(key);
        let key = key.map_err(|error| of_key(format!("cannot be read as private key ({error})")))?;
        let config = ServerConfig::builder_with_provider(provider()).with_safe_default_protocol_versions();
        let config = config.map_err(|error| of_key(error.to_string()))?.with_no_client_auth();
        let config = config.with_single_cert(chain, key);
        let mut config = config.map_err(|error| of_key(format!("does not fit the certificate ({error})")))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(TlsAcceptor::from(Arc::new(config)))
    }

    /// The client's side: this certificate, or one that it signed, and no other.
    pub fn connector(certificate: &Path) -> Result<TlsConnector, Complaint> {
        let mut roots = RootCertStore::empty();
        for one in certificates(certificate)? {
            let mend = || "give the server's own certificate, or the one that signed it".to_owned();
            roots.add(one).map_err(|error| (format!("cannot be trusted ({error})"), mend()))?;
        }
        let config = ClientConfig::builder_with_provider(provider()).with_safe_default_protocol_versions();
        let config = config.map_err(|error| (error.to_string(), String::new()))?;
        Ok(TlsConnector::from(Arc::new(config.with_root_certificates(roots).with_no_client_auth())))
    }
}

#[cfg(feature = "tls")]
pub use tokio_rustls::{TlsAcceptor, TlsConnector};
#[cfg(feature = "tls")]
pub use with_rustls::{acceptor, connector};

#[cfg(not(feature = "tls"))]
mod without {
    use std::path::{Path, PathBuf};

    use super::Complaint;

    /// There is none in this build.
    #[derive(Clone, Debug)]
    pub enum TlsAcceptor {}
    /// There is none in this build.
    #[derive(Clone, Debug)]
    pub enum TlsConnector {}

    fn none() -> Complaint {
        ("this wingd was built without TLS".to_owned(), "build it with the feature tls".to_owned())
    }

    /// The server's side.
    pub fn acceptor(certificate: &Path, _: &Path) -> Result<TlsAcceptor, (PathBuf, Complaint)> {
        Err((certificate.to_owned(), none()))
    }

    /// The client's side.
    pub fn connector(_: &Path) -> Result<TlsConnector, Complaint> {
        Err(none())
    }
}

#[cfg(not(feature = "tls"))]
pub use without::{TlsAcceptor, TlsConnector, acceptor, connector};
