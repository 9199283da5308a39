//! `motorctl calibrate` and `motorctl firmware-mode`.

use crate::failure::DirectFailure;
use crate::output::{Confirm, print_line};
use crate::target::{Target, parse_id};
use motord_protocol::commissioning::CALIBRATION_MAX;
use motord_protocol::gim::Calibration;
use motord_terminal::Interrupt;

/// The part that is calibrated (GIM document, Table 11).
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum CalibrationPart {
    /// The order of the phases.
    Phase,
    /// The encoder.
    Encoder,
}

/// `motorctl calibrate`.
pub(crate) fn calibrate(
    target: &Target,
    kind: CalibrationPart,
    confirm: Confirm,
) -> Result<(), DirectFailure> {
    let mut session = target.open_gim()?;
    let name = session.name();
    let (what, calibration) = match kind {
        CalibrationPart::Phase => ("the phase order", Calibration::PHASE_ORDER),
        CalibrationPart::Encoder => ("the encoder", Calibration::ENCODER),
    };
    confirm.ask(&format!(
        "This calibrates {what} of {name}. The shaft turns by itself, for up to {} s, and the result replaces the present \
         calibration. Take the load off, and make sure that the shaft is clear.",
        CALIBRATION_MAX.as_secs()
    ))?;
    let interrupt = Interrupt::register();
    let calibrated = session.gim().calibrate(calibration, &mut |elapsed| {
        eprint!("\r{:3} s of at most {} s", elapsed.as_secs(), CALIBRATION_MAX.as_secs());
        !interrupt.is_raised()
    });
    eprintln!();
    calibrated?;
    print_line(&format!("{name}: {what} calibrated"))
}

/// The options of `motorctl firmware-mode`.
#[derive(Debug, Clone, clap::Args)]
pub struct Firmware {
    #[command(flatten)]
    target: Target,
    /// Repeat the id of the motor. A motor in firmware mode needs the vendor's tool.
    #[arg(long, value_name = "ID", value_parser = parse_id, required = true)]
    repeat_id: u8,
    #[command(flatten)]
    confirm: Confirm,
}

/// `motorctl firmware-mode`.
pub(crate) fn firmware_mode(arguments: &Firmware) -> Result<(), DirectFailure> {
    if arguments.target.id.is_some_and(|id| id != arguments.repeat_id) {
        return Err(DirectFailure::Usage("--repeat-id is not the id of the motor".to_owned()));
    }
    let mut session = arguments.target.open_gim()?;
    if session.id != arguments.repeat_id {
        return Err(session.unfit("--repeat-id is another id"));
    }
    let name = session.name();
    arguments.confirm.ask(&format!(
        "This puts {name} into firmware mode. It leaves the bus, answers nothing, and needs the vendor's tool; no document says whether a power cycle ends this mode."
    ))?;
    session.gim().enter_firmware_mode()?;
    print_line(&format!("{name}: in firmware mode; it answers nothing now"))
}

/// `motorctl pts`: the vendor's document lists the command as not supported.
pub(crate) fn pts() -> Result<(), DirectFailure> {
    let reason = "PTS (position/torque/speed) control: \"Not supported.\" (GIM document 3.2.10); nothing was sent. Use torque, speed or position";
    Err(DirectFailure::Usage(reason.to_owned()))
}
