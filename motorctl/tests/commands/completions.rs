//! The names of a running daemon in the completions of bash.

use motord_harness::daemon::{BENCH, Daemon, until};
use motord_harness::programs::{directory, lacks};
use nix::sys::signal::Signal;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// Returns the words that bash offers for the last word of `line`, with daemons in `runtime`;
/// `None` without bash.
fn offered(runtime: &Path, line: &str) -> Option<Vec<String>> {
    const ASK: &str = r#"
        source <(motorctl completions bash)
        read -ra COMP_WORDS <<<"$0"
        [[ "$0" == *' ' ]] && COMP_WORDS+=('')
        COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMP_LINE=$0 COMP_POINT=${#0}
        complete=$(complete -p motorctl); complete=${complete##*-F }
        ${complete%% *} motorctl "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"
        printf '%s\n' "${COMPREPLY[@]}"
    "#;
    if lacks(&["bash"]) {
        return None;
    }
    let path = format!("{}:{}", directory().display(), std::env::var("PATH").unwrap());
    let mut bash = Command::new("bash");
    bash.args(["--norc", "-c", ASK, line]).env("PATH", path).env_remove("MOTORD_INSTANCE");
    let output = bash.env("MOTORD_RUNTIME_DIR", runtime).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "", "{line}");
    Some(String::from_utf8(output.stdout).unwrap().lines().map(str::to_owned).collect())
}

/// Goal: TAB offers the names that the running robot has, where a command takes such a name.
#[test]
fn names_of_running_daemon_are_offered() {
    let daemon = Daemon::start(BENCH);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    for (line, expected) in [
        ("motorctl --instance bench exclude ", "arm"),
        ("motorctl --instance bench zero a", "arm"),
        ("motorctl --instance=bench fault clear ", "arm"),
        ("motorctl --instance bench sim ", "arm"),
        ("motorctl --instance bench sim d", "desk"),
        ("motorctl --instance bench enable ", "all"),
        ("motorctl --instance bench reset a", "all"),
        ("motorctl --instance be", "bench"),
        ("motorctl status --instance ", "bench"),
        ("motorctl explain motor-l", "motor-lost"),
    ] {
        // A completion gives up early, which a busy machine may cause.
        let Some(words) = until(line, || match offered(daemon.directory.path(), line) {
            Some(words) if !words.iter().any(|word| word == expected) => None,
            offered => Some(offered),
        }) else {
            return;
        };
        assert!(words.iter().all(|word| !word.starts_with(['[', '<'])), "{line}: {words:?}");
    }
    for line in
        ["motorctl --instance bench exclude arm ", "motorctl exclude ", "motorctl --instance leg enable "]
    {
        let words = offered(daemon.directory.path(), line).unwrap();
        assert!(!words.iter().any(|word| ["arm", "all"].contains(&word.as_str())), "{line}: {words:?}");
    }
}

/// A frozen daemon answers nothing, and none may not be waited for.
#[test]
fn completion_never_waits_and_says_nothing() {
    let nowhere = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(BENCH);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    daemon.signal(Signal::SIGSTOP);
    for (runtime, line) in [
        (nowhere.path(), "motorctl exclude "),
        (nowhere.path(), "motorctl --instance "),
        (Path::new("/nonexistent"), "motorctl enable "),
        (daemon.directory.path(), "motorctl --instance bench exclude "),
    ] {
        let begun = Instant::now();
        if offered(runtime, line).is_none() {
            return;
        }
        assert!(begun.elapsed() < Duration::from_secs(5), "{line}: {:?}", begun.elapsed());
    }
    daemon.signal(Signal::SIGCONT);
}
