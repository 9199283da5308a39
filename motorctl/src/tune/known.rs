//! The mechanics of the joint: identified in this run, or from a file.

use crate::tune::failure::TuneFailure;
use motord_identify::Identified;
use motord_terminal::InputFile;
use serde::Deserialize;
use std::path::Path;

/// Largest identification, bytes: a thousand times that of one joint.
const BYTES_MAX: u64 = 1 << 20;

/// The mechanics of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Known {
    /// kg·m².
    pub(crate) inertia: f64,
    /// Viscous friction, N·m·s/rad; 0 where it is not identifiable.
    pub(crate) viscous: f64,
    /// Lag of the drive beyond the stamps, s.
    pub(crate) lag: f64,
    /// From a file.
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
        let text = InputFile::open(path).and_then(|file| file.read_text(BYTES_MAX));
        let text = text.map_err(|error| refused(error.to_string()))?;
        let file: File = serde_json::from_str(&text).map_err(|error| refused(error.to_string()))?;
        if file.joint != joint {
            return Err(refused(format!("it is that of {}", file.joint)));
        }
        let inertia = file
            .inertia_kg_m2
            .identified()
            .ok_or_else(|| refused("its inertia was not identifiable".into()))?;
        let viscous = file.viscous_friction_nm_s_per_rad.identified().unwrap_or(0.0);
        let lag = file.lag_us.unwrap_or(0.0).max(0.0) / 1e6;
        Ok(Self { inertia, viscous, lag, is_read: true })
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

    #[test]
    fn identification_of_another_joint_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let entry =
            |value: f64| format!(r#"{{"value": {value}, "lower": 0, "upper": 1, "is_identified": true}}"#);
        let text = format!(
            r#"{{"joint": "knee", "inertia_kg_m2": {}, "viscous_friction_nm_s_per_rad": {}, "lag_us": 1500.0, "notes": []}}"#,
            entry(0.03),
            entry(0.08)
        );
        std::fs::write(file.path(), text).unwrap();
        let known = Known::read(file.path(), "knee").unwrap();
        assert_eq!(known, Known { inertia: 0.03, viscous: 0.08, lag: 1.5e-3, is_read: true });
        let other = Known::read(file.path(), "hip").unwrap_err().to_string();
        assert!(other.contains("it is that of knee") && other.contains("identify hip --json"), "{other}");
        assert!(Known::read(Path::new("/dev/zero"), "knee").is_err());
    }
}
