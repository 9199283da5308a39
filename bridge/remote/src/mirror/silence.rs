//! The silence of a robot, after which its mirror opens the network again.
//!
//! Over UDP zenoh sends a declaration once. One that is lost leaves a robot that sends nothing: a
//! mirror whose robot is silent opens another session, which declares everything again. Frames carry
//! their whole key, so they need no declaration.

use super::wire::Wire;
use crate::config::Network;
use crate::network::{self, NetworkError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// After this long without a state the session is opened again: the network had time to open a link
/// again by itself.
const SILENCE: Duration = Duration::from_secs(3);
/// Longest time between two sessions: the robot may be switched off.
const SILENCE_MAX: Duration = Duration::from_secs(24);
/// Interval of the checks for silence.
const CHECK: Duration = Duration::from_millis(100);

/// Opens the session again whenever the robot is silent, until `ends`.
pub(super) fn watch(wire: &Arc<Wire>, network: &Network, ends: &AtomicBool) {
    let is_over = || ends.load(Ordering::Relaxed);
    let (mut opened, mut silence) = (Instant::now(), SILENCE);
    while !is_over() {
        std::thread::sleep(CHECK);
        if wire.time_since_state() < SILENCE {
            (opened, silence) = (Instant::now(), SILENCE);
        } else if opened.elapsed() >= silence {
            if silence == SILENCE {
                tracing::warn!("the robot is silent: opens the network again until it sends a state");
            }
            if let Err(error) = open_again(wire, network, is_over) {
                tracing::warn!("cannot open the network again: {error}");
            }
            (opened, silence) = (Instant::now(), (silence * 2).min(SILENCE_MAX));
        }
    }
}

fn open_again(wire: &Arc<Wire>, network: &Network, is_over: impl Fn() -> bool) -> Result<(), NetworkError> {
    let session = network::open(network, None, is_over)?;
    session.map_or(Ok(()), |session| wire.link(session))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Down, Echo, Head, Up};
    use crate::mirror::wire::BEAT;
    use crate::network::Keys;
    use motord_ports::clock;
    use motord_shared::StateMessage;
    use std::collections::HashMap;
    use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
    use std::sync::Mutex;
    use zenoh::pubsub::Subscriber;
    use zenoh::{Session, Wait};

    const ROBOT: &str = "go7";
    /// The handshake of zenoh, the declarations, and a few frames.
    const DATAGRAMS: usize = 9;
    /// Frames until a mirror gives up.
    const FRAMES_MAX: usize = 20_000;

    fn socket() -> UdpSocket {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        socket
    }

    /// Passes datagrams between mirrors and `robot` until `ends`, but not the one with number `lost`.
    fn relay(of_mirrors: &UdpSocket, robot: SocketAddr, lost: usize, ends: &AtomicBool) {
        let mut sockets: HashMap<SocketAddr, Arc<UdpSocket>> = HashMap::new();
        let mut datagram = [0; 65_536];
        let mut passed = 0;
        std::thread::scope(|scope| {
            while !ends.load(Ordering::Relaxed) {
                let Ok((length, mirror)) = of_mirrors.recv_from(&mut datagram) else { continue };
                let to_robot = sockets.entry(mirror).or_insert_with(|| {
                    let to_robot = Arc::new(socket());
                    let back = Arc::clone(&to_robot);
                    scope.spawn(move || {
                        let mut datagram = [0; 65_536];
                        while !ends.load(Ordering::Relaxed) {
                            let Ok(length) = back.recv(&mut datagram) else { continue };
                            let _dropped = of_mirrors.send_to(&datagram[..length], mirror);
                        }
                    });
                    to_robot.connect(robot).unwrap();
                    to_robot
                });
                if passed != lost {
                    let _dropped = to_robot.send(&datagram[..length]);
                }
                passed += 1;
            }
        });
    }

    fn network(text: &str) -> Network {
        toml::from_str(&format!("plaintext = true\n{text}")).unwrap()
    }

    /// The robot's side: a state after every frame of a mirror.
    fn robot(session: &Session) -> Subscriber<()> {
        let keys = Keys::of(ROBOT);
        let (states, numbers) = (session.clone(), Mutex::new(0));
        let state = keys.state();
        let beats = session.declare_subscriber(keys.beat()).callback(move |sample| {
            let Ok(Up { head, .. }) = Up::read_beat(&sample.payload().to_bytes()) else { return };
            let mut sequence = numbers.lock().unwrap();
            *sequence += 1;
            let echo = Echo { of: head.from, sent_ns: head.sent_ns, held_ns: 0 };
            let head = Head { from: 1, sequence: *sequence, sent_ns: clock::now_ns() };
            let _lost = states.put(&state, Down::bytes(&head, &[echo], &StateMessage::default())).wait();
        });
        beats.wait().unwrap()
    }

    /// A mirror over a network that loses the datagram with the number `lost`.
    fn finds_robot_without_datagram(lost: usize) {
        let port = socket().local_addr().unwrap().port();
        let listen = network(&format!("listen = [\"udp/127.0.0.1:{port}\"]\n"));
        let session = network::open(&listen, None, || false).unwrap().unwrap();
        let _beats = robot(&session);
        let of_mirrors = socket();
        let mirror = of_mirrors.local_addr().unwrap().port();
        let connect = network(&format!("connect = [\"udp/127.0.0.1:{mirror}\"]\n"));
        let ends = AtomicBool::new(false);
        let wire = Arc::new(Wire::new(Keys::of(ROBOT)).unwrap());
        std::thread::scope(|scope| {
            scope.spawn(|| relay(&of_mirrors, SocketAddr::from((Ipv4Addr::LOCALHOST, port)), lost, &ends));
            wire.link(network::open(&connect, None, || false).unwrap().unwrap()).unwrap();
            scope.spawn(|| watch(&wire, &connect, &ends));
            let beats = wire.sender(wire.keys.beat()).unwrap();
            let is_found = (0..FRAMES_MAX).any(|_| {
                beats.put(wire.up().beat());
                std::thread::park_timeout(BEAT);
                wire.newest().is_some()
            });
            ends.store(true, Ordering::Relaxed);
            assert!(is_found, "datagram {lost}");
        });
    }

    #[test]
    fn mirror_finds_robot_whichever_datagram_is_lost() {
        std::thread::scope(|scope| {
            for lost in 0..DATAGRAMS {
                scope.spawn(move || finds_robot_without_datagram(lost));
            }
        });
    }
}
