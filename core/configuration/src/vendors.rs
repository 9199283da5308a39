//! The user's files of vendors: those in the folder `models.d` beside a configuration.

use std::ffi::OsStr;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use motord_protocol::FAMILIES;
use motord_protocol::profile::{FileProblem, Profile, parse, register};

use super::file::text;
use super::problem::{Location, Problem, Wrong};
use super::similar::suggestion;

/// The folder beside a configuration.
pub const FOLDER: &str = "models.d";
/// Most files in the folder.
const FILES_MAX: usize = 100;

/// Makes the motors of every file `models.d/*.toml` beside `configuration` known in this process. A
/// missing folder has none. [`load`](crate::load) does it.
///
/// # Errors
///
/// Every problem found, with file, line and key. The files without one are known.
pub fn register_beside(configuration: &Path) -> Result<(), Vec<Problem>> {
    let folder = configuration.with_file_name(FOLDER);
    let problems = match files(&folder) {
        Ok(files) => files.iter().flat_map(|file| register_file(file)).collect(),
        Err(wrong) => vec![Problem { file: folder, location: None, wrong }],
    };
    if problems.is_empty() { Ok(()) } else { Err(problems) }
}

/// Returns the files of vendors in a folder, in the order of their names.
fn files(folder: &Path) -> Result<Vec<PathBuf>, Wrong> {
    match std::fs::metadata(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Ok(metadata) if metadata.permissions().mode() & 0o002 != 0 => return Err(Wrong::WorldWritable),
        _ => {}
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension() == Some(OsStr::new("toml")) {
            files.push(path);
        }
        if files.len() > FILES_MAX {
            return Err(Wrong::TooMany { max: FILES_MAX });
        }
    }
    files.sort_unstable();
    Ok(files)
}

fn register_file(file: &Path) -> Vec<Problem> {
    let (profile, text) = match read_vendor(file) {
        Ok(read) => read,
        Err(problems) => return problems,
    };
    match register(profile) {
        Ok(()) => Vec::new(),
        Err(taken) => vec![problem_at(file, &text, taken.name, Wrong::Vendor(taken.to_string()))],
    }
}

/// Reads and checks the file of a vendor, by the rules of [`load`](crate::load), and returns it with
/// its text. Other vendors may have its names.
///
/// # Errors
///
/// Every problem found, with file, line and key.
pub fn read_vendor(file: &Path) -> Result<(Profile, String), Vec<Problem>> {
    let text = text(file).map_err(|problem| vec![problem])?;
    let problem = |FileProblem { line, column, key, message }| Problem {
        file: file.into(),
        location: Some(Location { line, column, key: Some(key).filter(|key| !key.is_empty()) }),
        wrong: Wrong::Vendor(message),
    };
    let profile = parse(&text).map_err(|problems| problems.into_iter().map(problem).collect::<Vec<_>>())?;
    let is_known = |name: &&&str| FAMILIES.iter().any(|(known, _)| known == *name);
    let unknown = profile.protocols.iter().filter(|name| !is_known(name));
    let unknown: Vec<_> = unknown
        .map(|name| {
            let hint = suggestion(name, FAMILIES.iter().map(|(known, _)| *known));
            problem_at(file, &text, name, Wrong::Vendor(format!("unknown protocol `{name}`; {hint}")))
        })
        .collect();
    if unknown.is_empty() { Ok((profile, text)) } else { Err(unknown) }
}

/// Returns the text of the file of `vendor` in the folder beside `configuration`.
#[must_use]
pub fn text_beside(configuration: &Path, vendor: &str) -> Option<String> {
    let files = files(&configuration.with_file_name(FOLDER)).ok()?;
    let mut read = files.iter().filter_map(|file| read_vendor(file).ok());
    read.find_map(|(profile, text)| (profile.name == vendor).then_some(text))
}

/// Returns a problem at the first place of a text in quotes.
fn problem_at(file: &Path, text: &str, quoted: &str, wrong: Wrong) -> Problem {
    let quotes = [format!("\"{quoted}\""), format!("'{quoted}'")];
    let offset = quotes.iter().find_map(|quoted| text.find(quoted));
    let location = offset.map(|offset| Location::at(text.as_bytes(), offset, None));
    Problem { file: file.into(), location, wrong }
}
