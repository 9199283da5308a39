//! External IMUs: the real daemon, and publishers that are processes of their own.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_client::{Client, Error, Imu, ImuSample};
use motord_harness::daemon::{Daemon, PATIENCE, until};
use motord_ports::{ClientPorts, Instance};
use motord_shared::message::ImuMessage;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const CONFIG: &str = r#"
[daemon]
instance = "robot"
[cycle]
rate-hz = 500
max-lateness-ms = 1000.0
[[bus]]
name = "desk"
type = "simulated"
[[motor]]
name = "arm"
bus = "desk"
id = 1
protocol = "mit"
model = "GIM8108-8"
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

const LOST_AFTER: Duration = Duration::from_millis(200);
/// Variable for a process that publishes samples until it is killed: its runtime directory.
const PUBLISH: &str = "MOTORD_TEST_PUBLISH_IMU";

fn connect(place: &Path) -> Client {
    until("a daemon", || Client::connect_in(place, "robot").ok())
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

/// A process that publishes, killed when it is dropped.
struct Publisher(Child);

impl Publisher {
    fn kill(mut self) {
        kill(Pid::from_raw(self.0.id().cast_signed()), Signal::SIGKILL).unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        let _ended = self.0.kill();
        let _reaped = self.0.wait();
    }
}

/// Publishes at 1 kHz in another process.
fn publisher(place: &Path) -> Publisher {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["external_imu::publishing_process", "--exact", "--nocapture"]).env(PUBLISH, place);
    Publisher(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
}

/// Not a test: the process of [`publisher`].
#[test]
fn publishing_process() {
    let Some(place) = std::env::var_os(PUBLISH) else { return };
    let client = connect(Path::new(&place));
    let mut publisher = client.publish_imu("base").unwrap();
    loop {
        let _between_daemons = publisher.send(&sample());
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Goal: samples are in the state through the mount, a killed publisher is lost after `lost-after-ms`, the next one takes
/// over, and one survives a restart of the daemon.
#[test]
fn external_imu_follows_its_publishers() {
    let mut daemon = Daemon::start(CONFIG);
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

    first.kill();
    let lost = until("the loss", || base(&client).filter(|imu| imu.lost));
    let state = client.wait(PATIENCE).unwrap();
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
    third.kill();
}

/// Goal: a publisher that sends anything at 20 kHz and more changes nothing of the other IMUs, the motors and the cycle.
#[test]
fn hostile_publisher_changes_nothing_else() {
    let daemon = Daemon::start(CONFIG);
    let client = connect(daemon.directory.path());
    let owner = publisher(daemon.directory.path());
    until("a sample", || base(&client).filter(|imu| imu.fresh));
    let before = client.wait(PATIENCE).unwrap();
    let attachment = Instance::below(daemon.directory.path(), "robot").unwrap().attach().unwrap().unwrap();
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
    let after = client.wait(PATIENCE).unwrap();
    let imu = base(&client).unwrap();
    assert!(imu.rejected > 1000 && !imu.lost, "{imu:?}");
    let others =
        [&before, &after].map(|state| (state.imu(0).unwrap().rejected, state.joint(0).unwrap().missed));
    assert_eq!(others[0], others[1], "rejected samples of the other IMU, missed replies");
    owner.kill();
}
