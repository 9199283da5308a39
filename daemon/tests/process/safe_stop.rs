//! `motord safe-stop`, and the frames that it and the dead man's switch send.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::deadman::{Recorder, dead_with_a_jam};
use motord_bus::{Arrival, Bus, BusLock, Content, Frame, FrameId, Inbox, Instant, Readiness, Sent};
use motord_configuration as config;
use motord_core::stopper::Outlet;
use motord_deadman::safe_frames::{InterfaceError, InterfaceFrames, SafeFrames};
use motord_deadman::safe_stop::safe_stop;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;
use tempfile::TempDir;

pub(crate) const SIMULATED: &str = "type = 'simulated'";

/// Writes a file with a motor of each protocol on `interface`.
pub(crate) fn configuration(directory: &Path, bus: &str) -> PathBuf {
    let path = directory.join("test.toml");
    let text = format!(
        "[daemon]\ninstance = 'test'\n[safety]\ndamp-seconds = 0.2\n[[bus]]\nname = 'front'\n{bus}\n\
         [[motor]]\nname = 'hip'\nbus = 'front'\nid = 1\nprotocol = 'mit'\nmodel = 'GIM8108-8'\ndamping-kd = 2.0\n\
         [[motor]]\nname = 'jaw'\nbus = 'front'\nid = 2\nprotocol = 'gim'\nmodel = 'GIM3505-8'\n"
    );
    fs::write(&path, text).unwrap();
    path
}

/// Returns a name without an interface, used by one test: an interface has one lock on the whole
/// machine.
pub(crate) fn no_can(test: &str) -> String {
    format!("{test}{}", std::process::id())
}

pub(crate) fn can(interface: &str) -> String {
    format!("type = 'socketcan'\ninterface = '{interface}'")
}

/// An interface that cannot be read.
fn deaf(_: &str) -> Option<Box<dyn Bus>> {
    None
}

/// An interface on which answers with these ids arrive, once each.
fn answers(ids: &'static [u16]) -> impl FnMut(&str) -> Option<Box<dyn Bus>> {
    struct Answering(Vec<u16>);

    impl Bus for Answering {
        fn send(&mut self, _now: Instant, _frames: &[Frame]) -> Sent {
            panic!("it is opened to receive")
        }

        fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
            let Some(id) = self.0.pop() else { return };
            let frame = Frame::classic(FrameId::new(id).unwrap(), [0; 8]);
            inbox.push(Arrival { at: now, content: Content::Frame(frame) }).unwrap();
        }

        fn readiness(&self) -> Readiness<'_> {
            Readiness::Never
        }
    }
    |_: &str| Some(Box::new(Answering(ids.to_vec())) as Box<dyn Bus>)
}

/// Goal: a motor without power is not taken for a stopped one.
#[test]
fn safe_stop_names_motors_that_do_not_answer() {
    let directory = TempDir::new().unwrap();
    let path = configuration(directory.path(), &can(&no_can("quiet")));
    let (recorder, _sent) = channel();
    let stop = |ids: &'static [u16]| {
        safe_stop(&path, &mut |_, _| Ok(Box::new(Recorder::new(&recorder))), &mut answers(ids))
    };
    stop(&[0x102, 0x101]).unwrap();
    let error = stop(&[0x101]).unwrap_err();
    assert_eq!(
        (error.to_string().as_str(), error.exit_status()),
        ("the stop was sent, but these motors do not answer and may still move, so cut the power: jaw", 80)
    );
    let error = stop(&[]).unwrap_err().to_string();
    assert!(error.ends_with("cut the power: hip, jaw"), "{error}");
}

/// By the formula of the MIT document: position and torque 0, kp 0, kd 2 of 5 N·m·s/rad, zero above
/// and below the middle of the codes of velocity and torque. Stop is its special frame. The native
/// stop has a tail that is neutral in MIT.
#[test]
fn safe_frames_match_documented_damping_and_stop() {
    let directory = TempDir::new().unwrap();
    let settings = config::load(&configuration(directory.path(), &can("nocan0"))).unwrap().settings;
    let frames = SafeFrames::of(&settings);
    let gim_stop = || "002#9200800000000800".to_owned();
    let expected = InterfaceFrames {
        baud: None,
        interface: "nocan0".into(),
        damp: ["001#8000800000666800", "001#80007FF0006667FF"].map(|damp| vec![damp.into(), gim_stop()]),
        stop: vec!["001#FFFFFFFFFFFFFFFD".into(), gim_stop()],
    };
    assert_eq!((frames.damp, frames.buses), (Duration::from_millis(200), vec![expected]));
}

#[test]
fn a_safe_stop_damps_and_stops_once() {
    let directory = TempDir::new().unwrap();
    let (recorder, sent) = channel();
    let path = configuration(directory.path(), &can(&no_can("once")));
    safe_stop(&path, &mut |_, _| Ok(Box::new(Recorder::new(&recorder))), &mut deaf).unwrap();
    let sent: Vec<u8> = sent.try_iter().map(|(_, frame)| frame.payload()[7]).collect();
    // The last bytes of both damping frames and of stop of the one motor, and of stop of the other.
    let (damped, stopped) = sent.split_at(sent.len() - 6);
    assert!(damped.len() >= 4 && damped.chunks(4).all(|two| two == [0x00, 0x00, 0xFF, 0x00]), "{sent:x?}");
    assert_eq!(stopped, [0xFD, 0x00, 0xFD, 0x00, 0xFD, 0x00]);
}

#[test]
fn safe_stop_reports_motors_without_frames() {
    let directory = TempDir::new().unwrap();
    let interface = no_can("jam");
    let path = configuration(directory.path(), &can(&interface));
    let error =
        safe_stop(&path, &mut |_, _| Ok(Box::new(Recorder::jammed())), &mut answers(&[])).unwrap_err();
    assert_eq!(error.to_string(), format!("not told to stop: {interface} refuses frames"));
}

pub(crate) fn motord(runtime: &Path, arguments: &[&str], config: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_motord"));
    command.args(arguments).arg("--config").arg(config).env("MOTORD_RUNTIME_DIR", runtime);
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub(crate) fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Goal: two daemons with two runtime directories never drive one interface.
#[test]
fn driven_interface_is_refused_across_runtime_directories() {
    let directory = TempDir::new().unwrap();
    let interface = no_can("two");
    let _driven = BusLock::interface(interface.parse().unwrap()).unwrap();
    let config = configuration(directory.path(), &can(&interface));
    let output = motord(directory.path(), &["run"], &config).output().unwrap();
    assert_eq!(output.status.code(), Some(75), "{}", text(&output));
    let holder = format!("{interface} is in use by process {}", std::process::id());
    assert!(text(&output).contains(&holder), "{}", text(&output));
}

/// Goal: `motord safe-stop` does not interfere with a daemon of another user or another runtime
/// directory.
/// Method: this process holds the interface; no runtime directory contains it.
#[test]
fn safe_stop_leaves_driven_interfaces_alone() {
    let directory = TempDir::new().unwrap();
    let interface = no_can("held");
    let _driven = BusLock::interface(interface.parse().unwrap()).unwrap();
    let path = configuration(directory.path(), &can(&interface));
    let sends = |_: &str, _| -> Result<Box<dyn Outlet>, InterfaceError> { panic!("it opens the interface") };
    let error = safe_stop(&path, &mut { sends }, &mut deaf).unwrap_err().to_string();
    let holder = std::process::id();
    assert!(error.contains(&format!("{interface} is in use by process {holder}")), "{error}");
}

/// The switch holds the interface, so two senders do not interrupt each other's damping.
#[test]
fn safe_stop_reports_what_switch_cannot_reach() {
    let (directory, _instance, _switch) = dead_with_a_jam();
    let config = configuration(directory.path(), &can(&no_can("far")));
    let output = motord(directory.path(), &["safe-stop"], &config).output().unwrap();
    assert_eq!(output.status.code(), Some(69), "{}", text(&output));
    let complaint = "not told to stop: can1 refuses frames; the dead man's switch keeps trying";
    assert!(text(&output).contains(complaint), "{}", text(&output));
}

#[test]
fn safe_stop_names_the_interface_it_missed() {
    let directory = TempDir::new().unwrap();
    let interface = no_can("tells");
    let config = configuration(directory.path(), &can(&interface));
    let output = motord(directory.path(), &["safe-stop"], &config).output().unwrap();
    assert_eq!(output.status.code(), Some(69), "{}", text(&output));
    assert!(text(&output).contains(&interface), "{}", text(&output));
    let simulated = configuration(directory.path(), SIMULATED);
    let output = motord(directory.path(), &["safe-stop"], &simulated).output().unwrap();
    assert!(output.status.success(), "simulated motors died with their daemon: {}", text(&output));
}
