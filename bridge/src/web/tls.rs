//! The certificate of the page.

use crate::web::token::read_secret;
use std::path::Path;
use std::sync::Arc;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{Error, ServerConfig};

pub(crate) use tokio_rustls::TlsAcceptor;

/// Limit on a file, bytes.
const FILE_MAX: u64 = 256 * 1024;

/// Reads certificate and key. The error is a sentence that says what to do.
pub(crate) fn acceptor(certificate: &Path, key: &Path) -> Result<TlsAcceptor, String> {
    let chain = std::fs::read(certificate)
        .map_err(|error| format!("cannot read {}: {error}", certificate.display()))?;
    let chain: Vec<_> = CertificateDer::pem_slice_iter(&chain)
        .collect::<Result<_, _>>()
        .map_err(|error| format!("{}: no certificates in PEM: {error}", certificate.display()))?;
    if chain.is_empty() {
        return Err(format!("{}: no certificate in PEM", certificate.display()));
    }
    let secret = PrivateKeyDer::from_pem_slice(&read_secret(key, FILE_MAX)?)
        .map_err(|error| format!("{}: no private key in PEM: {error}", key.display()))?;
    let unfit = |error: Error| format!("{} does not fit {}: {error}", key.display(), certificate.display());
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(unfit)?
        .with_no_client_auth()
        .with_single_cert(chain, secret)
        .map_err(unfit)?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_certificate_is_named() {
        let error = acceptor(Path::new("/nonexistent"), Path::new("/nonexistent")).err().unwrap();
        assert!(error.contains("/nonexistent"), "{error}");
        let error = acceptor(Path::new("/dev/null"), Path::new("/dev/null")).err().unwrap();
        assert!(error.contains("no certificate"), "{error}");
    }
}
