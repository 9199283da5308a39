//! Lines that ask for a fault of a simulated motor, bus or IMU, with answers for people.

use motord_bus::Duration;
use motord_configuration::suggestion;
use motord_settings::settings::Settings;
use motord_shared::Fault;
use motord_simulator::{FaultVerb, InjectError, VERBS, VerbError};

/// Why there is no such fault. A name of the line is quoted with its control characters escaped.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FaultLineError {
    /// No motor, bus or IMU has this name.
    #[error("no motor, bus or IMU {target:?}: {suggestion}")]
    Target {
        /// The name.
        target: String,
        /// The name that was meant, or those that there are.
        suggestion: String,
    },
    /// There is no such word for a fault.
    #[error("no fault {verb:?}: {suggestion}")]
    Verb {
        /// The word.
        verb: String,
        /// The word that was meant, or those that there are.
        suggestion: String,
    },
    /// The motor's vendor has no such fault in its list.
    #[error("{motor} cannot raise {fault:?}: {suggestion}")]
    VendorFault {
        /// The motor.
        motor: String,
        /// The name of the fault.
        fault: String,
        /// The fault that was meant, or those that the motor has.
        suggestion: String,
    },
    /// The line is malformed.
    #[error(transparent)]
    Line(VerbError),
    /// The target cannot have this fault.
    #[error(transparent)]
    Inject(#[from] InjectError),
    /// The cycle does not run, or did not take the fault in time.
    #[error("the cycle took no fault within {0:?}: it may take this one later")]
    Unanswered(Duration),
}

/// Reads a line such as `fl-knee delayed 2ms` or `fl-knee fault over-voltage`, whose target is of
/// `settings`. Of the vendor's faults the name stands for the number.
///
/// # Errors
///
/// All but [`FaultLineError::Inject`] and [`FaultLineError::Unanswered`]. An unknown name is
/// answered by the one most like it.
pub fn read(line: &str, settings: &Settings) -> Result<FaultVerb, FaultLineError> {
    let words: Vec<&str> = line.split_whitespace().collect();
    if let Some(target) = words.first() {
        check_target(target, settings)?;
    }
    let numbered = match words[..] {
        [motor, "fault", name] if name.starts_with(|letter: char| letter.is_alphabetic()) => {
            format!("{motor} fault {}", vendor_number(motor, name, settings)?)
        }
        _ => line.to_owned(),
    };
    numbered.parse().map_err(|error| match error {
        VerbError::Verb => {
            let verb = words.get(1).copied().unwrap_or_default().to_owned();
            let suggestion = suggestion(&verb, VERBS.iter().map(|verb| verb.name));
            FaultLineError::Verb { verb, suggestion }
        }
        error => FaultLineError::Line(error),
    })
}

fn check_target(target: &str, settings: &Settings) -> Result<(), FaultLineError> {
    let motors = settings.motors.iter().map(|motor| motor.name.as_str());
    let buses = settings.buses.iter().map(|bus| bus.name.as_str());
    let mut names = motors.chain(buses).chain(settings.sensors.imus.iter().map(|imu| imu.name.as_str()));
    if names.clone().any(|name| name == target) {
        return Ok(());
    }
    let suggestion = suggestion(target, &mut names);
    Err(FaultLineError::Target { target: target.to_owned(), suggestion })
}

/// The number that the vendor of `motor` gives the fault `name`. For a bus, which has no such
/// fault, it is 0.
fn vendor_number(motor: &str, name: &str, settings: &Settings) -> Result<u32, FaultLineError> {
    let Some(found) = settings.motors.iter().find(|other| other.name == motor) else { return Ok(0) };
    let mut known = Vec::new();
    for (number, faults) in found.profile.fault_numbers() {
        if Fault::of_bits(faults.0).any(|fault| fault.name() == name) {
            return Ok(number);
        }
        known.extend(Fault::of_bits(faults.0).map(Fault::name));
    }
    let suggestion = suggestion(name, known.into_iter());
    Err(FaultLineError::VendorFault { motor: motor.to_owned(), fault: name.to_owned(), suggestion })
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_simulator::Fault;
    use std::path::Path;

    fn parsed(line: &str) -> Result<Fault, String> {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/quadruped-simulated.toml");
        let settings = motord_configuration::load(&file).unwrap().settings;
        read(line, &settings).map(|verb| verb.fault).map_err(|error| error.to_string())
    }

    #[test]
    fn vendor_fault_may_be_named_or_numbered() {
        assert_eq!(parsed("fl-knee fault over-voltage"), Ok(Fault::Raise(2)));
        assert_eq!(parsed("fl-knee fault 0x04"), Ok(Fault::Raise(4)));
    }

    #[test]
    fn unknown_word_suggests_the_nearest() {
        let cases = [
            ("fl-kne off", "no motor, bus or IMU \"fl-kne\": did you mean `fl-knee`?"),
            ("front-lft bus-off", "no motor, bus or IMU \"front-lft\": did you mean `front-left`?"),
            ("fl-knee delay 2ms", "no fault \"delay\": did you mean `delayed`?"),
            (
                "fl-knee fault overvoltage",
                "fl-knee cannot raise \"overvoltage\": did you mean `over-voltage`?",
            ),
            ("fl-knee delayed 2", "bad argument; expected something like 2ms"),
            ("fl-knee", "1 words; expected a target, a verb and at most one argument"),
            ("fl-knee \u{1b}[2J", "no fault \"\\u{1b}[2J\": known are ok, on, off"),
        ];
        for (line, begin) in cases {
            let sentence = parsed(line).unwrap_err();
            assert!(sentence.starts_with(begin), "{line}: {sentence}");
            assert!(!sentence.contains('\u{1b}'));
        }
    }
}
