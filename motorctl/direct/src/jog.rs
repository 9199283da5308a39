//! `motorctl jog`: a joint moves slowly while a key is held.

use crate::failure::DirectFailure;
use crate::guard::StopOnDrop;
use crate::motion::{Jogged, PERIOD, ranged};
use crate::output::{Confirm, print_line};
use crate::target::{Protocol, Target};
use motord_terminal::Interrupt;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{LocalFlags, SetArg, Termios, tcgetattr, tcsetattr};
use std::io::{self, IsTerminal, Stdin, Write};
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

/// A key counts as held for this time after each repetition. Terminals repeat a held key about 30
/// times a second, after a first pause.
const HELD: Duration = Duration::from_millis(150);

/// The options of `motorctl jog`.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The motor's name in the configuration, as with --joint. Without --config it is /etc/motord/motord.toml.
    #[arg(value_name = "JOINT", conflicts_with_all = ["bus", "id", "joint"])]
    name: Option<String>,
    #[command(flatten)]
    target: Target,
    /// Speed while a key is held, rad/s.
    #[arg(long, value_name = "RAD/S", default_value_t = 0.3, value_parser = |text: &str| ranged(text, 0.0, 3.0))]
    rad_s: f64,
    /// Stop when the shaft has turned this far from its start, rad. With --config the joint's
    /// limits also hold.
    #[arg(long, value_name = "RAD", default_value_t = 1.0, value_parser = |text: &str| ranged(text, 0.0, 12.0))]
    max_travel_rad: f64,
    /// Gain of a motor in MIT mode, N·m·s/rad. Its largest torque is the gain times the speed.
    #[arg(long, value_name = "KD", default_value_t = 2.0, value_parser = |text: &str| ranged(text, 0.0, 5.0))]
    kd: f64,
    /// Move for this duration, s, without keys, then stop. --backward sets the direction.
    #[arg(long, value_name = "S", value_parser = |text: &str| ranged(text, 0.0, 10.0))]
    seconds: Option<f64>,
    /// With --seconds: move backward.
    #[arg(long, requires = "seconds")]
    backward: bool,
    #[command(flatten)]
    confirm: Confirm,
}

/// `motorctl jog`.
pub(crate) fn run(arguments: &Arguments) -> Result<(), DirectFailure> {
    if arguments.seconds.is_none() && !io::stdin().is_terminal() {
        let usage = "holding a key needs a terminal: use --seconds elsewhere";
        return Err(DirectFailure::Usage(usage.to_owned()));
    }
    let named = arguments.name.as_ref().map(|joint| arguments.target.named(joint));
    let mut session = named.as_ref().unwrap_or(&arguments.target).open()?;
    if session.protocol == Protocol::RobStride && session.settings.is_none() {
        return Err(session.unfit("the ranges of its codes follow from its model: use --config and --joint"));
    }
    let name = session.name();
    arguments.confirm.ask(&format!(
        "This starts {name} and moves it at {} rad/s, at most {} rad from where it is.\n\
         Make sure that the joint is clear, and that it cannot fall when it is limp.",
        arguments.rad_s, arguments.max_travel_rad
    ))?;
    let interrupt = Interrupt::register();
    let allowed = session.allowed();
    let mut motor = StopOnDrop::new(Jogged::new(&mut session, arguments.kd as f32));
    let begin = motor.start()?;
    let position = hold_to_run(&mut motor, begin, allowed, arguments, &interrupt)?;
    motor.stop()?;
    print_line(&format!("{name}: stopped at {position:.3} rad"))
}

/// Moves the motor while a key is held. Returns the last position, rad.
fn hold_to_run(
    motor: &mut Jogged<'_>,
    begin: f64,
    allowed: [f64; 2],
    arguments: &Arguments,
    interrupt: &Interrupt,
) -> Result<f64, DirectFailure> {
    let mut hand = Hand::new(arguments);
    let mut position = begin;
    while let Some(direction) = hand.direction()
        && !interrupt.is_raised()
    {
        // At an end of the range only the way back is open.
        let blocked = if direction > 0.0 {
            position >= (begin + arguments.max_travel_rad).min(allowed[1])
        } else {
            position <= (begin - arguments.max_travel_rad).max(allowed[0])
        };
        let velocity = if blocked { 0.0 } else { direction * arguments.rad_s };
        let [at, speed] = motor.follow(velocity)?;
        position = at;
        if (at - begin).abs() > 1.2 * arguments.max_travel_rad || speed.abs() > 3.0 * arguments.rad_s + 1.0 {
            return Err(DirectFailure::Unfit {
                id: motor.id(),
                reason: "it moved beyond its bounds; the command stopped it".to_owned(),
            });
        }
        hand.show(position);
        interrupt.pause_until(Instant::now() + PERIOD);
    }
    Ok(position)
}

/// The source of the direction: keys or the command line.
enum Hand {
    Keys { keys: Keys, direction: f64, held_until: Instant },
    Timed { direction: f64, until: Instant },
}

impl Hand {
    fn new(arguments: &Arguments) -> Self {
        let now = Instant::now();
        match arguments.seconds {
            Some(seconds) => {
                let direction = if arguments.backward { -1.0 } else { 1.0 };
                Self::Timed { direction, until: now + Duration::from_secs_f64(seconds) }
            }
            None => {
                eprintln!("hold + or - to move, q to stop");
                Self::Keys { keys: Keys::open(), direction: 0.0, held_until: now }
            }
        }
    }

    /// Returns 1 forward, -1 backward, 0 at rest; `None` at the end.
    fn direction(&mut self) -> Option<f64> {
        let now = Instant::now();
        match self {
            Self::Timed { direction, until } => (now < *until).then_some(*direction),
            Self::Keys { keys, direction, held_until } => {
                while let Some(key) = keys.next() {
                    *direction = match key {
                        b'+' | b'=' => 1.0,
                        b'-' | b'_' => -1.0,
                        _ => return None,
                    };
                    *held_until = now + HELD;
                }
                Some(if now < *held_until { *direction } else { 0.0 })
            }
        }
    }

    fn show(&self, position: f64) {
        if matches!(self, Self::Keys { .. }) {
            eprint!("\r{position:8.3} rad ");
            let _flushed = io::stderr().flush();
        }
    }
}

/// Single keys of the terminal, read without blocking. Dropping this restores the terminal.
struct Keys {
    input: Stdin,
    before: Option<Termios>,
}

impl Keys {
    fn open() -> Self {
        let input = io::stdin();
        let before = tcgetattr(&input).ok();
        if let Some(before) = &before {
            let mut raw = before.clone();
            raw.local_flags.remove(LocalFlags::ICANON | LocalFlags::ECHO);
            let _kept = tcsetattr(&input, SetArg::TCSANOW, &raw);
        }
        Self { input, before }
    }

    fn next(&mut self) -> Option<u8> {
        let mut polled = [PollFd::new(self.input.as_fd(), PollFlags::POLLIN)];
        if poll(&mut polled, PollTimeout::ZERO) != Ok(1) {
            return None;
        }
        let mut key = [0];
        // A closed terminal ends the motion, as any other key does.
        match nix::unistd::read(&self.input, &mut key) {
            Ok(1) => Some(key[0]),
            _ => Some(b'q'),
        }
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _restored = tcsetattr(&self.input, SetArg::TCSANOW, before);
        }
        eprintln!();
    }
}
