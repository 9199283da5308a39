//! Other users who pretend to be a process of motord, or hide one: they create its files and
//! sockets first, or fill a queue. Most tests need root, to become another user.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::deadman::{DAMPING, Recorder, Switch, beating, safe_frames};
use crate::player::{Player, become_user};
use crate::registrar::Registration;
use crate::safe_stop::{can, configuration, motord, no_can, text};
use motord_bus::{BusLock, candump, clock};
use motord_core::stopper::Outlet;
use motord_deadman::channel::{Answer, Channel, Listener, Request};
use motord_deadman::safe_frames::InterfaceError;
use motord_deadman::safe_stop::safe_stop;
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
const TIMEOUT: Duration = Duration::from_secs(20);

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
                    let _disconnected = daemon.send(&Answer::Acting(vec!["can0".into()]), None);
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
    let losses = &registration.lost;
    assert!(losses.recv_timeout(TIMEOUT).unwrap(), "no switch yet");
    let watched = losses.recv_timeout(Duration::from_secs(3));
    assert!(watched.is_err(), "the daemon believes that process {} watches it", impostor.id());
    let switch = Switch::start(&instance);
    assert!(!losses.recv_timeout(TIMEOUT).unwrap(), "the real switch watches");
    let (_, first) = switch.sent.recv_timeout(TIMEOUT).unwrap();
    assert_eq!(candump::frame(DAMPING), Some(first), "this heartbeat stands still");
    heartbeat.rest();
    registration.end();
}

/// Runs in the process of a member that has the name of the socket for emergency stops; not a test
/// of its own.
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
    let outcome = AskedStop::send(&instance, TIMEOUT).unwrap().confirm(TIMEOUT);
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
    let printed = text(&output);
    assert!(printed.contains("answers instead of motord"), "{printed}");
    assert!(!printed.contains("left to the dead man's switch"), "{printed}");
    assert!(begun.elapsed() < Duration::from_secs(2), "{printed}");
}

/// Variable for a process that becomes another user and holds the lock of an interface: its name.
const PLAY_HOLDER: &str = "MOTORD_TEST_PLAY_HOLDER";

/// Starts a process of an outsider that holds the lock of `interface`. `None` where no outsider can
/// be played.
fn outsider(interface: &str) -> Option<Player> {
    if !nix::unistd::geteuid().is_root() {
        println!("NOT TESTED: only root can become another user");
        return None;
    }
    Some(Player::start("impostors::plays_the_holder", &[(PLAY_HOLDER, interface.as_ref())], "holds"))
}

/// Runs in the process of [`outsider`]; not a test of its own.
#[test]
fn plays_the_holder() {
    let Ok(interface) = std::env::var(PLAY_HOLDER) else { return };
    become_user(MEMBER);
    let _lock = BusLock::interface(interface.parse().unwrap()).unwrap();
    println!("holds");
    sleep(TIMEOUT);
}

fn hidden(interface: &str) -> bool {
    let name = BusLock::holders_of_interface(interface, false)[1];
    name.is_some_and(|holder| holder.uid.is_none())
}

/// Fills the queue of connections to the lock of `interface`, as any user can: no connection shows
/// the holder from then on.
fn hide_holder(interface: &str) {
    let begun = Instant::now();
    while !hidden(interface) {
        assert!(begun.elapsed() < TIMEOUT, "the kernel still names the holder");
    }
}

/// Returns the number of frames that a switch sends for a daemon that died. `hold` makes another
/// process hold the lock of the interface meanwhile. The switch is frozen for `frozen`.
fn frames_beside<T>(name: &str, frozen: Duration, hold: impl FnOnce(&str) -> T) -> usize {
    let directory = TempDir::new().unwrap();
    let instance = Instance::below(directory.path(), "test").unwrap();
    let (sends, sent) = channel();
    let open =
        |_: &str, _| -> Result<Box<dyn Outlet>, InterfaceError> { Ok(Box::new(Recorder::new(&sends))) };
    let mut server = Server::new(Listener::bind(&instance).unwrap(), open);
    let mut frames = safe_frames();
    frames.buses[0].interface = no_can(name);
    let interface = frames.buses[0].interface.clone();
    let (heartbeat, pulse) = beating();
    let daemon = Channel::connect(&instance, TIMEOUT).unwrap();
    daemon.send(&Request::Register(frames), Some(&pulse)).unwrap();
    (0..2).for_each(|_| server.turn(clock::monotonic() + TIMEOUT));
    let _held = hold(&interface);
    // That took time. These turns show the switch that it runs, and that the daemon does.
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

fn hidden_successor(interface: &str) -> BusLock {
    let successor = BusLock::interface(interface.parse().unwrap()).unwrap();
    hide_holder(interface);
    successor
}

/// Longer than the switch may be late without a successor.
const FROZEN: Duration = Duration::from_millis(600);

/// Goal: a switch that continues after SIGSTOP damps no motor of a living successor, although an
/// outsider hides who drives the interface. A switch that was not frozen damps as ever.
#[test]
fn frozen_switch_leaves_hidden_successor_alone() {
    assert_eq!(frames_beside("hide", FROZEN, hidden_successor), 0);
    assert!(frames_beside("hide", Duration::ZERO, hidden_successor) > 3, "no successor can be there so soon");
}

/// Goal: an outsider who takes the name of a lock, which is free once the daemon is dead, keeps no
/// motor driven.
#[test]
fn outsider_with_lock_stops_no_damping() {
    let plays = |interface: &str| outsider(interface).unwrap();
    if outsider(&no_can("probe")).is_none() {
        return;
    }
    for (frozen, name) in [(0, "o0"), (5, "o5"), (50, "o50"), (600, "o600")] {
        let frozen = Duration::from_millis(frozen);
        assert!(frames_beside(name, frozen, plays) > 3, "late by {frozen:?}");
        let hides = |interface: &str| {
            let outsider = plays(interface);
            hide_holder(interface);
            outsider
        };
        assert!(frames_beside(&format!("h{name}"), frozen, hides) > 3, "late by {frozen:?}, and hidden");
    }
}

/// Goal: the same for `motord safe-stop`, which ends with success. It names the holder, and what
/// ends it.
#[test]
fn safe_stop_damps_beside_outsider() {
    for hides in [false, true] {
        let (interface, directory) = (no_can(if hides { "veil" } else { "out" }), TempDir::new().unwrap());
        let Some(holder) = outsider(&interface) else { return };
        if hides {
            hide_holder(&interface);
        }
        let (recorder, sent) = channel();
        let path = configuration(directory.path(), &can(&interface));
        safe_stop(&path, &mut |_, _| Ok(Box::new(Recorder::new(&recorder))), &mut |_| None).unwrap();
        assert!(sent.try_iter().count() > 6, "hides: {hides}");
        let printed = text(&motord(directory.path(), &["safe-stop"], &path).output().unwrap());
        let (held, ends) = match hides {
            false => (format!("process {} (", holder.id()), format!("sudo kill {}", holder.id())),
            true => ("another process of user 65534".to_owned(), "sudo ss -xap".to_owned()),
        };
        assert!(
            printed.contains(&held) && printed.contains(&ends) && printed.contains(&interface),
            "{printed}"
        );
    }
}

/// Goal: `motord run` says who holds the lock of its bus, and what ends that.
#[test]
fn refused_daemon_names_holder_and_remedy() {
    let (interface, directory) = (no_can("run"), TempDir::new().unwrap());
    let Some(holder) = outsider(&interface) else { return };
    let config = configuration(directory.path(), &can(&interface));
    let output = motord(directory.path(), &["run"], &config).output().unwrap();
    let printed = text(&output);
    assert_eq!(output.status.code(), Some(75), "{printed}");
    let expected = [
        format!("process {} (", holder.id()),
        "of user 65534; ".into(),
        format!("`sudo kill {}`", holder.id()),
    ];
    assert!(expected.iter().all(|part| printed.contains(part)), "{printed}");
}
