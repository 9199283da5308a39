//! The connection to a plant: a stream socket. docs/twin.md describes it for other plants.
//!
//! | from | message |
//! |---|---|
//! | motord | one line of JSON: `motord_plant` (1), `seconds`, `description`, `physics` |
//! | plant | one line of JSON: `begin` and `imu`, or `error` |
//! | motord, each step | `f64` little endian: seconds of the step, and the torque of each joint, N·m |
//! | plant, each step | `f64` little endian: positions, rad; velocities, rad/s; with an IMU orientation w, x, y, z, angular velocity, rad/s, specific force, m/s² |

use motord_bus::{Duration, clock};
use motord_configuration::describe;
use motord_settings::settings::Settings;
use motord_shared::description::RobotDescription;
use motord_simulator::ImuValues;
use motord_twin::{JointPhysics, NUMBER_MAX};
use serde::{Deserialize, Serialize};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

/// Time from one step to the next.
pub(super) const STEP: Duration = Duration::from_micros(250);
/// The plant may need this long to read its model.
const GREETING: Duration = Duration::from_secs(60);
/// A plant that needs longer for a step has ended.
const SILENCE: Duration = Duration::from_secs(1);
const VERSION: u32 = 1;
/// Longest answer to the greeting.
const ANSWER_BYTES_MAX: usize = 64 * 1024;
/// Numbers of an IMU.
const IMU_LEN: usize = 10;

/// Why there is no plant, or none any more.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// No process accepts connections on the socket.
    #[error("{}: {source}; start the plant first: `python -m motord.sim live` does both", .path.display())]
    Connect {
        /// The socket.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The plant does not take this robot.
    #[error("the plant refuses the robot: {0}")]
    Refused(String),
    /// Its answer to the greeting is none.
    #[error("the plant's answer is not understood: {0}")]
    Answer(String),
    /// A number is NaN, infinite, or beyond any machine.
    #[error(
        "the plant has computed {quantity} {value:e} of {joint}, not a number from {:e} to {:e}: check the model for an unstable contact or a torque that is too large",
        -NUMBER_MAX,
        NUMBER_MAX
    )]
    NotPlausible {
        /// The quantity.
        quantity: &'static str,
        /// The number.
        value: f64,
        /// The joint, or the IMU.
        joint: String,
    },
    /// It closed the connection.
    #[error("the plant ended: the motors were damped and stopped")]
    Ended,
    /// It did not answer.
    #[error("the plant did not answer for {0:?}: the motors were damped and stopped")]
    Silent(Duration),
    /// Its answer to a step is not as long as the greetings say.
    #[error(
        "the plant answered a step with {answered} bytes, not {expected}: 8 for each position and velocity of the joints, and 80 for the IMU if the plant said `imu: true`"
    )]
    Length {
        /// The bytes that arrived.
        answered: String,
        /// The bytes of a complete answer.
        expected: usize,
    },
    /// The connection broke.
    #[error("the connection to the plant: {0}")]
    Io(io::Error),
}

impl PlantError {
    fn of(error: io::Error, timeout: Duration) -> Self {
        match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => Self::Silent(timeout),
            ErrorKind::UnexpectedEof | ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => Self::Ended,
            _ => Self::Io(error),
        }
    }
}

#[derive(Serialize)]
struct Greeting<'a> {
    motord_plant: u32,
    seconds: f64,
    description: &'a RobotDescription,
    physics: Vec<JointPhysics>,
}

#[derive(Deserialize)]
struct Answer {
    error: Option<String>,
    begin: Option<Vec<f64>>,
    #[serde(default)]
    imu: bool,
}

/// A plant that has taken the robot.
pub struct PlantLink {
    stream: UnixStream,
    names: Vec<String>,
    answer: Answer,
    outgoing: Vec<u8>,
    incoming: Vec<u8>,
}

impl PlantLink {
    /// Connects to the plant on the socket at `path`, and shows it the robot. Blocks until it has
    /// answered, at most 2 minutes.
    ///
    /// # Errors
    /// No process accepts connections there, or the plant refuses this robot.
    pub fn connect(path: &Path, settings: &Settings) -> Result<Self, PlantError> {
        let failed = |source| PlantError::Connect { path: path.to_owned(), source };
        let mut stream = UnixStream::connect(path).map_err(failed)?;
        stream.set_read_timeout(Some(GREETING)).map_err(failed)?;
        stream.set_write_timeout(Some(SILENCE)).map_err(failed)?;
        let answer = greet(&mut stream, settings)?;
        stream.set_read_timeout(Some(SILENCE)).map_err(failed)?;
        let names: Vec<_> = settings.motors.iter().map(|motor| motor.name.clone()).collect();
        if answer.begin.as_ref().is_some_and(|begin| begin.len() != names.len()) {
            return Err(PlantError::Answer(format!("`begin` must have {} positions", names.len())));
        }
        let imu = if answer.imu { IMU_LEN } else { 0 };
        // One byte more than the answer has: a longer answer shows.
        let (outgoing, incoming) = (vec![0; 8 * (1 + names.len())], vec![0; 8 * (2 * names.len() + imu) + 1]);
        let link = Self { stream, names, answer, outgoing, incoming };
        link.sound("the position", link.answer.begin.as_deref().unwrap_or_default())?;
        Ok(link)
    }

    pub(super) const fn joints(&self) -> usize {
        self.names.len()
    }

    pub(super) const fn has_imu(&self) -> bool {
        self.answer.imu
    }

    pub(super) fn begin(&self) -> Option<Vec<f64>> {
        self.answer.begin.clone()
    }

    /// Asks for a step with these torques. Returns the body's IMU values, if the plant has an IMU.
    /// Blocks at most 2 s.
    pub(super) fn step(
        &mut self,
        torques: &[f64],
        positions: &mut [f64],
        velocities: &mut [f64],
    ) -> Result<Option<ImuValues>, PlantError> {
        let numbers = std::iter::once(STEP.as_secs_f64()).chain(torques.iter().copied());
        self.outgoing
            .chunks_exact_mut(8)
            .zip(numbers)
            .for_each(|(bytes, number)| bytes.copy_from_slice(&number.to_le_bytes()));
        self.stream.write_all(&self.outgoing).map_err(|error| PlantError::of(error, SILENCE))?;
        self.read_answer()?;
        let mut numbers = self.incoming.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes));
        for value in positions.iter_mut().chain(&mut *velocities) {
            *value = numbers.next().unwrap_or(f64::NAN);
        }
        let imu =
            self.answer.imu.then(|| imu_values(std::array::from_fn(|_| numbers.next().unwrap_or(f64::NAN))));
        self.sound("the position", positions)?;
        self.sound("the velocity", velocities)?;
        imu.as_ref().map_or(Ok(()), sound_imu)?;
        Ok(imu)
    }

    /// Reads the answer to a step. Blocks at most twice [`SILENCE`]: an answer that arrives in
    /// parts must be complete in that time.
    fn read_answer(&mut self) -> Result<(), PlantError> {
        let (expected, begun) = (self.incoming.len() - 1, clock::monotonic());
        let mut count = 0;
        while count < expected {
            let part = match self.stream.read(&mut self.incoming[count..]) {
                Ok(0) => return Err(PlantError::Ended),
                Ok(part) => part,
                Err(error) if error.kind() == ErrorKind::Interrupted => 0,
                Err(error) => return Err(incomplete(PlantError::of(error, SILENCE), count, expected)),
            };
            count += part;
            if count < expected && clock::monotonic().since(begun) > SILENCE {
                return Err(incomplete(PlantError::Silent(SILENCE), count, expected));
            }
        }
        if count > expected {
            return Err(PlantError::Length { answered: format!("more than {expected}"), expected });
        }
        Ok(())
    }

    fn sound(&self, quantity: &'static str, values: &[f64]) -> Result<(), PlantError> {
        match values.iter().zip(&self.names).find(|(value, _)| !is_plausible(**value)) {
            Some((value, joint)) => {
                Err(PlantError::NotPlausible { quantity, value: *value, joint: joint.clone() })
            }
            None => Ok(()),
        }
    }
}

/// Values of an IMU that are level and at rest.
pub(super) const LEVEL: [f64; IMU_LEN] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.81];
/// A plant has no temperature, °C.
const TEMPERATURE: f64 = 25.0;

pub(super) fn imu_values([w, x, y, z, gx, gy, gz, ax, ay, az]: [f64; IMU_LEN]) -> ImuValues {
    ImuValues {
        orientation: [w, x, y, z],
        angular_velocity: [gx, gy, gz],
        acceleration: [ax, ay, az],
        temperature: TEMPERATURE,
    }
}

/// False for NaN.
fn is_plausible(value: f64) -> bool {
    value.abs() <= NUMBER_MAX
}

fn sound_imu(imu: &ImuValues) -> Result<(), PlantError> {
    let ImuValues { orientation, angular_velocity, acceleration, .. } = imu;
    let quantities: [(&'static str, &[f64]); 3] = [
        ("the orientation", orientation),
        ("the angular velocity", angular_velocity),
        ("the specific force", acceleration),
    ];
    for (quantity, values) in quantities {
        if let Some(value) = values.iter().find(|value| !is_plausible(**value)) {
            return Err(PlantError::NotPlausible { quantity, value: *value, joint: "its IMU".into() });
        }
    }
    Ok(())
}

/// The error of an answer of which only `count` bytes have arrived.
fn incomplete(error: PlantError, count: usize, expected: usize) -> PlantError {
    match error {
        PlantError::Silent(_) if count > 0 => PlantError::Length { answered: count.to_string(), expected },
        error => error,
    }
}

fn greet(stream: &mut UnixStream, settings: &Settings) -> Result<Answer, PlantError> {
    let greeting = Greeting {
        motord_plant: VERSION,
        seconds: STEP.as_secs_f64(),
        description: &describe(settings, 0),
        physics: JointPhysics::of(settings),
    };
    let failed = |error| PlantError::of(error, GREETING);
    let mut text = serde_json::to_vec(&greeting).map_err(|error| PlantError::Answer(error.to_string()))?;
    text.push(b'\n');
    stream.write_all(&text).map_err(failed)?;
    let line = line(stream).map_err(failed)?;
    let answer: Answer =
        serde_json::from_slice(&line).map_err(|error| PlantError::Answer(error.to_string()))?;
    match answer.error {
        Some(error) => Err(PlantError::Refused(error)),
        None => Ok(answer),
    }
}

/// Reads a line, for at most twice [`GREETING`]. The bytes after it are those of steps, and stay in
/// the socket.
fn line(stream: &mut UnixStream) -> io::Result<Vec<u8>> {
    let mut line = Vec::new();
    let (mut byte, begun) = ([0], clock::monotonic());
    loop {
        if clock::monotonic().since(begun) > GREETING {
            return Err(ErrorKind::TimedOut.into());
        }
        stream.read_exact(&mut byte)?;
        if byte == *b"\n" || line.len() == ANSWER_BYTES_MAX {
            return Ok(line);
        }
        line.push(byte[0]);
    }
}
