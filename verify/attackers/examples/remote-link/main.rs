//! A slow, lossy network, and a controller behind it whose setpoints are judged on the robot.
//! `verify/rigs/test-remote` runs it.
//!
//! ```text
//! remote-link link LISTEN TARGET                         the network alone, UDP
//! remote-link drive LISTEN TARGET ROBOT OTHER HZ SECONDS the network, and the controller
//! ```
//!
//! `ROBOT` and `OTHER` are `RUNTIME/INSTANCE`: of the robot, and of its mirror behind the network. A
//! line on standard input changes the network:
//!
//! ```text
//! quality DELAY_MS JITTER_MS LOSS REORDER DUPLICATE      each way; shares of the packets, 0 to 1
//! cut MS                                                 no packet passes for so long
//! replay                                                 the last packets to TARGET are sent again
//! drive [cut MS]                                         the controller drives; a line of JSON follows
//! watch                                                  the robot is watched, which another controller drives
//! watched                                                until now; a line of JSON follows
//! ```

mod controller;
mod network;
mod watcher;

use controller::Drive;
use network::{Network, Quality};
use std::io::BufRead;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let texts: Vec<_> = arguments.iter().map(String::as_str).collect();
    let (addresses, drive) = match texts[..] {
        ["link", listen, target] => ([listen, target], None),
        ["drive", listen, target, robot, other, hz, seconds] => {
            let [hz, seconds] = [hz, seconds].map(|number| number.parse().expect("a number"));
            ([listen, target], Some(Drive::new(robot, other, hz, seconds)))
        }
        _ => panic!("see the head of main.rs"),
    };
    let [listen, target] = addresses.map(|address| address.parse::<SocketAddr>().expect("an address"));
    let network = Network::start(listen, target);
    let mut watcher = None;
    for line in std::io::stdin().lock().lines() {
        let line = line.expect("text");
        let robot = || drive.as_ref().expect("a robot");
        match &line[..] {
            "watch" => watcher = Some(robot().watch()),
            "watched" => println!("{}", watcher.take().expect("a watcher").end("")),
            line => obey(line, &network, drive.as_ref()),
        }
    }
}

fn obey(line: &str, network: &Arc<Network>, drive: Option<&Drive>) {
    let words: Vec<_> = line.split_whitespace().collect();
    let number = |word: &str| word.parse::<f64>().expect("a number");
    let milliseconds = |word: &str| Duration::from_secs_f64(number(word) / 1e3);
    match words[..] {
        ["quality", delay, jitter, loss, reorder, duplicate] => network.set(Quality {
            delay: milliseconds(delay),
            jitter: milliseconds(jitter),
            loss: number(loss),
            reorder: number(reorder),
            duplicate: number(duplicate),
        }),
        ["cut", time] => network.cut(milliseconds(time)),
        ["replay"] => network.replay(),
        ["drive"] => println!("{}", drive.expect("a controller").drive(None, network)),
        ["drive", "cut", time] => {
            println!("{}", drive.expect("a controller").drive(Some(milliseconds(time)), network));
        }
        _ => panic!("unknown line {line:?}"),
    }
}
