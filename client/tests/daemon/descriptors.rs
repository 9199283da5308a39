//! Calls in a process whose file descriptors are used up.

use super::fake_daemon::Running;
use super::{INSTANCE, TIMEOUT, directory};
use motord_client::{Client, Error, emergency_stop_in};
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use std::fs::File;
use std::path::Path;
use std::process::Command;

/// Descriptors that the process may open beyond those that it inherits.
const FREE: u64 = 96;

#[test]
fn used_up_descriptors_are_the_cause() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "descriptors::every_call_without_descriptors"])
        .env("MOTORD_RUNTIME_DIR", directory.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

/// A call, with a client that has made none before.
type Call = fn(&Client, &Path) -> Result<(), Error>;

#[test]
#[ignore = "the body of a process that another test starts: its limit holds for all of its threads"]
fn every_call_without_descriptors() {
    let Some(runtime) = std::env::var_os("MOTORD_RUNTIME_DIR") else { return };
    let runtime = Path::new(&runtime);
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    let inherited = std::fs::read_dir("/proc/self/fd").unwrap().count() as u64;
    setrlimit(Resource::RLIMIT_NOFILE, inherited + FREE, hard).unwrap();
    let calls: [(&str, Call); 8] = [
        ("connect", |_, runtime| Client::connect_in(runtime, INSTANCE).map(drop)),
        ("newest", |client, _| client.newest().map(drop)),
        ("wait", |client, _| client.wait(TIMEOUT).map(drop)),
        ("claim", |client, _| client.claim("leg").map(drop)),
        ("records", |client, _| client.records().map(drop)),
        ("file_descriptor", |client, _| client.file_descriptor().map(drop)),
        ("emergency_stop", |client, _| client.emergency_stop()),
        ("emergency_stop_in", |_, runtime| emergency_stop_in(runtime, INSTANCE)),
    ];
    let prepared = Client::connect_to_stop(INSTANCE).unwrap();
    for (name, call) in calls {
        let client = Client::connect_in(runtime, INSTANCE).unwrap();
        let most = free_until(|| call(&client, runtime), name);
        println!("{name} needs {most} descriptors");
    }
    let most = free_until(|| prepared.emergency_stop(), "emergency_stop of connect_to_stop");
    assert_eq!(most, 0, "it took what it needs");
}

/// Frees one descriptor after the other until `call` succeeds, and checks the cause of each error.
/// Returns the number of free descriptors with which it succeeds.
fn free_until(call: impl Fn() -> Result<(), Error>, name: &str) -> usize {
    let mut files: Vec<_> = std::iter::from_fn(|| File::open("/dev/null").ok()).collect();
    let all = files.len();
    while let Err(error) = call() {
        let (sentence, free) = (error.to_string(), all - files.len());
        let names_cause = sentence.contains("file descriptors") || sentence.contains("open files");
        assert!(names_cause && !sentence.contains("damaged"), "{name} with {free} free: {sentence}");
        assert!(files.pop().is_some(), "{name} needs more than {free}: {sentence}");
    }
    all - files.len()
}
