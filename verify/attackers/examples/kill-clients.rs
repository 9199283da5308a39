//! Starts clients of one instance and kills them by SIGKILL at random moments; prints their stages.
//! `verify/rigs/test-kills` runs it.
//!
//! ```text
//! kill-clients INSTANCE CLIENTS AT-A-TIME GROUP...
//! ```
//!
//! The clients claim these groups; several clients compete for each.

use motord_client::{Client, Error};
use std::hash::{BuildHasher, RandomState};
use std::io::{Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// A client writes the index of each stage when it enters it.
const STAGES: [&str; 7] = ["starting", "connecting", "watching", "claiming", "owning", "sending", "leaving"];
const CONNECTING: u8 = 1;
const WATCHING: u8 = 2;
const CLAIMING: u8 = 3;
const OWNING: u8 = 4;
const SENDING: u8 = 5;
const LEAVING: u8 = 6;
/// The signal that a process cannot ignore.
const SIGKILL: i32 = 9;
/// Limit on the delay of a kill after the client enters its randomly chosen stage, µs.
const IN_STAGE_MAX_US: usize = 4000;
/// Time limit for a client to reach its stage: another client may own the group, or the computer is
/// busy.
const STAGE_TIMEOUT: Duration = Duration::from_secs(2);
/// Number of cycles in which a client sends.
const SENT: usize = 50;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["client", instance, group] => {
            client(instance, group).map_or(ExitCode::FAILURE, |()| ExitCode::SUCCESS)
        }
        [instance, clients, at_a_time, ref groups @ ..] if !groups.is_empty() => {
            let [clients, at_a_time] = [clients, at_a_time].map(|count| count.parse().expect("a count"));
            kill_all(instance, clients, at_a_time, groups);
            ExitCode::SUCCESS
        }
        _ => ExitCode::from(64),
    }
}

fn enter(stage: u8) {
    std::io::stdout().write_all(&[stage]).and_then(|()| std::io::stdout().flush()).expect("a reader");
}

/// Runs a controller through all stages once.
fn client(instance: &str, group: &str) -> Result<(), Error> {
    const LONG: Duration = Duration::from_secs(5);
    enter(CONNECTING);
    let client = retry(|| Client::connect(instance))?;
    enter(WATCHING);
    let state = retry(|| client.wait(LONG))?;
    enter(CLAIMING);
    let mut claim = retry(|| client.claim(group))?;
    enter(OWNING);
    claim.hold(&state, 5.0, 0.5)?;
    claim.commit()?;
    enter(SENDING);
    // After the kill of its last owner, a group is stopped until a reset, and may not be enabled.
    let _still_damped = claim.reset();
    let _refused = claim.enable();
    for _ in 0..SENT {
        client.wait(LONG)?;
        claim.commit()?;
    }
    enter(LEAVING);
    drop((claim, client));
    Ok(())
}

/// Retries: the slots and groups of killed clients become free soon.
fn retry<T>(attempt: impl Fn() -> Result<T, Error>) -> Result<T, Error> {
    let begun = Instant::now();
    loop {
        match attempt() {
            Err(_) if begun.elapsed() < Duration::from_secs(1) => {
                std::thread::sleep(Duration::from_millis(5));
            }
            other => return other,
        }
    }
}

fn kill_all(instance: &str, clients: usize, at_a_time: usize, groups: &[&str]) {
    let (killed, ended, left) = (Mutex::new([0_usize; STAGES.len()]), Mutex::new(0), Mutex::new(clients));
    std::thread::scope(|scope| {
        for lane in 0..at_a_time {
            let (killed, ended, left) = (&killed, &ended, &left);
            scope.spawn(move || {
                while take(left) {
                    match kill_one(instance, groups[lane % groups.len()]) {
                        Some(stage) => killed.lock().expect("counts")[stage] += 1,
                        None => {
                            *ended.lock().expect("counts") += 1;
                            *left.lock().expect("counts") += 1;
                        }
                    }
                }
            });
        }
    });
    let killed = killed.into_inner().expect("counts");
    let stages: Vec<String> =
        STAGES.iter().zip(killed).map(|(stage, count)| format!("{count} {stage}")).collect();
    println!(
        "{} clients were killed, {at_a_time} at a time: {}; {} more ended first",
        killed.iter().sum::<usize>(),
        stages.join(", "),
        ended.into_inner().expect("counts")
    );
}

fn take(left: &Mutex<usize>) -> bool {
    let mut left = left.lock().expect("counts");
    let some = *left > 0;
    *left -= usize::from(some);
    some
}

/// Kills a client at a random moment of a random stage. Returns the last stage that it entered;
/// `None` when it exited before.
fn kill_one(instance: &str, group: &str) -> Option<usize> {
    let program = std::env::current_exe().expect("this program's path");
    let mut command = Command::new(program);
    command
        .args(["client", instance, group])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    let mut child = command.spawn().expect("a process");
    let mut stages = child.stdout.take().expect("its output");
    let target = random(STAGES.len());
    let (sender, entered) = std::sync::mpsc::channel();
    let reader = std::thread::spawn(move || {
        let mut last = 0;
        let mut byte = [0_u8];
        while let Ok(1) = stages.read(&mut byte) {
            last = usize::from(byte[0]);
            let _given_up = sender.send(last);
        }
        last
    });
    let begun = Instant::now();
    let mut stage = 0;
    while stage < target {
        let left = STAGE_TIMEOUT.saturating_sub(begun.elapsed());
        let Ok(next) = entered.recv_timeout(left) else { break };
        stage = next;
    }
    std::thread::sleep(Duration::from_micros(random(IN_STAGE_MAX_US) as u64));
    let was_killed = end(&mut child);
    let last = reader.join().expect("its reader");
    was_killed.then_some(last)
}

/// Kills the client. Returns `true` if it was running.
fn end(child: &mut Child) -> bool {
    let _exited = child.kill();
    child.wait().expect("its status").signal() == Some(SIGKILL)
}

/// Returns a random number below `bound`.
fn random(bound: usize) -> usize {
    (RandomState::new().hash_one(0) % bound as u64) as usize
}
