//! The host names under which the metrics are served.
//!
//! A page of another site can direct its own name to a loopback address (DNS rebinding), and read
//! the answers that a browser on this computer gets from there. The browser sends that name, so only known
//! names are answered.

use http::uri::Authority;
use std::net::{IpAddr, Ipv6Addr};

/// The names that are served: those of the loopback interface, and configured ones.
#[derive(Debug, Clone, Default)]
pub(crate) struct Hosts(Vec<String>);

impl Hosts {
    /// Serves the `names` too.
    pub(crate) fn new(names: Vec<String>) -> Self {
        Self(names)
    }

    /// Returns whether `authority`, a name with or without a port, is served. The port is not
    /// checked.
    pub(crate) fn has(&self, authority: &str) -> bool {
        // RFC 9110 permits no user in the field.
        let Some(authority) = authority.parse::<Authority>().ok().filter(|_| !authority.contains('@')) else {
            return false;
        };
        let host = authority.host();
        let is = |name: &str| host.eq_ignore_ascii_case(name);
        is("localhost") || is_loopback(host) || self.0.iter().any(|name| is(name))
    }
}

fn is_loopback(host: &str) -> bool {
    let version6 = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    match version6 {
        Some(address) => address.parse() == Ok(Ipv6Addr::LOCALHOST),
        None => host.parse().is_ok_and(|address: IpAddr| address.is_loopback()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_and_configured_names_are_served() {
        let hosts = Hosts::new(vec!["robot.lan".into()]);
        for served in
            ["localhost", "LocalHost:80", "127.0.0.1:9464", "127.255.0.1", "[::1]", "Robot.LAN:9464"]
        {
            assert!(hosts.has(served), "{served}");
        }
        let others = [
            "",
            ":80",
            "attacker.example",
            "localhost.attacker.example",
            "x@localhost",
            "10.0.0.1",
            "[::2]",
            "::1",
            "a b",
        ];
        for other in others {
            assert!(!hosts.has(other), "{other}");
        }
    }
}
