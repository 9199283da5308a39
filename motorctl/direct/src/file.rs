//! `motorctl config dump|diff|apply|reset`: the configuration of a motor as a file.

use crate::failure::DirectFailure;
use crate::journal::Journal;
use crate::memory::{effective, parse_item, read, text};
use crate::output::{Confirm, print_line};
use crate::target::{Session, Target};
use motord_configuration::Wrong;
use motord_protocol::commissioning::{
    Apply, Change, Error, Failed, Family, Native, changes, check_value, identify, is_taken,
};
use motord_protocol::gim::{Access, CONFIGURATION, ConfigurationItem, Finite, Value, ValueType};
use motord_terminal::{Cell, Palette, Table, json, printable};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::Path;

/// Items and their values.
type Values = Vec<(&'static ConfigurationItem, Value)>;

/// The id of a new motor. Not documented by the vendors.
pub(crate) const FACTORY_ID: u8 = 1;

/// A file of `motorctl config dump`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    /// The motor that the file was read from. Not used.
    #[serde(default, rename = "motor")]
    _motor: toml::Table,
    configuration: toml::Table,
}

/// `motorctl config dump`: to a new file, or to standard output.
pub(crate) fn dump(target: &Target, file: Option<&Path>, force: bool) -> Result<(), DirectFailure> {
    let mut session = target.open_gim()?;
    let text = document(&mut session)?;
    let Some(path) = file else { return Ok(io::stdout().write_all(text.as_bytes())?) };
    let mut options = OpenOptions::new();
    let options = options.write(true).create(true).truncate(true).create_new(!force);
    let written = options.open(path).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.sync_all()
    });
    written.map_err(|source| DirectFailure::File { path: path.to_owned(), source })?;
    print_line(&format!("{}: configuration written to {}", session.name(), path.display()))
}

fn document(session: &mut Session) -> Result<String, Error> {
    let (id, bus) = (session.id, session.line.name.clone());
    let mut motor = session.gim();
    let firmware = motor.version()?;
    let mut text = format!(
        "# The configuration of a motor, read by `motorctl config dump`. `motorctl config apply` writes it back.\n\n\
         [motor]\nid = {id}\nbus = {bus:?}\nfirmware = {firmware}\n\n[configuration]\n"
    );
    for item in &CONFIGURATION {
        let line = match read(&mut motor, item)? {
            Ok(Value::Integer(value)) => format!("{} = {value}", item.name),
            // Debug prints the shortest text that is this float, always as a float.
            Ok(Value::Float(value)) => format!("{} = {:?}", item.name, value.get()),
            Err(refusal) => format!("# {}: {refusal}", item.name),
        };
        let unit = if item.unit.is_empty() { String::new() } else { format!(" {}", item.unit) };
        let access = if item.access == Access::ReadOnly { " read only" } else { "" };
        let note = format!("{unit}{access}");
        let _infallible = match note.is_empty() {
            true => writeln!(text, "{line}"),
            false => writeln!(text, "{line}  #{note}"),
        };
    }
    Ok(text)
}

/// Reads and checks the complete file before anything is written to a motor.
fn load(path: &Path) -> Result<Values, DirectFailure> {
    let malformed = |reason: String| DirectFailure::Malformed { path: path.to_owned(), reason };
    let text = motord_configuration::text(path).map_err(|problem| match problem.wrong {
        Wrong::Unreadable(source) => DirectFailure::File { path: path.to_owned(), source },
        wrong => malformed(wrong.to_string()),
    })?;
    let document: Document = toml::from_str(&text).map_err(|error| malformed(error.to_string()))?;
    let values = document.configuration.iter().map(|(name, value)| {
        let item =
            parse_item(name).map_err(|expected| format!("`{name}` is no configuration item: {expected}"))?;
        Ok((item, value_of(item, value)?))
    });
    values.collect::<Result<Values, String>>().map_err(malformed)
}

fn value_of(item: &ConfigurationItem, value: &toml::Value) -> Result<Value, String> {
    let read = match (item.value_type, value) {
        (ValueType::Integer, toml::Value::Integer(value)) => i32::try_from(*value).ok().map(Value::Integer),
        (ValueType::Float, toml::Value::Integer(value)) => Finite::new(*value as f32).map(Value::Float),
        (ValueType::Float, toml::Value::Float(value)) => Finite::new(*value as f32).map(Value::Float),
        _ => None,
    };
    let kind = if item.value_type == ValueType::Integer { "an integer of 32 bits" } else { "a number" };
    let read = read.ok_or_else(|| format!("{} is {kind}, not {value}", item.name))?;
    check_value(item, read)?;
    Ok(read)
}

/// Reads the present values of the items in `wanted`.
pub(crate) fn present(session: &mut Session, wanted: &Values) -> Result<Values, Error> {
    let mut motor = session.gim();
    wanted.iter().map(|(item, _)| Ok((*item, motor.configuration(item.key())?))).collect()
}

#[derive(Serialize)]
struct Difference {
    item: &'static str,
    motor: f64,
    file: f64,
}

fn print(changes: &[Change], as_json: bool) -> io::Result<()> {
    let out = &mut io::stdout().lock();
    if as_json {
        let row = |change: &Change| Difference {
            item: change.item.name,
            motor: change.from.as_f64(),
            file: change.to.as_f64(),
        };
        return json::write_line(out, &changes.iter().map(row).collect::<Vec<_>>());
    }
    let mut table = Table::new(&["item", "motor", "file", "unit", "effective"]);
    for Change { item, from, to } in changes {
        let cells = [item.name, &text(*from), &text(*to), item.unit, effective(item)];
        table.row(cells.map(Cell::plain).into());
    }
    table.write(out, Palette::of_stdout())
}

/// `motorctl config diff`. The exit status is 1 when something differs.
pub(crate) fn diff(target: &Target, file: &Path, as_json: bool) -> Result<(), DirectFailure> {
    let wanted = load(file)?;
    let mut session = target.open_gim()?;
    let present = present(&mut session, &wanted)?;
    let changes = changes(&present, &wanted);
    print(&changes, as_json)?;
    match changes.len() {
        0 => Ok(()),
        count => Err(DirectFailure::Differs { count }),
    }
}

/// `motorctl config apply`: writes each differing item and reads it back.
pub(crate) fn apply(
    target: &Target,
    file: &Path,
    journal: Option<&Path>,
    confirm: Confirm,
) -> Result<(), DirectFailure> {
    let wanted = load(file)?;
    let mut session = target.open_gim()?;
    let present = present(&mut session, &wanted)?;
    let changes = changes(&present, &wanted);
    let (name, apply) = (session.name(), Apply { changes: &changes });
    if changes.is_empty() {
        return print_line(&format!("{name}: nothing differs"));
    }
    apply.check(&mut session.gim())?;
    print(&changes, false)?;
    let mut journal = Journal::open(file, journal)?;
    if let Some(unfinished) = journal.unfinished() {
        eprintln!("motorctl: an earlier application was cut off: {}", printable(&unfinished.to_string()));
    }
    confirm.ask(&format!(
        "This permanently writes {} to {name}. {} records each write, also after a power cut.",
        items(changes.len()),
        journal.path().display()
    ))?;
    journal.begin(&name, &changes)?;
    match apply.run(&mut session.gim(), &mut |event| journal.note(&event)) {
        Ok(()) => {
            journal.end("done")?;
            print_line(&format!("{name}: {} written, each read back", items(changes.len())))
        }
        Err(Failed::Journal(failure)) => Err(failure),
        Err(failed @ Failed::Motor { .. }) => {
            let reason = failed.to_string();
            journal.end(&reason)?;
            Err(DirectFailure::Apply { reason, journal: journal.path().to_owned() })
        }
    }
}

/// Returns a count of items in words.
fn items(count: usize) -> String {
    if count == 1 { "1 item".to_owned() } else { format!("{count} items") }
}

/// `motorctl config reset`: sets every item to its default, also id and bit rate.
pub(crate) fn reset(target: &Target, confirm: Confirm) -> Result<(), DirectFailure> {
    let mut session = target.open_gim()?;
    let (name, id) = (session.name(), session.id);
    let link = &mut session.line.link;
    if id != FACTORY_ID && is_taken(link, FACTORY_ID)? {
        let reason = "another motor answers as id 1, which this one may have after a reset: connect it alone";
        return Err(session.unfit(reason));
    }
    confirm.ask(&format!(
        "This permanently gives every configuration item of {name} its default: also its id, host id, bit rate, protocol, zero \
         position and motor constants. Save them first with `motorctl config dump`, and connect it alone: the defaults are in \
         no document."
    ))?;
    session.gim().reset_configuration()?;
    for candidate in [FACTORY_ID, id] {
        if let Some(found) = identify(&mut session.line.link, candidate)? {
            if found.family == Family::Native {
                // Makes the defaults survive a loss of power.
                Native::new(&mut session.line.link, candidate, found.host_id).refresh()?;
            }
            let host_id =
                found.host_id.map_or_else(String::new, |id| format!(" with host id {:#05X}", id.raw()));
            return print_line(&format!("{name}: reset; it answers as id {candidate}{host_id} now"));
        }
    }
    print_line(&format!(
        "{name}: reset; it answers neither as id {FACTORY_ID} nor as id {id}: `motorctl scan` finds it"
    ))
}
