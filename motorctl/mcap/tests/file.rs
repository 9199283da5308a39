//! A file is read as it was written. A damaged one is read up to its damage, without a panic of the
//! reader.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use motord_mcap::{Clock, Counts, Memory, Origin, ReadError, Reader, Reading, Stops, Writer};
use motord_shared::description::{GroupDescription, ImuDescription, JointDescription, RobotDescription};
use motord_shared::message::{IMU_FRESH, IMU_VALID};
use motord_shared::{
    BusCondition, Cause, CycleRecord, ImuState, JointSetpoint, MotorMode, Phase, SetpointMode,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

const CYCLES: u64 = 3000;

fn robot() -> RobotDescription {
    let joint = |name: &str| JointDescription { name: name.into(), ..JointDescription::default() };
    RobotDescription {
        instance: "demo".into(),
        rate_hz: 1000.0,
        boot_id: 77,
        joints: vec![joint("hip"), joint("knee")],
        groups: vec![GroupDescription { name: "leg".into(), joints: vec![0, 1] }],
        buses: vec!["can".into()],
        imus: vec![ImuDescription { name: "base".into(), rate_hz: 500.0, ..Default::default() }],
        ..RobotDescription::default()
    }
}

/// Every other cycle has a fresh sample.
fn imu(cycle: u64) -> ImuState {
    let sequence = cycle / 2;
    if sequence == 0 {
        return ImuState::UNKNOWN;
    }
    ImuState {
        orientation: [0.5, -0.5, 0.5, -0.5],
        angular_velocity: [sequence as f32, 0.2, 0.3],
        acceleration: [0.1, 0.2, 9.8],
        temperature: 31.5,
        flags: IMU_VALID | if cycle.is_multiple_of(2) { IMU_FRESH } else { 0 },
        missing: 4,
        rejected: 5,
        sequence,
        receive_ns: sequence * 2_000_000,
        publisher: 0,
    }
}

/// Creates a cycle in which every recorded value differs from zero.
fn record(cycle: u64) -> CycleRecord {
    let mut record = CycleRecord { sequence: cycle + 5, ..CycleRecord::default() };
    let state = &mut record.state;
    (state.boot_id, state.cycle, state.tick_ns) = (77, cycle, cycle * 1_000_000);
    (state.wake_latency_ns, state.publish_ns, state.overruns, state.flags) =
        (9, cycle * 1_000_000 + 400_000, 3, 0b11111);
    (state.joint_count, state.group_count, state.bus_count, state.indicator_count) = (2, 1, 1, 1);
    for (index, joint) in state.joints[..2].iter_mut().enumerate() {
        joint.position = (cycle as f32 * 0.01).sin() + index as f32;
        (joint.velocity, joint.torque, joint.temperature) = (0.5, -1.5, 31.0);
        (joint.applied.position, joint.applied.kp, joint.applied.kd) = (0.25, 40.0, 1.0);
        (joint.limits, joint.mode, joint.fault, joint.flags) = (5, MotorMode::Active.code(), 2, 3);
        (joint.age_cycles, joint.missed, joint.reply_latency_ns, joint.late) = (1, 2, 150_000, 4);
        (joint.implausible, joint.foreign_commands, joint.receive_ns) = (6, 7, 123_456);
    }
    let group = &mut state.groups[0];
    (group.lease, group.sequence, group.setpoint_age_ns) = (1 << 32 | 1, cycle, 800_000);
    (group.answered_cycle, group.used_cycle, group.phase) = (cycle, cycle, Phase::Active.code());
    (group.cause, group.cause_joint, group.cause_pid) = (Cause::MotorFault.code(), 1, 4711);
    (group.accepted, group.late, group.setpoint_horizon_ns) = (8, 1, 25_000_000);
    group.rejected[2] = 3;
    let bus = &mut state.buses[0];
    (bus.condition, bus.sent, bus.received, bus.errors) = (BusCondition::Active.code(), 24, 23, 1);
    state.indicators[0].joint = 1;
    state.indicators[0].values.fill(f32::NAN);
    state.indicators[0].values[0] = 24.5;
    // A sample in every other cycle.
    (state.imu_count, state.imus[0]) = (1, imu(cycle));
    let setpoint = JointSetpoint {
        position: 0.3,
        velocity: 0.1,
        kp: 60.0,
        kd: 2.0,
        torque: 0.7,
        mode: SetpointMode::Impedance.code(),
    };
    record.set_setpoint(1, setpoint);
    record
}

fn written(finish: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer =
        Writer::new(&mut bytes, &robot(), Origin { unix_ns: 1_700_000_000_000_000_000 }, 0).unwrap();
    for cycle in 1..=CYCLES {
        writer.write(&record(cycle)).unwrap();
        if cycle % 1000 == 0 {
            writer.flush().unwrap();
        }
    }
    if finish {
        writer.finish(&Counts { recorded: CYCLES, ..Counts::default() }).unwrap();
    } else {
        // A drop would end the file.
        std::mem::forget(writer);
    }
    bytes
}

/// Returns the readable cycles, and `true` for a damaged file.
fn read(bytes: &[u8]) -> Result<(Vec<u64>, bool), ReadError> {
    let mut reader = Reader::new(bytes)?;
    let mut cycles = Vec::new();
    while let Some(record) = reader.next_cycle() {
        cycles.push(record.state.cycle);
    }
    Ok((cycles, reader.damage().is_some()))
}

#[test]
fn every_cycle_is_read_as_it_was_written() {
    let bytes = written(true);
    let mut reader = Reader::new(&bytes[..]).unwrap();
    assert_eq!(reader.robot(), &robot());
    for cycle in 1..=CYCLES {
        let (expected, read) = (record(cycle), reader.next_cycle().unwrap());
        assert_eq!(read.state.joints(), expected.state.joints());
        assert_eq!(read.state.groups(), expected.state.groups());
        assert_eq!(read.state.buses(), expected.state.buses());
        // Before the first sample the values are no numbers.
        assert_eq!(format!("{:?}", read.state.imus()), format!("{:?}", expected.state.imus()));
        assert_eq!((read.setpoint(0), read.setpoint(1)), (None, expected.setpoint(1)));
        let whole = |record: &CycleRecord| {
            let state = record.state;
            (record.sequence, state.cycle, state.tick_ns, state.publish_ns, state.overruns, state.flags)
        };
        assert_eq!(whole(read), whole(&expected));
        let indicators = read.state.indicators();
        assert_eq!((indicators.len(), indicators[0].joint), (1, 1));
        assert!((indicators[0].values[0] - 24.5).abs() < f32::EPSILON && indicators[0].values[1].is_nan());
    }
    assert!(reader.next_cycle().is_none());
    assert_eq!(reader.damage(), None);
}

#[test]
fn killed_recorder_leaves_file_readable_to_last_flush() {
    let bytes = written(false);
    let (cycles, _) = read(&bytes).unwrap();
    assert!(cycles.len() as u64 >= CYCLES);
    for cut in (bytes.len() / 2..bytes.len()).step_by(997) {
        let (cycles, is_damaged) = read(&bytes[..cut]).unwrap();
        assert!(is_damaged && cycles.len() >= 1000, "{cut} of {}: {}", bytes.len(), cycles.len());
        assert!(
            cycles.iter().zip(1..).all(|(cycle, expected)| *cycle == expected),
            "from the first, without a gap"
        );
    }
}

#[test]
fn no_damage_makes_the_reader_panic_or_hang() {
    let bytes = written(true);
    for (index, seed) in (0..bytes.len()).step_by(bytes.len() / 150).zip(1_u8..) {
        let mut damaged = bytes.clone();
        damaged[index] ^= seed;
        let _any_outcome = read(&damaged);
        let _any_outcome = read(&bytes[..index]);
    }
    assert!(read(b"").is_err());
    assert!(read(b"not an mcap file at all").is_err());
}

/// Returns a record of an MCAP file.
fn record_of(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![kind];
    bytes.extend((body.len() as u64).to_le_bytes());
    bytes.extend(body);
    bytes
}

/// Returns a chunk that declares `size` bytes.
fn chunk_of(size: u64) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend(size.to_le_bytes());
    // With a check sum, the chunk is expanded as a whole.
    body.extend([1; 4]);
    body.extend(b"\x04\0\0\0zstd");
    body.extend(5_u64.to_le_bytes());
    body.extend(b"\x28\xb5\x2f\xfd\0");
    record_of(6, &body)
}

/// Returns a file without its end.
fn endless(bytes: &[u8]) -> &[u8] {
    let end = bytes.windows(9).rposition(|head| head == [0x0F, 4, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    &bytes[..end]
}

/// Returns a file of ten chunks, each of which expands from a kilobyte to 15 MiB.
fn bomb() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().chunk_size(Some(1)).compression(Some(mcap::Compression::Zstd));
    let mut writer = options.create(&mut bytes).unwrap();
    let channel_id = writer.add_channel(0, "/zeros", "raw", &std::collections::BTreeMap::new()).unwrap();
    let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
    (0..10).for_each(|_| writer.write_to_known_channel(&header, &vec![0; 15 << 20]).unwrap());
    writer.finish().unwrap();
    drop(writer);
    endless(&bytes.into_inner()).to_vec()
}

#[test]
fn excessive_files_end_by_a_limit() {
    let mut writer = Writer::new(Vec::new(), &robot(), Origin::default(), 0).unwrap();
    (1..=10).for_each(|cycle| writer.write(&record(cycle)).unwrap());
    let whole = writer.finish(&Counts::default()).unwrap();
    let bomb = bomb();
    assert!(bomb.len() < 100_000, "{} bytes for 150 MiB", bomb.len());
    let record = [&[5][..], &(1_u64 << 60).to_le_bytes()].concat();
    for (index, end) in [&bomb[8..], &chunk_of(1 << 60), &[0; 1 << 16], &record].iter().enumerate() {
        let (cycles, is_damaged) = read(&[endless(&whole), end].concat()).unwrap();
        assert!(is_damaged && cycles.len() == 10, "{index}: {cycles:?}");
    }
    let first = [&bomb[..8], &[0; 1 << 16]].concat();
    assert!(matches!(read(&first), Err(ReadError::Excessive)));
}

#[test]
fn a_file_of_another_program_is_refused() {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut other = mcap::Writer::new(&mut bytes).unwrap();
    let channel = other.add_channel(0, "/chat", "json", &std::collections::BTreeMap::new()).unwrap();
    let header =
        mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
    other.write_to_known_channel(&header, b"{}").unwrap();
    other.finish().unwrap();
    drop(other);
    assert!(matches!(read(&bytes.into_inner()), Err(ReadError::NoRobot)));
}

/// Returns the file of a memory of two seconds after six.
fn remembered(bytes_max: usize) -> Vec<u8> {
    let mut memory = Memory::new(&robot(), Duration::from_secs(2), bytes_max);
    (1..=6000).for_each(|cycle| memory.take(&record(cycle)).unwrap());
    let mut bytes = Vec::new();
    let written = memory.remembered(Origin::default()).unwrap().write(&mut bytes).unwrap();
    assert_eq!(written, read(&bytes).unwrap().0.len() as u64);
    bytes
}

#[test]
fn memory_keeps_last_seconds_within_its_bytes() {
    let bytes = remembered(usize::MAX);
    let expected: Vec<u64> = (3001..=6000).collect();
    assert_eq!(read(&bytes).unwrap(), (expected, false), "and up to a second more");
    let (fewer, is_damaged) = read(&remembered(bytes.len())).unwrap();
    assert!(!is_damaged && fewer.len() < 3000, "{}", fewer.len());
    assert_eq!(fewer.last(), Some(&6000), "the newest stay");
}

/// Goal: a file that spans a step of the clock has one origin of its times, and names the step.
/// Method: the clock shows 1970 for three seconds, and 2026 from then on.
#[test]
fn file_across_clock_step_has_one_origin() {
    const SECOND: u64 = 1_000_000_000;
    const YEAR_2026: u64 = 1_767_225_600 * SECOND;
    let now = Arc::new(AtomicU64::new(0));
    let shown = Arc::clone(&now);
    let mut clock = Clock::of(move || {
        let monotonic_ns = shown.load(Ordering::Relaxed);
        let set = if monotonic_ns > 3 * SECOND { YEAR_2026 } else { 0 };
        Reading { monotonic_ns, unix_ns: monotonic_ns + set }
    });
    let mut memory = Memory::new(&robot(), Duration::from_secs(10), usize::MAX);
    for cycle in 1..=6000 {
        now.store(record(cycle).state.tick_ns, Ordering::Relaxed);
        clock.step().into_iter().for_each(|step| memory.take_step(step));
        memory.take(&record(cycle)).unwrap();
    }
    let mut bytes = Vec::new();
    memory.remembered(clock.origin()).unwrap().write(&mut bytes).unwrap();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    assert!(messages.iter().all(|message| message.log_time >= YEAR_2026), "times of 1970 in a file of 2026");
    let is_step =
        |data: &[u8]| data.windows(41).any(|part| part == b"set forward by 1767225600.000 s, or it sl");
    let steps: Vec<_> = messages.iter().filter(|message| is_step(&message.data)).collect();
    assert_eq!(steps.len(), 1);
    assert_eq!(steps[0].channel.topic, "/events");
    assert!((steps[0].log_time - YEAR_2026).abs_diff(3 * SECOND) <= SECOND / 10 + 1);
}

#[test]
fn stop_is_found_once_after_first_cycle() {
    let mut stops = Stops::default();
    let mut of = |cause: u32| {
        let mut record = record(1);
        record.state.groups[0].cause = cause;
        stops.of(&record)
    };
    let stop = Cause::EmergencyStop;
    let found = [stop.code(), 0, stop.code(), stop.code(), Cause::MotorFault.code()].map(&mut of);
    assert_eq!(found, [None, None, Some(stop), None, Some(Cause::MotorFault)]);
}
