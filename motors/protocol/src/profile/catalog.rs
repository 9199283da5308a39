//! The known profiles: those in the folder `models` of this crate, and those that the user
//! registered.

use super::{Profile, parse};
use crate::model::Model;
use core::fmt;
use std::sync::{LazyLock, PoisonError, RwLock};

/// Defines the profiles that the crate brings. A row has the documentation, the name in Rust, and
/// the file.
macro_rules! shipped {
    ($($(#[$doc:meta])* $name:ident = $file:literal),+ $(,)?) => {
        $($(#[$doc])*
        pub static $name: LazyLock<Profile> =
            LazyLock::new(|| read(include_str!(concat!("../../models/", $file))));)+

        /// Returns the profiles that the crate brings, each with the text of its file.
        #[must_use]
        pub fn shipped() -> Vec<(&'static Profile, &'static str)> {
            vec![$((&*$name, include_str!(concat!("../../models/", $file)))),+]
        }
    };
}

shipped! {
    /// SteadyWin SDC101, SDC102 and SDC103.
    STEADYWIN = "steadywin.toml",
    /// Damiao's DM-J series.
    DAMIAO = "damiao.toml",
    /// RobStride's RS series, MIT mode.
    ROBSTRIDE = "robstride.toml",
    /// CubeMars' AK series, MIT mode.
    CUBEMARS = "cubemars.toml",
    /// MyActuator's RMD series.
    MYACTUATOR = "myactuator.toml",
    /// ODrive Pro, S1 and Micro.
    ODRIVE = "odrive.toml",
}

/// The profiles that the user registered. Never read by a cycle.
static REGISTERED: RwLock<Vec<&'static Profile>> = RwLock::new(Vec::new());

/// Reads a file of this crate.
///
/// # Panics
///
/// When it has a problem. A test reads every one.
fn read(text: &'static str) -> Profile {
    match parse(text) {
        Ok(profile) => profile,
        Err(problems) => panic!("a file of this crate has a problem: {}", problems[0]),
    }
}

/// Why a profile is not registered: a name of it is taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NameTaken {
    /// The name, of a vendor or of a model.
    pub name: &'static str,
    /// The vendor that has it.
    pub vendor: &'static str,
}

impl fmt::Display for NameTaken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, vendor } = self;
        if name.eq_ignore_ascii_case(vendor) {
            write!(f, "there is a vendor `{vendor}` already; give this one another name")
        } else {
            write!(f, "`{name}` is a model of `{vendor}` already; give this one another name")
        }
    }
}

impl std::error::Error for NameTaken {}

/// Makes `profile` known in this process, for its life. No effect for a profile that is known.
///
/// # Errors
///
/// When another vendor has its name, or a model of another vendor the name of one of its models.
pub fn register(profile: Profile) -> Result<(), NameTaken> {
    let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
    let known: Vec<_> = known(registered.clone()).collect();
    if known.contains(&&profile) {
        return Ok(());
    }
    for other in known {
        if let Some(name) = shared_name(&profile, other) {
            return Err(NameTaken { name, vendor: other.name });
        }
    }
    registered.push(Box::leak(Box::new(profile)));
    Ok(())
}

/// Returns the profiles that the crate brings, then these.
fn known(registered: Vec<&'static Profile>) -> impl Iterator<Item = &'static Profile> {
    shipped().into_iter().map(|(profile, _)| profile).chain(registered)
}

/// Returns a name of the vendor or of a model that two profiles share.
fn shared_name(profile: &Profile, other: &Profile) -> Option<&'static str> {
    let is_taken = |name: &str| other.models.iter().any(|model| model.name.eq_ignore_ascii_case(name));
    let names = core::iter::once(profile.name).filter(|name| name.eq_ignore_ascii_case(other.name));
    names.chain(profile.models.iter().map(|model| model.name).filter(|name| is_taken(name))).next()
}

impl Profile {
    /// Returns the profiles of all supported vendors: those that the crate brings, then those that
    /// the user registered.
    pub fn all() -> impl Iterator<Item = &'static Self> {
        let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner).clone();
        known(registered)
    }

    /// Returns the profile with this name, in upper or lower case.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        Self::all().find(|profile| profile.name.eq_ignore_ascii_case(name))
    }

    /// Returns the model with this name, in upper or lower case, and its profile.
    #[must_use]
    pub fn of_model(name: &str) -> Option<(&'static Self, &'static Model)> {
        Self::all().find_map(|profile| {
            let model = profile.models.iter().find(|model| model.name.eq_ignore_ascii_case(name))?;
            Some((profile, model))
        })
    }
}

impl Model {
    /// Returns the model with this name, of any vendor, upper or lower case.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        Profile::of_model(name).map(|(_, model)| model)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn model_is_found_by_name_with_gear_ratio() {
        for model in STEADYWIN.models {
            let (_, ratio) = model.name.split_once('-').unwrap();
            assert_eq!(ratio.parse(), Ok(model.gear_ratio));
            assert_eq!(Model::by_name(model.name), Some(model));
        }
        assert_eq!(Model::by_name("gim8108-8").map(|model| model.name), Some("GIM8108-8"));
        assert_eq!(Model::by_name("GIM8108"), None);
    }

    #[test]
    fn every_models_peak_current_gives_its_peak_torque() {
        for model in STEADYWIN.models {
            let torque = model.peak_current * model.torque_constant * model.gear_ratio;
            assert!((torque / model.peak_torque - 1.0).abs() < 0.05, "{}: {torque} N·m", model.name);
        }
    }

    #[test]
    fn peak_torque_and_velocity_lie_within_code_ends() {
        for model in Profile::all().flat_map(|profile| profile.models) {
            let ends = model.scales().unwrap().ends();
            assert!(f64::from(model.peak_torque) <= ends.torque, "{}", model.name);
            assert!(f64::from(model.max_velocity) <= ends.velocity, "{}", model.name);
            assert!(model.rated_torque < model.peak_torque, "{}", model.name);
        }
    }

    #[test]
    fn names_of_known_profiles_are_taken() {
        let text = include_str!("../../models/damiao.toml");
        assert_eq!(register(parse(text).unwrap()), Ok(()), "the same profile is known");
        let other = parse(&text.replace("Damiao DM-J", "Another")).unwrap();
        let taken = register(other).unwrap_err();
        assert_eq!(taken.to_string(), "there is a vendor `damiao` already; give this one another name");
        let other = parse(&text.replace("vendor = \"damiao\"", "vendor = \"other\"")).unwrap();
        let taken = register(other).unwrap_err();
        let expected = "`DM-J3507-2EC` is a model of `damiao` already; give this one another name";
        assert_eq!(taken.to_string(), expected);
    }
}
