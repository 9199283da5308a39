//! Changes single values of a configuration file. Its comments, order and other values stay.

use crate::failure::DirectFailure;
use motord_configuration::{self as config, Machine};
use motord_settings::settings::Settings;
use motord_terminal::recreate;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use toml_edit::{DocumentMut, InlineTable, Item, TableLike, Value};

pub(super) const DIRECTION: &str = "direction";
pub(super) const POSITION: &str = "limits.position-rad";
pub(super) const TORQUE_CONSTANT: &str = "torque-constant-nm-per-a";
pub(super) const GEAR_RATIO: &str = "gear-ratio";

/// Values of a motor by their keys, as TOML. A key may name a table first: `limits.position-rad`.
pub(super) type Values = BTreeMap<String, String>;

/// A configuration file and its settings.
pub(super) struct Configuration {
    pub(super) path: PathBuf,
    pub(super) settings: Settings,
}

impl Configuration {
    /// Reads and checks the file.
    ///
    /// # Errors
    ///
    /// Its mistakes.
    pub(super) fn load(path: &Path) -> Result<Self, DirectFailure> {
        Ok(Self { path: path.to_owned(), settings: config::load(path)?.settings })
    }

    /// Returns the values of these keys that the `[[motor]]` of `joint` has.
    ///
    /// # Errors
    ///
    /// The file cannot be read, or has no such `[[motor]]`.
    pub(super) fn values(&self, joint: &str, keys: &[&str]) -> Result<Values, DirectFailure> {
        let mut document = self.document()?;
        let motor = self.motor(&mut document, joint)?;
        let value = |key: &&str| {
            let found = match key.split_once('.') {
                Some((table, key)) => motor.get(table)?.as_table_like()?.get(key),
                None => motor.get(key),
            };
            let mut value = found?.as_value()?.clone();
            value.decor_mut().clear();
            Some(((*key).to_owned(), value.to_string()))
        };
        Ok(keys.iter().filter_map(value).collect())
    }

    /// Gives the keys of `joint` these values, and removes those without one. Checks the new text
    /// before it replaces the file.
    ///
    /// # Errors
    ///
    /// The mistakes of the new text, other buses than at first, or the file cannot be read or
    /// written. Then it has not changed.
    pub(super) fn set(&mut self, joint: &str, keys: &[&str], values: &Values) -> Result<(), DirectFailure> {
        let mut document = self.document()?;
        let motor = self.motor(&mut document, joint)?;
        for &key in keys {
            let value = values.get(key).map(|text| text.parse::<Value>());
            let value = value.transpose().map_err(|error| self.malformed(error.to_string()))?;
            change(motor, key, value).ok_or_else(|| self.malformed(format!("`{key}` is in no table")))?;
        }
        let text = document.to_string();
        let loaded = config::parse(&self.path, text.as_bytes(), &Machine::here())?;
        if !has_same_buses(&loaded.settings, &self.settings) {
            let reason = "its buses have changed while the guide runs: leave with q, and start it again";
            return Err(self.malformed(reason.to_owned()));
        }
        replace(&self.path, &text)?;
        self.settings = loaded.settings;
        Ok(())
    }

    fn document(&self) -> Result<DocumentMut, DirectFailure> {
        let malformed = |error: &dyn ToString| self.malformed(error.to_string());
        let text = config::text(&self.path).map_err(|problem| malformed(&problem.wrong))?;
        text.parse().map_err(|error: toml_edit::TomlError| malformed(&error.message()))
    }

    fn motor<'d>(
        &self,
        document: &'d mut DocumentMut,
        joint: &str,
    ) -> Result<&'d mut dyn TableLike, DirectFailure> {
        let is_it = |motor: &dyn TableLike| motor.get("name").and_then(Item::as_str) == Some(joint);
        let found = match document.get_mut("motor") {
            Some(Item::ArrayOfTables(motors)) => {
                motors.iter_mut().map(|motor| motor as &mut dyn TableLike).find(|motor| is_it(*motor))
            }
            Some(Item::Value(Value::Array(motors))) => {
                let tables = motors.iter_mut().filter_map(Value::as_inline_table_mut);
                tables.map(|motor| motor as &mut dyn TableLike).find(|motor| is_it(*motor))
            }
            _ => None,
        };
        found.ok_or_else(|| self.malformed(format!("there is no [[motor]] {joint}")))
    }

    fn malformed(&self, reason: String) -> DirectFailure {
        DirectFailure::Malformed { path: self.path.clone(), reason }
    }
}

/// Motors and open buses refer to buses by their index.
fn has_same_buses(one: &Settings, other: &Settings) -> bool {
    let buses = |settings: &Settings| -> Vec<(String, String)> {
        settings.buses.iter().map(|bus| (bus.name.to_string(), bus.device().to_owned())).collect()
    };
    buses(one) == buses(other)
}

/// Sets or removes a key. `None` when the name of its table is that of a value.
fn change(motor: &mut dyn TableLike, key: &str, value: Option<Value>) -> Option<()> {
    let Some((table, key)) = key.split_once('.') else { return set(motor, key, value) };
    let is_removed = value.is_none();
    if motor.get(table).is_none() {
        motor.insert(table, Item::Value(InlineTable::new().into()));
    }
    let values = motor.get_mut(table)?.as_table_like_mut()?;
    set(values, key, value)?;
    let is_left = values.is_empty() && motor.get(table).is_some_and(Item::is_inline_table);
    if is_removed && is_left {
        motor.remove(table);
    }
    Some(())
}

fn set(table: &mut dyn TableLike, key: &str, value: Option<Value>) -> Option<()> {
    match (value, table.get_mut(key).and_then(Item::as_value_mut)) {
        (Some(Value::Array(new)), Some(Value::Array(old))) if new.len() == old.len() => {
            // With the comments between its lines.
            old.iter_mut().zip(new).for_each(|(old, new)| set_value(old, new));
        }
        (Some(new), Some(old)) => set_value(old, new),
        (Some(new), None) => drop(table.insert(key, Item::Value(new))),
        (None, _) => drop(table.remove(key)),
    }
    Some(())
}

/// Replaces a value, and keeps the comment after it.
fn set_value(old: &mut Value, mut new: Value) {
    *new.decor_mut() = old.decor().clone();
    *old = new;
}

/// Replaces a file atomically and durably, with the permissions that it has. A symbolic link stays.
///
/// # Errors
///
/// The file cannot be written.
pub(super) fn replace(path: &Path, text: &str) -> Result<(), DirectFailure> {
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let write = || {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let next = path.with_file_name(format!(".{name}.motorctl"));
        let mut file = recreate(&next)?;
        if let Ok(old) = fs::metadata(&path) {
            file.set_permissions(old.permissions())?;
        }
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&next, &path)?;
        synchronise_folder(&path)
    };
    write().map_err(|source| DirectFailure::File { path: path.clone(), source })
}

/// Makes a new name last over a loss of power.
fn synchronise_folder(path: &Path) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "\
# My robot.
[[bus]]
name = 'arm'
type = 'socketcan' # on the left
interface = 'can0'

[[motor]]
name = 'hip'
bus = 'arm'
id = 1
protocol = 'mit'
model = 'GIM8108-8'
direction = -1 # as mounted
[motor.limits]
torque-nm = 2 # cautious
position-rad = [-0.5, 0.5] # guessed

[[motor]]
name = 'knee'
bus = 'arm'
id = 2
protocol = 'mit'
model = 'GIM8108-8'
";

    fn configuration(test: &str, text: &str) -> Configuration {
        let path = std::env::temp_dir().join(format!("motord-edit-{test}-{}.toml", std::process::id()));
        fs::write(&path, text).unwrap();
        Configuration::load(&path).unwrap()
    }

    fn end(file: &Configuration) -> String {
        let text = fs::read_to_string(&file.path).unwrap();
        fs::remove_file(&file.path).unwrap();
        text
    }

    fn values(values: &[(&str, &str)]) -> Values {
        values.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect()
    }

    #[test]
    fn only_the_edited_values_change() {
        let mut file = configuration("values", TEXT);
        let new = values(&[(DIRECTION, "1"), (POSITION, "[-0.25, 1.5]")]);
        let former = file.values("hip", &[DIRECTION, POSITION, GEAR_RATIO]).unwrap();
        assert_eq!(former, values(&[(DIRECTION, "-1"), (POSITION, "[-0.5, 0.5]")]));
        file.set("hip", &[DIRECTION, POSITION], &new).unwrap();
        assert_eq!(file.settings.motors[0].limits.position, [-0.25, 1.5]);
        let edited = TEXT.replace("direction = -1", "direction = 1").replace("[-0.5, 0.5]", "[-0.25, 1.5]");
        assert_eq!(end(&file), edited);
    }

    #[test]
    fn new_keys_are_removed_again() {
        let mut file = configuration("keys", TEXT);
        file.set("knee", &[DIRECTION, GEAR_RATIO], &values(&[(DIRECTION, "-1"), (GEAR_RATIO, "9")])).unwrap();
        let text = fs::read_to_string(&file.path).unwrap();
        assert_eq!(text, format!("{TEXT}direction = -1\ngear-ratio = 9\n"));
        file.set("knee", &[DIRECTION, GEAR_RATIO], &Values::new()).unwrap();
        file.set("knee", &[POSITION], &values(&[(POSITION, "[-0.25, 1.5]")])).unwrap();
        file.set("knee", &[POSITION], &Values::new()).unwrap();
        assert_eq!(end(&file), TEXT);
    }

    #[test]
    fn comments_between_ends_of_range_stay() {
        let text = TEXT.replace("[-0.5, 0.5]", "[\n  -0.5, # folded\n  0.5, # stretched\n]");
        let mut file = configuration("comments", &text);
        file.set("hip", &[POSITION], &values(&[(POSITION, "[-0.25, 1.5]")])).unwrap();
        assert_eq!(end(&file), text.replace("-0.5,", "-0.25,").replace(" 0.5,", " 1.5,"));
    }

    #[test]
    fn other_buses_are_refused() {
        let mut file = configuration("buses", TEXT);
        let other = TEXT.replace("interface = 'can0'", "interface = 'can1'");
        fs::write(&file.path, &other).unwrap();
        let refused = file.set("hip", &[DIRECTION], &values(&[(DIRECTION, "1")])).unwrap_err();
        assert!(refused.to_string().contains("buses have changed"), "{refused}");
        assert_eq!(end(&file), other);
    }

    #[test]
    fn refused_value_leaves_file_as_it_was() {
        let mut file = configuration("refused", TEXT);
        let refused = file.set("hip", &[POSITION], &values(&[(POSITION, "[2.0, 1.0]")])).unwrap_err();
        assert!(matches!(refused, DirectFailure::Config(_)), "{refused}");
        assert_eq!(end(&file), TEXT);
    }
}
