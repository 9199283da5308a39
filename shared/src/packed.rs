//! Messages as bytes for a network: the memory of the message, little-endian, without the unused
//! entries of its arrays.

use crate::plain::{Sparse, Used};

/// Appends the bytes of `message`. Allocates.
pub fn pack<T: Sparse>(message: &T, bytes: &mut Vec<u8>) {
    let mut whole = Vec::with_capacity(size_of::<T>());
    message.write(&mut whole);
    let mut end = 0;
    for array in T::ARRAYS {
        bytes.extend_from_slice(&whole[end..array.start]);
        end = array.start + array.entry * array.most;
        bytes.extend_from_slice(&whole[array.start..array.start + array.entry * used(array, &whole)]);
    }
    bytes.extend_from_slice(&whole[end..]);
}

/// Returns the message with exactly these bytes; its unused entries are zero. `None` when there are
/// more or fewer bytes than its numbers of used entries say. Allocates.
#[must_use]
pub fn unpack<T: Sparse>(mut bytes: &[u8]) -> Option<T> {
    let mut whole = vec![0; size_of::<T>()];
    let mut take = |part: &mut [u8]| bytes.split_off(..part.len()).map(|packed| part.copy_from_slice(packed));
    let mut end = 0;
    for array in T::ARRAYS {
        take(&mut whole[end..array.start])?;
        end = array.start + array.entry * array.most;
        let used = used(array, &whole);
        take(&mut whole[array.start..array.start + array.entry * used])?;
    }
    take(&mut whole[end..])?;
    let message = T::read(&mut whole.as_slice());
    message.filter(|_| bytes.is_empty())
}

/// Returns the number of used entries of an array, which stands before it. A hostile number is
/// limited to the array.
fn used(array: &Used, whole: &[u8]) -> usize {
    let count = whole[array.count..].first_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes));
    (count as usize).min(array.most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::JOINTS_MAX;
    use crate::{GroupState, JointSetpoint, JointState, SetpointMessage, StateMessage};

    fn setpoint(joint_count: u32) -> SetpointMessage {
        let joint = JointSetpoint { position: -1.5, velocity: 2.0, kp: 3.0, kd: 4.0, torque: 5.0, mode: 1 };
        let mut joints = [JointSetpoint::default(); JOINTS_MAX];
        joints[..(joint_count as usize).min(JOINTS_MAX)].fill(joint);
        SetpointMessage { lease: 1, sequence: 2, time_ns: 3, cycle: 4, joint_count, horizon_ns: 5, joints }
    }

    fn packed<T: Sparse>(message: &T) -> Vec<u8> {
        let mut bytes = Vec::new();
        pack(message, &mut bytes);
        bytes
    }

    #[test]
    fn packed_message_holds_used_entries_only() {
        for (joint_count, used) in [(0, 0), (1, 1), (12, 12), (64, 64), (u32::MAX, 64)] {
            let message = setpoint(joint_count);
            let bytes = packed(&message);
            assert_eq!(bytes.len(), 40 + 24 * used);
            assert_eq!(unpack(&bytes), Some(message));
        }
    }

    /// Offsets of the layout, from the table of the structure.
    #[test]
    fn packed_message_is_memory_little_endian() {
        let bytes = packed(&setpoint(1));
        assert_eq!(bytes[..8], 1_u64.to_le_bytes());
        assert_eq!(bytes[32..36], 1_u32.to_le_bytes());
        assert_eq!(bytes[36..40], 5_u32.to_le_bytes());
        assert_eq!(bytes[40..44], (-1.5_f32).to_le_bytes());
    }

    #[test]
    fn state_survives_packing() {
        let mut state =
            StateMessage { boot_id: 7, cycle: 8, joint_count: 12, group_count: 2, ..Default::default() };
        state.joints[..12].fill(JointState { missed: 9, ..JointState::default() });
        state.groups[..2].fill(GroupState { lease: 10, ..GroupState::default() });
        let bytes = packed(&state);
        assert!(unpack(&bytes) == Some(state));
        assert!(bytes.len() < size_of::<StateMessage>() / 4, "{} bytes", bytes.len());
    }

    #[test]
    fn wrong_number_of_bytes_is_no_message() {
        let bytes = packed(&setpoint(3));
        for length in 0..bytes.len() {
            assert_eq!(unpack::<SetpointMessage>(&bytes[..length]), None, "{length} bytes");
        }
        assert_eq!(unpack::<SetpointMessage>(&[&bytes[..], &[0]].concat()), None);
    }
}
