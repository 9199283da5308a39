//! Files of the largest size that is read.

use motord_configuration::{Machine, parse};
use nix::time::{ClockId, clock_gettime};
use std::path::Path;
use std::time::Duration;

/// A file that is a little shorter than the limit: `head`, and `line` with the numbers from 0 on.
fn filled(head: &str, line: impl Fn(usize) -> String, end: &str) -> String {
    let mut text = head.to_owned();
    for number in 0.. {
        let line = line(number);
        if text.len() + line.len() + end.len() > 1 << 20 {
            break;
        }
        text += &line;
    }
    text + end
}

/// The processor time of this thread: the test depends on no other load.
fn processor_time() -> Duration {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).expect("each thread has this clock").into()
}

/// A file of 1 MiB took minutes: the daemon reads it at its start, and `motorctl` at each TAB.
#[test]
fn largest_files_are_refused_within_seconds() {
    const ROBOT: &str = "[[bus]]\nname='a'\ntype='simulated'\n[[motor]]\nname='m'\nbus='a'\nid=1\nprotocol='mit'\nmodel='GIM8108-8'\n";
    let files = [
        ("more than 64", filled("", |_| "[[motor]]\n".into(), "")),
        ("more than 64", filled(ROBOT, |number| format!("[[motor]]\nname='m{number}'\nbus='a'\n"), "")),
        ("more than 16", filled("", |_| "[[bus]]\n".into(), "")),
        ("more than 8", filled(ROBOT, |_| "[[group]]\n".into(), "")),
        ("more than 4", filled(ROBOT, |_| "[[imu]]\n".into(), "")),
        ("more than 64", filled("motor=[", |_| "{},".into(), "]\n")),
        (
            "more than 64",
            filled(&format!("{ROBOT}[[group]]\nname='g'\njoints=["), |number| format!("'j{number}',"), "]\n"),
        ),
        ("unknown key", filled("[cycle]\n", |number| format!("k{number}=1\n"), "")),
        ("is no configuration", filled("", |number| format!("[t{number}]\n"), "")),
    ];
    for (expected, text) in files {
        let begun = processor_time();
        let errors =
            parse(Path::new("robot.toml"), text.as_bytes(), &Machine::here()).unwrap_err().to_string();
        assert!(errors.contains(expected), "{expected}: {}", errors.chars().take(1000).collect::<String>());
        assert!(errors.lines().count() <= 1000, "{expected}");
        let used = processor_time() - begun;
        assert!(used < Duration::from_secs(10), "{expected}: {used:?}");
    }
}
