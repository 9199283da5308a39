//! Facts of the vendors' MIT motors, written from the vendors' documents (docs/motors.md). To add a
//! vendor, add a row to [`VENDORS`].

use crate::protocol::mit::ReplyFormat;

/// The facts of one vendor that a check needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Vendor {
    /// Its name in kebab-case.
    pub name: &'static str,
    /// The beginning of the names of its models.
    pub models: &'static str,
    /// The daemon's default id of a motor's replies is the motor's id plus this (docs/configuration.md);
    /// `None` where all motors reply with the id 0.
    pub reply_offset: Option<u16>,
    /// The form of its replies.
    pub reply: ReplyFormat,
    /// The simulator's command that raises an over-voltage, by the vendor's number.
    pub over_voltage: &'static str,
    /// The simulator's command that raises an over-current, by the vendor's number.
    pub over_current: &'static str,
}

/// All supported vendors. The first one is that of unknown models.
pub const VENDORS: &[Vendor] = &[
    // MIT document 1.1: the whole first byte is the id.
    Vendor {
        name: "steadywin",
        models: "GIM",
        reply_offset: Some(0x100),
        reply: ReplyFormat::STEADYWIN,
        over_voltage: "fault 0x02",
        over_current: "fault 0x40",
    },
    // DM_CAN.py: four bits of the id below an error code, two temperatures at the end, and the
    // error in every reply.
    Vendor {
        name: "damiao",
        models: "DM-",
        reply_offset: Some(0x10),
        reply: ReplyFormat { id_mask: 0x0F, length: 8, report: None, registers: true },
        over_voltage: "fault 0x08",
        over_current: "fault 0x0A",
    },
    // SampleProgram, RS00 manual: a temperature of two bytes at the end, and 17 bits of faults
    // after the id of a report.
    Vendor {
        name: "robstride",
        models: "RS",
        reply_offset: Some(0x40),
        reply: ReplyFormat { id_mask: 0xFF, length: 8, report: Some(4), registers: false },
        over_voltage: "fault 0x08",
        over_current: "fault 0x10000",
    },
    // AK manual 1.0.8, pages 48 to 50; DFKI's driver: all motors reply with the id 0, and a temperature and
    // an error code end every reply. Seven bytes 0xFF and 0xFB are a control frame to them.
    Vendor {
        name: "cubemars",
        models: "AK",
        reply_offset: None,
        reply: ReplyFormat { id_mask: 0xFF, length: 8, report: None, registers: false },
        over_voltage: "fault 0x03",
        over_current: "fault 0x02",
    },
    // MyActuator's protocol document V4.2: MIT only by the fields of its motion mode.
    Vendor {
        name: "myactuator",
        models: "X",
        reply_offset: Some(0x500),
        reply: ReplyFormat { id_mask: 0xFF, length: 8, report: None, registers: false },
        over_voltage: "fault 0x08",
        over_current: "fault 0x10",
    },
    // ODrive's drives speak no MIT. The simulator numbers their faults as SteadyWin's.
    Vendor {
        name: "odrive",
        models: "ODrive-",
        reply_offset: Some(0x100),
        reply: ReplyFormat { id_mask: 0xFF, length: 8, report: None, registers: false },
        over_voltage: "fault 0x02",
        over_current: "fault 0x40",
    },
];

impl Vendor {
    /// Returns the vendor with this name.
    ///
    /// # Panics
    ///
    /// When [`VENDORS`] has no such name: a robot with its motors could not be checked.
    #[must_use]
    pub fn named(name: &str) -> &'static Self {
        let named = VENDORS.iter().find(|vendor| vendor.name == name);
        named.unwrap_or_else(|| panic!("the checker does not know the vendor {name}"))
    }

    /// Returns the vendor of a motor's model, and the first vendor for an unknown model.
    #[must_use]
    pub fn of_model(model: &str) -> &'static Self {
        VENDORS.iter().find(|vendor| model.starts_with(vendor.models)).unwrap_or(&VENDORS[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::ranges::Ranges;

    #[test]
    fn replies_of_each_vendor_have_their_form() {
        let ranges = Ranges::steadywin(30.0);
        let read = |vendor: &str, payload: &[u8]| Vendor::named(vendor).reply.read(payload, 1, &ranges);
        assert!(read("steadywin", &[1, 0x80, 0, 0x80, 8, 0]).is_some());
        assert!(read("damiao", &[0x11, 0x80, 0, 0x80, 8, 0, 25, 25]).is_some());
        assert_eq!(read("steadywin", &[2, 0x80, 0, 0x80, 8, 0]), None);
        assert_eq!(read("steadywin", &[1, 0x80, 0, 0x80, 8, 0, 25, 25]), None);
        assert_eq!(read("steadywin", &[1, 0x80, 0, 0, 0, 0]), None);
        assert_eq!(read("damiao", &[0x12, 0x80, 0, 0x80, 8, 0, 25, 25]), None);
        assert!(read("robstride", &[1, 0x80, 0, 0x80, 8, 0, 1, 0]).is_some());
        assert_eq!(read("robstride", &[1, 0, 0, 1, 0, 0, 0, 0]), None, "fault 16");
    }

    #[test]
    fn unknown_model_has_first_vendor() {
        assert_eq!(Vendor::of_model("DM-J4310-2EC").name, "damiao");
        assert_eq!(Vendor::of_model("RS01").name, "robstride");
        assert_eq!(Vendor::of_model("").name, "steadywin");
    }
}
