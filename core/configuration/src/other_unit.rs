//! The hint for an unknown key that is a known one in another unit.

use toml::Spanned;
use toml::de::DeValue;

use super::similar::closest;
use super::units::{Shown, Unit, short};
use super::value::Value;

/// Returns the hint for the unknown key `name`: the same number would mean something else in the
/// known key.
pub(super) fn hint(
    (name, value): (&str, &Spanned<DeValue<'_>>),
    keys: &[&'static str],
    units: &[&'static str],
) -> Option<String> {
    let name = &kebab(name);
    let own = |key: &str| Unit::of_key(units.get(keys.iter().position(|known| *known == key)?)?);
    let of_stem = |key: &&&'static str| {
        own(key).is_some_and(|own| {
            name.strip_prefix(stem(key, own))
                .is_some_and(|rest| rest.starts_with('-') && own.spelt(&rest[1..]).is_some())
        })
    };
    let key = keys.iter().find(of_stem).copied().or_else(|| closest(name, keys.iter().copied()))?;
    let own = own(key)?;
    let ends = name.match_indices('-').map(|(at, _)| &name[at + 1..]);
    let from = match name.strip_prefix(stem(key, own)).and_then(|rest| rest.strip_prefix('-')) {
        Some(suffix) => own.spelt(suffix),
        None => ends.filter_map(|end| own.spelt(end)).next(),
    }?;
    if from == own {
        return None;
    }
    let unit = own.name();
    let Some((written, converted)) = converted(value, own, from) else {
        return Some(format!("`{key}` is in {unit}, and not in {}; convert the value", from.name()));
    };
    let (written, with) = (from.with(&written), own.with(&converted));
    Some(format!("`{key}` is in {unit}; {written} is {with}: write {key} = {converted}"))
}

/// The key without its unit.
fn stem<'k>(key: &'k str, own: &Unit) -> &'k str {
    let ends = key.match_indices('-').map(|(at, _)| at);
    let at = ends.into_iter().find(|at| own.spelt(&key[at + 1..]) == Some(own));
    at.map_or(key, |at| &key[..at])
}

/// A number or a list of numbers, and the same in the unit `to`.
fn converted(value: &Spanned<DeValue<'_>>, to: &Unit, from: &Unit) -> Option<(String, String)> {
    let Some(items) = value.get_ref().as_array() else {
        let number = f64::read(value).ok().filter(|number| number.is_finite())?;
        return Some((Shown(number).to_string(), short(to.convert(number, from)?)));
    };
    let pairs = items.iter().map(|item| {
        let number = f64::read(item).ok().filter(|number| number.is_finite())?;
        Some((Shown(number).to_string(), short(to.convert(number, from)?)))
    });
    let (written, converted): (Vec<_>, Vec<_>) = pairs.collect::<Option<Vec<_>>>()?.into_iter().unzip();
    Some((format!("[{}]", written.join(", ")), format!("[{}]", converted.join(", "))))
}

/// `setpoint-timeout-s` of `setpoint_timeout_s` or `setpointTimeoutS`.
fn kebab(name: &str) -> String {
    let letter = |letter: char| match letter {
        '_' => "-".to_owned(),
        letter if letter.is_ascii_uppercase() => format!("-{}", letter.to_ascii_lowercase()),
        letter => letter.to_string(),
    };
    name.chars().map(letter).collect::<String>().trim_start_matches('-').to_owned()
}
