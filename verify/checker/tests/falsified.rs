//! Goal: the rules for logs accept a correct log, and refuse every log with one error. Method: logs
//! of twelve motors are generated, and falsified line by line. Each must be refused for its error.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use motord_bus::Duration;
use motord_checker::log::deaths::Deaths;
use motord_checker::log::disturbances::{self, Disturbances};
use motord_checker::log::replies::{self, Replies};
use motord_checker::log::service::Service;
use motord_checker::log::times::Limits;
use motord_checker::log::trot::{self, Trot};
use motord_checker::log::{Verdict, check, marks};
use motord_checker::robot::Wiring;
use std::fmt::Write;

const TROT: &str = "81237FF0A4099812";
const DAMPING: &str = "81237FF0000997FF";
const START: &str = "FFFFFFFFFFFFFFFC";
const STOP: &str = "FFFFFFFFFFFFFFFD";
const QUESTION: &str = "FFFFFFFFFFFF00FB";
const ZERO: &str = "FFFFFFFFFFFFFFFE";
/// A stiffness, a torque, a velocity, no damping, a start.
const WRONG: [&str; 5] =
    ["81237FF0010997FF", "81237FF000099801", "81238010000997FF", "81237FF0000007FF", START];

/// Twelve motors on four interfaces.
fn wiring() -> Wiring {
    let mut text = String::new();
    for leg in 0..4 {
        writeln!(text, "[[bus]]\nname = \"leg{leg}\"\ninterface = \"vcan{leg}\"").unwrap();
    }
    for leg in 0..4 {
        for (id, joint) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
            writeln!(text, "[[motor]]\nname = \"{leg}-{joint}\"\nbus = \"leg{leg}\"\nid = {id}").unwrap();
            let direction = if leg % 2 == 0 { 1 } else { -1 };
            writeln!(text, "protocol = \"mit\"\nmodel = \"GIM8108-8\"\ndirection = {direction}").unwrap();
            writeln!(text, "limits = {{ position-rad = [-0.5, 1.0] }}").unwrap();
        }
    }
    Wiring::parse(&text).unwrap()
}

/// One line of a log.
#[derive(Debug, Clone, PartialEq)]
struct Line {
    /// ms
    at: u32,
    address: String,
    data: String,
}

impl Line {
    fn new(at: u32, address: &str, data: &str) -> Self {
        Self { at, address: address.into(), data: data.into() }
    }

    fn is(&self, address: &str, data: &str) -> bool {
        self.address.starts_with(address) && self.data == data
    }
}

/// Returns lines for every motor. The plan has begin, end and interval, ms, and the data.
fn received(plan: &[(u32, u32, usize, &str)]) -> Vec<Line> {
    let mut lines = Vec::new();
    for &(begin, end, every, data) in plan {
        for at in (begin..end).step_by(every) {
            let places = (0..4).flat_map(|bus| (1..4).map(move |id| format!("vcan{bus} {id:03}")));
            lines.extend(places.map(|address| Line::new(at, &address, data)));
        }
    }
    lines
}

/// Returns the format of candump.
fn candump(lines: &[Line]) -> String {
    let second = |at: u32| format!("{}.{:03}000", 1000 + at / 1000, at % 1000);
    lines.iter().fold(String::new(), |mut text, Line { at, address, data }| {
        let (interface, id) = address.split_once(' ').unwrap();
        writeln!(text, "({}) {interface} {id}#{data}", second(*at)).unwrap();
        text
    })
}

/// A good log and its marks, and the rules that check them.
struct Rig {
    lines: Vec<Line>,
    marks: &'static [&'static str],
    check: fn(&[&str], &str) -> Verdict,
}

impl Rig {
    fn is_good(&self) {
        let verdict = (self.check)(self.marks, &candump(&self.lines));
        assert_eq!(verdict.wrong, 0, "a good log was refused: {:?}", verdict.complaints);
    }

    /// Asserts the `complaint` after each line of the log is replaced by these.
    fn refuses(&self, complaint: &str, falsify: impl Fn(Line) -> Vec<Line>) {
        let lines: Vec<_> = self.lines.iter().cloned().flat_map(falsify).collect();
        assert_ne!(lines, self.lines, "nothing was falsified for: {complaint}");
        assert_refused((self.check)(self.marks, &candump(&lines)), complaint);
    }

    fn refuses_without(&self, complaint: &str, left_out: impl Fn(&Line) -> bool) {
        self.refuses(complaint, |line| if left_out(&line) { vec![] } else { vec![line] });
    }

    /// Asserts the `complaint` after this command is added at the end of the log.
    fn refuses_also(&self, complaint: &str, at: u32, data: &str) {
        let also = candump(&[Line::new(at, "vcan1 002", data)]);
        assert_refused((self.check)(self.marks, &(candump(&self.lines) + &also)), complaint);
    }

    fn refuses_text(&self, complaint: &str, more: &str) {
        assert_refused((self.check)(self.marks, &(candump(&self.lines) + more)), complaint);
    }

    fn refuses_marks(&self, complaint: &str, marks: &[&str]) {
        assert_refused((self.check)(marks, &candump(&self.lines)), complaint);
    }
}

fn assert_refused(verdict: Verdict, complaint: &str) {
    let Verdict { report, complaints, wrong } = verdict;
    assert!(wrong > 0, "it should have said: {complaint}");
    let printed = report.iter().chain(&complaints).any(|line| line.contains(complaint));
    assert!(printed, "it said this instead of {complaint:?}: {report:?} {complaints:?}");
}

const LOST: &str = "DROPCOUNT: dropped 1 CAN frame\n";

fn deaths() -> Rig {
    let lines = received(&[
        (10, 11, 1, START),
        (11, 50, 1, TROT),
        (53, 150, 10, DAMPING),
        (154, 155, 1, STOP),
        (410, 411, 1, START),
        (411, 450, 1, TROT),
        (453, 753, 10, DAMPING),
        (754, 755, 1, STOP),
    ]);
    let check = |marked: &[&str], log: &str| {
        let limits = Limits { medians: [("daemon".to_string(), 5.0)].into(), maximum_per_median: 4.0 };
        let wiring = wiring();
        check(&mut Deaths::new(&wiring, &limits), &wiring, &marks(&marked.join("\n")).unwrap(), log)
    };
    Rig { lines, marks: DEATHS, check }
}

const DEATHS: &[&str] = &[
    "1000.000000 due 2 daemon",
    "1000.000000 start",
    "1000.050000 daemon",
    "1000.400000 start",
    "1000.450000 daemon",
    "1000.800000 start",
];

#[test]
fn after_death_only_damping_then_stop_accepted() {
    let rig = deaths();
    rig.is_good();
    for wrong in WRONG {
        rig.refuses_also(&format!("vcan1 002#{wrong} after damping"), 200, wrong);
    }
    rig.refuses_without("no damping for vcan2 001", |line| line.is("vcan2", DAMPING));
    rig.refuses_without("no damping for vcan2 001", |line| line.is("vcan2 001", DAMPING));
    rig.refuses_without("no stop for vcan3 003", |line| line.is("vcan3 003", STOP));
    rig.refuses_without(&format!("vcan3 003#{STOP} before damping"), |line| line.is("vcan3 003", DAMPING));
}

#[test]
fn death_counts_only_after_complete_trot() {
    let rig = deaths();
    rig.refuses_without("the robot did not trot on vcan0", |line| line.is("vcan0", TROT));
    rig.refuses_without("11 motors of 12", |line| line.address == "vcan0 003");
    rig.refuses_without("0 motors of 12", |_| true);
    rig.refuses_text("candump says", LOST);
    rig.refuses_text("no motor has this id", "(1000.200000) vcan1 004#00\n");
}

#[test]
fn every_due_death_is_judged_per_bus() {
    let rig = deaths();
    let both = [DEATHS, &["1000.900000 both"]].concat();
    rig.refuses_marks("no damping for vcan0 001 (both, repetition 1)", &both);
    rig.refuses_marks("no death is due", &[]);
    rig.refuses_marks("daemon was judged 0 times of 8", &[DEATHS[0], DEATHS[1], DEATHS[3], DEATHS[5]]);
    rig.refuses_marks("daemon was judged 4 times of 8", &[&DEATHS[..2], &DEATHS[3..]].concat());
    rig.refuses_without("daemon was judged 7 times of 8", |line| {
        line.is("vcan2", DAMPING) && (400..800).contains(&line.at)
    });
    let due = [&["1000.000000 due 2 daemon both"], &DEATHS[1..]].concat();
    rig.refuses_marks("both was judged 0 times of 8", &due);
}

#[test]
fn late_median_and_maximum_are_refused() {
    let rig = deaths();
    // Half of the deaths, one bus of one death, and a robot that continues to trot.
    rig.refuses_without("and 20 ms: MEDIAN TOO LATE", |line| (453..460).contains(&line.at));
    rig.refuses_without("and 20 ms: MAX TOO LATE", |line| {
        line.address.starts_with("vcan2") && [453, 463].contains(&line.at)
    });
    rig.refuses(": MAX TOO LATE", |line| {
        let trots_on = line.data == DAMPING && (450..700).contains(&line.at);
        vec![if trots_on { Line { data: TROT.into(), ..line } } else { line }]
    });
}

const DISTURBANCES: &[&str] =
    &["1000.020000 stop", "1000.080000 reset", "1000.120000 stop vcan0", "1000.400000 reset"];

/// The motors of `others` may be reset without a mark.
fn check_disturbances(others: &[&str], marked: &[&str], log: &str) -> Verdict {
    let others = others.iter().map(|&other| other.into()).collect();
    let demand = disturbances::Demand { notice: Duration::from_millis(15), stops: 2, others };
    let wiring = wiring();
    check(&mut Disturbances::new(&wiring, demand), &wiring, &marks(&marked.join("\n")).unwrap(), log)
}

fn disturbances() -> Rig {
    let lines = received(&[
        (0, 20, 1, TROT),
        (26, 40, 1, DAMPING),
        (41, 60, 1, STOP),
        (100, 120, 1, TROT),
        (126, 140, 1, DAMPING),
        (141, 300, 1, STOP),
    ]);
    let check = |marked: &[&str], log: &str| check_disturbances(&[], marked, log);
    Rig { lines, marks: DISTURBANCES, check }
}

#[test]
fn other_groups_may_move_before_the_reset() {
    let rig = disturbances();
    let wrong = |address: &str, received: &str, others: &[&str]| {
        let is_received = |line: &Line| line.address == address && line.at == 200;
        let data = |line: &Line| if is_received(line) { received.into() } else { line.data.clone() };
        let lines: Vec<_> = rig.lines.iter().map(|line| Line { data: data(line), ..line.clone() }).collect();
        check_disturbances(others, rig.marks, &candump(&lines)).wrong
    };
    assert_eq!(wrong("vcan2 002", TROT, &["vcan2"]), 0);
    assert_eq!(wrong("vcan2 002", TROT, &[]), 1);
    assert_eq!(wrong("vcan1 002", TROT, &["vcan2"]), 1);
    assert_eq!(wrong("vcan2 002", "00", &["vcan2"]), 1);
}

#[test]
fn nothing_moves_between_stop_and_reset() {
    let rig = disturbances();
    rig.is_good();
    for wrong in WRONG {
        rig.refuses_also(&format!("vcan1 002#{wrong} after the stop"), 200, wrong);
    }
    rig.refuses(&format!("{TROT} after the stop"), |line| {
        vec![if line.data == DAMPING { Line { data: TROT.into(), ..line } } else { line }]
    });
    rig.refuses_without("vcan3 003 heard nothing after the stop", |line| {
        line.address == "vcan3 003" && (20..100).contains(&line.at)
    });
    rig.refuses_without("nothing was damped after the stop", |line| line.data == DAMPING);
    rig.refuses_without("11 motors", |line| line.address == "vcan3 003");
    rig.refuses_without(" 0 motors", |_| true);
    rig.refuses_marks("1 stops", &DISTURBANCES[..2]);
    rig.refuses_text("candump says", LOST);
}

#[test]
fn position_beyond_joint_limits_is_refused() {
    let rig = disturbances();
    // 1.05 rad and -0.55 rad; the motors of the second bus have the direction opposite to their
    // joints.
    for (address, beyond, within) in [("vcan0 002", "8AC0", "85A1"), ("vcan1 002", "85A1", "7A5E")] {
        let follow = |position: &str| format!("{position}{}", &TROT[4..]);
        let at = |line: &Line| line.address == address && line.at == 10;
        let lines = |position: &str| -> Vec<Line> {
            let data = |line: &Line| if at(line) { follow(position) } else { line.data.clone() };
            rig.lines.iter().map(|line| Line { data: data(line), ..line.clone() }).collect()
        };
        assert_eq!((rig.check)(rig.marks, &candump(&lines(within))).wrong, 0, "{address}");
        assert_refused((rig.check)(rig.marks, &candump(&lines(beyond))), "beyond the limits of the joint");
    }
}

fn service() -> Rig {
    let lines = received(&[
        (0, 1, 1, STOP),
        (20, 21, 1, START),
        (25, 250, 50, TROT),
        (275, 300, 50, TROT),
        (305, 405, 10, DAMPING),
        (405, 406, 1, STOP),
        (410, 500, 10, DAMPING),
        (505, 506, 1, STOP),
        (550, 551, 1, START),
        (575, 650, 50, TROT),
        (675, 750, 50, TROT),
        (755, 805, 10, DAMPING),
        (805, 806, 1, STOP),
    ]);
    let marks = &[
        "1000.000000 rest",
        "1000.010000 start",
        "1000.050000 trot",
        "1000.250000 died",
        "1000.540000 start",
        "1000.560000 trot",
        "1000.650000 stopped",
        "1000.850000 silent",
        "1000.950000 rest",
    ];
    let check = |marked: &[&str], log: &str| {
        let wiring = wiring();
        check(
            &mut Service::new(&wiring),
            &wiring,
            &motord_checker::log::marks(&marked.join("\n")).unwrap(),
            log,
        )
    };
    Rig { lines, marks, check }
}

impl Rig {
    /// Asserts the `complaint` after one motor receives another command at `at`.
    fn refuses_instead(&self, complaint: &str, at: u32, old: &str, new: &str) {
        self.refuses(complaint, |line| {
            let is = line.at == at && line.is("vcan1 002", old);
            vec![if is { Line { data: new.into(), ..line } } else { line }]
        });
    }

    /// Asserts the `complaint` after one motor receives its command at `at` this number of
    /// additional times.
    fn refuses_repeated(&self, complaint: &str, at: u32, times: usize) {
        self.refuses(complaint, |line| {
            let more = if line.at == at && line.address == "vcan1 002" { times } else { 0 };
            vec![line; 1 + more]
        });
    }
}

#[test]
fn dying_service_damps_and_then_stops() {
    let rig = service();
    rig.is_good();
    for wrong in WRONG {
        rig.refuses_instead("vcan1 002 heard \"TDTDSDS\" after mark 4 died", 345, DAMPING, wrong);
        rig.refuses_instead("vcan1 002 heard \"TDTDS\" after mark 7 stopped", 775, DAMPING, wrong);
    }
    rig.refuses_without("vcan1 002 heard \"TS\" after mark 4 died", |line| line.is("vcan1 002", DAMPING));
    rig.refuses_without("vcan1 002 heard \"TD\" after mark 4 died", |line| line.is("vcan1 002", STOP));
    rig.refuses_without("vcan1 002 heard \"\" after mark 4 died", |line| {
        line.address == "vcan1 002" && (250..510).contains(&line.at)
    });
    rig.refuses_repeated("vcan1 002 received 11 commands to move after mark 4 died", 275, 10);
    rig.refuses_repeated("vcan1 002 received 62 commands to move after mark 7 stopped", 675, 60);
}

#[test]
fn ended_service_is_silent_and_resting_moves_nothing() {
    let rig = service();
    for wrong in [TROT, DAMPING, STOP, QUESTION] {
        rig.refuses_also("after mark 8 silent", 900, wrong);
    }
    rig.refuses_instead("vcan1 002 heard \"TD\" after mark 3 trot", 225, TROT, DAMPING);
    rig.refuses_instead("vcan1 002 heard \"T\" after mark 1 rest", 0, STOP, TROT);
    rig.refuses_without("to 11 motors", |line| line.address == "vcan0 003");
    rig.refuses_without("0 frames to 0 motors", |_| true);
    rig.refuses_marks(" 0 marks", &[]);
    rig.refuses_text("candump says", LOST);
}

fn trot() -> Rig {
    let lines = received(&[(0, 1, 1, START), (1, 10_000, 1, TROT), (10_000, 10_001, 1, STOP)]);
    let check = |_: &[&str], log: &str| {
        let wiring = wiring();
        let demand = trot::Demand { rate: 1000.0, seconds: 10.0, share: 0.95 };
        check(&mut Trot::new(&wiring, demand), &wiring, &[], log)
    };
    Rig { lines, marks: &[], check }
}

#[test]
fn trot_is_one_control_frame_per_cycle() {
    let rig = trot();
    rig.is_good();
    rig.refuses_without("0 control frames to 2-hip", |line| {
        line.address == "vcan2 001" && (1000..2000).contains(&line.at)
    });
    rig.refuses_repeated("2 control frames to 1-thigh", 1500, 1);
    rig.refuses("2 polls on vcan2", |line| {
        let polled = line.at == 1500 && line.address.starts_with("vcan2") && !line.address.ends_with('3');
        let poll = Line { data: QUESTION.into(), ..line.clone() };
        if polled { vec![line, poll] } else { vec![line] }
    });
    rig.refuses(&format!("{ZERO} to 2-hip was not due"), |line| {
        let zeroed = line.at == 1500 && line.address == "vcan2 001";
        let zero = Line { data: ZERO.into(), ..line.clone() };
        if zeroed { vec![line, zero] } else { vec![line] }
    });
    rig.refuses_without("(91.0 %)", |line| (1000..1900).contains(&line.at));
    rig.refuses_without("11 motors", |line| line.address == "vcan2 001");
    rig.refuses_without("0 motors", |_| true);
    rig.refuses_without("ended early", |line| line.at >= 2000);
}

/// Every motor gets a command every 4 ms and replies after 1 ms. A disturbance lasts from 400 to
/// 800 ms and from 1200 to 1600 ms.
fn replies() -> Rig {
    let mut lines = received(&[(0, 1700, 4, TROT)]);
    let answers = lines.iter().map(|line| {
        let (interface, id) = line.address.split_once(' ').unwrap();
        Line::new(line.at + 1, &format!("{interface} 1{}", &id[1..]), "018000800800")
    });
    let answers: Vec<_> = answers.collect();
    lines.extend(answers);
    let marks = &[
        "1000.000000 well",
        "1000.400000 ill silent",
        "1000.800000 well",
        "1001.200000 ill corrupt 5%",
        "1001.600000 rest",
    ];
    let check = |marked: &[&str], log: &str| {
        let demand = replies::Demand { parts: 2, ratio: 1.1, rate: 250.0, seconds: 1.6, share: 0.95 };
        let wiring = wiring();
        check(
            &mut Replies::new(&wiring, demand),
            &wiring,
            &motord_checker::log::marks(&marked.join("\n")).unwrap(),
            log,
        )
    };
    Rig { lines, marks, check }
}

#[test]
fn motors_reply_on_time_beside_disturbed_bus() {
    let rig = replies();
    rig.is_good();
    let is_ill = |line: &Line| (400..800).contains(&line.at);
    let is_reply = |line: &Line| line.address.ends_with("102") && line.address.starts_with("vcan1");
    rig.refuses_without("1-thigh did not reply before 1000.444000 s (ill silent)", |line| {
        is_reply(line) && line.at == 441
    });
    rig.refuses("1-thigh was not asked before 1000.442000 s (ill silent)", |line| {
        let twice = is_reply(&line) && line.at == 441;
        let again = Line { at: line.at + 1, ..line.clone() };
        if twice { vec![line, again] } else { vec![line] }
    });
    rig.refuses("vcan1: replies 1000, 1000, 1000 µs", |line| {
        let late = is_ill(&line) && is_reply(&line);
        vec![if late { Line { at: line.at + 2, ..line } } else { line }]
    });
    rig.refuses_without("TOO LATE", |line| {
        is_ill(line) && line.address.starts_with("vcan2") && line.at % 8 >= 4
    });
    for wrong in [START, STOP, ZERO] {
        rig.refuses_also(&format!("vcan1 002#{wrong} to 1-thigh was not due"), 441, wrong);
    }
    // Frames outside all parts are not checked.
    let rests = rig.lines.iter().filter(|line| !is_reply(line) || line.at < 1650).cloned().collect();
    Rig { lines: rests, ..replies() }.is_good();
}

#[test]
fn replies_count_only_when_every_part_was_there() {
    let rig = replies();
    rig.refuses_marks("2 parts well and 1 ill of 2", &[&rig.marks[..3], &rig.marks[4..]].concat());
    rig.refuses_marks("no mark of a part: trot", &[&rig.marks[..4], &["1001.500000 trot"]].concat());
    rig.refuses_marks("0 parts well and 0 ill of 2", &[]);
    rig.refuses_without("cycles on vcan3", |line| line.address.starts_with("vcan3") && line.at > 1200);
    rig.refuses_without("0 cycles on vcan0", |_| true);
    rig.refuses_text("candump says", LOST);
}

#[test]
fn serial_motors_are_in_no_candump_log() {
    let text = "[[bus]]\nname = \"leg\"\ninterface = \"vcan0\"\n[[bus]]\nname = \"hand\"\ndevice = \"/dev/ttyUSB0\"\n\
                [[motor]]\nname = \"hip\"\nbus = \"leg\"\nid = 1\n[[motor]]\nname = \"jaw\"\nbus = \"hand\"\nid = 1\n";
    let wiring = Wiring::parse(text).unwrap();
    assert_eq!(wiring.motors.iter().map(|motor| motor.name.as_str()).collect::<Vec<_>>(), ["hip"]);
    assert!(Wiring::parse(&text.replace("bus = \"hand\"", "bus = \"foot\"")).is_err());
}

#[test]
fn vendor_reply_ids_and_questions_are_respected() {
    let mut text = String::from("[[bus]]\nname = \"leg\"\ninterface = \"vcan0\"\n");
    for (id, model) in [(1, "GIM8108-8"), (2, "DM-J8009-2EC"), (3, "RS00")] {
        writeln!(text, "[[motor]]\nname = \"{model}\"\nbus = \"leg\"\nid = {id}\nmodel = \"{model}\"")
            .unwrap();
    }
    let wiring = Wiring::parse(&text).unwrap();
    let with = |frame: &str| {
        let demand = trot::Demand { rate: 1000.0, seconds: 10.0, share: 0.95 };
        let log = format!("(1000.000000) vcan0 {frame}\n");
        check(&mut Trot::new(&wiring, demand), &wiring, &[], &log).complaints.join("\n")
    };
    for reply in ["101#018000800800", "012#0280008008001919", "043#03800080080000FA"] {
        assert!(!with(reply).contains("no motor has this id"), "{reply}");
    }
    assert!(with("102#028000800800").contains("no motor has this id"));
    assert!(!with("7FF#0200331500000000").contains("no motor has this id"), "reads a register of Damiao's");
    for strange in ["7FF#0100331500000000", "7FF#0200551500004841", "7FF#0200AA0100000000"] {
        assert!(with(strange).contains("no motor has this id"), "{strange}");
    }
    let is_refused = |id: u16| with(&format!("{id:03X}#{QUESTION}")).contains("a question that is a command");
    assert_eq!([1, 2, 3].map(is_refused), [false, true, false]);
}

#[test]
fn frames_of_every_protocol_have_their_motor() {
    let mut text = String::from("[[bus]]\nname = \"leg\"\ninterface = \"vcan0\"\n");
    for (id, model, protocol) in [(4, "RS02", "robstride"), (5, "GIM6010-8", "cansimple")] {
        let motor = format!("name = \"{model}\"\nbus = \"leg\"\nid = {id}\nmodel = \"{model}\"");
        writeln!(text, "[[motor]]\n{motor}\nprotocol = \"{protocol}\"").unwrap();
    }
    let wiring = Wiring::parse(&text).unwrap();
    let with = |frame: &str| {
        let demand = trot::Demand { rate: 1000.0, seconds: 10.0, share: 0.95 };
        let starts =
            "(999.000000) vcan0 0300FD04#0000000000000000\n(999.000000) vcan0 0A7#0800000000000000\n";
        let [one, other] = ["01800004#8000800000000000", "0A8#7FFF7FF0000007FF"];
        let cycle = format!("(999.100000) vcan0 {one}\n(999.100001) vcan0 {other}\n");
        let control = format!("{cycle}(999.101000) vcan0 {one}\n");
        let log = format!("{starts}{control}(1000.000000) vcan0 {frame}\n");
        check(&mut Trot::new(&wiring, demand), &wiring, &[], &log).complaints.join("\n")
    };
    let controls = ["01800004#8000800000000000", "0A8#7FFF7FF0000007FF"];
    let replies =
        ["028004FD#8000800080000104", "0A8#057FFF7FF7FF", "0A1#0000000008000000", "0A9#0000000000000000"];
    for frame in controls.into_iter().chain(replies) {
        let complaints = with(frame);
        assert!(!complaints.contains("no motor") && !complaints.contains("not due"), "{frame}: {complaints}");
    }
    for strange in ["01800006#8000800000000000", "0C8#7FFF7FF0000007FF", "004#7FFF7FF0000007FF"] {
        assert!(with(strange).contains("no motor has this id"), "{strange}");
    }
    for wrong in ["0700FD04#0000000000000000", "0A7#0300000000000000", "0BF#0000000000000000"] {
        assert!(with(wrong).contains("was not due"), "{wrong}: {}", with(wrong));
    }
}

/// Their samples and exactly the requests for them pass: no write of a setting, and no start beside
/// motors.
#[test]
fn only_requests_and_samples_of_imus_pass() {
    let wiring = |alone: bool, more: &str| {
        let bus = if alone { "body" } else { "leg" };
        Wiring::parse(&format!(
            "[[bus]]\nname = \"leg\"\ninterface = \"vcan0\"\n[[bus]]\nname = \"body\"\ninterface = \"vcan1\"\n\
             [[motor]]\nname = \"hip\"\nbus = \"leg\"\nid = 7\nmodel = \"GIM8108-8\"\n\
             [[imu]]\nname = \"a\"\ntype = \"hipnuc-can\"\nbus = \"{bus}\"\n\
             [[imu]]\nname = \"b\"\ntype = \"damiao\"\nbus = \"{bus}\"\n{more}\n[[imu]]\nname = \"c\"\ntype = \"external\"\n"
        ))
        .unwrap()
    };
    let passes = |wiring: &Wiring, interface: &str, frame: &str| {
        let demand = trot::Demand { rate: 1000.0, seconds: 10.0, share: 0.95 };
        let log = format!("(1000.000000) {interface} {frame}\n");
        let verdict = check(&mut Trot::new(wiring, demand), wiring, &[], &log);
        !verdict.complaints.join("\n").contains("no motor has this id")
    };
    let beside = wiring(false, "");
    for good in
        ["188#00000000E803", "488#1027000000000000", "708#05", "001#CC0400DD00000000", "011#0280008008001919"]
    {
        assert!(passes(&beside, "vcan0", good), "{good}");
        assert!(!passes(&beside, "vcan1", good), "{good} on another bus");
    }
    for bad in [
        "188#00",
        "189#00000000E803",
        "000#0108",
        "608#2B00180505000000",
        "001#CC0401DD00000000",
        "001#CC0300DD00000000",
    ] {
        assert!(!passes(&beside, "vcan0", bad), "{bad}");
    }
    let alone = wiring(true, "firmware = 1022");
    assert!(passes(&alone, "vcan1", "000#0108") && !passes(&alone, "vcan1", "000#0208"));
    assert!(passes(&alone, "vcan1", "6FF#010001CC") && !passes(&alone, "vcan1", "001#CC0400DD00000000"));
}

#[test]
fn replies_are_not_judged_but_strange_ids() {
    let rig = trot();
    let with = |frame: &str| (rig.check)(&[], &(candump(&rig.lines) + "(1001.500000) vcan1 " + frame + "\n"));
    assert_eq!(with("102#028000800800").wrong, 0);
    assert_refused(with("104#028000800800"), "no motor has this id");
}
