//! Arbitrary and damaged files.

use crate::document::{GOOD, machine, shipped, validate};
use crate::shipped::shipped_names;
use motord_configuration::{Loaded, parse};
use proptest::prelude::*;
use std::fs;
use std::path::Path;
use std::time::Duration;

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = parse(Path::new("robot.toml"), &bytes, &machine());
    }

    /// Text of any language, with what begins and ends the parts of a file.
    #[test]
    fn arbitrary_text_never_panics(parts in prop::collection::vec("\\PC{0,6}|[\\[\\]{}=\"'#,.\\\\ \t\r\n-]{1,3}|rate-hz = |\n\\[cycle\\]\n|limits = \\{", 0..40)) {
        let text = parts.concat();
        if let Err(error) = parse(Path::new("robot.toml"), text.as_bytes(), &machine()) {
            for problem in &error.problems {
                prop_assert!(!problem.to_string().contains(char::is_control), "{:?}", problem.to_string());
            }
        }
    }

    /// Damage to a shipped file reaches more checks than random bytes do: a part of it moves to
    /// another position, or is replaced.
    #[test]
    fn damaged_shipped_file_never_panics_and_names_line(
        (file, at, removed) in (prop::sample::select(shipped_names()), any::<prop::sample::Index>(), 0_usize..40),
        moved in prop::option::of(any::<prop::sample::Index>()),
        inserted in "[-0-9.e'\"\\[\\]{}=,a-z\n#]{0,12}|\\[\\[?(bus|motor|group|cycle|ipc|exchange)\\]\\]?\n|nan|-inf|1e400",
    ) {
        let text = fs::read(shipped(&file)).unwrap();
        let at = at.index(text.len());
        let end = (at + removed).min(text.len());
        let mut damaged = [&text[..at], inserted.as_bytes(), &text[end..]].concat();
        if let Some(location) = moved {
            let location = location.index(damaged.len() + 1);
            damaged.splice(location..location, text[at..end].iter().copied());
        }
        if let Err(error) = parse(Path::new("robot.toml"), &damaged, &machine()) {
            prop_assert!(!error.problems.is_empty());
            let lines = 1 + damaged.iter().filter(|byte| **byte == b'\n').count();
            for problem in &error.problems {
                let location = problem.location.as_ref();
                prop_assert!(location.is_some_and(|location| (1..=lines).contains(&location.line)), "{}", problem);
                prop_assert!(!problem.to_string().contains(char::is_control), "{:?}", problem.to_string());
            }
        }
    }

    /// Damage to a good file reaches more checks than random bytes do.
    #[test]
    fn damaged_file_never_panics_and_names_line(
        at in 0..GOOD.len(),
        removed in 0_usize..20,
        inserted in "[-0-9.e'\\[\\]=a-z\n#]{0,12}",
    ) {
        let end = (at + removed).min(GOOD.len());
        let text = format!("{}{inserted}{}", &GOOD[..at], &GOOD[end..]);
        if let Err(error) = validate(&text) {
            prop_assert!(!error.problems.is_empty());
            prop_assert!(error.problems.iter().all(|problem| problem.location.is_some()));
        }
    }

    /// Any number replaces any other: settings are finite, positive where required, and durations
    /// never panic.
    #[test]
    fn whatever_numbers_are_accepted_make_sane_settings(value in any::<f64>(), nth in 0_usize..12) {
        let numbers: Vec<_> = GOOD.match_indices("= ").filter(|(at, _)| GOOD.as_bytes()[at + 2].is_ascii_digit()).collect();
        let at = numbers[nth % numbers.len()].0 + 2;
        let line_end = at + GOOD[at..].find('\n').unwrap();
        let text = format!("{}{value:?}{}", &GOOD[..at], &GOOD[line_end..]);
        if let Ok(Loaded { settings, .. }) = validate(&text) {
            prop_assert!(settings.cycle.period >= Duration::from_micros(250));
            for motor in settings.motors {
                let (torque, kp) = (motor.limits.torque, motor.limits.kp);
                prop_assert!(torque > 0.0 && torque <= motor.winding.peak_torque && kp.is_finite());
            }
        }
    }
}
