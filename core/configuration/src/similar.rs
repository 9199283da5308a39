//! Suggests the known name that is most similar to an unknown one.

use super::problem::plain;

/// Least similarity (Jaro-Winkler) of a suggestion; 1 is equal.
const ALIKE: f64 = 0.8;

/// Returns a hint for an unknown name: the most similar known name, or all of them. Escapes control
/// characters in the known names.
#[must_use]
pub fn suggestion<'k>(written: &str, known: impl Iterator<Item = &'k str>) -> String {
    let known: Vec<_> = known.collect();
    let likeness = |name: &str| strsim::jaro_winkler(&written.to_lowercase(), &name.to_lowercase());
    let closest = known.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    match closest {
        Some(name) if likeness(name) >= ALIKE => format!("did you mean `{}`?", plain(name)),
        _ => format!("known are {}", plain(&known.join(", "))),
    }
}
