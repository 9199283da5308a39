//! External IMUs: the real daemon, and publishers that are processes of their own.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_client::{Client, Error, Imu, ImuContradiction, ImuSample};
use motord_harness::conventions::CONVENTIONS;
use motord_harness::daemon::{Daemon, TIMEOUT, bench_at, until};
use motord_harness::programs::Process;
use motord_ports::{ClientPorts, Instance};
use motord_shared::message::ImuMessage;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const IMUS: &str = r#"
[[imu]]
name = "spare"
type = "simulated"
[[imu]]
name = "base"
type = "external"
rate-hz = 1000
mount-rpy-deg = [0, 0, 90]
lost-after-ms = 200
when-lost = "stop"
"#;

fn config() -> String {
    bench_at(500) + IMUS
}

const LOST_AFTER: Duration = Duration::from_millis(200);
/// Variable for a process that publishes samples until it is killed: its runtime directory.
const PUBLISH: &str = "MOTORD_TEST_PUBLISH_IMU";

fn connect(directory: &Path) -> Client {
    until("a daemon", || Client::connect_in(directory, "bench").ok())
}

/// The newest state of the external IMU.
fn base(client: &Client) -> Option<Imu> {
    let state = client.wait(Duration::from_millis(100)).ok()?;
    state.imu(client.imu("base")?)
}

/// The nose is turned to the left by 90°: the heading of a sensor whose x points left is 180°.
fn sample() -> ImuSample {
    ImuSample {
        orientation: [0.0, 0.0, 0.0, 1.0],
        angular_velocity: [1.0, 0.0, 0.0],
        acceleration: [0.0, 0.0, 9.81],
        temperature: Some(30.0),
        time_ns: 0,
    }
}

/// The noise that every sensor has: equal measurements for a second are none.
fn noisy(sample: ImuSample, turn: u32) -> ImuSample {
    let [x, y, z] = sample.acceleration;
    ImuSample { acceleration: [x, y, z + 1e-4 * (turn % 7) as f32], ..sample }
}

/// Publishes at 1 kHz in another process.
fn publisher(directory: &Path) -> Process {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["external_imu::publishing_process", "--exact", "--nocapture"]).env(PUBLISH, directory);
    Process(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
}

/// Not a test: the process of [`publisher`].
#[test]
fn publishing_process() {
    let Some(directory) = std::env::var_os(PUBLISH) else { return };
    let client = connect(Path::new(&directory));
    let mut publisher = client.publish_imu("base").unwrap();
    for turn in 0_u32.. {
        let _between_daemons = publisher.send(&noisy(sample(), turn));
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Goal: samples are in the state through the mount, a killed publisher is lost after
/// `lost-after-ms`, the next one takes over, and one survives a restart of the daemon.
#[test]
fn external_imu_follows_its_publishers() {
    let mut daemon = Daemon::start(&config());
    let client = connect(daemon.directory.path());
    assert!(until("a state", || base(&client)).lost);
    let first = publisher(daemon.directory.path());
    let imu = until("a sample", || base(&client).filter(|imu| imu.fresh));
    let [roll, pitch, yaw] = imu.roll_pitch_yaw().unwrap();
    assert!(roll.abs() < 1e-3 && pitch.abs() < 1e-3 && (yaw - std::f32::consts::FRAC_PI_2).abs() < 1e-3);
    let [x, y, _] = imu.angular_velocity().unwrap();
    assert!(x.abs() < 1e-6 && (y - 1.0).abs() < 1e-6, "the sensor's x is the body's y");
    assert_eq!((imu.temperature, imu.rejected), (Some(30.0), 0));

    let mut second = client.publish_imu("base").unwrap();
    let other = until("a refusal", || second.send(&sample()).err());
    assert_eq!(other, Error::OtherPublisher { imu: "base".into(), process: first.0.id() });

    drop(first);
    let lost = until("the loss", || base(&client).filter(|imu| imu.lost));
    let state = client.wait(TIMEOUT).unwrap();
    let silent = Duration::from_nanos(state.tick_ns() - lost.receive_ns);
    assert!(silent > LOST_AFTER, "{silent:?}");
    until("the next publisher", || {
        let _other_for_a_cycle = second.send(&sample());
        second.is_used().then_some(())
    });
    drop(second);

    // A publisher that waits already takes over in the cycle of the loss.
    until("the loss", || base(&client).filter(|imu| imu.lost));
    let third = publisher(daemon.directory.path());
    until("the third publisher", || base(&client).filter(|imu| imu.fresh));
    daemon.kill();
    daemon.restart();
    let client = connect(daemon.directory.path());
    until("samples after the restart", || base(&client).filter(|imu| imu.fresh && !imu.lost));
    drop(third);
}

/// Starts a daemon without a mount of its IMU.
fn unmounted(config: &str) -> Daemon {
    Daemon::start(&config.replace("mount-rpy-deg = [0, 0, 90]\n", ""))
}

/// Goal: each convention of a resting body is named in the state and in the log, and one that
/// agrees again as well.
#[test]
fn convention_of_a_publisher_is_named_in_log() {
    let daemon = unmounted(&config());
    let client = connect(daemon.directory.path());
    let mut publisher = client.publish_imu("base").unwrap();
    for convention in &CONVENTIONS {
        let (names, begun, mut turn) = (convention.names(), Instant::now(), 0);
        until(&format!("{names:?}"), || {
            turn += 1;
            let sample = ImuSample {
                orientation: convention.orientation,
                angular_velocity: [0.0; 3],
                acceleration: convention.noisy(turn),
                temperature: None,
                time_ns: 0,
            };
            let _other_for_a_cycle = publisher.send(&sample);
            let found = base(&client)?.contradictions().map(ImuContradiction::name);
            found.eq(names.iter().copied()).then_some(())
        });
        println!("{names:?} after {:?}", begun.elapsed());
        let logged =
            names.first().map_or("agree about gravity".into(), |name| format!("contradictions=\"{name}\""));
        daemon.await_log(&logged);
    }
}

/// Goal: a publisher whose samples are lost many times a second gets the line about its convention
/// none the less.
#[test]
fn contradiction_is_logged_beside_many_losses() {
    let daemon = unmounted(&config().replace("lost-after-ms = 200", "lost-after-ms = 5"));
    let client = connect(daemon.directory.path());
    let mut publisher = client.publish_imu("base").unwrap();
    // Pitched by 0.3 rad, its acceleration in g.
    let sent = ImuSample {
        orientation: [0.988_771, 0.0, 0.149_438, 0.0],
        angular_velocity: [0.0; 3],
        acceleration: [-0.295_520, 0.0, 0.955_336],
        temperature: None,
        time_ns: 0,
    };
    let mut turn = 0;
    until("a contradiction", || {
        turn += 1;
        let _late_for_the_cycle = publisher.send(&noisy(sent, turn));
        std::thread::sleep(Duration::from_millis(40));
        (base(&client)?.contradictions().count() > 0).then_some(())
    });
    until("a line about it", || {
        let text = daemon.log();
        (text.contains("too-many-changes") && text.contains("acceleration-in-g")).then_some(())
    });
}

/// Goal: a publisher that repeats one measurement is lost, and one with another clock learns it
/// from `send`.
#[test]
fn stuck_and_misdated_publishers_are_named() {
    let daemon = unmounted(&config());
    let client = connect(daemon.directory.path());
    let mut publisher = client.publish_imu("base").unwrap();
    until("samples", || {
        let _other_for_a_cycle = publisher.send(&sample());
        base(&client).filter(|imu| !imu.lost)
    });
    until("the loss", || {
        let _other_for_a_cycle = publisher.send(&sample());
        base(&client).filter(|imu| imu.lost && imu.rejected > 0)
    });
    daemon.await_log("repeats one measurement");
    let realtime = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap();
    let dated = ImuSample { time_ns: realtime.as_nanos() as u64, ..sample() };
    let error = publisher.send(&dated).unwrap_err();
    assert!(error.to_string().contains("and fits CLOCK_REALTIME (time.time())"), "{error}");
    // A program that does not use this library.
    let attachment = Instance::below(daemon.directory.path(), "bench").unwrap().attach().unwrap().unwrap();
    let port = ClientPorts::open(attachment).unwrap().imu_sender().unwrap();
    let message = ImuMessage {
        boot_id: client.description().boot_id,
        publisher: 77 << 32,
        sequence: 1,
        time_ns: dated.time_ns,
        imu: 1,
        orientation: dated.orientation,
        acceleration: dated.acceleration,
        ..ImuMessage::default()
    };
    port.send(&message).unwrap();
    daemon.await_log("fit CLOCK_REALTIME");
}

/// Goal: a publisher that sends anything at 20 kHz and more changes nothing of the other IMUs, the
/// motors and the cycle.
#[test]
fn hostile_publisher_changes_nothing_else() {
    let daemon = Daemon::start(&config());
    let client = connect(daemon.directory.path());
    let owner = publisher(daemon.directory.path());
    until("a sample", || base(&client).filter(|imu| imu.fresh));
    let before = client.wait(TIMEOUT).unwrap();
    let attachment = Instance::below(daemon.directory.path(), "bench").unwrap().attach().unwrap().unwrap();
    let port = ClientPorts::open(attachment).unwrap().imu_sender().unwrap();
    let mut random = 1_u64;
    for turn in 0..40_000_u32 {
        // A generator of Marsaglia's xorshift.
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        let value = f32::from_bits((random >> 16) as u32);
        let message = ImuMessage {
            boot_id: if turn % 2 == 0 { client.description().boot_id } else { random },
            publisher: random,
            sequence: random.rotate_left(9),
            time_ns: before.tick_ns().wrapping_add(random >> 30),
            imu: if turn % 8 < 6 { 1 } else { (random >> 60) as u32 },
            reserved: turn,
            orientation: [value; 4],
            angular_velocity: [value; 3],
            acceleration: [value; 3],
            temperature: value,
            padding: turn,
        };
        port.send(&message).unwrap();
        if turn % 100 == 0 {
            let imu = base(&client).unwrap();
            let down = imu.acceleration().unwrap()[2];
            assert!((down - 9.81).abs() < 1e-3, "{imu:?}");
        }
    }
    let after = client.wait(TIMEOUT).unwrap();
    let imu = base(&client).unwrap();
    assert!(imu.rejected > 1000 && !imu.lost, "{imu:?}");
    let others =
        [&before, &after].map(|state| (state.imu(0).unwrap().rejected, state.joint(0).unwrap().missed));
    assert_eq!(others[0], others[1], "rejected samples of the other IMU, missed replies");
    drop(owner);
    // Samples of others are no fault of the files of this daemon.
    daemon.await_log("foreign-imu-samples");
    let log = daemon.log();
    assert!(!log.contains("are its files damaged"), "{log}");
}

#[test]
fn one_process_leaves_slots_to_other_publishers() {
    let daemon = Daemon::start(&config());
    let clients = [(); 2].map(|()| connect(daemon.directory.path()));
    let publish = |number: usize| clients[number % 2].publish_imu("base");
    let mut kept: Vec<_> = (0..4).map(|number| publish(number).unwrap()).collect();
    let refused = publish(4).err().unwrap();
    assert!(refused.to_string().contains("this process uses 4 slots already"), "{refused}");
    assert!(!refused.is_transient(), "it stays until this process drops one");
    let other = publisher(daemon.directory.path());
    until("samples of the other process", || base(&clients[0]).filter(|imu| imu.fresh));
    drop(other);
    kept.pop();
    assert!(publish(4).is_ok());
}
