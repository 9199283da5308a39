//! A network between two computers: UDP packets with delay, jitter, loss, reordering and repetition.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, VecDeque};
use std::net::{SocketAddr, UdpSocket};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// Of each way.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Quality {
    pub(crate) delay: Duration,
    /// The delay varies by up to so much, either way. Packets keep their order.
    pub(crate) jitter: Duration,
    /// Shares of the packets.
    pub(crate) loss: f64,
    pub(crate) reorder: f64,
    pub(crate) duplicate: f64,
}

/// A thread that panics ends the program.
pub(crate) const UNPOISONED: &str = "no thread panicked";
/// Packets that are captured.
const CAPTURED: usize = 2000;

/// A packet in transit: when it arrives, its number, and its direction.
type InTransit = Reverse<(Instant, u64, usize)>;

#[derive(Debug, Default)]
struct State {
    quality: Quality,
    cut_until: Option<Instant>,
    queue: BinaryHeap<InTransit>,
    packets: HashMap<u64, (Vec<u8>, Arc<UdpSocket>, SocketAddr)>,
    /// Latest arrival of each way: later packets come after it.
    latest: [Option<Instant>; 2],
    next: u64,
    random: u64,
    /// Packets to the target, for their repetition.
    captured: VecDeque<(Vec<u8>, Arc<UdpSocket>, SocketAddr)>,
}

impl State {
    /// Returns a number from 0 to 1, of a xorshift generator.
    fn random(&mut self) -> f64 {
        let mut bits = self.random.max(1);
        bits ^= bits << 13;
        bits ^= bits >> 7;
        bits ^= bits << 17;
        self.random = bits;
        (bits >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn send(&mut self, way: usize, packet: &[u8], socket: &Arc<UdpSocket>, target: SocketAddr) {
        if way == 0 {
            self.captured.push_back((packet.to_vec(), Arc::clone(socket), target));
            if self.captured.len() > CAPTURED {
                self.captured.pop_front();
            }
        }
        let now = Instant::now();
        let Quality { delay, jitter, loss, reorder, duplicate } = self.quality;
        if self.cut_until.is_some_and(|until| now < until) || self.random() < loss {
            return;
        }
        let copies = if self.random() < duplicate { 2 } else { 1 };
        for _ in 0..copies {
            let varied = delay.as_secs_f64() + jitter.as_secs_f64() * (2.0 * self.random() - 1.0);
            let mut at = now + Duration::from_secs_f64(varied.max(0.0));
            if self.random() < reorder {
                // It overtakes those before it.
                at = now;
            } else {
                at = at.max(self.latest[way].unwrap_or(at));
                self.latest[way] = Some(at);
            }
            self.next += 1;
            self.queue.push(Reverse((at, self.next, way)));
            self.packets.insert(self.next, (packet.to_vec(), Arc::clone(socket), target));
        }
    }
}

/// The network.
#[derive(Debug, Default)]
pub(crate) struct Network {
    state: Mutex<State>,
    changed: Condvar,
}

impl Network {
    /// Passes packets between those who send to `listen`, and `target`, until the program ends.
    pub(crate) fn start(listen: SocketAddr, target: SocketAddr) -> Arc<Self> {
        let network = Arc::new(Self::default());
        let socket = Arc::new(UdpSocket::bind(listen).expect("a free port"));
        let of_deliveries = Arc::clone(&network);
        std::thread::spawn(move || of_deliveries.deliver());
        let of_packets = Arc::clone(&network);
        std::thread::spawn(move || of_packets.receive(&socket, target));
        network
    }

    pub(crate) fn set(&self, quality: Quality) {
        self.state.lock().expect(UNPOISONED).quality = quality;
    }

    /// From now on no packet passes for `time`.
    pub(crate) fn cut(&self, time: Duration) {
        self.state.lock().expect(UNPOISONED).cut_until = Some(Instant::now() + time);
    }

    /// Sends the newest packets to the target again.
    pub(crate) fn replay(&self) {
        let captured = self.state.lock().expect(UNPOISONED).captured.clone();
        for (packet, socket, target) in captured {
            let _gone = socket.send_to(&packet, target);
        }
    }

    /// Each sender has a socket to the target, by which the answers come back.
    fn receive(self: &Arc<Self>, socket: &Arc<UdpSocket>, target: SocketAddr) {
        let mut outs: HashMap<SocketAddr, Arc<UdpSocket>> = HashMap::new();
        let mut packet = vec![0; 1 << 16];
        loop {
            // A peer that has ended is reported by the next call.
            let Ok((length, from)) = socket.recv_from(&mut packet) else { continue };
            let out = outs.entry(from).or_insert_with(|| {
                let out = Arc::new(UdpSocket::bind((any(target), 0)).expect("a free port"));
                let (network, back, answers) = (Arc::clone(self), Arc::clone(socket), Arc::clone(&out));
                std::thread::spawn(move || network.answer(&answers, &back, from));
                out
            });
            self.send(0, &packet[..length], out, target);
        }
    }

    fn answer(&self, answers: &UdpSocket, back: &Arc<UdpSocket>, to: SocketAddr) {
        let mut packet = vec![0; 1 << 16];
        loop {
            let Ok((length, _)) = answers.recv_from(&mut packet) else { continue };
            self.send(1, &packet[..length], back, to);
        }
    }

    fn send(&self, way: usize, packet: &[u8], socket: &Arc<UdpSocket>, target: SocketAddr) {
        self.state.lock().expect(UNPOISONED).send(way, packet, socket, target);
        self.changed.notify_one();
    }

    fn deliver(&self) {
        let mut state = self.state.lock().expect(UNPOISONED);
        loop {
            let now = Instant::now();
            while let Some(Reverse((at, number, _))) = state.queue.peek().copied()
                && at <= now
            {
                state.queue.pop();
                let (packet, socket, target) = state.packets.remove(&number).expect("a packet in transit");
                let _gone = socket.send_to(&packet, target);
            }
            let next = state
                .queue
                .peek()
                .map_or(Duration::from_secs(1), |Reverse((at, _, _))| at.saturating_duration_since(now));
            state = self.changed.wait_timeout(state, next).expect(UNPOISONED).0;
        }
    }
}

fn any(of: SocketAddr) -> std::net::IpAddr {
    match of {
        SocketAddr::V4(_) => std::net::Ipv4Addr::UNSPECIFIED.into(),
        SocketAddr::V6(_) => std::net::Ipv6Addr::UNSPECIFIED.into(),
    }
}
