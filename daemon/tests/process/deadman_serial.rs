//! The switch stops motors on a serial port that no other process stops, and delays no CAN
//! interface.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::{Duration, Frame, FrameId, Instant, Monotonic, Refusal};
use motord_core::stopper::Outlet;
use motord_deadman::interfaces::{Interface, Interfaces};
use motord_deadman::safe_frames::InterfaceFrames;
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::termios::{FlowArg, tcflow};
use std::fs::File;
use std::io::Read;
use std::os::fd::OwnedFd;
use std::sync::mpsc::{Sender, channel};

const DAMP: Duration = Duration::from_millis(300);
const STOP: [u8; 8] = [0x92, 0, 0x80, 0, 0, 0, 8, 0];

/// A CAN interface that reports the times of its frames.
struct Recorder(Sender<Instant>);

impl Outlet for Recorder {
    fn send_round(&mut self, now: Instant, _frames: &[Frame]) -> Option<Refusal> {
        self.0.send(now).unwrap();
        None
    }
}

fn pty() -> (File, OwnedFd, String) {
    let OpenptyResult { master, slave } = openpty(None, None).unwrap();
    // A program that another test starts meanwhile would keep the terminal from hanging up.
    for end in [&master, &slave] {
        fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
    }
    let device = nix::unistd::ttyname(&slave).unwrap().to_str().unwrap().to_owned();
    (master.into(), slave, device)
}

/// Runs a stop of `can0` and of two motors on `device`. Returns the times of the rounds on `can0`,
/// and the interfaces that were not served.
fn stop(device: &str) -> (Vec<Instant>, Vec<String>) {
    let (sent, rounds) = channel();
    let mut open = |_: &str, _: u32| -> Result<Box<dyn Outlet>, _> { Ok(Box::new(Recorder(sent.clone()))) };
    let can = InterfaceFrames {
        interface: "can0".into(),
        baud: None,
        damp: [vec!["001#0000000000000000".into()], vec!["001#0000000000000000".into()]],
        stop: vec!["001#0101010101010101".into()],
    };
    let frames = [1, 2].map(|id| Frame::classic(FrameId::from(id), STOP).to_string()).to_vec();
    let port = InterfaceFrames {
        interface: device.into(),
        baud: Some(921_600),
        damp: [frames.clone(), frames.clone()],
        stop: frames,
    };
    let opened = [port, can].map(|frames| Interface::open(&frames, &mut open).unwrap());
    let mut interfaces = Interfaces::new(opened, DAMP);
    interfaces.run(&mut Monotonic);
    (rounds.try_iter().collect(), interfaces.unserved())
}

/// Returns the longest time from one round to the next.
fn longest_gap(rounds: &[Instant]) -> Duration {
    rounds.windows(2).map(|pair| pair[1].since(pair[0])).max().unwrap()
}

#[test]
fn motors_of_line_are_stopped_in_turn() {
    let (mut motors, _host, device) = pty();
    let (rounds, unserved) = stop(&device);
    assert_eq!((rounds.len(), unserved), (33, vec![]), "30 rounds that damp, and 3 that stop");
    let mut received = [0; 12 * 2 * 30];
    motors.read_exact(&mut received).unwrap();
    for (round, frames) in received.chunks(24).enumerate() {
        let of = |id: u8| [&[id, 0, 8, id ^ 8][..], &STOP].concat();
        assert_eq!(frames, [of(1), of(2)].concat(), "round {round}: table 3 of the GIM document");
    }
}

/// A port that is missing, one that accepts no byte, and one that is unplugged meanwhile.
#[test]
fn no_can_interface_waits_for_a_port() {
    let (_motors, host, blocked) = pty();
    tcflow(&host, FlowArg::TCOOFF).unwrap();
    let (motors, own, terminal) = pty();
    // The kernel gives the name of the terminal to the next one, which another test may open.
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("ttyUSB0");
    std::os::unix::fs::symlink(terminal, &link).unwrap();
    let unplugged = link.to_str().unwrap().to_owned();
    let unplugs = std::thread::spawn(move || {
        std::thread::sleep(DAMP / 2);
        std::fs::remove_file(link).unwrap();
        drop((motors, own));
    });
    for device in [unplugged.as_str(), blocked.as_str(), "/dev/motord-is-not-here"] {
        let (rounds, unserved) = stop(device);
        let gap = longest_gap(&rounds);
        println!("{device}: {} rounds on can0, at most {gap:?} apart", rounds.len());
        assert_eq!(unserved, [device], "it is not said to be served");
        assert_eq!(rounds.len(), 33, "{device}");
        assert!(gap < Duration::from_millis(50), "{device}: {gap:?} instead of 10 ms");
    }
    unplugs.join().unwrap();
}
