//! The section `[web]` of the configuration, and the rules which addresses may be served how.

use serde::Deserialize;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

/// Limit on configured names.
const NAMES_MAX: usize = 32;

/// The page and its requests.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Web {
    pub(crate) enabled: bool,
    /// The address on which the page is served.
    pub(crate) address: IpAddr,
    pub(crate) port: u16,
    /// Further names of this computer that a browser may use: `host` or `host:port`.
    pub(crate) names: Vec<String>,
    /// Lines of a person's name and token.
    pub(crate) token_file: Option<PathBuf>,
    /// PEM, the server's certificate first.
    pub(crate) tls_certificate: Option<PathBuf>,
    /// PEM.
    pub(crate) tls_key: Option<PathBuf>,
    /// A reverse proxy with TLS passes the requests on.
    pub(crate) behind_proxy: bool,
}

impl Default for Web {
    fn default() -> Self {
        Self {
            enabled: false,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            port: 8642,
            names: Vec::new(),
            token_file: None,
            tls_certificate: None,
            tls_key: None,
            behind_proxy: false,
        }
    }
}

impl Web {
    /// Returns `true` if other computers may reach the page.
    fn is_exposed(&self) -> bool {
        !self.address.is_loopback() || self.behind_proxy || !self.names.is_empty()
    }

    /// Returns `true` if the bridge itself encrypts.
    pub(crate) fn has_tls(&self) -> bool {
        self.tls_certificate.is_some()
    }

    /// Checks an enabled page. The error is a sentence that says what to do.
    pub(crate) fn check(&self) -> Result<(), String> {
        if !self.enabled {
            return Ok(());
        }
        let address = self.address;
        if self.port == 0 {
            return Err("web.port: 0 is not allowed; set a port from 1 to 65535".to_owned());
        }
        if self.tls_certificate.is_some() != self.tls_key.is_some() {
            return Err("web.tls-certificate and web.tls-key belong together: set both, or none".to_owned());
        }
        if self.is_exposed() && self.token_file.is_none() {
            return Err(format!(
                "[web] lets other computers reach the page ({address}, names or behind-proxy): set web.token-file \
                 (docs/phone.md), or use address = \"127.0.0.1\" without names and behind-proxy"
            ));
        }
        if !address.is_loopback() && !self.has_tls() && !self.behind_proxy {
            return Err(format!(
                "web.address {address} would carry tokens unencrypted: set web.tls-certificate and web.tls-key, or set \
                 behind-proxy = true and let a reverse proxy with TLS pass the requests on (docs/phone.md)"
            ));
        }
        if address.is_unspecified() && self.names.is_empty() {
            return Err(format!(
                "web.address {address} stands for every address of this computer: list in web.names those that \
                 browsers use, such as names = [\"robot.local\", \"192.168.1.5\"]"
            ));
        }
        self.check_names()
    }

    fn check_names(&self) -> Result<(), String> {
        if self.names.len() > NAMES_MAX {
            return Err(format!("web.names has {} names; at most {NAMES_MAX} are allowed", self.names.len()));
        }
        let is_name =
            |name: &&String| !name.contains('@') && name.parse::<hyper::http::uri::Authority>().is_ok();
        match self.names.iter().find(|name| !is_name(name)) {
            Some(name) => Err(format!(
                "web.names: {name:?} is no host; write \"robot.local\", \"192.168.1.5\" or \"robot.local:8443\""
            )),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(text: &str) -> Result<(), String> {
        toml::from_str::<Web>(&format!("enabled = true\n{text}")).unwrap().check()
    }

    fn error(text: &str) -> String {
        outcome(text).unwrap_err()
    }

    #[test]
    fn loopback_needs_no_token() {
        assert_eq!(outcome(""), Ok(()));
        assert_eq!(outcome("address = \"::1\""), Ok(()));
    }

    #[test]
    fn other_address_needs_token_and_encryption() {
        let address = "address = \"192.168.1.5\"\n";
        let token = "token-file = \"tokens\"\n";
        assert!(error(address).contains("token-file"));
        assert!(error(&format!("{address}{token}")).contains("behind-proxy = true"));
        let tls = "tls-certificate = \"a\"\ntls-key = \"b\"\n";
        assert!(error(&format!("{address}{tls}")).contains("token-file"));
        assert_eq!(outcome(&format!("{address}{token}{tls}")), Ok(()));
        assert_eq!(outcome(&format!("{address}{token}behind-proxy = true")), Ok(()));
    }

    #[test]
    fn proxy_and_names_need_a_token() {
        assert!(error("behind-proxy = true").contains("token-file"));
        assert!(error("names = [\"robot.local\"]").contains("token-file"));
    }

    #[test]
    fn certificate_needs_its_key() {
        assert!(error("tls-certificate = \"a\"").contains("web.tls-key"));
        assert!(error("tls-key = \"a\"").contains("web.tls-certificate"));
    }

    #[test]
    fn every_address_needs_names() {
        let all = "address = \"0.0.0.0\"\ntoken-file = \"t\"\nbehind-proxy = true\n";
        assert!(error(all).contains("web.names"));
        assert_eq!(outcome(&format!("{all}names = [\"robot.local:443\"]")), Ok(()));
    }

    #[test]
    fn invalid_name_is_refused_by_name() {
        for name in ["https://robot", "a b", "", "user@robot"] {
            let text = error(&format!("token-file = \"t\"\nnames = [\"{name}\"]"));
            assert!(text.contains(&format!("{name:?}")), "{text}");
        }
    }

    #[test]
    fn disabled_page_is_not_checked() {
        let web: Web = toml::from_str("address = \"0.0.0.0\"").unwrap();
        assert_eq!(web.check(), Ok(()));
    }
}
