//! Other users who pretend to be a process of motord, or hide one: they create its files and sockets
//! first, or fill a queue. Most tests need root, to become another user.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::deadman::{DAMPING, Recorder, Switch, beating, safe_frames};
use crate::player::{Player, become_user};
use crate::registrar::Registration;
use crate::safe_stop::{can, configuration, motord, no_can, text};
use motord_bus::{BusLock, Holder, candump, clock};
use motord_core::stopper::Outlet;
use motord_deadman::channel::{Answer, Channel, Listener, Request};
use motord_deadman::safe_frames::InterfaceError;
use motord_deadman::server::Server;
use motord_ports::instance::Instance;
use motord_ports::stop_socket::{self, AskedStop, CONFIRMED, StopError};
use nix::sys::socket::{Backlog, MsgFlags, SockFlag, accept, bind, listen, send};
use nix::unistd::{Gid, chown};
use std::fs::{self, Permissions};
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::mpsc::channel;
use std::thread::sleep;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Variable for a process that becomes another user and plays the switch: its runtime directory.
const PLAY: &str = "MOTORD_TEST_PLAY_IMPOSTOR";
/// The same for the socket of emergency stops.
const PLAY_STOP: &str = "MOTORD_TEST_PLAY_STOP_SOCKET";
/// A user who owns nothing, and the group whose members share the directory.
const MEMBER: u32 = 65_534;
/// Longer than a busy machine stalls.
const PATIENCE: Duration = Duration::from_secs(20);

/// Returns a directory like that of the service, `/run/motord`. `None` where no member can be
/// played.
fn shared() -> Option<(TempDir, Instance)> {
    if !nix::unistd::geteuid().is_root() {
        println!("not run: only root can become another user");
        return None;
    }
    let directory = TempDir::new().unwrap();
    chown(directory.path(), None, Some(Gid::from_raw(MEMBER))).unwrap();
    fs::set_permissions(directory.path(), Permissions::from_mode(0o3770)).unwrap();
    let instance = Instance::below(directory.path(), "test").unwrap();
    Some((directory, instance))
}

/// Starts a process of a member that answers as the dead man's switch.
fn impostor(runtime: &Path) -> Player {
    Player::start("impostors::plays_the_switch", &[(PLAY, runtime.as_os_str())], "listens")
}

/// Runs in the process of [`impostor`]; not a test of its own.
#[test]
fn plays_the_switch() {
    let Some(runtime) = std::env::var_os(PLAY) else { return };
    let instance = Instance::below(Path::new(&runtime), "test").unwrap();
    become_user(MEMBER);
    let listener = Listener::bind(&instance).unwrap();
    let socket = instance.runtime().join("test.deadman");
    fs::set_permissions(socket, Permissions::from_mode(0o777)).unwrap();
    println!("listens");
    let mut daemons: Vec<Channel> = Vec::new();
    loop {
        daemons.extend(listener.accept().ok());
        for daemon in &daemons {
            match daemon.receive::<Request>() {
                Ok((Request::Register(_), _)) => daemon.send(&Answer::Registered, None).unwrap(),
                Ok((Request::AskWhetherActing, _)) => {
                    let _gone = daemon.send(&Answer::Acting(vec!["can0".into()]), None);
                }
                Err(_) => daemon.beat(),
            }
        }
        sleep(Duration::from_millis(5));
    }
}

/// Goal: the daemon never counts a member's process as its dead man's switch, and the real switch
/// replaces it.
#[test]
fn daemon_registers_with_no_switch_of_a_member() {
    let Some((directory, instance)) = shared() else { return };
    let impostor = impostor(directory.path());
    let (heartbeat, pulse) = beating();
    let registration = Registration::start(&instance, pulse);
    let hears = &registration.lost;
    assert!(hears.recv_timeout(PATIENCE).unwrap(), "no switch yet");
    let watched = hears.recv_timeout(Duration::from_secs(3));
    assert!(watched.is_err(), "the daemon believes that process {} watches it", impostor.id());
    let switch = Switch::start(&instance);
    assert!(!hears.recv_timeout(PATIENCE).unwrap(), "the real switch watches");
    let (_, first) = switch.sent.recv_timeout(PATIENCE).unwrap();
    assert_eq!(candump::frame(DAMPING), Some(first), "this heartbeat stands still");
    heartbeat.rest();
    registration.end();
}

/// Runs in the process of a member that has the name of the socket for emergency stops; not a test of its own.
#[test]
fn plays_the_stop_socket() {
    let Some(runtime) = std::env::var_os(PLAY_STOP) else { return };
    let instance = Instance::below(Path::new(&runtime), "test").unwrap();
    become_user(MEMBER);
    let listener = stop_socket::open(SockFlag::empty()).unwrap();
    bind(listener.as_raw_fd(), &stop_socket::address(&instance).unwrap()).unwrap();
    listen(&listener, Backlog::new(8).unwrap()).unwrap();
    println!("listens");
    loop {
        let caller = accept(listener.as_raw_fd()).unwrap();
        send(caller, CONFIRMED, MsgFlags::empty()).unwrap();
    }
}

/// Goal: an emergency stop that a member's process confirms is not confirmed.
#[test]
fn stop_that_a_member_confirms_is_unconfirmed() {
    let Some((directory, instance)) = shared() else { return };
    let role = "impostors::plays_the_stop_socket";
    let impostor = Player::start(role, &[(PLAY_STOP, directory.path().as_os_str())], "listens");
    let outcome = AskedStop::send(&instance, PATIENCE).unwrap().confirm(PATIENCE);
    let Err(StopError::NotTrusted(found)) = outcome else { panic!("{outcome:?}") };
    assert_eq!((found.pid.cast_unsigned(), found.uid), (impostor.id(), MEMBER));
}

/// Goal: a member who claims that the switch acts does not keep `motord safe-stop` from damping.
#[test]
fn safe_stop_believes_no_switch_of_a_member() {
    let Some((directory, _instance)) = shared() else { return };
    let _impostor = impostor(directory.path());

    let config = configuration(directory.path(), &can(&no_can("lie")));
    let begun = Instant::now();
    let output = motord(directory.path(), &["safe-stop"], &config).output().unwrap();
    let said = text(&output);
    assert!(said.contains("answers instead of motord"), "{said}");
    assert!(!said.contains("left to the dead man's switch"), "{said}");
    assert!(begun.elapsed() < Duration::from_secs(2), "{said}");
}

/// Fills the queue of connections to the lock of `interface`, as any user can: the holder is unknown
/// from then on.
fn hide_holder(interface: &str) {
    let begun = Instant::now();
    while BusLock::holder_of_interface(interface) != Some(Holder(None)) {
        assert!(begun.elapsed() < PATIENCE, "the kernel still names the holder");
    }
}

/// Returns the number of frames that a switch sends for a daemon that died, where another process
/// holds the interface's lock and the holder is hidden. The switch was frozen for `frozen` meanwhile.
fn frames_beside_hidden_holder(frozen: Duration) -> usize {
    let directory = TempDir::new().unwrap();
    let instance = Instance::below(directory.path(), "test").unwrap();
    let (sends, sent) = channel();
    let open =
        |_: &str, _| -> Result<Box<dyn Outlet>, InterfaceError> { Ok(Box::new(Recorder::new(&sends))) };
    let mut server = Server::new(Listener::bind(&instance).unwrap(), open);
    let mut frames = safe_frames();
    frames.buses[0].interface = no_can("hide");
    let interface = frames.buses[0].interface.clone();
    let (heartbeat, pulse) = beating();
    let daemon = Channel::connect(&instance, PATIENCE).unwrap();
    daemon.send(&Request::Register(frames), Some(&pulse)).unwrap();
    (0..2).for_each(|_| server.turn(clock::monotonic() + PATIENCE));
    let _successor = BusLock::interface(interface.parse().unwrap()).unwrap();
    hide_holder(&interface);
    // Filling the queue took time. These turns show the switch that it runs, and that the daemon does.
    for cycle in 2..4 {
        heartbeat.beat(cycle);
        server.turn(clock::monotonic());
    }
    drop(daemon);
    sleep(frozen);
    let _served = server.finish(clock::monotonic() + Duration::from_secs(1));
    (0..20).for_each(|_| server.turn(clock::monotonic() + Duration::from_millis(10)));
    sent.try_iter().count()
}

/// Goal: a switch that continues after SIGSTOP damps no motor of a living successor, although an
/// outsider hides who drives the interface. A switch that was not frozen damps as ever.
#[test]
fn frozen_switch_leaves_hidden_successor_alone() {
    assert_eq!(frames_beside_hidden_holder(Duration::from_millis(600)), 0);
    assert!(frames_beside_hidden_holder(Duration::ZERO) > 3, "no successor can be there so soon");
}
