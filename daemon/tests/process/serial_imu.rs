//! IMUs on serial lines: the real daemon, and `motord-sim` with its own encoders on pseudo
//! terminals.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_client::{Cause, Client, Error, Imu, ImuContradiction, Phase, Refusal, Setpoint, State};
use motord_harness::conventions::CONVENTIONS;
use motord_harness::daemon::{Daemon, bench_at, until};
use motord_harness::programs::Process;
use motord_protocol::imu::hipnuc::serial::encode as hipnuc_frame;
use motord_protocol::imu::xsens::{MESSAGE_LEN_MAX, encode as xsens_frame};
use motord_protocol::imu::{DeviceTime, Quaternion, Sample};
use nix::pty::openpty;
use nix::unistd::ttyname;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longer than a busy machine stalls: an IMU that is lost sooner is not lost by this time.
const LOST_AFTER: Duration = Duration::from_secs(10);
/// The sensors of both are on one body, and sway together.
const SENSORS: &str = r#"
limits = { position-rad = [-1, 1] }
[[group]]
name = "arms"
joints = ["arm"]
[[imu]]
name = "base"
type = "hipnuc-serial"
device = "PLACE/hipnuc"
lost-after-ms = 10000
when-lost = "stop"
[[imu]]
name = "head"
type = "xsens"
device = "PLACE/xsens"
baud = 921600
rate-hz = 200
mount-rpy-deg = [0, 0, 90]
lost-after-ms = 10000
"#;

fn config(directory: &Path) -> String {
    let patient = "start-timeout-ms = 10000.0\nlost-cycles = 1000";
    let robot = bench_at(500).replace("deadman-ms = 2000.0", patient);
    let robot = robot.replace("[safety]", "max-skipped-percent = 100.0\n[safety]");
    robot + &SENSORS.replace("PLACE", directory.to_str().unwrap())
}

/// The simulated sensors: another process, since a child of this one would keep their terminals
/// open.
struct Sensors {
    process: Process,
    output: BufReader<ChildStdout>,
}

impl Sensors {
    fn start(directory: &Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_motord-sim"));
        command.arg("--config").arg(directory.join("motord.toml")).arg("--link").arg(directory);
        let mut process = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let output = BufReader::new(process.stdout.take().unwrap());
        let mut sensors = Self { process: Process(process), output };
        sensors.until("ready");
        sensors
    }

    fn until(&mut self, expected: &str) {
        let mut line = String::new();
        while line.trim_end() != expected {
            line.clear();
            assert!(self.output.read_line(&mut line).unwrap() > 0, "it ended before {expected}");
            assert!(!line.starts_with("error"), "{line}");
        }
    }

    fn obey(&mut self, verb: &str) {
        writeln!(self.process.0.stdin.as_mut().unwrap(), "{verb}").unwrap();
        self.until("ok");
    }
}

/// A running daemon.
struct Robot {
    daemon: Daemon,
    client: Client,
}

impl Robot {
    fn start() -> Self {
        let directory = TempDir::new().unwrap();
        let config = config(directory.path());
        let daemon = Daemon::start_in(directory, &config, |_| {});
        let client = until("a daemon", || Client::connect_in(daemon.directory.path(), "bench").ok());
        Self { daemon, client }
    }

    /// Returns the runtime directory, with the links to the sensors.
    fn directory(&self) -> &Path {
        self.daemon.directory.path()
    }

    fn state(&self) -> State {
        until("a state", || self.client.wait(Duration::from_secs(1)).ok())
    }

    fn imu(&self, name: &str) -> Imu {
        self.state().imu(self.client.imu(name).unwrap()).unwrap()
    }

    /// Waits for an IMU that is as `wanted`.
    fn await_imu(&self, name: &str, wanted: impl Fn(&Imu) -> bool) -> Imu {
        until(name, || Some(self.imu(name)).filter(|imu| wanted(imu)))
    }

    fn await_fresh(&self) {
        for name in ["base", "head"] {
            self.await_imu(name, |imu| imu.fresh && !imu.lost);
        }
    }

    fn device(&self) -> PathBuf {
        std::fs::read_link(self.directory().join("hipnuc")).unwrap()
    }
}

/// The axes x, y and z of the body, in the world.
fn axes(imu: &Imu) -> [[f32; 3]; 3] {
    let [w, x, y, z] = imu.orientation().unwrap();
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// The largest difference between two vectors' parts.
fn difference(one: [f32; 3], other: [f32; 3]) -> f32 {
    one.iter().zip(other).map(|(one, other)| (one - other).abs()).fold(0.0, f32::max)
}

/// Goal: a daemon starts without its devices, refuses to enable, and takes samples through the
/// mount when they are plugged in. Method: x of the sensor of `head` is y of the body. While both
/// are stuck, their values are those of two moments of one slow motion.
#[test]
fn late_devices_deliver_samples_through_the_mount() {
    let robot = Robot::start();
    assert!(robot.imu("base").lost && robot.imu("head").lost);
    until("a refusal", || match robot.client.claim("arms").unwrap().enable() {
        Err(Error::Refused { refusal: Refusal::ImuLost, .. }) => Some(()),
        _motor_is_not_known_yet => None,
    });
    let mut sensors = Sensors::start(robot.directory());
    robot.await_fresh();
    let (base, head) = until("samples of one moment", || {
        let state = robot.state();
        let [base, head] = ["base", "head"].map(|name| state.imu(robot.client.imu(name).unwrap()).unwrap());
        (base.receive_ns.abs_diff(head.receive_ns) < 20_000_000).then_some((base, head))
    });
    let ([bx, by, bz], [hx, hy, hz]) = (axes(&base), axes(&head));
    // 0.5 rad/s at most, 20 ms apart.
    assert!(
        difference(hy, bx) < 0.05 && difference(hx.map(|part| -part), by) < 0.05,
        "{hx:?} {hy:?} {bx:?} {by:?}"
    );
    assert!(difference(hz, bz) < 0.05, "{hz:?} {bz:?}");
    for imu in [base, head] {
        let ([x, y, z], force) = (axes(&imu), imu.acceleration().unwrap());
        let up = [0, 1, 2].map(|part| x[part] * force[0] + y[part] * force[1] + z[part] * force[2]);
        assert!(difference(up, [0.0, 0.0, 9.81]) < 0.3, "{up:?}");
        assert_eq!((imu.temperature, imu.rejected), (Some(35.0), 0));
    }
    // A device that repeats a sample goes on counting.
    sensors.obey("head stuck");
    let before = robot.await_imu("head", |imu| imu.fresh);
    robot.await_imu("head", |imu| imu.sequence > before.sequence + 20);
}

/// Goal: an unplugged device is lost at once and not by its timeout, stops the moving robot, and is
/// fresh again when it is plugged in, also as another node.
#[test]
fn unplugged_device_stops_the_robot_and_returns() {
    let robot = Robot::start();
    let mut sensors = Sensors::start(robot.directory());
    robot.await_fresh();
    let mut claim = robot.client.claim("arms").unwrap();
    until("the robot moves", || {
        claim.send(&[Setpoint::damping(0.5)]).unwrap();
        let group = robot.state().group(claim.index()).unwrap();
        if group.phase == Some(Phase::Disarmed) {
            let _not_yet = claim.enable();
        }
        (group.phase == Some(Phase::Active)).then_some(())
    });
    let node = robot.device();
    sensors.obey("base gone");
    let (state, lost) = until("the loss", || {
        let _stopped = claim.send(&[Setpoint::damping(0.5)]);
        let state = robot.state();
        let imu = state.imu(0).unwrap();
        imu.lost.then_some((state, imu))
    });
    let silent = Duration::from_nanos(state.tick_ns() - lost.receive_ns);
    println!("lost {silent:?} after its last sample");
    assert!(silent < LOST_AFTER, "{silent:?}");
    assert_eq!(until("the stop", || robot.state().group(0)?.cause), Cause::ImuLost);
    assert!(!robot.imu("head").lost);

    // More than one: other tests may have freed lower numbers.
    let _take_the_name: Vec<_> = (0..64).map(|_| openpty(None, None).unwrap()).collect();
    sensors.obey("base ok");
    assert_ne!(robot.device(), node, "it is another node now");
    let again = robot.await_imu("base", |imu| imu.fresh && !imu.lost);
    assert!(again.sequence > lost.sequence && again.missing == lost.missing, "a new connection has no gap");
}

/// Goal: of a damaged stream only intact samples are published. Method: one byte in 200 is changed,
/// a third of the samples.
#[test]
fn damaged_samples_are_counted_and_not_published() {
    let robot = Robot::start();
    let mut sensors = Sensors::start(robot.directory());
    robot.await_fresh();
    sensors.obey("base corrupt 0.5%");
    let begun = robot.imu("base");
    let mut end = begun;
    while end.sequence < begun.sequence + 200 {
        end = robot.await_imu("base", |imu| imu.fresh);
        let [roll, pitch, yaw] = end.roll_pitch_yaw().unwrap();
        assert!(roll.abs() < 0.05 && pitch.abs() < 0.05 && yaw.abs() < 0.25, "{end:?}");
        let force = end.acceleration().unwrap().iter().map(|part| part * part).sum::<f32>().sqrt();
        assert!((force - 9.81).abs() < 0.5, "{end:?}");
    }
    println!("{end:?}");
    assert!(end.rejected > begun.rejected + 20, "{end:?}");
}

/// Firmware of each convention: both protocols carry it, and the mount of `head` turns its axes.
/// HiPNUC has G on the wire: its "in g" is a firmware that divides twice.
#[test]
fn each_convention_of_a_serial_sensor_is_named() {
    let robot = Robot::start();
    let open = |name: &str| {
        let ends = openpty(None, None).unwrap();
        std::os::unix::fs::symlink(ttyname(&ends.slave).unwrap(), robot.directory().join(name)).unwrap();
        (std::fs::File::from(ends.master), ends.slave)
    };
    let ((mut hipnuc, _hipnuc_stays), (mut xsens, _xsens_stays)) = (open("hipnuc"), open("xsens"));
    let mut counter = 0_u16;
    for convention in &CONVENTIONS {
        let (names, begun) = (convention.names(), Instant::now());
        until(&format!("{names:?} of both"), || {
            counter = counter.wrapping_add(1);
            let sample = Sample {
                orientation: Some(Quaternion::from(convention.orientation)),
                angular_velocity: Some([0.002 * f32::from(counter % 7), 0.0, 0.0]),
                acceleration: Some(convention.noisy(counter.into())),
                counter: Some(counter),
                time: Some(DeviceTime { ticks: 10 * u32::from(counter), per_second: 1000 }),
                ..Sample::default()
            };
            hipnuc.write_all(&hipnuc_frame(&sample)).unwrap();
            xsens.write_all(xsens_frame(&sample, &mut [0; MESSAGE_LEN_MAX])).unwrap();
            std::thread::sleep(Duration::from_millis(10));
            let is_named = |name: &str| {
                let imu = robot.imu(name);
                !imu.lost && imu.contradictions().map(ImuContradiction::name).eq(names.iter().copied())
            };
            (is_named("base") && is_named("head")).then_some(())
        });
        println!("{names:?} after {:?}", begun.elapsed());
    }
}

/// The processor time of the threads that read serial IMUs, in ticks of 10 ms.
fn reader_ticks(pid: u32) -> u64 {
    let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let stats = tasks.filter_map(|task| std::fs::read_to_string(task.unwrap().path().join("stat")).ok());
    let fields = |stat: String| -> Vec<u64> {
        let fields = stat.rsplit(')').next().unwrap().split_whitespace();
        fields.map(|field| field.parse().unwrap_or_default()).collect()
    };
    // utime and stime of proc_pid_stat(5), fields 14 and 15; the third is the first here.
    let times = stats.filter(|stat| stat.contains("(motord-imu-line)")).map(fields);
    times.map(|fields| fields[11] + fields[12]).sum()
}

/// Goal: a line full of random bytes is lost, and neither costs much nor disturbs the other IMU and
/// the motors.
#[test]
fn garbage_at_line_speed_changes_nothing_else() {
    let robot = Robot::start();
    let mut sensors = Sensors::start(robot.directory());
    robot.await_fresh();
    sensors.obey("head garbage");
    let (begun, ticks) = (robot.imu("head"), reader_ticks(robot.daemon.process.id()));
    let (base, first, since) = (robot.imu("base"), robot.state(), Instant::now());
    robot.await_imu("base", |imu| imu.sequence > base.sequence + 300);
    let (percent, last) = (reader_ticks(robot.daemon.process.id()) - ticks, robot.state());
    let percent = percent as f64 / since.elapsed().as_secs_f64();
    println!("{percent:.1} % of a processor");
    assert!(percent < 20.0, "{percent} % of a processor");
    let end = robot.imu("head");
    assert_eq!(end.sequence, begun.sequence, "no random bytes are published");
    assert!(!robot.imu("base").lost);
    let [before, after] = [&first, &last].map(|state| (state.joint(0).unwrap().missed, state.overruns()));
    println!("missed replies and ticks before {before:?}, after {after:?}");
    until("a motor that answers", || robot.state().joint(0).unwrap().fresh.then_some(()));
    sensors.obey("head ok");
    robot.await_fresh();
}
