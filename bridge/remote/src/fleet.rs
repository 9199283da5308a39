//! Many robots: who is there, how they are, and their stop.

use crate::config::{Fleet, Network};
use crate::network::{self, FLEET, Keys, NetworkError};
use crate::receipt::Receipt;
use crate::summary::Summary;
use motord_terminal::printable;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use zenoh::pubsub::Subscriber;
use zenoh::query::QueryTarget;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

/// Two summaries and the time that a link needs.
const LISTEN: Duration = Duration::from_millis(1500);
/// Time in which the tokens of all robots arrive.
const SETTLE: Duration = Duration::from_millis(700);
/// Longest time for the receipts of a stop.
const RECEIPTS: Duration = Duration::from_secs(3);
/// Time until a stop is sent again to the robots without a receipt, and before the first receipt:
/// the link may not be there yet.
const ATTEMPT: Duration = Duration::from_millis(300);
const FIRST_ATTEMPT: Duration = Duration::from_millis(20);
/// A robot without a summary for longer is silent.
const QUIET: Duration = Duration::from_secs(3);

/// The token and the newest summary of a robot.
#[derive(Debug, Default)]
struct Known {
    is_alive: bool,
    summary: Option<Summary>,
    at: Option<Instant>,
}

type Robots = Arc<Mutex<BTreeMap<String, Known>>>;

type Receipts = Arc<Mutex<BTreeMap<String, (Receipt, Duration)>>>;

/// Lists the robots. Returns `true` if each expected one is there and well.
pub(crate) fn list(fleet: &Fleet, network: &Network, json: bool, watch: bool) -> Result<bool, NetworkError> {
    let session = network::open_at_once(network)?;
    let robots = Robots::default();
    for name in &fleet.robots {
        locked(&robots).insert(name.clone(), Known::default());
    }
    let _notes = (note_tokens(&session, &robots)?, note_summaries(&session, &robots)?);
    loop {
        std::thread::sleep(LISTEN);
        let known = locked(&robots);
        print(&known, json);
        if !watch {
            return Ok(!known.is_empty() && known.values().all(Known::is_well));
        }
    }
}

/// Stops robots: those named, or all that are there. Returns `true` if each gave a receipt and was
/// stopped.
pub(crate) fn stop(names: &[String], network: &Network, json: bool) -> Result<bool, NetworkError> {
    let session = network::open_at_once(network)?;
    let robots = Robots::default();
    let _tokens = note_tokens(&session, &robots)?;
    let begun = Instant::now();
    let receipts = Receipts::default();
    let missing = || {
        let known = locked(&robots);
        let alive = known.iter().filter(|(_, known)| known.is_alive).map(|(name, _)| name.clone());
        let wanted: Vec<_> = if names.is_empty() { alive.collect() } else { names.to_vec() };
        let received = locked(&receipts);
        wanted.into_iter().filter(|name| !received.contains_key(name)).collect::<Vec<_>>()
    };
    while begun.elapsed() < RECEIPTS {
        let has_receipts = !locked(&receipts).is_empty();
        // The first requests go to all: the tokens of robots may come later.
        let wanted = if names.is_empty() && !has_receipts { vec!["*".to_owned()] } else { missing() };
        if wanted.is_empty() && (!names.is_empty() || begun.elapsed() >= SETTLE) {
            break;
        }
        wanted.iter().for_each(|name| request(&session, name, begun, &receipts));
        std::thread::sleep(if has_receipts { ATTEMPT } else { FIRST_ATTEMPT });
    }
    let missing = missing();
    let receipts = locked(&receipts);
    print_receipts(&receipts, &missing, json);
    Ok(missing.is_empty() && !receipts.is_empty() && receipts.values().all(|(receipt, _)| receipt.confirmed))
}

/// Requests the stop of a robot, or of all with the name `*`.
fn request(session: &Session, name: &str, begun: Instant, receipts: &Receipts) {
    let receipts = Arc::clone(receipts);
    let query =
        session.get(Keys::of(name).stop()).target(QueryTarget::All).payload(requester()).timeout(RECEIPTS);
    let sent = query.callback(move |reply| {
        let Ok(sample) = reply.result() else { return };
        let Some(robot) = robot_of(sample.key_expr().as_str()) else { return };
        if let Ok(receipt) = serde_json::from_slice(&sample.payload().to_bytes()) {
            locked(&receipts).entry(robot.to_owned()).or_insert((receipt, begun.elapsed()));
        }
    });
    if let Err(error) = sent.wait() {
        tracing::error!("the network: {error}");
    }
}

/// Returns the name that robots log.
fn requester() -> String {
    let of = |variable| std::env::var(variable).unwrap_or_default();
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    format!("fleet: {}@{}", of("USER"), host.trim_end())
}

/// Notes which robots are alive, as long as the result lives.
fn note_tokens(session: &Session, robots: &Robots) -> Result<Subscriber<()>, NetworkError> {
    let robots = Arc::clone(robots);
    let tokens = session.liveliness().declare_subscriber(format!("{FLEET}/alive")).history(true);
    let tokens = tokens.callback(move |sample| {
        let Some(name) = robot_of(sample.key_expr().as_str()) else { return };
        locked(&robots).entry(name.to_owned()).or_default().is_alive = sample.kind() == SampleKind::Put;
    });
    tokens.wait().map_err(NetworkError::of)
}

/// Notes the summaries of robots, as long as the result lives.
fn note_summaries(session: &Session, robots: &Robots) -> Result<Subscriber<()>, NetworkError> {
    let robots = Arc::clone(robots);
    let summaries = session.declare_subscriber(format!("{FLEET}/status")).callback(move |sample| {
        let Some(name) = robot_of(sample.key_expr().as_str()) else { return };
        if let Ok(summary) = serde_json::from_slice(&sample.payload().to_bytes()) {
            let mut robots = locked(&robots);
            let known = robots.entry(name.to_owned()).or_default();
            (known.summary, known.at) = (Some(summary), Some(Instant::now()));
        }
    });
    summaries.wait().map_err(NetworkError::of)
}

/// Returns the robot in a key `motord/<robot>/…`.
fn robot_of(key: &str) -> Option<&str> {
    key.strip_prefix("motord/")?.split('/').next()
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Known {
    fn is_well(&self) -> bool {
        self.word() == "well"
    }

    /// One word for the robot.
    fn word(&self) -> &'static str {
        let is_quiet = self.at.is_none_or(|at| at.elapsed() > QUIET);
        match &self.summary {
            _ if !self.is_alive => "absent",
            _ if is_quiet => "silent",
            Some(summary) if summary.is_well() => "well",
            _ => "look",
        }
    }

    fn details(&self) -> String {
        let Some(summary) = self.summary.as_ref().filter(|_| self.is_alive) else { return String::new() };
        let groups = summary.groups.iter().map(|group| match &group.cause {
            Some(cause) => {
                let joint = group.joint.as_ref().map_or_else(String::new, |joint| format!(" at {joint}"));
                format!("{} {} ({cause}{joint})", group.name, group.phase)
            }
            None => format!("{} {}", group.name, group.phase),
        });
        let mut parts: Vec<_> = groups.collect();
        parts
            .extend((!summary.offline.is_empty()).then(|| format!("offline: {}", summary.offline.join(" "))));
        parts.extend((!summary.faulty.is_empty()).then(|| format!("faults: {}", summary.faulty.join(" "))));
        parts.join("; ")
    }
}

fn print(robots: &BTreeMap<String, Known>, json: bool) {
    if json {
        let list: Vec<_> = robots
            .iter()
            .map(|(name, known)| {
                serde_json::json!({"robot": name, "is": known.word(), "status": known.summary})
            })
            .collect();
        println!("{}", serde_json::Value::from(list));
        return;
    }
    println!("{:<16} {:<7} {:>9} {:>5}  groups", "robot", "is", "battery V", "°C");
    for (name, known) in robots {
        let number = |value: Option<f32>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.1}"));
        let of = |part: fn(&Summary) -> Option<f32>| number(known.summary.as_ref().and_then(part));
        let (battery, hottest) = (of(|summary| summary.battery_v), of(|summary| summary.hottest_celsius));
        let (name, details) = (printable(name), known.details());
        println!("{name:<16} {:<7} {battery:>9} {hottest:>5}  {}", known.word(), printable(&details));
    }
    if robots.is_empty() {
        println!("no robot is in this network");
    }
}

fn print_receipts(receipts: &BTreeMap<String, (Receipt, Duration)>, missing: &[String], json: bool) {
    if json {
        let mut list: Vec<_> = receipts
            .iter()
            .map(|(robot, (receipt, after))| {
                serde_json::json!({"robot": robot, "after_ms": after.as_secs_f64() * 1e3, "receipt": receipt})
            })
            .collect();
        list.extend(missing.iter().map(|robot| serde_json::json!({"robot": robot, "receipt": null})));
        println!("{}", serde_json::Value::from(list));
        return;
    }
    for (robot, (receipt, after)) in receipts {
        let (robot, message) = (printable(robot), printable(&receipt.message));
        println!("{robot:<16} {message} ({:.0} ms)", after.as_secs_f64() * 1e3);
    }
    for robot in missing {
        println!("{:<16} NO RECEIPT: it may still move; cut its power", printable(robot));
    }
    if receipts.is_empty() && missing.is_empty() {
        println!("NO ROBOT ANSWERED: cut the power of those that move");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robot_is_in_the_key() {
        assert_eq!(robot_of("motord/go7/alive"), Some("go7"));
        assert_eq!(robot_of("other/go7/alive"), None);
    }

    #[test]
    fn robot_without_token_is_absent() {
        assert_eq!(Known::default().word(), "absent");
        let silent = Known { is_alive: true, ..Known::default() };
        assert_eq!(silent.word(), "silent");
    }
}
