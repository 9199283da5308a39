//! `motorctl` on virtual CAN interfaces, and on an RS485 line beside them.
//!
//! These tests need interfaces vcan0 to vcan3: `verify/rigs/test-commissioning` boots a kernel that
//! has them; elsewhere they are ignored.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

mod line;

use line::{Calls, Line, motor};
use motord_bus::socketcan::SocketCanBus;
use motord_bus::{Bus as _, Frame, FrameId, clock};
use motord_protocol::gim::{Access, CONFIGURATION, INDICATORS, PARAMETERS, ValueType};
use motord_simulator::{Dialect, MotorSettings};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

fn in_mit(name: &str, id: u16) -> MotorSettings {
    MotorSettings { dialect: Dialect::Mit, host_id: 0x100 + id, ..motor(name, id) }
}

fn knee() -> Line {
    Line::on_can("vcan0", vec![MotorSettings { host_id: 0x103, ..motor("knee", 3) }])
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn scan_finds_motors_on_can_and_line_together() {
    let of = |id: u16| {
        let name = format!("m{id}");
        if id.is_multiple_of(2) {
            in_mit(&name, id)
        } else {
            MotorSettings { host_id: 0x100 + id, ..motor(&name, id) }
        }
    };
    let interfaces: Vec<Line> = (0..4_u16)
        .map(|at| Line::on_can(&format!("vcan{at}"), (3 * at + 1..=3 * at + 3).map(of).collect()))
        .collect();
    let line = Line::new(vec![motor("m20", 20), motor("m21", 21), motor("m22", 22)]);
    let buses: String = interfaces.iter().map(|bus| format!("--bus {} ", bus.device())).collect();
    let scanned = line.json(&format!("scan {buses}--bus LINE --ids 1-24"));
    let found: Vec<(String, u64, String)> = scanned["motors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|found| {
            let text = |key: &str| found[key].as_str().unwrap().to_owned();
            (text("bus"), found["id"].as_u64().unwrap(), text("protocol"))
        })
        .collect();
    let on_can = (1..=12_u64).map(|id| {
        let protocol = if id.is_multiple_of(2) { "mit" } else { "gim" };
        (format!("vcan{}", (id - 1) / 3), id, protocol.to_owned())
    });
    let on_the_line = (20..=22).map(|id| (line.device(), id, "gim".to_owned()));
    assert_eq!(found, on_can.chain(on_the_line).collect::<Vec<_>>());
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn every_command_of_the_document_works_over_can() {
    let line = knee();
    assert_eq!(line.json("ping @")["host_id"], 0x103);
    assert_eq!(line.json("version @")["version"], 0x0001_0203);
    assert_eq!(line.json("indicator @").as_array().unwrap().len(), INDICATORS.len());
    for (index, row) in PARAMETERS.iter().enumerate() {
        line.good(&format!("parameter set {} {} @ --yes", row.name, 500 + index));
    }
    let stored = line.json("parameter get @");
    assert!((0..PARAMETERS.len()).all(|index| stored[index]["value"] == 500 + index));
    assert!(line.json("config get power-off-position @")["value"].is_number());
    line.good("start @ --yes");
    line.good("stop @ --control");
    line.good("stop @");
    line.good("torque 0.3 --seconds 0.2 --max-travel-rad 9 --max-rad-s 40 @ --yes");
    line.good("speed 0.5 --seconds 0.2 @ --yes");
    let at = line.json("indicator shaft-angle @")[0]["value"].as_f64().unwrap();
    line.good(&format!("position {:.3} --seconds 0.6 @ --yes", at + 0.2));
    line.good("zero @ --at 0.5 --yes");
    line.good("calibrate phase @ --yes");
    line.good("calibrate encoder @ --yes");
    line.inject("knee fault 0x42");
    assert_eq!(line.json("fault get @ --protocol gim")["bits"], 0x42);
    line.good("fault clear @ --protocol gim");
    line.good("id @ --set-id 5 --set-host-id 0x105 --yes");
    line.good("firmware-mode --bus LINE --id 5 --repeat-id 5 --yes");
    line.bad("fault get --bus LINE --id 5 --protocol gim", 69);
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn every_configuration_item_is_written_over_can() {
    let line = knee();
    let rows = line.json("config list @");
    let changed = CONFIGURATION.iter().zip(rows.as_array().unwrap()).filter(|(item, _)| {
        let is_link = ["can-id", "host-id", "can-protocol", "can-baud-rate"].contains(&item.name);
        item.access == Access::ReadWrite && !is_link
    });
    let items: String = changed
        .map(|(item, row)| match item.value_type {
            ValueType::Integer => format!("{} = {}\n", item.name, row["value"].as_i64().unwrap() + 1),
            ValueType::Float => format!("{} = {:?}\n", item.name, row["value"].as_f64().unwrap() * 1.5),
        })
        .collect();
    std::fs::write(line.path("knee.toml"), format!("[configuration]\n{items}")).unwrap();
    let printed = line.good("config apply knee.toml @ --yes");
    assert!(printed.contains("25 items written, each read back"), "{printed}");
    line.good("config diff knee.toml @");
    let refused = line.bad("config set zero-position 100000 @ --yes", 1);
    assert!(refused.contains("data format (RES 0x07)"), "{refused}");
}

/// Goal: the same as over RS485. The motor is unreachable until the bus has its new bit rate.
#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn every_writable_item_is_set_over_can() {
    let line = knee();
    line::write_every_item(&line);
    line::write_every_address(&line);
    for (code, bitrate) in [(5, 500_000), (10, 1_000_000)] {
        let printed = line.good(&format!("config set can-baud-rate {code} @ --yes"));
        assert!(printed.contains("unreachable until this bus has its bit rate"), "{printed}");
        line.bad("ping @", 69);
        line.inject(&format!("line bitrate {bitrate}"));
        assert_eq!(line.json("config get can-baud-rate @")["value"], code);
    }
    let printed = line.good("config set can-protocol 1 @ --yes");
    assert!(printed.contains("the motor answers in MIT now"), "{printed}");
    assert_eq!(line.json("ping @")["protocol"], "mit");
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn every_documented_fault_is_cleared_over_can() {
    line::read_and_clear_every_fault(&knee(), "gim");
    line::read_and_clear_every_fault(&Line::on_can("vcan0", vec![in_mit("knee", 3)]), "mit");
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn every_result_code_is_shown_over_can() {
    line::refuse_with_every_result_code(&knee());
}

/// Goal: dump, factory reset, apply and diff leave no difference, for three motors, one after the
/// other on its interface.
#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn factory_reset_is_undone_over_can() {
    for id in [3, 17, 99] {
        let line = Line::on_can("vcan0", vec![MotorSettings { host_id: 0x100 + id, ..motor("knee", id) }]);
        let here = format!("--bus LINE --id {id}");
        line.good(&format!("config set rated-current {id} {here} --yes"));
        line.good(&format!("config dump knee.toml {here}"));
        let printed = line.good(&format!("config reset {here} --yes"));
        assert!(printed.contains("it answers as id 1"), "{printed}");
        line.bad("config diff knee.toml --bus LINE --id 1", 1);
        line.good("config apply knee.toml --bus LINE --id 1 --yes");
        line.good(&format!("config diff knee.toml {here}"));
    }
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn interrupted_application_over_can_leaves_a_journal() {
    line::cut_the_power_during_an_application(&knee());
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn write_over_can_survives_power_loss() {
    line::lose_power_after_every_write(&knee());
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn unconfirmed_start_over_can_is_stopped() {
    line::lose_the_answer_to_a_start(&knee(), "130ms");
}

/// Goal: a motor in MIT mode continues after the kill of motorctl until it is stopped: MIT has no
/// duration.
/// Method: it turns at 0.5 rad/s for 1.5 s, and as long again afterwards. A jog with a small motion
/// reports its position.
#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn mit_motor_continues_after_killed_jog_until_stopped() {
    let line = Line::on_can("vcan0", vec![in_mit("knee", 3)]);
    let position = || -> f64 {
        let printed = line.good("jog @ --seconds 0.01 --rad-s 0.001 --yes");
        printed.split(" stopped at ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap()
    };
    let begin = position();
    let mut jog =
        line.command("jog @ --seconds 9 --rad-s 0.5 --kd 5 --max-travel-rad 12 --yes").spawn().unwrap();
    let pause = || std::thread::sleep(std::time::Duration::from_millis(1500));
    pause();
    jog.kill().unwrap();
    jog.wait().unwrap();
    pause();
    line.good("stop @");
    let moved = position() - begin;
    assert!(moved > 1.0, "{moved}");
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn mit_motor_is_found_jogged_and_zeroed() {
    let line = Line::on_can("vcan0", vec![in_mit("knee", 3)]);
    assert_eq!(line.json("ping @")["protocol"], "mit");
    line.good("jog @ --seconds 0.4 --kd 5 --yes");
    line.good("zero @ --yes");
    line.good("stop @");
    line.inject("knee fault 0x02");
    assert_eq!(line.json("fault get @ --protocol mit")["bits"], 2);
    line.good("fault clear @ --protocol mit");
    let native = line.bad("config list @", 1);
    assert!(native.contains("serial port"), "{native}");
    let way_back = line.bad("protocol gim @ --yes", 1);
    assert!(way_back.contains("use its serial port"), "{way_back}");
    drop(line);

    let line = knee();
    let printed = line.good("protocol mit @ --yes");
    assert!(printed.contains("the motor answers in MIT now"), "{printed}");
    assert_eq!(line.json("ping @")["protocol"], "mit");
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn interface_in_use_is_refused_with_process_id() {
    let line = knee();
    let mut first = line.command("indicator @ --watch").stdout(std::process::Stdio::null()).spawn().unwrap();
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(10);
    while line.motorctl("ping @").status.code() != Some(75) {
        assert!(std::time::Instant::now() < deadline, "the interface is not locked");
    }
    let refused = line.bad("ping @", 75);
    assert!(refused.contains(&format!("process {}", first.id())), "{refused}");
    first.kill().unwrap();
    first.wait().unwrap();
}

/// The simulated device decodes SDO requests by itself. Its node changes with its next power-on.
#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn hipnuc_on_can_is_set() {
    let line = Line::hipnuc_on_can("vcan0", vec![MotorSettings { host_id: 0x103, ..motor("knee", 3) }]);
    let set = line.json("imu set --bus vcan0 --node 8 --rate-hz 200 --yes");
    assert!((set["measured_hz"].as_f64().unwrap() - 200.0).abs() < 20.0, "{set}");
    let printed = line.good("imu set --bus vcan0 --node 8 --new-node 9 --new-bitrate 1000000 --yes");
    assert!(printed.contains("stored node 9 and 1000000 bit/s, as read back"), "{printed}");
    line.inject("base power-cycle");
    assert_eq!(line.json("imu find --bus vcan0")["imus"][0]["node_id"], 9);
    let printed = line.bad("imu set --bus vcan0 --node 8 --rate-hz 100 --yes", 1);
    assert!(printed.contains("so nothing is written"), "{printed}");
    for (values, reason) in [
        ("--rate-hz 500", "a HiPNUC on CAN has 10, "),
        ("--new-node 65", "expected 1 to 64"),
        ("--new-bitrate 9600", "expected 125000"),
    ] {
        let printed = line.bad(&format!("imu set --bus vcan0 --node 9 {values} --yes"), 64);
        assert!(printed.contains(reason), "{printed}");
    }
    let held = motord_bus::BusLock::interface("vcan0".parse().unwrap()).unwrap();
    line.bad("imu set --bus vcan0 --node 9 --rate-hz 100 --yes", 75);
    drop(held);
}

/// A HiPNUC sends its TPDOs at 100 Hz beside a motor. The bytes are those of a level device, by the
/// vendor's manual.
#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn hipnuc_beside_a_motor_is_found() {
    let line = knee();
    let frames = [
        Frame::new(FrameId::new(0x188).unwrap(), &[0, 0, 0, 0, 0xE8, 0x03]),
        Frame::new(FrameId::new(0x288).unwrap(), &[0; 6]),
        Frame::new(FrameId::new(0x388).unwrap(), &[0; 6]),
        Frame::new(FrameId::new(0x488).unwrap(), &[0x10, 0x27, 0, 0, 0, 0, 0, 0]),
    ];
    let frames = frames.map(Option::unwrap);
    let is_over = AtomicBool::new(false);
    let found = std::thread::scope(|threads| {
        threads.spawn(|| {
            let mut bus = SocketCanBus::open_as_is("vcan0".parse().unwrap()).unwrap();
            while !is_over.load(Ordering::Relaxed) {
                bus.send(clock::monotonic(), &frames);
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        let found = line.json("imu find --bus vcan0");
        is_over.store(true, Ordering::Relaxed);
        found
    });
    let imu = &found["imus"][0];
    assert_eq!((imu["type"].as_str(), imu["bus"].as_str()), (Some("hipnuc-can"), Some("vcan0")), "{found}");
    assert_eq!((imu["node_id"].as_u64(), found["imus"].as_array().map(Vec::len)), (Some(8), Some(1)));
    assert!(imu["lines"].as_str().is_some_and(|lines| lines.contains("node-id = 8\n")), "{found}");
    let nothing = line.bad("imu find --bus vcan1", 69);
    assert!(nothing.contains("vcan1: no HiPNUC IMU sends its TPDOs"), "{nothing}");
}

/// The commands of a section of docs/first-motor.md, without `motorctl`, on `vcan0`.
fn section(title: &str) -> Vec<String> {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/first-motor.md");
    let page = std::fs::read_to_string(page).unwrap();
    let (_, section) = page.split_once(&format!("\n## {title}\n")).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let commands = section.lines().filter_map(|line| line.strip_prefix("$ motorctl "));
    commands.map(|command| command.replace("can0", "vcan0")).collect()
}

/// A motor of a family beside another one, and `motord.toml` for it as fl-knee. A motor that is alone does
/// not acknowledge frames while it restarts.
fn fl_knee(model: &str, protocol: &str, new: MotorSettings) -> Line {
    let hip = MotorSettings { host_id: 0x10A, ..motor("fl-hip", 10) };
    let line = Line::on_can("vcan0", vec![MotorSettings { initial_position: 0.3, ..new }, hip]);
    let torque = if protocol == "myactuator" { "torque-end-nm = 24\n" } else { "" };
    let of = |name, id, protocol, model| {
        format!(
            "[[motor]]\nname = '{name}'\nbus = 'leg'\nid = {id}\nprotocol = '{protocol}'\nmodel = '{model}'\n"
        )
    };
    let text = format!(
        "[cycle]\nrate-hz = 100\n[[bus]]\nname = 'leg'\ntype = 'socketcan'\ninterface = 'vcan0'\n{}{}{torque}",
        of("fl-hip", 10, "gim", "GIM8108-8"),
        of("fl-knee", 3, protocol, model)
    );
    std::fs::write(line.path("motord.toml"), text).unwrap();
    line
}

/// Model, protocol and settings of a motor from the box. A CANSimple driver has another bit rate there, and an
/// AK motor has got its id with the vendor's tool.
fn of_family(family: &str) -> (&'static str, &'static str, MotorSettings) {
    let knee = |id: u16, vendor, dialect, ends| MotorSettings {
        vendor,
        dialect,
        ends: Some(ends),
        host_id: 0,
        ..motor("fl-knee", id)
    };
    let new = |settings: MotorSettings| MotorSettings { is_new: true, ..settings };
    match family {
        "RobStride" => {
            ("RS02", "robstride", new(knee(1, "robstride", Dialect::RobStride, [12.57, 44.0, 17.0])))
        }
        "MyActuator" => {
            ("X6-40", "myactuator", new(knee(1, "myactuator", Dialect::MyActuator, [12.5, 45.0, 24.0])))
        }
        "CubeMars and T-Motor" => ("AK80-9", "mit", knee(3, "cubemars", Dialect::Mit, [12.5, 50.0, 18.0])),
        _ => ("GIM6010-8", "cansimple", knee(1, "steadywin", Dialect::CanSimple, [12.5, 65.0, 50.0])),
    }
}

/// Goal: the commands of the sections on single families set up and move a motor.
#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn commands_of_each_family_set_up_a_motor() {
    for (family, commands) in [
        ("SteadyWin with an SDC104, GDS68 or GDZ driver", 5),
        ("RobStride", 5),
        ("MyActuator", 5),
        ("CubeMars and T-Motor", 4),
    ] {
        let (model, protocol, new) = of_family(family);
        let line = fl_knee(model, protocol, new);
        let section = section(family);
        assert_eq!(section.len(), commands, "{family}");
        let printed: Vec<String> = section.iter().map(|command| line.good(command)).collect();
        let stopped = printed.last().unwrap();
        let at: f64 =
            stopped.split(" stopped at ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((0.03..0.2).contains(&at), "{family}: {printed:?}");
    }
}

#[test]
#[ignore = "needs vcan: verify/rigs/test-commissioning"]
fn broken_motor_of_each_family_is_replaced() {
    for family in ["CANSimple", "RobStride", "MyActuator"] {
        let (model, protocol, new) = of_family(family);
        let line = fl_knee(model, protocol, new);
        let plan = line.bad("replace fl-knee --config motord.toml", 64);
        assert!(plan.contains("cannot be read: its model"), "{plan}");
        let printed = line.good("replace fl-knee --config motord.toml --yes");
        assert!(printed.contains("fl-knee: its new motor answers as id 3"), "{printed}");
        line.inject("fl-knee power-cycle");
        std::thread::sleep(Duration::from_millis(500));
        line.good("setup --config motord.toml --joint fl-knee");
        let again = line.bad("replace fl-knee --config motord.toml --yes", 1);
        assert!(again.contains("the motor of fl-knee answers"), "{again}");
    }
}
