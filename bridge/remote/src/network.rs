//! The zenoh session: links, certificates, and who may do what.

use crate::config::{Network, Tls};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use zenoh::{Config, Session, Wait};

/// A peer that is silent for longer is gone, and its link is closed.
const LINK_LEASE: Duration = Duration::from_secs(2);
/// Longest attempt of a client to connect, and the pause after it.
const CONNECT: Duration = Duration::from_secs(1);
const RETRY: Duration = Duration::from_millis(200);
/// Time after which a command ends that has no link.
const GIVE_UP: Duration = Duration::from_secs(3);
/// Longest time that a message waits for the queue of a slow link before it is dropped, µs.
const DROP_AFTER_US: u64 = 100;
/// Longest time that an answer waits for the queue of a slow link before that is closed, µs. The
/// thread that waits may be one that receives from all links.
const CLOSE_AFTER_US: u64 = 200_000;
/// Limit on the bytes of one message: an answer has at most 48 KiB of text.
const MESSAGE_MAX: usize = 128 * 1024;

/// Every robot, in keys.
pub(crate) const FLEET: &str = "motord/*";

/// The keys of a robot.
#[derive(Debug, Clone)]
pub(crate) struct Keys(String);

impl Keys {
    pub(crate) fn of(robot: &str) -> Self {
        Self(format!("motord/{robot}"))
    }

    /// States, for all mirrors.
    pub(crate) fn state(&self) -> String {
        self.key("state")
    }

    /// Frames of mirrors that only measure.
    pub(crate) fn beat(&self) -> String {
        self.key("beat")
    }

    /// Setpoints.
    pub(crate) fn setpoint(&self) -> String {
        self.key("setpoint")
    }

    /// Samples of external IMUs.
    pub(crate) fn imu(&self) -> String {
        self.key("imu")
    }

    /// Frames of mirrors that want records.
    pub(crate) fn want(&self) -> String {
        self.key("want")
    }

    /// Records of each cycle, for the mirror with this session.
    pub(crate) fn record(&self, session: u64) -> String {
        self.key(&format!("record/{session:016x}"))
    }

    /// Records for all mirrors.
    fn records(&self) -> String {
        self.key("record/*")
    }

    /// Requests that change something.
    pub(crate) fn request(&self) -> String {
        self.key("request")
    }

    /// Requests that only read.
    pub(crate) fn ask(&self) -> String {
        self.key("ask")
    }

    /// Emergency stops.
    pub(crate) fn stop(&self) -> String {
        self.key("stop")
    }

    /// The summary of the robot, as JSON.
    pub(crate) fn status(&self) -> String {
        self.key("status")
    }

    /// Changes of its groups, as JSON.
    pub(crate) fn events(&self) -> String {
        self.key("events")
    }

    /// The daemon's latencies, as JSON.
    pub(crate) fn latency(&self) -> String {
        self.key("latency")
    }

    /// Counters and latencies of this side of the network.
    pub(crate) fn link(&self) -> String {
        self.key("link")
    }

    /// The token of a robot whose states are served.
    pub(crate) fn alive(&self) -> String {
        self.key("alive")
    }

    fn key(&self, name: &str) -> String {
        format!("{}/{name}", self.0)
    }
}

/// The reason why the network cannot be used, a sentence of zenoh.
#[derive(Debug, thiserror::Error)]
#[error("the network: {0}")]
pub(crate) struct NetworkError(String);

impl NetworkError {
    pub(crate) fn of(error: impl std::fmt::Display) -> Self {
        Self(error.to_string())
    }
}

/// Opens the session of `network`, and waits for its first link where it only connects. With
/// `served`, other computers may do with this robot what [`permissions`] says. `None` once `ends`
/// returns true.
pub(crate) fn open(
    network: &Network,
    served: Option<&Served<'_>>,
    ends: impl Fn() -> bool,
) -> Result<Option<Session>, NetworkError> {
    let mut has_reported = false;
    while !ends() {
        match zenoh::open(config(network, served)?).wait() {
            Ok(session) => return Ok(Some(session)),
            // Another attempt does not free a port.
            Err(error) if !network.listen.is_empty() => return Err(NetworkError::of(error)),
            Err(error) if !std::mem::replace(&mut has_reported, true) => {
                tracing::warn!("waits for the network: {error}");
            }
            Err(_) => {}
        }
        std::thread::sleep(RETRY);
    }
    Ok(None)
}

/// Opens the session for a command, and gives up after some seconds.
pub(crate) fn open_at_once(network: &Network) -> Result<Session, NetworkError> {
    let begun = Instant::now();
    let session = open(network, None, || begun.elapsed() > GIVE_UP)?;
    session.ok_or_else(|| NetworkError("no robot and no router is reached".to_owned()))
}

fn config(network: &Network, served: Option<&Served<'_>>) -> Result<Config, NetworkError> {
    let mut config = Config::default();
    for (key, value) in settings(network, served) {
        config
            .insert_json5(key, &value.to_string())
            .map_err(|error| NetworkError(format!("{key} = {value}: {error}")))?;
    }
    Ok(config)
}

/// A robot that is served, and the certificates that may claim it.
#[derive(Debug)]
pub(crate) struct Served<'a> {
    pub(crate) keys: &'a Keys,
    pub(crate) may_claim: &'a [String],
}

fn settings(network: &Network, served: Option<&Served<'_>>) -> Vec<(&'static str, Value)> {
    // A router connects its clients with everybody, but leaves peers to connect with each other.
    let mode = if network.listen.is_empty() { "client" } else { "peer" };
    let mut settings = vec![
        ("mode", json!(mode)),
        ("listen/endpoints", json!(network.listen)),
        ("connect/endpoints", json!(network.connect)),
        // A peer keeps trying in the background; a client is opened again.
        ("connect/timeout_ms", json!({"peer": -1, "client": CONNECT.as_millis() as u64})),
        ("connect/exit_on_failure", json!({"peer": false, "client": true})),
        ("connect/retry", json!({"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2})),
        // Robots and routers are named in the configuration, and nowhere else.
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/link/tx/lease", json!(LINK_LEASE.as_millis() as u64)),
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(DROP_AFTER_US)),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", json!(CLOSE_AFTER_US)),
        ("transport/link/rx/max_message_size", json!(MESSAGE_MAX)),
    ];
    if let Some(tls) = &network.tls {
        settings.push(("transport/link/tls", tls_settings(tls)));
        settings.push(("transport/link/protocols", json!(["tls", "quic"])));
    }
    if let Some(served) = served {
        settings.push(("access_control", permissions(served, network.tls.is_some())));
    }
    settings
}

/// Both sides show a certificate of the same authority.
fn tls_settings(tls: &Tls) -> Value {
    json!({
        "root_ca_certificate": tls.authority,
        "listen_certificate": tls.certificate,
        "listen_private_key": tls.key,
        "connect_certificate": tls.certificate,
        "connect_private_key": tls.key,
        "enable_mtls": true,
        // Public authorities are trusted as well: the name alone tells the robot from others.
        "verify_name_on_connect": true,
        "close_link_on_expiration": true,
    })
}

/// Returns the rights of other computers. The link of a sender refuses what is not listed.
///
/// | who | may |
/// |---|---|
/// | every certificate of the authority | receive states and records, read the description and telemetry, stop |
/// | a certificate in `may-claim` | also send setpoints, samples of IMUs and all other requests |
///
/// Without TLS there are no certificates: everybody who reaches the port may do everything.
fn permissions(served: &Served<'_>, has_certificates: bool) -> Value {
    let rules = rules(served.keys);
    let everybody = json!({"id": "everybody"});
    let claimers = json!({"id": "claimers", "cert_common_names": served.may_claim});
    let watching = json!({"rules": ["watch", "read", "beat", "robot"], "subjects": ["everybody"]});
    let claiming = |who: &str| json!({"rules": ["claim", "request"], "subjects": [who]});
    let (subjects, policies) = match (has_certificates, served.may_claim.is_empty()) {
        (false, _) => (json!([everybody]), json!([watching, claiming("everybody")])),
        (true, true) => (json!([everybody]), json!([watching])),
        (true, false) => (json!([everybody, claimers]), json!([watching, claiming("claimers")])),
    };
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}

/// Returns the rules that [`permissions`] gives to some or all.
fn rules(keys: &Keys) -> Value {
    let rule = |id: &str, flow: &str, messages: &[&str], keys: &[String]| json!({"id": id, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys});
    // A stop of the whole fleet names no robot.
    let read = [keys.ask(), keys.stop(), keys.link(), format!("{FLEET}/stop")];
    let from_robot = [
        keys.state(),
        keys.status(),
        keys.events(),
        keys.latency(),
        keys.alive(),
        keys.ask(),
        keys.stop(),
        keys.link(),
        keys.request(),
        keys.setpoint(),
        keys.imu(),
        keys.beat(),
        keys.want(),
        keys.records(),
    ];
    json!([
        rule(
            "watch",
            "ingress",
            &["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"],
            &["motord/**".to_owned()]
        ),
        rule("read", "ingress", &["query"], &read),
        rule("beat", "ingress", &["put"], &[keys.beat(), keys.want()]),
        rule(
            "robot",
            "egress",
            &["put", "reply", "declare_subscriber", "declare_queryable", "liveliness_token"],
            &from_robot
        ),
        rule("claim", "ingress", &["put"], &[keys.setpoint(), keys.imu()]),
        rule("request", "ingress", &["query"], &[keys.request()]),
    ])
}
