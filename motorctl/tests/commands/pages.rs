//! Completions and manual pages of the three programs contain what `--help` shows, in real shells
//! and in real viewers.
//!
//! The tests that need shells or viewers are ignored by default: `.ci/full pages` installs their
//! requirements and runs them.

use crate::programs::{PROGRAMS, below, commands, directory, help, options, program};
use motord_harness::tmux::Tmux;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// The file that `program completions SHELL` fills.
fn script(name: &str, shell: &str, directory: &Path) -> String {
    let output = program(name).args(["completions", shell]).output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{name} {shell}: {output:?}");
    let path = directory.join(format!("{name}.{shell}"));
    std::fs::write(&path, output.stdout).unwrap();
    path.to_str().unwrap().to_owned()
}

fn manual(name: &str, directory: &Path) {
    let output = program(name).arg("manual").arg(directory).output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{name}: {output:?}");
}

fn page(name: &str, command: &[String]) -> String {
    format!("{}.1", [&[name.to_owned()], command].concat().join("-"))
}

fn shell(program: &str, arguments: &[&str]) -> Output {
    let output = Command::new(program).args(arguments).env("LC_ALL", "C.UTF-8").output();
    output.unwrap_or_else(|error| panic!("{program}: {error}: .ci/full pages installs it"))
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn every_visible_command_has_a_page() {
    let directory = TempDir::new().unwrap();
    for name in PROGRAMS {
        let pages = directory.path().join(name);
        manual(name, &pages);
        let mut expected: Vec<String> = commands(name).iter().map(|command| page(name, command)).collect();
        let written = std::fs::read_dir(&pages).unwrap();
        let mut written: Vec<String> =
            written.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        expected.sort();
        written.sort();
        assert_eq!(written, expected, "{name}");
    }
}

#[test]
#[ignore = "needs man and groff: .ci/full pages installs them"]
fn every_page_is_rendered_without_a_warning() {
    let directory = TempDir::new().unwrap();
    for name in PROGRAMS {
        manual(name, directory.path());
        for command in commands(name) {
            let path = directory.path().join(page(name, &command));
            let path = path.to_str().unwrap();
            let shown = shell("man", &["--warnings", "-E", "UTF-8", "-l", path]);
            let (printed, complaint) = (text(&shown.stdout), text(&shown.stderr));
            assert!(shown.status.success() && complaint.is_empty(), "{path}: {complaint}");
            let described = help(name, &command);
            for option in options(&described) {
                assert!(printed.contains(&option), "{path}: {option} in\n{printed}");
            }
            let strict = shell("groff", &["-man", "-Tutf8", "-ww", "-z", "-k", path]);
            assert!(strict.status.success() && strict.stderr.is_empty(), "{}", text(&strict.stderr));
        }
    }
}

/// The words that a shell offers after `line`.
fn offered(shell_name: &str, script: &str, name: &str, line: &str) -> Vec<String> {
    let output = match shell_name {
        "bash" => {
            let ask = format!(
                "source {script}; COMP_WORDS=({line} \"$0\"); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); \
                 COMP_LINE=\"{line} $0\"; COMP_POINT=${{#COMP_LINE}}; \
                 complete=$(complete -p {name}); complete=${{complete##*-F }}; ${{complete%% *}} {name} \"$0\" \
                 \"${{COMP_WORDS[COMP_CWORD-1]}}\"; printf '%s\\n' \"${{COMPREPLY[@]}}\""
            );
            let ask = |begun: &str| text(&shell("bash", &["--norc", "-c", &ask, begun]).stdout);
            ask("") + &ask("--")
        }
        _ => {
            let ask = |begun: &str| {
                text(
                    &shell(
                        "fish",
                        &["--no-config", "-c", &format!("source {script}; complete -C '{line} {begun}'")],
                    )
                    .stdout,
                )
            };
            ask("") + &ask("--")
        }
    };
    output.lines().filter_map(|line| line.split('\t').next()).map(str::to_owned).collect()
}

/// Goal: everything that `--help` lists can be completed.
/// Method: read the completions of the shell after each command.
#[test]
#[ignore = "needs bash and fish: .ci/full pages installs them"]
fn bash_and_fish_complete_every_command_and_option() {
    let scratch = TempDir::new().unwrap();
    for name in PROGRAMS {
        for shell_name in ["bash", "fish"] {
            let script = script(name, shell_name, scratch.path());
            for command in commands(name) {
                let line = [&[name.to_owned()], &command[..]].concat().join(" ");
                let help = help(name, &command);
                let offered = offered(shell_name, &script, name, &line);
                for word in below(&help).into_iter().chain(options(&help)) {
                    assert!(offered.contains(&word), "{shell_name}: {word} after `{line}`: {offered:?}");
                }
            }
        }
    }
}

/// The completions of zsh need a terminal.
#[test]
#[ignore = "needs zsh and tmux: .ci/full pages installs them"]
fn zsh_completes_command_and_option_of_each_program() {
    let scratch = TempDir::new().unwrap();
    for name in PROGRAMS {
        std::fs::rename(script(name, "zsh", scratch.path()), scratch.path().join(format!("_{name}")))
            .unwrap();
    }
    let path = format!("{}:{}", directory().display(), std::env::var("PATH").unwrap());
    let terminal = Tmux::start(&[("PATH", &path)]).expect("tmux, which .ci/full pages installs");
    let functions = scratch.path().display();
    terminal.enter("exec env PS1='z''sh> ' zsh -f");
    terminal.until("zsh", |screen| screen.contains("zsh>"));
    let load =
        format!("fpath=({functions} $fpath); autoload -U compinit; compinit -D -u; clear; echo rea''dy");
    terminal.enter(&load);
    terminal.until("the completions", |screen| screen.lines().any(|line| line == "ready"));
    for (typed, expected) in [
        ("motorctl lat", "motorctl latency"),
        ("motorctl fault g", "motorctl fault get"),
        ("motorctl latency --js", "motorctl latency --json"),
        ("motord safe", "motord safe-stop"),
        ("motord check --conf", "motord check --config"),
        ("motord-sim comp", "motord-sim completions"),
        ("motord-sim --se", "motord-sim --seed"),
    ] {
        terminal.press(&["C-u"]);
        terminal.press(&["-l", typed]);
        terminal.press(&["Tab"]);
        terminal.until(expected, |screen| screen.contains(expected));
    }
}
