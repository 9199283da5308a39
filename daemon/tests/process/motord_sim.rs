//! The help of `motord-sim` is correct, and its motors can be commissioned.

use motord::buses;
use motord_bus::clock;
use motord_configuration as config;
use motord_simulator::{BusSettings, FaultVerb, Medium, SerialPort, SerialSlave, SimulatedBus};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Returns the lines of faults that the help shows below `title`.
fn lines(title: &str) -> Vec<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_motord-sim")).arg("--help").output().expect("is built");
    let help = String::from_utf8(output.stdout).expect("is text");
    let lines = help.lines().skip_while(|line| !line.starts_with(title)).skip(1);
    lines.take_while(|line| line.starts_with("  ")).map(|line| line.trim().to_owned()).collect()
}

/// Method: the program itself needs CAN interfaces. Therefore its lines go to the simulated buses
/// of the shipped quadruped, in the same way.
#[test]
fn documented_sim_faults_work_on_simulated_bus() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/quadruped-simulated.toml");
    let settings = config::load(&file).expect("is shipped").settings;
    let mut bus = buses::simulate(&settings, 0, 0);
    let lines = lines("Lines:");
    assert!(lines.len() >= 5, "{lines:?}");
    for line in lines {
        let verb: FaultVerb = line.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        bus.inject(clock::monotonic(), &verb).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
}

#[test]
fn documented_sim_faults_work_on_serial_port() {
    let settings = BusSettings { name: "gripper".into(), medium: Medium::Serial, ..BusSettings::default() };
    let slave = SerialSlave::new(SimulatedBus::new(settings, Vec::new(), 0), 0);
    let mut port = SerialPort::open(slave, None).expect("this kernel has pseudo terminals");
    let lines = lines("Lines for a serial bus:");
    assert!(lines.len() >= 7, "{lines:?}");
    for line in lines {
        let verb: FaultVerb = line.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        port.inject(clock::monotonic(), &verb).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
}

/// `motord-sim` with three motors on a serial line, as a script uses it.
struct Program {
    process: Child,
    output: BufReader<ChildStdout>,
}

impl Program {
    fn start(folder: &Path, options: &[&str]) -> Self {
        let folder = folder.to_str().expect("is text");
        let mut process = Command::new(env!("CARGO_BIN_EXE_motord-sim"))
            .args([
                "--config",
                &format!("{folder}/arm.toml"),
                "--link",
                folder,
                "--store",
                &format!("{folder}/memories"),
            ])
            .args(options)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("is built");
        let output = BufReader::new(process.stdout.take().expect("is piped"));
        let mut program = Self { process, output };
        assert!(program.line().starts_with("arm: /dev/"));
        assert_eq!(program.line(), "ready");
        program
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).expect("it lives");
        line.trim_end().to_owned()
    }

    fn obey(&mut self, line: &str) {
        let input = self.process.stdin.as_mut().expect("is piped");
        writeln!(input, "{line}").expect("it reads");
        assert_eq!(self.line(), "ok", "{line}");
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ended = self.process.kill();
        let _ended = self.process.wait();
    }
}

/// Returns the answer to `payload` for the motor `id`, and the receiver in the answer (GIM
/// document, table 3).
fn ask(line: &mut File, id: u8, payload: [u8; 8]) -> Option<(u8, [u8; 8])> {
    let request = [&[id, 0, 8, id ^ 8], &payload[..]].concat();
    line.write_all(&request).expect("the port is there");
    let end = Instant::now() + Duration::from_millis(300);
    let (mut answer, mut count) = ([0; 12], 0);
    while Instant::now() < end && count < 12 {
        match line.read(&mut answer[count..]) {
            Ok(read) => count += read,
            Err(_) => sleep(Duration::from_millis(1)),
        }
    }
    let [host, 0, 8, check, payload @ ..] = answer else { return None };
    (check == host ^ 8).then_some((host, payload))
}

const ARM: &str = "\
    [cycle]\nrate-hz = 200\n\
    [[bus]]\nname = 'arm'\ntype = 'serial'\ndevice = 'FOLDER/ttyUSB0'\nevery = 4\n\
    [[motor]]\nname = 'shoulder'\nbus = 'arm'\nid = 1\nhost-id = 0x10\nprotocol = 'gim'\nmodel = 'GIM8115-36'\n\
    [motor.limits]\nposition-rad = [-1.0, 1.0]\n\
    [[motor]]\nname = 'elbow'\nbus = 'arm'\nid = 2\nhost-id = 0x10\nprotocol = 'gim'\nmodel = 'GIM8108-36'\n\
    [motor.limits]\nposition-rad = [-1.0, 1.0]\n\
    [[motor]]\nname = 'wrist'\nbus = 'arm'\nid = 3\nhost-id = 0x10\nprotocol = 'gim'\nmodel = 'GIM4310-36'\n\
    [motor.limits]\nposition-rad = [-1.0, 1.0]\n";

/// The last motors first: the id 1 of a new motor must be free until the end.
#[test]
fn new_motors_get_their_ids_in_turn() {
    let folder = tempfile::tempdir().expect("there is a place");
    let config = ARM.replace("FOLDER", folder.path().to_str().expect("is text"));
    std::fs::write(folder.path().join("arm.toml"), config).expect("is written");
    let open = || {
        let flags = libc::O_NONBLOCK | libc::O_NOCTTY;
        let device = folder.path().join("ttyUSB0");
        File::options().read(true).write(true).custom_flags(flags).open(device).expect("is linked")
    };
    let pole_pairs = [0x84, 0, 0, 0, 0, 0, 0, 0];
    let mut program = Program::start(folder.path(), &["--new", "--off"]);
    let mut line = open();
    assert_eq!(ask(&mut line, 1, pole_pairs), None, "no motor has power");
    for (name, id, pairs) in [("wrist", 3, 14), ("elbow", 2, 21), ("shoulder", 1, 21)] {
        program.obey(&format!("{name} on"));
        sleep(Duration::from_millis(400));
        assert_eq!(ask(&mut line, 1, pole_pairs), Some((0, [0x84, 0, 0, 0, pairs, 0, 0, 0])));
        let written = ask(&mut line, 1, [0x83, 0, 0x12, 0, id, 0, 0, 0]);
        assert_eq!(written, Some((0, [0x83, 0, 0x12, 0, 0, 0, 0, 0])));
        assert_eq!(ask(&mut line, id, [0x82, 0, 0, 0, 0, 0, 0, 0]).map(|(_, bytes)| bytes[1]), Some(0));
    }
    let answers = |line: &mut File| [1, 2, 3].map(|id| ask(line, id, pole_pairs).map(|(_, bytes)| bytes[4]));
    assert_eq!(answers(&mut line), [Some(21), Some(21), Some(14)]);
    drop((program, line));
    let _program = Program::start(folder.path(), &["--new"]);
    assert_eq!(answers(&mut open()), [Some(21), Some(21), Some(14)], "they keep their ids");
}
