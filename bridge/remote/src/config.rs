//! The configuration file: what this computer serves, or which robot it mirrors.

use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The file that the commands read by default.
pub(crate) const DEFAULT_FILE: &str = "/etc/motord/remote.toml";
/// Longest name of a robot in the network.
const NAME_BYTES_MAX: usize = 64;
/// Highest rate of states.
const STATES_HZ_MAX: f64 = 2000.0;
/// Longest age of a frame that may be configured: a controller behind a slower network is none.
const AGE_MAX_MS: u32 = 500;

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConfigError {
    #[error("cannot read {path}: {error}")]
    Read { path: PathBuf, error: std::io::Error },
    #[error("{path}: {error}")]
    Parse { path: PathBuf, error: toml::de::Error },
    #[error("{path}: {0}", path = .1.display())]
    Value(String, PathBuf),
}

/// The configuration.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct Config {
    pub(crate) serve: Option<Serve>,
    pub(crate) mirror: Option<Mirror>,
    #[serde(default)]
    pub(crate) fleet: Fleet,
    pub(crate) network: Network,
}

/// The robot of this computer, for others.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct Serve {
    /// Name of the robot in the network.
    pub(crate) robot: String,
    /// Instance of motord.
    #[serde(default = "default_instance")]
    pub(crate) instance: String,
    /// States a second, at most the daemon's rate.
    #[serde(default = "default_states_hz")]
    pub(crate) states_hz: f64,
    /// A setpoint or request that may have been on its way for longer does not count.
    #[serde(default = "default_age_max_ms")]
    pub(crate) age_max_ms: u32,
    /// Common names of the certificates that may claim groups.
    #[serde(default)]
    pub(crate) may_claim: Vec<String>,
}

/// A robot of another computer, as an instance on this one.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct Mirror {
    /// Name of the robot in the network.
    pub(crate) robot: String,
    /// Instance under which programs of this computer find it.
    #[serde(default = "default_instance")]
    pub(crate) instance: String,
}

/// Robots for `motord-remote fleet`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct Fleet {
    /// Those that should be there.
    #[serde(default)]
    pub(crate) robots: Vec<String>,
}

/// The links.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct Network {
    /// Where this computer listens, such as `quic/192.168.7.2:7447?mixed_rel=1`.
    #[serde(default)]
    pub(crate) listen: Vec<String>,
    /// Robots and routers to connect to.
    #[serde(default)]
    pub(crate) connect: Vec<String>,
    /// Certificates. Without this table, `plaintext = true` is needed.
    pub(crate) tls: Option<Tls>,
    /// No certificates and no encryption: everybody who reaches a port may claim the robot.
    #[serde(default)]
    pub(crate) plaintext: bool,
}

/// Files of certificates, in PEM.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct Tls {
    /// Certificate of the authority that signed those of all computers.
    pub(crate) authority: PathBuf,
    pub(crate) certificate: PathBuf,
    pub(crate) key: PathBuf,
}

fn default_instance() -> String {
    motord_shared::DEFAULT_INSTANCE.to_owned()
}

const fn default_states_hz() -> f64 {
    500.0
}

const fn default_age_max_ms() -> u32 {
    50
}

impl Config {
    /// Reads and checks a file.
    pub(crate) fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| ConfigError::Read { path: path.to_owned(), error })?;
        let config: Self =
            toml::from_str(&text).map_err(|error| ConfigError::Parse { path: path.to_owned(), error })?;
        config.check().map_err(|fault| ConfigError::Value(fault, path.to_owned()))?;
        Ok(config)
    }

    fn check(&self) -> Result<(), String> {
        let Self { serve, mirror, fleet, network } = self;
        for robot in &fleet.robots {
            check_name("fleet", robot)?;
        }
        if let Some(serve) = serve {
            check_name("serve", &serve.robot)?;
            serve.check()?;
        }
        if let Some(mirror) = mirror {
            check_name("mirror", &mirror.robot)?;
        }
        if let (Some(serve), Some(mirror)) = (serve, mirror)
            && serve.instance == mirror.instance
        {
            return Err(format!(
                "[serve] and [mirror] both name the instance {}: give the mirrored robot another one",
                serve.instance
            ));
        }
        let may_claim = serve.as_ref().map_or(&[][..], |serve| &serve.may_claim);
        network.check(may_claim)
    }
}

impl Serve {
    pub(crate) fn age_max(&self) -> Duration {
        Duration::from_millis(self.age_max_ms.into())
    }

    fn check(&self) -> Result<(), String> {
        if !(self.states_hz > 0.0 && self.states_hz <= STATES_HZ_MAX) {
            return Err(format!(
                "[serve] states-hz = {}: it must be above 0, and at most 2000",
                self.states_hz
            ));
        }
        if !(1..=AGE_MAX_MS).contains(&self.age_max_ms) {
            return Err(format!("[serve] age-max-ms = {}: it must be 1 to {AGE_MAX_MS}", self.age_max_ms));
        }
        Ok(())
    }
}

impl Network {
    fn check(&self, may_claim: &[String]) -> Result<(), String> {
        match (&self.tls, self.plaintext) {
            (Some(_), true) => {
                return Err("[network] has certificates and plaintext = true: remove one".to_owned());
            }
            (None, false) => {
                return Err("[network] has no [network.tls]: name certificates, or set plaintext = true \
                    on a cable that nobody else reaches"
                    .to_owned());
            }
            (None, true) if !may_claim.is_empty() => {
                return Err("[serve] may-claim names certificates, which plaintext = true does not have: \
                    remove may-claim, and everybody who reaches the port may claim the robot"
                    .to_owned());
            }
            _ => {}
        }
        if self.listen.is_empty() && self.connect.is_empty() {
            return Err("[network] names no address: set listen, connect, or both".to_owned());
        }
        let secure = |address: &&String| !address.starts_with("tls/") && !address.starts_with("quic/");
        let plain = self.listen.iter().chain(&self.connect).find(secure);
        match plain.filter(|_| self.tls.is_some()) {
            Some(plain) => {
                Err(format!("[network] {plain}: with certificates an address begins with quic/ or tls/"))
            }
            None => Ok(()),
        }
    }
}

/// Names are parts of keys.
fn check_name(table: &str, name: &str) -> Result<(), String> {
    let is_sound = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    match (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(is_sound) {
        true => Ok(()),
        false => Err(format!(
            "[{table}] robot = {name:?}: it must be 1 to {NAME_BYTES_MAX} letters, digits, `-`, `_` and `.`"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CABLE: &str = "[network]\nplaintext = true\nlisten = [\"udp/127.0.0.1:7447\"]\n";
    const CERTIFICATES: &str = "[network.tls]\nauthority = \"ca\"\ncertificate = \"c\"\nkey = \"k\"\n";

    fn checked(text: &str) -> Result<Config, String> {
        let config: Config = toml::from_str(text).map_err(|error| error.to_string())?;
        config.check().map(|()| config)
    }

    #[test]
    fn defaults_are_those_of_the_page() {
        let config = checked(&format!("[serve]\nrobot = \"go7\"\n{CABLE}")).unwrap();
        let serve = config.serve.unwrap();
        assert_eq!((serve.instance.as_str(), serve.states_hz, serve.age_max_ms), ("robot", 500.0, 50));
        assert!(serve.may_claim.is_empty());
    }

    #[test]
    fn nothing_is_open_by_omission() {
        let refused = checked("[network]\nlisten = [\"tcp/127.0.0.1:1\"]\n").unwrap_err();
        assert!(refused.contains("plaintext"), "{refused}");
        let refused = checked("[network]\nplaintext = true\n").unwrap_err();
        assert!(refused.contains("no address"), "{refused}");
        let refused =
            checked(&format!("[network]\nlisten = [\"tcp/127.0.0.1:1\"]\n{CERTIFICATES}")).unwrap_err();
        assert!(refused.contains("quic/ or tls/"), "{refused}");
        let named = format!("[serve]\nrobot = \"a\"\nmay-claim = [\"nuc\"]\n{CABLE}");
        assert!(checked(&named).unwrap_err().contains("may-claim"));
        assert!(checked(&format!("{CABLE}{CERTIFICATES}")).unwrap_err().contains("remove one"));
    }

    #[test]
    fn values_outside_their_range_are_refused() {
        for line in ["states-hz = 0", "states-hz = nan", "age-max-ms = 0", "age-max-ms = 501", "other = 1"] {
            assert!(checked(&format!("[serve]\nrobot = \"a\"\n{line}\n{CABLE}")).is_err(), "{line}");
        }
        for name in ["", "a/b", "a*", "a b", &"x".repeat(65)] {
            assert!(checked(&format!("[serve]\nrobot = \"{name}\"\n{CABLE}")).is_err(), "{name}");
        }
    }

    #[test]
    fn one_instance_is_not_served_and_mirrored() {
        let text = format!("[serve]\nrobot = \"a\"\n[mirror]\nrobot = \"b\"\n{CABLE}");
        assert!(checked(&text).unwrap_err().contains("another one"));
        let other = text.replace("[mirror]", "[mirror]\ninstance = \"b\"");
        assert!(checked(&other).is_ok());
    }
}
