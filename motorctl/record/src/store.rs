//! The files of `motorctl flight` in their directory.

use motord_mcap::Remembered;
use motord_terminal::recreate;
use std::fs;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// Size of a write to the disk, bytes.
const WRITE_BYTES: usize = 256 << 10;

/// The destination of the files.
#[derive(Debug, Clone)]
pub(crate) struct FileStore {
    pub(crate) directory: PathBuf,
    pub(crate) instance: String,
    /// Limit on the files of the instance.
    pub(crate) files_max: usize,
}

impl FileStore {
    /// Writes a file under a temporary name, and renames it once it is complete. Then removes the
    /// oldest files, and never this one.
    pub(crate) fn write(&self, remembered: &Remembered, why: &str) -> io::Result<(PathBuf, u64)> {
        let unfinished = self.directory.join(format!("{}.unfinished", self.instance));
        let number = self.ours().last().map_or(0, |(number, _)| *number).saturating_add(1);
        let name = self.name(OffsetDateTime::now_utc(), number, why);
        let path = self.directory.join(&name);
        let written = Self::fill(&unfinished, remembered).and_then(|cycles| {
            fs::rename(&unfinished, &path)?;
            Ok((path, cycles))
        });
        match written {
            Ok(_) => self.remove_oldest(&name),
            Err(_) => {
                let _missing = fs::remove_file(&unfinished);
            }
        }
        written
    }

    /// Writes the file `path`, in place of what has this name.
    fn fill(path: &Path, remembered: &Remembered) -> io::Result<u64> {
        let mut out = BufWriter::with_capacity(WRITE_BYTES, recreate(path)?);
        let cycles = remembered.write(&mut out)?;
        out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        Ok(cycles)
    }

    /// The clock may be wrong, so `number` orders the files of an instance.
    fn name(&self, time: OffsetDateTime, number: u64, why: &str) -> String {
        let (date, clock) = (time.date(), time.time());
        let (year, month, day) = (date.year(), u8::from(date.month()), date.day());
        let (hour, minute, second) = (clock.hour(), clock.minute(), clock.second());
        let instance = &self.instance;
        format!(
            "{instance}-{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}Z-{number:06}-{why}.mcap"
        )
    }

    /// Returns the number in the name of a file of this instance; 0 for a name without a number.
    /// The name of another instance may begin with the name of this one.
    fn number(&self, name: &str) -> Option<u64> {
        let rest = name.strip_suffix(".mcap")?.strip_prefix(&self.instance)?.strip_prefix('-')?;
        let (time, rest) = rest.split_once("Z-")?;
        let is_time = time.len() == 15
            && time
                .bytes()
                .enumerate()
                .all(|(index, byte)| if index == 8 { byte == b'T' } else { byte.is_ascii_digit() });
        let number = rest.split_once('-').and_then(|(number, _)| number.parse().ok());
        is_time.then(|| number.unwrap_or(0))
    }

    /// Returns number and name of the files of this instance, the oldest first. Files without a
    /// number sort by the time in their names.
    fn ours(&self) -> Vec<(u64, String)> {
        let Ok(entries) = fs::read_dir(&self.directory) else { return Vec::new() };
        let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let mut ours: Vec<_> = names.filter_map(|name| Some((self.number(&name)?, name))).collect();
        ours.sort_unstable();
        ours
    }

    /// Removes the oldest files of the instance until at most `files_max` are left, with `newest`
    /// among them.
    fn remove_oldest(&self, newest: &str) {
        let ours = self.ours();
        let others = ours.iter().filter(|(_, name)| name != newest);
        for (_, name) in others.take(ours.len().saturating_sub(self.files_max)) {
            let _next_time = fs::remove_file(self.directory.join(name));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    /// Goal: the newest file is never the one that is removed, whatever the clock says.
    /// Method: the directory is full of files of a time in the future.
    #[test]
    fn newest_file_stays_whatever_the_clock_shows() {
        let directory = std::env::temp_dir().join(format!("motord-flight-clock-{}", std::process::id()));
        fs::create_dir(&directory).unwrap();
        let store = FileStore { directory: directory.clone(), instance: "arm".to_owned(), files_max: 2 };
        let future = ["20990101", "20990102", "20990103"].map(|day| format!("arm-{day}T000000Z-x.mcap"));
        future.iter().for_each(|name| fs::write(directory.join(name), "").unwrap());
        let robot = motord_client::RobotDescription::default();
        let mut memory = motord_mcap::Memory::new(&robot, Duration::from_secs(1), 1 << 20);
        let written: Vec<PathBuf> = (0..3)
            .map(|_| {
                store
                    .write(&memory.remembered(motord_mcap::Origin::default()).unwrap(), "motor-fault")
                    .unwrap()
                    .0
            })
            .inspect(|path| assert!(path.exists(), "{} was reported as written", path.display()))
            .collect();
        let left = written.iter().filter(|path| path.exists()).count();
        assert_eq!(left, 2, "each has a name of its own, and the two newest are left");
        assert!(!future.iter().any(|name| directory.join(name).exists()));
        fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn oldest_files_of_this_instance_are_removed() {
        let directory = std::env::temp_dir().join(format!("motord-flight-{}", std::process::id()));
        fs::create_dir(&directory).unwrap();
        let store = FileStore { directory: directory.clone(), instance: "arm".to_owned(), files_max: 3 };
        let others = ["arm-2-20250101T000000Z-x.mcap", "arm-notes.mcap", "leg-20240101T000000Z-x.mcap"];
        let named = |number| store.name(OffsetDateTime::UNIX_EPOCH, number, "daemon-gone");
        assert_eq!(named(17), "arm-19700101T000000Z-000017-daemon-gone.mcap");
        let ours = [
            "arm-20260101T000000Z-x.mcap".to_owned(),
            "arm-20260102T000000Z-daemon-gone.mcap".to_owned(),
            named(9_999_999),
            named(10_000_000),
            named(10_000_001),
        ];
        for name in others.iter().copied().chain(ours.iter().map(String::as_str)) {
            fs::write(directory.join(name), "").unwrap();
        }
        store.remove_oldest(&ours[0]);
        let is_there = |name: &str| directory.join(name).exists();
        assert!(others.iter().all(|name| is_there(name)));
        assert_eq!(ours.each_ref().map(|name| is_there(name)), [true, false, false, true, true]);
        fs::remove_dir_all(&directory).unwrap();
    }

    /// Goal: a user who may write to the directory has no file elsewhere overwritten, and blocks no
    /// write.
    #[test]
    fn prepared_unfinished_file_is_not_written_into() {
        let directory = std::env::temp_dir().join(format!("motord-flight-link-{}", std::process::id()));
        fs::create_dir(&directory).unwrap();
        let store = FileStore { directory: directory.clone(), instance: "arm".to_owned(), files_max: 9 };
        let (unfinished, elsewhere) = (directory.join("arm.unfinished"), directory.join("elsewhere"));
        let robot = motord_client::RobotDescription::default();
        let mut memory = motord_mcap::Memory::new(&robot, Duration::from_secs(1), 1 << 20);
        let mut write = || store.write(&memory.remembered(motord_mcap::Origin::default()).unwrap(), "x");
        fs::write(&elsewhere, "kept").unwrap();
        std::os::unix::fs::symlink(&elsewhere, &unfinished).unwrap();
        let (linked, _) = write().unwrap();
        assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "kept");
        assert!(fs::symlink_metadata(linked).unwrap().is_file());
        assert!(std::process::Command::new("mkfifo").arg(&unfinished).status().unwrap().success());
        let (piped, _) = write().unwrap();
        assert!(fs::symlink_metadata(piped).unwrap().is_file());
        fs::remove_dir_all(&directory).unwrap();
    }
}
