//! The DDS domain and the addresses, from the configuration and the variables of ROS 2.

use crate::config::{DOMAIN_MAX, Range, Ros2};

/// Where to exchange messages.
#[derive(Debug, PartialEq)]
pub(crate) struct Network {
    pub(crate) domain: u16,
    pub(crate) range: Range,
    /// Variables of ROS 2 that the bridge does not honour.
    pub(crate) warnings: Vec<String>,
}

/// The reason why a variable cannot be honoured.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(crate) enum NetworkError {
    #[error("ROS_DOMAIN_ID is {0:?}; it must be from 0 to {DOMAIN_MAX}, or set domain-id in [ros2]")]
    Domain(String),
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: the bridge would reach no node; unset it, or set discovery-range in [ros2]"
    )]
    Off,
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE is {0:?}; it must be SUBNET, LOCALHOST or SYSTEM_DEFAULT, or set discovery-range in [ros2]"
    )]
    Range(String),
}

impl Network {
    /// Returns the network of the configuration; `variable` reads one of the environment.
    pub(crate) fn of(ros2: &Ros2, variable: impl Fn(&str) -> Option<String>) -> Result<Self, NetworkError> {
        let variable = |name: &str| variable(name).filter(|value| !value.is_empty());
        let mut warnings = Vec::new();
        let domain = match (ros2.domain_id, variable("ROS_DOMAIN_ID")) {
            (Some(domain), _) => domain,
            (None, None) => 0,
            (None, Some(text)) => {
                let number = text.parse().ok().filter(|number| *number <= DOMAIN_MAX);
                number.ok_or(NetworkError::Domain(text))?
            }
        };
        let only_localhost = variable("ROS_LOCALHOST_ONLY").is_some_and(|value| value != "0");
        let range = match (ros2.discovery_range, only_localhost) {
            (Some(range), _) => range,
            (None, true) => Range::Localhost,
            (None, false) => range_of(variable("ROS_AUTOMATIC_DISCOVERY_RANGE"), &mut warnings)?,
        };
        if variable("ROS_STATIC_PEERS").is_some() && !only_localhost {
            warnings.push(
                "ROS_STATIC_PEERS is set: the bridge finds peers by multicast and on this computer only"
                    .to_owned(),
            );
        }
        if let Some(rmw) = variable("RMW_IMPLEMENTATION").filter(|rmw| rmw.contains("zenoh")) {
            warnings
                .push(format!("RMW_IMPLEMENTATION is {rmw}: the bridge speaks DDS, which its nodes do not"));
        }
        for name in ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "CYCLONEDDS_URI"] {
            if variable(name).is_some() {
                warnings.push(format!("{name} is set: the bridge does not read it"));
            }
        }
        if variable("ROS_SECURITY_ENABLE").is_some_and(|value| value == "true") {
            warnings.push(
                "ROS_SECURITY_ENABLE is true: the bridge does not encrypt, and secured nodes ignore it"
                    .to_owned(),
            );
        }
        if range == Range::Localhost {
            warnings.push(
                "discovery is limited to 127.0.0.1, but the UDP ports accept packets from every interface: the systemd unit \
                 denies them (IPAddressDeny=any), otherwise use a firewall"
                    .to_owned(),
            );
        }
        Ok(Self { domain, range, warnings })
    }
}

fn range_of(value: Option<String>, warnings: &mut Vec<String>) -> Result<Range, NetworkError> {
    match value.as_deref() {
        None => Ok(Range::Localhost),
        Some("LOCALHOST") => Ok(Range::Localhost),
        Some("SUBNET") => Ok(Range::Subnet),
        Some("SYSTEM_DEFAULT") => {
            warnings.push(
                "ROS_AUTOMATIC_DISCOVERY_RANGE is SYSTEM_DEFAULT: the bridge uses every interface".to_owned(),
            );
            Ok(Range::Subnet)
        }
        Some("OFF") => Err(NetworkError::Off),
        Some(other) => Err(NetworkError::Range(other.to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(ros2: &Ros2, variables: &[(&str, &str)]) -> Result<Network, NetworkError> {
        let value = |name: &str| {
            variables.iter().find(|(known, _)| *known == name).map(|(_, value)| value.to_string())
        };
        Network::of(ros2, value)
    }

    fn domain_and_range(variables: &[(&str, &str)]) -> Result<(u16, Range), NetworkError> {
        network(&Ros2::default(), variables).map(|network| (network.domain, network.range))
    }

    #[test]
    fn variables_of_ros_2_are_honoured() {
        assert_eq!(domain_and_range(&[]), Ok((0, Range::Localhost)));
        assert_eq!(domain_and_range(&[("ROS_DOMAIN_ID", "42")]), Ok((42, Range::Localhost)));
        let subnet = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET");
        assert_eq!(domain_and_range(&[subnet]), Ok((0, Range::Subnet)));
        assert_eq!(domain_and_range(&[subnet, ("ROS_LOCALHOST_ONLY", "1")]), Ok((0, Range::Localhost)));
    }

    #[test]
    fn configuration_precedes_the_variables() {
        let ros2 = Ros2 { domain_id: Some(7), discovery_range: Some(Range::Subnet), ..Ros2::default() };
        let network =
            network(&ros2, &[("ROS_DOMAIN_ID", "x"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]).unwrap();
        assert_eq!((network.domain, network.range), (7, Range::Subnet));
    }

    #[test]
    fn what_cannot_be_honoured_is_an_error() {
        assert!(matches!(domain_and_range(&[("ROS_DOMAIN_ID", "233")]), Err(NetworkError::Domain(_))));
        assert_eq!(domain_and_range(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]), Err(NetworkError::Off));
        let unknown = [("ROS_AUTOMATIC_DISCOVERY_RANGE", "LAN")];
        assert!(matches!(domain_and_range(&unknown), Err(NetworkError::Range(_))));
    }

    #[test]
    fn ignored_variables_are_warned_of() {
        let variables = [
            ("ROS_STATIC_PEERS", "10.0.0.1"),
            ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
            ("CYCLONEDDS_URI", "x"),
        ];
        let warnings = network(&Ros2::default(), &variables).unwrap().warnings.join("\n");
        assert!(variables.iter().all(|(name, _)| warnings.contains(name)), "{warnings}");
    }
}
