//! The mechanics of the joint: identified in this run, or from a file.

use crate::identify::known::read_identified;
use crate::tune::failure::TuneFailure;
use motord_identify::Identified;
use serde::Deserialize;
use std::path::Path;

/// Inertia of any joint, kg·m².
const INERTIA: [f64; 2] = [1e-6, 100.0];
/// Viscous friction of any joint, N·m·s/rad.
const VISCOUS: [f64; 2] = [0.0, 100.0];
/// Lag of any drive, µs.
const LAG_US: [f64; 2] = [0.0, 1e5];

/// The mechanics of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Known {
    /// kg·m².
    pub(crate) inertia: f64,
    /// Viscous friction, N·m·s/rad; 0 where it is not identifiable.
    pub(crate) viscous: f64,
    /// Lag of the drive beyond the stamps, s.
    pub(crate) lag: f64,
    /// It was read from a file.
    pub(crate) is_read: bool,
}

#[derive(Deserialize)]
struct File {
    joint: String,
    inertia_kg_m2: Entry,
    viscous_friction_nm_s_per_rad: Entry,
    lag_us: Option<f64>,
}

#[derive(Deserialize)]
struct Entry {
    value: Option<f64>,
    is_identified: bool,
}

impl Entry {
    fn identified(&self) -> Option<f64> {
        self.value.filter(|value| self.is_identified && *value > 0.0 && value.is_finite())
    }
}

impl File {
    /// The mechanics of the joint, or why they are none.
    fn known(&self) -> Result<Known, String> {
        let inertia = self.inertia_kg_m2.identified().ok_or("its inertia was not identifiable")?;
        let viscous = self.viscous_friction_nm_s_per_rad.identified().unwrap_or(0.0);
        let lag_us = self.lag_us.unwrap_or(0.0).max(0.0);
        within("inertia_kg_m2", inertia, INERTIA)?;
        within("viscous_friction_nm_s_per_rad", viscous, VISCOUS)?;
        within("lag_us", lag_us, LAG_US)?;
        Ok(Known { inertia, viscous, lag: lag_us / 1e6, is_read: true })
    }
}

/// Refuses a value of `key` that no joint has.
fn within(key: &str, value: f64, [least, most]: [f64; 2]) -> Result<(), String> {
    let is_possible = (least..=most).contains(&value);
    is_possible.then_some(()).ok_or_else(|| format!("{key} is {value:e}, and {least} to {most} is possible"))
}

impl Known {
    /// Reads the output of `motorctl identify --json`.
    ///
    /// # Errors
    ///
    /// [`TuneFailure::Identified`].
    pub(crate) fn read(path: &Path, joint: &str) -> Result<Self, TuneFailure> {
        let refused = |reason: String| TuneFailure::Identified {
            path: path.display().to_string(),
            joint: joint.to_owned(),
            reason,
        };
        let file: File = read_identified(path, joint, |file: &File| &file.joint).map_err(&refused)?;
        file.known().map_err(refused)
    }

    /// The mechanics that were found in this run.
    ///
    /// # Errors
    ///
    /// [`TuneFailure::Inertia`].
    pub(crate) fn found(found: &Identified, joint: &str) -> Result<Self, TuneFailure> {
        let why = found.inertia.why.map_or_else(String::new, |why| format!(": {why}"));
        let inertia = found.inertia.identified().filter(|inertia| *inertia > 0.0);
        let inertia = inertia.ok_or_else(|| TuneFailure::Inertia { joint: joint.to_owned(), why })?;
        let viscous = found.viscous.identified().unwrap_or(0.0);
        Ok(Self { inertia, viscous, lag: found.lag().unwrap_or(0.0).max(0.0), is_read: false })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file for the joint `knee`.
    fn written([inertia, viscous]: [&str; 2], lag_us: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        let entry =
            |value: &str| format!(r#"{{"value": {value}, "lower": 0, "upper": 1, "is_identified": true}}"#);
        let text = format!(
            r#"{{"joint": "knee", "inertia_kg_m2": {}, "viscous_friction_nm_s_per_rad": {}, "lag_us": {lag_us}, "notes": []}}"#,
            entry(inertia),
            entry(viscous)
        );
        std::fs::write(file.path(), text).unwrap();
        file
    }

    #[test]
    fn absurd_mechanics_are_refused_with_numbers() {
        for (mechanics, lag_us, complaint) in [
            (["1e-200", "0.1"], "0", "inertia_kg_m2 is 1e-200, and 0.000001 to 100 is possible"),
            (["1e200", "0.1"], "0", "inertia_kg_m2 is 1e200"),
            (["0.03", "1e5"], "0", "viscous_friction_nm_s_per_rad is 1e5, and 0 to 100"),
            (["0.03", "0.1"], "2e5", "lag_us is 2e5, and 0 to 100000"),
            (["NaN", "0.1"], "0", "expected"),
        ] {
            let refused = Known::read(written(mechanics, lag_us).path(), "knee").unwrap_err().to_string();
            assert!(refused.contains(complaint), "{refused}");
        }
    }

    #[test]
    fn identification_of_another_joint_is_refused() {
        let file = written(["0.03", "0.08"], "1500.0");
        let known = Known::read(file.path(), "knee").unwrap();
        assert_eq!(known, Known { inertia: 0.03, viscous: 0.08, lag: 1.5e-3, is_read: true });
        let other = Known::read(file.path(), "hip").unwrap_err().to_string();
        assert!(other.contains("it is that of knee") && other.contains("identify hip --json"), "{other}");
        assert!(Known::read(Path::new("/dev/zero"), "knee").is_err());
    }
}
