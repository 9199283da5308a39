//! Other processes of this machine.

pub use crate::kernel::{GROUPS_OF_A_PROCESS_MAX, peer_groups};

/// Returns the name of the program that process `pid` runs: its first 15 bytes, as `comm` of
/// proc(5). A process may choose any name. Reads a file of the kernel, which does not block.
#[must_use]
pub fn program(pid: u32) -> Option<String> {
    let name = std::fs::read(format!("/proc/{pid}/comm")).ok()?;
    Some(String::from_utf8_lossy(&name).trim_end_matches('\n').to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn process_has_program_and_absent_process_none() {
        let own = std::env::current_exe().unwrap();
        let own = own.file_name().unwrap().to_str().unwrap();
        assert!(own.starts_with(&program(std::process::id()).unwrap()), "{own}");
        assert_eq!(program(0), None);
    }
}
