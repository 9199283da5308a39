//! `motord run --plant`: the real daemon, and a plant that speaks the protocol of docs/twin.md by
//! itself.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_client::{ImuContradiction, Phase, Setpoint};
use motord_harness::conventions::{CONVENTIONS, Convention};
use motord_harness::daemon::{Daemon, TIMEOUT, until};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Its interface does not exist: `--plant` opens none.
const CONFIG: &str = r#"
[daemon]
instance = "robot"
[cycle]
rate-hz = 500
max-lateness-ms = 1000.0
[[bus]]
name = "left"
type = "socketcan"
interface = "absent0"
[[motor]]
name = "arm"
bus = "left"
id = 1
protocol = "mit"
model = "GIM8108-8"
direction = -1
[[imu]]
name = "base"
type = "external"
rate-hz = 500
mount-rpy-deg = [0, 0, 90]
"#;

/// The measurements of its IMU: orientation w, x, y, z, angular velocity, specific force.
type Measure = Box<dyn FnMut() -> [f64; 10] + Send>;

/// A level body that turns at `rate` about x, rad/s.
fn turning(rate: f64) -> [f64; 10] {
    [1.0, 0.0, 0.0, 0.0, rate, 0.2, 0.3, 0.0, 0.0, 9.81]
}

/// How the plant answers a step, with the torque: position and velocity.
type Answer = Box<dyn FnMut(f64) -> [f64; 2] + Send>;

/// Starts a daemon whose plant answers the greeting with `greeting`, and each step by `answer`
/// until that returns `f64::MAX` for the velocity.
fn daemon(config: &str, greeting: &'static str, answer: Answer) -> Daemon {
    daemon_with_imu(config, greeting, answer, Box::new(|| turning(0.1)))
}

/// As [`daemon`], with the measurements of its IMU.
fn daemon_with_imu(config: &str, greeting: &'static str, answer: Answer, measure: Measure) -> Daemon {
    let directory = TempDir::new().unwrap();
    let socket = directory.path().join("plant");
    let listener = UnixListener::bind(&socket).unwrap();
    std::thread::spawn(move || plant(listener.accept().unwrap().0, greeting, answer, measure));
    Daemon::start_in(directory, config, |command| {
        command.arg("--plant").arg(socket);
    })
}

fn plant(stream: UnixStream, greeting: &str, mut answer: Answer, mut measure: Measure) {
    let mut reader = BufReader::new(stream.try_clone().unwrap());
    let mut line = String::new();
    reader.read_line(&mut line).unwrap();
    let hello: Value = serde_json::from_str(&line).unwrap();
    assert_eq!((&hello["motord_plant"], &hello["physics"][0]["name"]), (&1.into(), &"arm".into()));
    assert!(hello["physics"][0]["armature"].as_f64().unwrap() > 0.0);
    assert_eq!(hello["description"]["joints"][0]["name"], "arm");
    let mut writer = stream;
    writeln!(writer, "{greeting}").unwrap();
    let mut asked = [[0; 8]; 2];
    while reader.read_exact(asked.as_flattened_mut()).is_ok() {
        let [seconds, torque] = asked.map(f64::from_le_bytes);
        assert_eq!(seconds, 0.00025);
        let [position, velocity] = answer(torque);
        let imu = measure().into_iter().take(if greeting.contains("true") { 10 } else { 0 });
        let numbers = [position, velocity].into_iter().chain(imu).flat_map(f64::to_le_bytes);
        if velocity == f64::MAX || writer.write_all(&numbers.collect::<Vec<_>>()).is_err() {
            return;
        }
    }
}

/// A joint that begins at 0.7 rad, with an inertia of 0.05 kg·m² and viscous friction.
fn joint() -> Answer {
    let (mut position, mut velocity) = (0.7, 0.0);
    Box::new(move |torque| {
        velocity += (torque - 0.2 * velocity) / 0.05 * 0.00025;
        position += velocity * 0.00025;
        [position, velocity]
    })
}

/// Waits until the daemon ends, and returns its exit status and its log.
fn end(mut daemon: Daemon) -> (Option<i32>, String) {
    let status = daemon.wait();
    (status.code(), daemon.log())
}

#[test]
fn plant_moves_joints_and_is_measured() {
    let daemon = daemon(CONFIG, r#"{"begin": [0.7], "imu": true}"#, joint());
    let client = daemon.connect();
    let state = client.wait(TIMEOUT).unwrap();
    let begin = state.joints().next().unwrap().position().unwrap();
    assert!((begin - 0.7).abs() < 0.01, "{begin}");
    let imu = until("a sample", || {
        client
            .wait(TIMEOUT)
            .ok()?
            .imu(client.imu("base")?)
            .filter(|imu| imu.angular_velocity().is_some_and(|axes| axes[0] > 0.0))
    });
    // An IMU of the plant measures the body: the mount of the real one does not turn it.
    assert_eq!(imu.angular_velocity(), Some([0.1, 0.2, 0.3]));

    let mut claim = client.claim("all").unwrap();
    claim.hold(&client.wait(TIMEOUT).unwrap(), 20.0, 1.0).unwrap();
    claim.commit().unwrap();
    claim.enable().unwrap();
    claim.wait_for(Phase::Active, TIMEOUT).unwrap();
    until("the joint at its goal", || {
        claim.set("arm", Setpoint::impedance(1.0, 0.0, 20.0, 1.0, 0.0)).ok()?;
        claim.commit().ok()?;
        let position = client.wait(TIMEOUT).ok()?.joints().next()?.position()?;
        ((position - 1.0).abs() < 0.02).then_some(())
    });
    claim.disable().unwrap();
    assert_eq!(daemon.motorctl(&["sim", "arm", "off"]).status.code(), Some(0));
}

/// The end of the plant is the end of the robot: no controller goes on with joints that nothing
/// moves.
#[test]
fn daemon_ends_with_its_plant() {
    let mut steps = 0;
    let ends = Box::new(move |_torque: f64| {
        steps += 1;
        [0.0, if steps > 2000 { f64::MAX } else { 0.0 }]
    });
    let (status, log) = end(daemon(CONFIG, r#"{"imu": true}"#, ends));
    assert_eq!(status, Some(69), "{log}");
    assert!(log.contains("the plant ended: the motors were damped and stopped"), "{log}");
}

#[test]
fn daemon_ends_when_its_plant_is_silent() {
    let mut steps = 0;
    let hangs = Box::new(move |_torque: f64| {
        steps += 1;
        if steps > 1000 {
            std::thread::sleep(Duration::from_secs(5));
        }
        [0.0, 0.0]
    });
    let (status, log) = end(daemon(CONFIG, r#"{"imu": true}"#, hangs));
    assert_eq!(status, Some(69), "{log}");
    assert!(log.contains("the plant did not answer for 1s"), "{log}");
}

#[test]
fn numbers_that_are_none_end_the_daemon() {
    for (number, name) in [(f64::NAN, "NaN"), (-1e308, "-1e308")] {
        let mut steps = 0;
        let breaks = Box::new(move |_torque: f64| {
            steps += 1;
            [if steps > 1000 { number } else { 0.0 }, 0.0]
        });
        let (status, log) = end(daemon(CONFIG, r#"{"imu": true}"#, breaks));
        assert_eq!(status, Some(69), "{log}");
        assert!(log.contains(&format!("the plant has computed the position {name} of arm")), "{log}");
    }
}

/// A plant whose answers have another length does not fit its greeting: each later answer would be
/// read shifted.
#[test]
fn answers_of_wrong_length_end_the_daemon() {
    for (greeting, expected) in [
        (r#"{"imu": false}"#, "the plant answered a step with more than 16 bytes, not 16"),
        (r#"{"imu": true}"#, "the plant answered a step with 16 bytes, not 96"),
    ] {
        let directory = TempDir::new().unwrap();
        let socket = directory.path().join("plant");
        let listener = UnixListener::bind(&socket).unwrap();
        let imu = greeting.contains("false");
        std::thread::spawn(move || {
            let mut stream = listener.accept().unwrap().0;
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            reader.read_line(&mut String::new()).unwrap();
            writeln!(stream, "{greeting}").unwrap();
            let answer = vec![0; if imu { 96 } else { 16 }];
            while reader.read_exact(&mut [0; 16]).is_ok() && stream.write_all(&answer).is_ok() {}
        });
        let (status, log) = end(Daemon::start_in(directory, CONFIG, |command| {
            command.arg("--plant").arg(socket);
        }));
        assert_eq!(status, Some(69), "{log}");
        assert!(log.contains(expected), "{log}");
    }
}

#[test]
fn imu_of_nan_ends_the_daemon() {
    let mut steps = 0;
    let breaks: Measure = Box::new(move || {
        steps += 1;
        turning(if steps > 1000 { f64::NAN } else { 0.1 })
    });
    let (status, log) = end(daemon_with_imu(CONFIG, r#"{"imu": true}"#, Box::new(|_| [0.0, 0.0]), breaks));
    assert_eq!(status, Some(69), "{log}");
    assert!(log.contains("the plant has computed the angular velocity NaN of its IMU"), "{log}");
}

/// Goal: each convention of a plant's IMU is named in the status of the daemon.
#[test]
fn each_convention_of_a_plant_is_in_status() {
    let kind = Arc::new(AtomicUsize::new(0));
    let measured = Arc::clone(&kind);
    let measure: Measure = Box::new(move || {
        let Convention { orientation, acceleration, .. } = CONVENTIONS[measured.load(Ordering::Relaxed)];
        let values = orientation.iter().chain(&[0.0; 3]).chain(&acceleration);
        let mut numbers = [0.0; 10];
        numbers.iter_mut().zip(values).for_each(|(number, value)| *number = f64::from(*value));
        numbers
    });
    let daemon = daemon_with_imu(CONFIG, r#"{"imu": true}"#, joint(), measure);
    let client = daemon.connect();
    for (index, convention) in CONVENTIONS.iter().enumerate() {
        kind.store(index, Ordering::Relaxed);
        let (names, begun) = (convention.names(), Instant::now());
        until(&format!("{names:?}"), || {
            let imu = client.wait(TIMEOUT).ok()?.imu(0)?;
            imu.contradictions().map(ImuContradiction::name).eq(names.iter().copied()).then_some(())
        });
        println!("{names:?} after {:?}", begun.elapsed());
        let names = Value::from(names);
        daemon.await_status(|status| status["imus"][0]["contradictions"] == names);
    }
}

#[test]
fn plant_without_imu_is_reported() {
    let mut steps = 0;
    let ends = Box::new(move |_torque: f64| {
        steps += 1;
        [0.0, if steps > 1000 { f64::MAX } else { 0.0 }]
    });
    let (_, log) = end(daemon(CONFIG, "{}", ends));
    assert!(log.contains("gets no samples: the plant has no IMU") && log.contains("imu=\"base\""), "{log}");
}

#[test]
fn refusals_of_plant_are_told() {
    let serial = CONFIG.replace(
        "type = \"socketcan\"\ninterface = \"absent0\"",
        "type = \"serial\"\ndevice = \"/dev/absent\"\nevery = 4",
    );
    let serial = serial.replace("\"mit\"", "\"gim\"");
    for (config, greeting, expected, code) in [
        (
            CONFIG,
            r#"{"error": "arm: the model has no joint of this name"}"#,
            "refuses the robot: arm: the model has no joint",
            69,
        ),
        (CONFIG, "no JSON", "the plant's answer is not understood", 69),
        (CONFIG, r#"{"begin": [0.1, 0.2]}"#, "`begin` must have 1 positions", 69),
        (CONFIG, r#"{"begin": [1e999]}"#, "the plant's answer is not understood", 69),
        (CONFIG, r#"{"begin": [1e308]}"#, "the plant has computed the position 1e308 of arm", 69),
        (&serial, "{}", "bus left is a serial line", 78),
    ] {
        let (status, log) = end(daemon(config, greeting, joint()));
        assert_eq!(status, Some(code), "{log}");
        assert!(log.contains(expected), "{log}");
    }
}

#[test]
fn missing_plant_is_told_with_a_cure() {
    let daemon = Daemon::start_in(TempDir::new().unwrap(), CONFIG, |command| {
        command.arg("--plant").arg(Path::new("/nowhere/plant"));
    });
    let (status, log) = end(daemon);
    assert_eq!(status, Some(69), "{log}");
    assert!(log.contains("/nowhere/plant: No such file or directory"), "{log}");
    assert!(log.contains("python -m motord.sim live"), "{log}");
}
