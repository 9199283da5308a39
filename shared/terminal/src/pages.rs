//! The commands `completions` and `manual`, generated from the command line of a program.

use clap::{Command, Subcommand, ValueEnum};
use clap_complete::generate;
use clap_mangen::Man;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The files that a package installs beside a program.
#[derive(Debug, Subcommand)]
pub enum Pages {
    /// Print the completions of this program for a shell. Those of motorctl offer the names of the running daemon.
    ///
    /// bash loads them from ~/.local/share/bash-completion/completions/PROGRAM, fish from
    /// ~/.config/fish/completions/PROGRAM.fish, zsh from the file _PROGRAM in a directory of its $fpath.
    Completions {
        /// The shell.
        shell: Shell,
    },
    /// Write the manual pages of this program and of its commands.
    Manual {
        /// The directory for the pages, created if it does not exist. `man -l DIRECTORY/PROGRAM.1`
        /// shows one.
        directory: PathBuf,
    },
}

/// A shell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Shell {
    /// GNU bash.
    Bash,
    /// zsh.
    Zsh,
    /// fish.
    Fish,
}

impl Pages {
    /// Writes the files of `program`.
    ///
    /// # Errors
    ///
    /// When the output, or a file, cannot be written.
    pub fn write(&self, program: Command) -> io::Result<()> {
        match self {
            Self::Completions { shell } => io::stdout().write_all(&completions(*shell, &program)),
            Self::Manual { directory } => {
                std::fs::create_dir_all(directory)?;
                let version = program.get_version().unwrap_or_default().to_owned();
                let mut program = program.disable_help_subcommand(true);
                program.build();
                write_pages(&program, &version, directory)
            }
        }
    }
}

fn completions(shell: Shell, program: &Command) -> Vec<u8> {
    use clap_complete::Shell::{Bash, Fish, Zsh};
    let has_words = program.find_subcommand(WORDS).is_some();
    let (mut program, mut script) = (visible(program), Vec::new());
    let name = program.get_name().to_owned();
    match shell {
        Shell::Bash => {
            generate(Bash, &mut program, &name, &mut script);
            script = with_hyphen(&name, script);
        }
        Shell::Zsh => generate(Zsh, &mut program, &name, &mut script),
        Shell::Fish => generate(Fish, &mut program, &name, &mut script),
    }
    if has_words { with_words(shell, &name, &script).into_bytes() } else { script }
}

/// The hidden command of a program that prints the words that may follow on a command line. Its arguments are the words before the
/// cursor; it ends soon, and prints no error.
const WORDS: &str = "complete-words";

/// Adds the words of the program's own command to a script.
fn with_words(shell: Shell, name: &str, script: &[u8]) -> String {
    let script = String::from_utf8_lossy(script);
    match shell {
        Shell::Bash => {
            let own = format!("_{name}_words");
            let script = script.replace(&format!("complete -F _{name} "), &format!("complete -F {own} "));
            format!("{}\n{script}", BASH.replace("PROGRAM", name))
        }
        Shell::Zsh => {
            let (head, rest) = script.split_once('\n').unwrap_or((&script, ""));
            let rest = rest.replace(":_default'", &format!(":_{name}_words'"));
            format!("{head}\n{}\n{rest}", ZSH.replace("PROGRAM", name))
        }
        Shell::Fish => format!("{script}\n{}", FISH.replace("PROGRAM", name)),
    }
}

/// Adds the words, and leaves out the names of arguments, which no command line has.
const BASH: &str = r#"
_PROGRAM_words() {
    _PROGRAM "$@"
    local offered=() word words
    for word in "${COMPREPLY[@]}"; do
        [[ $word == [\[\<]* ]] || offered+=("$word")
    done
    words=$("$1" complete-words -- "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null) || words=
    COMPREPLY=("${offered[@]}" $words)
}
"#;

const ZSH: &str = r#"
_PROGRAM_words() {
    local -a typed found
    typed=(${(z)LBUFFER})
    [[ $LBUFFER == *[[:space:]] ]] && typed+=('')
    found=(${(f)"$(command PROGRAM complete-words -- ${(Q)typed[2,-1]} 2>/dev/null)"})
    if (( $#found )); then compadd -a found; else _default; fi
}
"#;

const FISH: &str = r#"
complete -c PROGRAM -f -n 'not string match -q -- "-*" (commandline -ct)' -a '(command PROGRAM complete-words -- (commandline -opc)[2..] (commandline -ct) 2>/dev/null)'
"#;

/// Works around clap_complete 4.6, which writes a hyphen in a program's name in two ways.
fn with_hyphen(name: &str, script: Vec<u8>) -> Vec<u8> {
    if !name.contains('-') {
        return script;
    }
    let script = String::from_utf8_lossy(&script);
    script.replace(&name.replace('-', "__subcmd__"), &name.replace('-', "__")).into_bytes()
}

/// `command` without its hidden commands, which `clap_complete` would offer.
fn visible(command: &Command) -> Command {
    // clap needs 'static names. The program ends after it has printed them.
    let kept = |text: &str| -> &'static str { text.to_owned().leak() };
    let commands = command.get_subcommands().filter(|command| !command.is_hide_set()).map(visible);
    let mut seen = Command::new(kept(command.get_name()))
        .args(command.get_arguments().cloned())
        .groups(command.get_groups().cloned())
        .subcommands(commands);
    if let Some(about) = command.get_about() {
        seen = seen.about(about.clone());
    }
    match command.get_version() {
        Some(version) => seen.version(kept(version)),
        None => seen,
    }
}

/// Writes the page of `command` and of its subcommands, without the hidden ones.
fn write_pages(command: &Command, version: &str, directory: &Path) -> io::Result<()> {
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        write_pages(below, version, directory)?;
    }
    let name = command.get_display_name().unwrap_or_else(|| command.get_name());
    std::fs::write(directory.join(format!("{name}.1")), page(command, name, version)?)
}

/// Returns the sections of `clap_mangen` with another title and other examples. Its title has the
/// version in place of the date, and it fills examples like text.
fn page(command: &Command, name: &str, version: &str) -> io::Result<Vec<u8>> {
    let page = Man::new(command.clone());
    let mut roff = format!(
        ".ie \\n(.g .ds Aq \\(aq\n.el .ds Aq '\n.TH \"{name}\" \"1\" \"\" \"motord {version}\" \"Commands of motord\"\n"
    )
    .into_bytes();
    page.render_name_section(&mut roff)?;
    page.render_synopsis_section(&mut roff)?;
    page.render_description_section(&mut roff)?;
    page.render_options_section(&mut roff)?;
    if command.get_subcommands().any(|below| !below.is_hide_set()) {
        page.render_subcommands_section(&mut roff)?;
    }
    let after = command.get_after_long_help().or_else(|| command.get_after_help());
    roff.extend(after.map_or_else(String::new, |after| sections(&after.to_string())).into_bytes());
    Ok(roff)
}

/// Converts the text after a help to roff. A line that ends with a colon becomes a heading;
/// indented lines stay as they are.
fn sections(text: &str) -> String {
    const EXIT_STATUS: &str = "Exit status: ";
    let (mut roff, mut is_filled) = (String::new(), true);
    for line in text.lines().filter(|line| !line.trim().is_empty()) {
        if line.starts_with(' ') == is_filled {
            roff.push_str(if is_filled { ".nf\n" } else { ".fi\n" });
            is_filled = !is_filled;
        }
        let status = line.strip_prefix(EXIT_STATUS);
        let heading = status.map(|_| EXIT_STATUS.trim_end_matches(": "));
        let heading = heading.or_else(|| line.strip_suffix(':').filter(|_| is_filled));
        if let Some(heading) = heading {
            roff.push_str(&format!(".SH \"{}\"\n", verbatim(&heading.to_uppercase())));
        }
        let body = status.unwrap_or(if heading.is_some() { "" } else { line });
        if !body.is_empty() {
            roff.push_str(&format!("{}\n", verbatim(body)));
        }
    }
    roff + if is_filled { "" } else { ".fi\n" }
}

/// Escapes `text` so that roff prints every character unchanged.
fn verbatim(text: &str) -> String {
    let escaped = |letter| match letter {
        '\\' => "\\e".to_owned(),
        '-' => "\\-".to_owned(),
        '\'' => "\\(aq".to_owned(),
        '`' => "\\(ga".to_owned(),
        '^' => "\\(ha".to_owned(),
        '~' => "\\(ti".to_owned(),
        letter => letter.to_string(),
    };
    let guard = if text.starts_with('.') { "\\&" } else { "" };
    guard.to_owned() + &text.chars().map(escaped).collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hidden_command_is_not_offered() {
        let program = Command::new("robot")
            .version("1")
            .subcommand(Command::new("walk").about("Walk away"))
            .subcommand(Command::new("guard").hide(true));
        for shell in Shell::value_variants() {
            let script = String::from_utf8(completions(*shell, &program)).unwrap();
            assert!(script.contains("walk") && script.contains("version"), "{shell:?}: {script}");
            assert!(!script.contains("guard"), "{shell:?}: {script}");
        }
    }

    #[test]
    fn examples_stay_verbatim_in_manual_page() {
        let text = "Examples:\n  robot walk --to 'home' | jq .x\n\nExit status: 0 done,\n1 not.";
        let roff = "\
.SH \"EXAMPLES\"
.nf
  robot walk \\-\\-to \\(aqhome\\(aq | jq .x
.fi
.SH \"EXIT STATUS\"
0 done,
1 not.
";
        assert_eq!(sections(text), roff);
    }
}
