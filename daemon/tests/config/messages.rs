//! The words of a mistake: its place and key, what was expected, what was found, and what to write.

use crate::document::validate;

/// A robot of one joint, for the tests to damage. Its line 5 is that of the rate.
pub(crate) const ROBOT: &str = r#"[daemon]
instance = "robot"

[cycle]
rate-hz = 1000

[safety]
setpoint-timeout-ms = 20.0

[[bus]]
name = "desk"
type = "simulated"

[[motor]]
name = "hip"
bus = "desk"
id = 1
protocol = "mit"
model = "GIM8108-8"
limits = { position-rad = [-1.0, 1.0], velocity-rad-s = 25.0 }

[[group]]
name = "legs"
joints = ["hip"]
"#;

/// A line of [`ROBOT`], what is written instead, and the message without the name of the file.
type Mistake<'m> = (&'m str, &'m str, &'m str);

/// Asserts that each mistake has exactly this message.
fn assert_messages(mistakes: &[Mistake<'_>]) {
    let printed = mistakes.iter().map(|(line, instead, expected)| {
        assert!(ROBOT.contains(line), "nothing to damage: {line}");
        let text = ROBOT.replacen(line, instead, 1);
        let error = validate(&text).map_or_else(|error| error.to_string(), |_| "is accepted".to_owned());
        (error, format!("robot.toml:{expected}"))
    });
    let wrong: Vec<_> = printed.filter(|(printed, expected)| printed != expected).collect();
    let list: Vec<_> = wrong
        .iter()
        .map(|(printed, expected)| format!("said:     {printed}\nexpected: {expected}"))
        .collect();
    assert!(wrong.is_empty(), "{} of {} differ:\n{}", wrong.len(), mistakes.len(), list.join("\n"));
}

/// Values of another type.
const TYPES: &[Mistake<'_>] = &[
    (
        "rate-hz = 1000",
        "rate-hz = \"1000\"",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found the text \"1000\"; write rate-hz = 1000, without quotes",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = 'fast' # why",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found the text 'fast'; write a number, such as rate-hz = 1000",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = \"1000 Hz\"",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found the text \"1000 Hz\"; write rate-hz = 1000, without quotes",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = true",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found true; write a number, such as rate-hz = 1000",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = [1000]",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found the list [1000]; write rate-hz = 1000, without brackets",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = { value = 1000 }",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found the table { value = 1000 }; write a number, such as rate-hz = 1000",
    ),
    (
        "setpoint-timeout-ms = 20.0",
        "setpoint-timeout-ms = \"20,5\"",
        "8:23: safety.setpoint-timeout-ms: expected a number from 1 to 1000 ms, found the text \"20,5\"; write setpoint-timeout-ms = 20.5, without quotes",
    ),
    (
        "id = 1",
        "id = \"0x01\"",
        "17:6: motor.id: expected an integer from 0 to 254, found the text \"0x01\"; write id = 0x01, without quotes",
    ),
    (
        "id = 1",
        "id = 1.0",
        "17:6: motor.id: expected an integer from 0 to 254, found the number 1.0; write id = 1, without a point",
    ),
    (
        "id = 1",
        "id = 99999999999999999999",
        "17:6: motor.id: expected an integer from 0 to 254, found the integer 99999999999999999999; write an integer, such as id = 1",
    ),
    (
        "rate-hz = 1000",
        "require-realtime = \"True\"",
        "5:20: cycle.require-realtime: expected true or false, found the text \"True\"; write require-realtime = true, without quotes",
    ),
    (
        "rate-hz = 1000",
        "require-realtime = 1",
        "5:20: cycle.require-realtime: expected true or false, found the integer 1; write require-realtime = true",
    ),
    (
        "bus = \"desk\"",
        "bus = 0",
        "16:7: motor.bus: expected a text, found the integer 0; write bus = \"0\", with quotes",
    ),
    (
        "protocol = \"mit\"",
        "protocol = 2",
        "18:12: motor.protocol: expected one of \"mit\", \"gim\", \"robstride\", \"cansimple\", \"myactuator\", \"odrive\", found the integer 2; write a text, such as protocol = \"mit\"",
    ),
];

#[test]
fn wrong_type_says_what_to_write() {
    assert_messages(TYPES);
}

/// Lists and tables in the place of others.
const LISTS: &[Mistake<'_>] = &[
    (
        "joints = [\"hip\"]",
        "joints = \"hip, knee\"",
        "24:10: group.joints: expected a list of texts, found the text \"hip, knee\"; write joints = [\"hip\", \"knee\"]",
    ),
    (
        "joints = [\"hip\"]",
        "joints = [1, 2]",
        "24:10: group.joints: expected a list of texts, found the list [1, 2]; write texts, such as joints = [\"hip\", \"knee\"]",
    ),
    (
        "position-rad = [-1.0, 1.0]",
        "position-rad = 0.8",
        "20:27: motor.limits.position-rad: expected a list of two numbers, found the number 0.8; write position-rad = [-0.8, 0.8]",
    ),
    (
        "position-rad = [-1.0, 1.0]",
        "position-rad = [\"-1\", \"1\"]",
        "20:27: motor.limits.position-rad: expected a list of two numbers, found the list [\"-1\", \"1\"]; write two numbers, such as position-rad = [-0.5, 0.5]",
    ),
    (
        "position-rad = [-1.0, 1.0]",
        "position-rad = [-1,0, 1,0]",
        "20:27: motor.limits.position-rad: expected two numbers, the lowest and the highest position, found 4; write decimals with a point, such as position-rad = [-0.5, 0.5]",
    ),
    (
        "limits = { position-rad = [-1.0, 1.0], velocity-rad-s = 25.0 }",
        "limits = [-1.0, 1.0]",
        "20:10: motor.limits: expected a table, found the list [-1.0, 1.0]; write limits = { KEY = VALUE }",
    ),
    ("[cycle]\nrate-hz = 1000", "[daemon.x]", "4:9: daemon.x: unknown key `x`; known are instance"),
];

#[test]
fn wrong_list_or_table_says_what_to_write() {
    assert_messages(LISTS);
    for (text, expected) in [
        (
            "cycle = 1000",
            "1:9: cycle: expected a table, found the integer 1000; write [cycle] in a line of its own, and its keys below",
        ),
        (
            "motor = \"hip\"",
            "1:9: motor: expected a table, found the text \"hip\"; write [[motor]] in a line of its own, and its keys below",
        ),
        (
            "motor = [\"hip\", \"knee\"]",
            "1:9: motor: expected tables, found the list [\"hip\", \"knee\"]; write [[motor]] in a line of its own, and its keys below",
        ),
    ] {
        let error = validate(&format!("{text}\n[[bus]]\nname = 'b'\ntype = 'simulated'\n"))
            .expect_err(text)
            .to_string();
        assert_eq!(error.lines().next(), Some(format!("robot.toml:{expected}").as_str()));
        assert!(!error.contains("motor: is missing") || text.starts_with("cycle"), "{error}");
    }
}

/// Problems that only follow from a misspelt table are not reported.
#[test]
fn misspelt_table_suggests_the_near_one() {
    assert_messages(&[
        ("[[motor]]", "[[motors]]", "14:3: motors: unknown table [[motors]]; did you mean [[motor]]?"),
        ("[[bus]]", "[[buses]]", "10:3: buses: unknown table [[buses]]; did you mean [[bus]]?"),
        ("[cycle]", "[cycles]", "4:2: cycles: unknown table [cycles]; did you mean [cycle]?"),
        (
            "rate-hz = 1000",
            "ratehz = 1000",
            "5:1: cycle.ratehz: unknown key `ratehz`; did you mean `rate-hz`?",
        ),
    ]);
    let joint = validate(&ROBOT.replace("[[motor]]", "[[joint]]")).expect_err("must be refused").to_string();
    let known = "robot.toml:14:3: joint: unknown table [[joint]]; known are [daemon], [cycle], [ipc], [telemetry], [safety], [[bus]], \
                 [[motor]], [[group]], [[imu]]";
    assert!(joint.lines().any(|line| line == known), "{joint}");
    assert!(!joint.contains("known are \n") && !joint.ends_with("known are "), "{joint}");
}

#[test]
fn file_without_keys_says_how_to_begin() {
    for text in ["", "\n\n", "# only a comment\n"] {
        assert_eq!(
            validate(text).expect_err("must be refused").to_string(),
            "robot.toml: has no keys; `motord init --file FILE` writes a first configuration"
        );
    }
}

/// Values that are no TOML.
const VALUES: &[Mistake<'_>] = &[
    (
        "rate-hz = 1000",
        "rate-hz = 1000 Hz",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found `1000 Hz`; write rate-hz = 1000, without a unit",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = 1kHz # fast",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found `1kHz`; write rate-hz = 1000, without a unit",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = 1,000",
        "5:12: cycle.rate-hz: expected a number from 1 to 10000 Hz, found `1,000`; write rate-hz = 1000, or 1.000 with a \
             decimal point",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = fast",
        "5:11: cycle.rate-hz: expected a number from 1 to 10000 Hz, found `fast`; write a number, such as rate-hz = 1000",
    ),
    (
        "rate-hz = 1000",
        "rate-hz =",
        "5:10: cycle.rate-hz: expected a number from 1 to 10000 Hz, found nothing; write rate-hz = 1000",
    ),
    (
        "setpoint-timeout-ms = 20.0",
        "setpoint-timeout-ms = 20,0",
        "8:25: safety.setpoint-timeout-ms: expected a number from 1 to 1000 ms, found `20,0`; write \
             setpoint-timeout-ms = 20.0, with a point and no comma",
    ),
    (
        "velocity-rad-s = 25.0",
        "velocity-rad-s = 5,0",
        "20:61: motor.limits.velocity-rad-s: expected a number of at least 0.01 rad/s, found `5,0`; write \
             velocity-rad-s = 5.0, with a point and no comma",
    ),
    (
        "id = 1",
        "id = 01",
        "17:6: motor.id: expected an integer from 0 to 254, found `01`; write id = 1, without the zero before it",
    ),
    (
        "type = \"simulated\"",
        "type = simulated",
        "12:8: bus.type: expected one of \"socketcan\", \"serial\", \"simulated\", found `simulated` without quotes; \
             write type = \"simulated\"",
    ),
    (
        "name = \"desk\"",
        "name = \"desk",
        "11:13: bus.name: the text has no quote at its end; write name = \"desk\"",
    ),
    (
        "name = \"desk\"",
        "name = desk\"",
        "11:8: bus.name: the text has no quote at its begin; write name = \"desk\"",
    ),
    (
        "name = \"desk\"",
        "name = “desk”",
        "11:8: bus.name: found the quotes of a text processor; write name = \"desk\", with straight quotes",
    ),
    (
        "name = \"desk\"",
        "name = \"a\\dev\"",
        "11:11: bus.name: `\\` begins an escape in a text; write name = 'a\\dev', with single quotes",
    ),
    (
        "rate-hz = 1000",
        "require-realtime = True",
        "5:20: cycle.require-realtime: expected true or false, found `True`; write require-realtime = true",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = 1000 // fast",
        "5:11: cycle.rate-hz: a comment begins with `#`; write rate-hz = 1000 # fast",
    ),
];

#[test]
fn malformed_value_says_what_to_write() {
    assert_messages(VALUES);
}

/// Lines that are no TOML.
const FORMS: &[Mistake<'_>] = &[
    (
        " }\n\n[[group]]",
        "\n\n[[group]]",
        "20:10: motor.limits: `{` has no end; write `}` after the last item",
    ),
    ("[\"hip\"]\n", "[\"hip\"\n", "24:10: group.joints: `[` has no end; write `]` after the last item"),
    (
        "[cycle]",
        "[cycle",
        "4:7: cycle: expected a table's name in brackets, found `[cycle`; write [cycle], alone in its line",
    ),
    (
        "rate-hz = 1000",
        "rate-hz: 1000",
        "5:8: cycle.rate-hz: expected `=` after the key, found `:`; write rate-hz = 1000",
    ),
    (
        "rate-hz = 1000",
        "rate-hz = 1000\nrate-hz = 500",
        "6:1: cycle.rate-hz: `rate-hz` is there twice, first in line 5; keep one",
    ),
    ("[safety]", "[cycle]", "7:2: cycle: `cycle` is there twice, first in line 4; keep one"),
    (
        "rate-hz = 1000",
        "rate-hz = 1000 cpu = 0",
        "5:11: cycle.rate-hz: found two keys in one line; write rate-hz = 1000 and cpu = … in a line each",
    ),
    (
        ", velocity-rad-s",
        " velocity-rad-s",
        "20:39: motor.limits.velocity-rad-s: expected a comma before this key; write , velocity-rad-s = 25.0",
    ),
    (
        "velocity-rad-s = 25.0",
        "velocity-rad-s = 25.0 torque-nm = 5.0",
        "20:57: motor.limits.velocity-rad-s: expected a comma after `25.0`; write velocity-rad-s = 25.0,",
    ),
    (
        "limits = { ",
        "limits = ",
        "20:10: motor.limits: expected `{` before the keys of a table; write limits = { position-rad = [-1.0, 1.0], \
             velocity-rad… }",
    ),
    ("[daemon]", "; mine\n[daemon]", "1:1: a comment begins with `#`; write # mine"),
    (
        "rate-hz = 1000",
        "<<<<<<< HEAD\nrate-hz = 1000",
        "5:1: cycle: is a mark of a merge conflict; choose one side, and delete the marks",
    ),
    (
        "rate-hz = 1000",
        "rate-hz\u{a0}= 1000",
        "5:8: cycle.rate-hz: has the invisible character U+00A0 here; delete it, or write a space",
    ),
    (
        "rate-hz = 1000",
        "rate-hz \u{e0041}= 1000",
        "5:9: cycle.rate-hz: has the invisible character U+E0041 here; delete it, or write a space",
    ),
];

#[test]
fn brackets_and_keys_without_form_are_explained() {
    assert_messages(FORMS);
}

#[test]
fn file_of_another_format_is_named() {
    let printed = |bytes: &[u8]| {
        let path = std::path::Path::new("robot.toml");
        motord_configuration::parse(path, bytes, &crate::document::machine())
            .expect_err("no TOML")
            .to_string()
    };
    for (text, format) in
        [("{\n \"cycle\": 1 }", "JSON"), ("[\n {} ]", "JSON"), ("---\na: 1", "YAML"), ("<robot/>", "XML")]
    {
        let expected = format!(
            "robot.toml:1:1: is {format}, and no TOML: a table is [cycle], a key in it rate-hz = 1000; "
        );
        assert!(printed(text.as_bytes()).starts_with(&expected), "{}", printed(text.as_bytes()));
    }
    let wide = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<_>>();
    for bytes in [wide(ROBOT), [&[0xFF, 0xFE][..], &wide(ROBOT)].concat()] {
        assert!(
            printed(&bytes).starts_with("robot.toml:1:1: is UTF-16, and not UTF-8; save the file as UTF-8")
        );
    }
    let returns = printed(ROBOT.replace('\n', "\r").as_bytes());
    assert!(
        returns.starts_with("robot.toml:1:9: has a carriage return without a line feed here"),
        "{returns}"
    );
    for same in [ROBOT.replace('\n', "\r\n"), format!("\u{feff}{ROBOT}"), ROBOT.replace(" = ", "\t=\t")] {
        assert!(validate(&same).is_ok(), "{same:?}");
    }
}
