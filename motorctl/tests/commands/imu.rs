//! `motorctl imu`: IMUs on serial ports, and the mount of one.

use crate::line::{Calls, Line, text};
use crate::schemas::assert_lines_valid;
use motord_client::{Client, ImuSample};
use motord_harness::daemon::{BENCH, Daemon, until};
use motord_simulator::ImuVendor;
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

#[test]
fn imu_is_found_with_type_and_rate() {
    for (vendor, kind) in [(ImuVendor::Hipnuc, "hipnuc-serial"), (ImuVendor::Xsens, "xsens")] {
        let line = Line::imu(vendor);
        let found = line.good("imu find --device LINE --baud 921600 --json");
        assert_lines_valid("motorctl-imu-find", &found);
        let found: serde_json::Value = serde_json::from_str(&found).unwrap();
        let imu = &found["imus"][0];
        assert_eq!((imu["type"].as_str(), imu["baud"].as_u64()), (Some(kind), Some(921_600)));
        assert_eq!(imu["complete"], true);
        // A busy machine loses samples of the simulated device, or serves it late.
        assert!((50.0..250.0).contains(&imu["measured_hz"].as_f64().unwrap()), "{imu}");
        let pasted = line.good("imu find --device LINE --baud 921600");
        assert!(pasted.contains(&format!("[[imu]]\nname = \"base\"\ntype = \"{kind}\"\n")), "{pasted}");
    }
}

/// The device stores the rate: it has it after a loss of power, and `imu find` finds it.
#[test]
fn rate_is_written_stored_and_measured() {
    for (vendor, rate) in [(ImuVendor::Hipnuc, 500.0), (ImuVendor::Xsens, 400.0)] {
        let line = Line::imu_with(vendor, (100.0, 921_600));
        let set = line.good(&format!("imu set --device LINE --baud 921600 --rate-hz {rate} --yes --json"));
        assert_lines_valid("motorctl-imu-set", &set);
        let set: serde_json::Value = serde_json::from_str(&set).unwrap();
        assert_eq!(set["asked"]["rate_hz"], rate);
        assert!((set["measured_hz"].as_f64().unwrap() / rate - 1.0).abs() < 0.1, "{set}");
        line.inject("base power-cycle");
        let found = line.json("imu find --device LINE --baud 921600");
        assert!((found["imus"][0]["measured_hz"].as_f64().unwrap() / rate - 1.0).abs() < 0.1, "{found}");
    }
}

/// The port has the old baud rate before, and the new one after; the terminal garbles bytes of
/// another one.
#[test]
fn baud_rate_is_changed_with_the_rate() {
    for vendor in [ImuVendor::Hipnuc, ImuVendor::Xsens] {
        let line = Line::imu_with(vendor, (100.0, 115_200));
        let printed = line.good("imu set --device LINE --new-baud 460800 --rate-hz 200 --yes");
        assert!(
            printed.contains("asked for 200 Hz, ") && printed.contains(" Hz arrive at 460800 baud"),
            "{printed}"
        );
        let printed = line.bad("imu set --device LINE --baud 115200 --rate-hz 100 --yes", 1);
        assert!(printed.contains("so nothing was written"), "{printed}");
    }
}

#[test]
fn rate_that_cannot_be_is_refused() {
    let line = Line::imu_with(ImuVendor::Hipnuc, (100.0, 115_200));
    for (values, reason) in [
        ("--rate-hz 500", "500 Hz of 82 bytes do not fit into 115200 baud, which carry 140 Hz"),
        ("--rate-hz 300", "300 Hz: the device has 1, 2, 5, 10, 20, 50, 100, 200, 250, 500, 1000"),
        ("--new-baud 9600", "9600 baud: the device has 115200, 460800, 921600"),
        ("--new-node 9", "--bus"),
        ("", "--rate-hz"),
    ] {
        let printed = line.bad(&format!("imu set --device LINE --baud 115200 {values} --yes"), 64);
        assert!(printed.contains(reason), "{values}: {printed}");
    }
    let printed = line.bad("imu set --device LINE --baud 115200 --rate-hz 50", 64);
    assert!(
        printed.contains("This changes and stores the settings") && printed.contains("--yes"),
        "{printed}"
    );
    let measured = line.json("imu find --device LINE --baud 115200")["imus"][0]["measured_hz"].as_f64();
    assert!((measured.unwrap() - 100.0).abs() < 10.0, "nothing was written: {measured:?}");
}

/// A daemon holds the lock of its port.
#[test]
fn port_of_a_daemon_is_not_set() {
    let line = Line::imu_with(ImuVendor::Xsens, (100.0, 115_200));
    let held = motord_bus::serial::Port::exclusive(&line.device(), 115_200).unwrap();
    let printed = line.bad("imu set --device LINE --rate-hz 50 --yes", 75);
    assert!(printed.contains("another"), "{printed}");
    drop(held);
    line.good("imu set --device LINE --rate-hz 50 --yes");
}

#[test]
fn silent_and_unknown_lines_are_named() {
    let line = Line::imu(ImuVendor::Hipnuc);
    line.inject("base off");
    let printed = line.bad("imu find --device LINE --baud 921600", 69);
    assert!(
        printed.contains("is silent: check power and wiring") && printed.contains("no IMU on 1 serial ports"),
        "{printed}"
    );
    line.inject("base ok");
    line.inject("base garbage");
    let printed = line.bad("imu find --device LINE --baud 921600", 69);
    assert!(printed.contains("and no sample of a known IMU"), "{printed}");
    let printed = line.bad("imu find --device /dev/ttyNONE", 69);
    assert!(printed.contains("/dev/ttyNONE: there is no such device"), "{printed}");
}

/// A sensor at rest that is mounted with roll 2°, pitch 0 and yaw 90°, and turns at `turn`, rad/s.
fn mounted(turn: f32) -> ImuSample {
    let (sine, cosine) = 2.0_f32.to_radians().sin_cos();
    // Roll is the first turn, so it is about the sensor's x: up leans to its y.
    ImuSample {
        orientation: [1.0, 0.0, 0.0, 0.0],
        angular_velocity: [turn, 0.0, 0.0],
        acceleration: [0.0, 9.81 * sine, 9.81 * cosine],
        temperature: None,
        time_ns: 0,
    }
}

/// A sensor at rest whose x points down, on a body whose nose is lowered by this angle, °: pitch
/// 90° and the angle.
fn pitched(lowered: f32) -> ImuSample {
    let (sine, cosine) = (90.0 + lowered).to_radians().sin_cos();
    let (half_sine, half_cosine) = ((90.0 + lowered) / 2.0).to_radians().sin_cos();
    ImuSample {
        orientation: [half_cosine, 0.0, half_sine, 0.0],
        acceleration: [-9.81 * sine, 0.0, 9.81 * cosine],
        ..mounted(0.0)
    }
}

/// Publishes `samples` until `end`: the second one once `moved` is set.
fn publish(client: &Client, samples: [ImuSample; 2], moved: &AtomicBool, end: &AtomicBool) {
    let mut publisher = client.publish_imu("base").unwrap();
    for number in 0_u32.. {
        if end.load(Ordering::Relaxed) {
            break;
        }
        let sample = samples[usize::from(moved.load(Ordering::Relaxed))];
        let [x, y, z] = sample.angular_velocity;
        // Without noise the samples would count as one that is repeated.
        let angular_velocity = [x, y, z + 1e-4 * (number % 7) as f32];
        let _not_yet = publisher.send(&ImuSample { angular_velocity, ..sample });
        std::thread::sleep(Duration::from_millis(4));
    }
}

/// Runs `imu level base` beside a publisher, which sends the second sample when the command asks
/// for the second pose.
fn level(daemon: &Daemon, samples: [ImuSample; 2], arguments: &[&str]) -> (Option<i32>, String, String) {
    let (client, moved, end) = (daemon.connect(), AtomicBool::new(false), AtomicBool::new(false));
    until("the end of the last publisher", || daemon.status()["imus"][0]["lost"].as_bool()?.then_some(()));
    std::thread::scope(|scope| {
        scope.spawn(|| publish(&client, samples, &moved, &end));
        daemon.await_status(|status| status["imus"][0]["lost"] == false);
        let mut command = daemon.command(&[&["imu", "level", "base"], arguments].concat());
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut printed = String::new();
        for line in BufReader::new(process.stderr.take().unwrap()).lines() {
            printed += &line.unwrap();
            moved.fetch_or(printed.contains("Now lower the nose"), Ordering::Relaxed);
        }
        let output = process.wait_with_output().unwrap();
        end.store(true, Ordering::Relaxed);
        (output.status.code(), text(&output.stdout), printed)
    })
}

fn external_imu() -> Daemon {
    let imu =
        "\n[[imu]]\nname = \"base\"\ntype = \"external\"\nmount-rpy-deg = [0, 0, 90]\nlost-after-ms = 1000\n";
    Daemon::start(&format!("{BENCH}{imu}"))
}

#[test]
fn level_measures_roll_and_pitch_and_keeps_yaw() {
    let daemon = external_imu();
    let (code, measured, printed) = level(&daemon, [mounted(0.0); 2], &["--json"]);
    assert_eq!(code, Some(0), "{printed}");
    assert_lines_valid("motorctl-imu-level", &measured);
    let measured: serde_json::Value = serde_json::from_str(&measured).unwrap();
    assert_eq!(measured["line"], "mount-rpy-deg = [2, 0, 90]", "{measured}");
    assert!((measured["tilt_deg"].as_f64().unwrap() - 2.0).abs() < 0.01, "{measured}");
    let (code, _, printed) = level(&daemon, [mounted(0.5); 2], &[]);
    assert_eq!(code, Some(1));
    assert!(
        printed.contains("the mount of base is not measured: the robot turns, at up to 0.50 rad/s"),
        "{printed}"
    );
    let unknown = daemon.motorctl(&["imu", "level", "bas"]);
    assert!(!unknown.status.success() && text(&unknown.stderr).contains("bas"), "{}", text(&unknown.stderr));
}

/// Within 10° of ±90° of pitch noise would decide roll and yaw.
#[test]
fn vertical_axis_asks_for_second_pose() {
    let daemon = external_imu();
    let (code, measured, printed) = level(&daemon, [pitched(0.0); 2], &["--seconds", "0.5"]);
    assert_eq!((code, measured.as_str()), (Some(1), ""), "{printed}");
    assert!(
        printed.contains("Measure a second pose as well: `motorctl imu level base --two-poses`"),
        "{printed}"
    );
    let poses = [pitched(0.0), pitched(40.0)];
    let (code, measured, printed) = level(&daemon, poses, &["--seconds", "0.5", "--two-poses"]);
    assert_eq!((code, measured.trim()), (Some(0), "mount-rpy-deg = [0, 90, 0]"), "{printed}");
}
