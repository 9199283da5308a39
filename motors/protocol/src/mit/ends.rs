//! The ends of a motor's codes, as the motor itself reports them.

use crate::link::Error;
use crate::link::{Link, LinkEvent};
use crate::register::{PMAX, REQUEST_ID, TMAX, VMAX, read, value};
use motord_bus::{Frame, FrameId};

/// Requests of one register before it counts as unanswered.
const TRIES: usize = 2;

/// Reads the largest position, velocity and torque that the codes of the Damiao motor `id` can
/// have, rad, rad/s and N·m. Its answers have the id `host_id`. `None` where the motor does not
/// answer, or answers with a number that is no end. The motor does not move.
///
/// # Errors
///
/// [`Error::Bus`] when the bus does not accept a frame.
pub fn ends(link: &mut Link, id: u8, host_id: FrameId) -> Result<Option<[f32; 3]>, Error> {
    let mut ends = [0.0; 3];
    for (end, register) in ends.iter_mut().zip([PMAX, VMAX, TMAX]) {
        match register_of(link, id, host_id, register)?.filter(|end| end.is_finite() && *end > 0.0) {
            Some(value) => *end = value,
            None => return Ok(None),
        }
    }
    Ok(Some(ends))
}

fn register_of(link: &mut Link, id: u8, host_id: FrameId, register: u8) -> Result<Option<f32>, Error> {
    let Some(request_id) = FrameId::new(REQUEST_ID) else { return Ok(None) };
    let request = Frame::classic(request_id, read(id, register));
    for _ in 0..TRIES {
        let timeout = link.timeout();
        let found = link.ask_frame(&request, timeout, |event| match event {
            LinkEvent::Frame(frame) if frame.id() == host_id => value(id, register, frame.payload()),
            _ => None,
        })?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}
