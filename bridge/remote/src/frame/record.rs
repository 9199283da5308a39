//! A cycle for recorders, as bytes: head, number, bits of the joints with a setpoint, their setpoints,
//! and the state.

use super::{FrameError, Head};
use motord_shared::CycleRecord;
use motord_shared::limits::JOINTS_MAX;
use motord_shared::packed::{pack, unpack};
use motord_shared::plain::Plain;

/// Returns the bytes of a frame with `record`.
pub(crate) fn record_bytes(head: &Head, record: &CycleRecord) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(8192);
    head.write(&mut bytes);
    [record.sequence, record.known].write(&mut bytes);
    for joint in joints(record.known) {
        record.setpoints[joint].write(&mut bytes);
    }
    pack(&record.state, &mut bytes);
    bytes
}

/// Returns the head and the record of a frame.
pub(crate) fn read_record(mut bytes: &[u8]) -> Result<(Head, Box<CycleRecord>), FrameError> {
    let head = Head::read(&mut bytes)?;
    let mut record = Box::<CycleRecord>::default();
    [record.sequence, record.known] = Plain::read(&mut bytes).ok_or(FrameError::Malformed)?;
    for joint in joints(record.known) {
        record.setpoints[joint] = Plain::read(&mut bytes).ok_or(FrameError::Malformed)?;
    }
    record.state = unpack(bytes).ok_or(FrameError::Malformed)?;
    Ok((head, record))
}

/// Returns the joints whose bits are set.
fn joints(known: u64) -> impl Iterator<Item = usize> {
    (0..JOINTS_MAX).filter(move |joint| known & (1 << joint) != 0)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{UP, damaged};
    use super::*;
    use motord_shared::JointSetpoint;
    use proptest::prelude::*;

    const HEAD: Head = UP.head;

    fn record() -> CycleRecord {
        let mut record = CycleRecord { sequence: 3, ..CycleRecord::default() };
        record.state.joint_count = 12;
        record.state.cycle = 77;
        for joint in [0, 5, 63] {
            record.set_setpoint(joint, JointSetpoint { position: joint as f32, ..JointSetpoint::default() });
        }
        record
    }

    #[test]
    fn record_survives_the_network() {
        let bytes = record_bytes(&HEAD, &record());
        assert_eq!(read_record(&bytes), Ok((HEAD, Box::new(record()))));
        assert!(bytes.len() < size_of::<CycleRecord>() / 3, "{} bytes", bytes.len());
    }

    proptest! {
        #[test]
        fn damaged_records_are_refused_or_read(bytes in damaged(0..600)) {
            let _refused_or_read = read_record(&bytes);
        }

        #[test]
        fn shortened_records_are_refused(part in 0.0..1.0_f64) {
            let bytes = record_bytes(&HEAD, &record());
            let length = (bytes.len() as f64 * part) as usize;
            prop_assert!(read_record(&bytes[..length]).is_err());
            prop_assert!(read_record(&[&bytes[..], &[0]].concat()).is_err());
        }
    }
}
