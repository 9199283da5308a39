//! Units that people write: the quantity of each, and its size.

use std::f64::consts::{PI, TAU};

/// The quantity of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quantity {
    Time,
    Frequency,
    BitRate,
    Angle,
    Velocity,
    Torque,
    TorqueConstant,
    Stiffness,
    Damping,
    Inertia,
    Temperature,
    Share,
}

impl Quantity {
    const fn name(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Frequency => "frequency",
            Self::BitRate => "bit rate",
            Self::Angle => "angle",
            Self::Velocity => "angular velocity",
            Self::Torque => "torque",
            Self::TorqueConstant => "torque constant",
            Self::Stiffness => "stiffness",
            Self::Damping => "damping",
            Self::Inertia => "inertia",
            Self::Temperature => "temperature",
            Self::Share => "share",
        }
    }
}

/// A unit and its spellings without signs between letters.
#[derive(Debug, PartialEq)]
pub(super) struct Unit {
    quantity: Quantity,
    /// As it is shown.
    name: &'static str,
    spellings: &'static [&'static str],
    /// Its size in the first unit of the quantity.
    size: f64,
    /// Its zero in the first unit of the quantity.
    zero: f64,
}

const fn unit(quantity: Quantity, name: &'static str, spellings: &'static [&'static str], size: f64) -> Unit {
    Unit { quantity, name, spellings, size, zero: 0.0 }
}

use Quantity::{
    Angle, BitRate, Damping, Frequency, Inertia, Share, Stiffness, Temperature, Time, Torque, TorqueConstant,
    Velocity,
};

static UNITS: [Unit; 40] = [
    unit(Time, "s", &["s", "sec", "secs", "second", "seconds"], 1.0),
    unit(Time, "ms", &["ms", "msec", "millis", "millisecond", "milliseconds"], 1e-3),
    unit(Time, "µs", &["µs", "μs", "us", "usec", "micros", "microseconds"], 1e-6),
    unit(Time, "ns", &["ns", "nsec", "nanoseconds"], 1e-9),
    unit(Frequency, "Hz", &["hz", "hertz"], 1.0),
    unit(Frequency, "kHz", &["khz"], 1e3),
    unit(Frequency, "MHz", &["mhz"], 1e6),
    unit(BitRate, "bit/s", &["bits", "bit", "bps", "baud", "bd"], 1.0),
    unit(BitRate, "kbit/s", &["kbits", "kbit", "kbps", "kbaud", "kbd"], 1e3),
    unit(BitRate, "Mbit/s", &["mbits", "mbit", "mbps", "mbaud", "mbd"], 1e6),
    unit(Angle, "rad", &["rad", "rads", "radian", "radians"], 1.0),
    unit(Angle, "mrad", &["mrad"], 1e-3),
    unit(Angle, "°", &["°", "deg", "degs", "degree", "degrees"], PI / 180.0),
    unit(Angle, "turns", &["turn", "turns", "rev", "revs", "rotations"], TAU),
    unit(Velocity, "rad/s", &["rads", "radsec"], 1.0),
    unit(Velocity, "°/s", &["°s", "degs", "dps", "degsec"], PI / 180.0),
    unit(Velocity, "rpm", &["rpm", "revmin", "umin"], TAU / 60.0),
    unit(Velocity, "turns/s", &["rps", "revs", "turns", "hz"], TAU),
    unit(Torque, "N·m", &["nm", "newtonmeters"], 1.0),
    unit(Torque, "mN·m", &["mnm"], 1e-3),
    unit(Torque, "N·cm", &["ncm"], 1e-2),
    unit(Torque, "kN·m", &["knm"], 1e3),
    unit(Torque, "kgf·cm", &["kgcm", "kgfcm"], 0.098_066_5),
    unit(Torque, "kgf·m", &["kgm", "kgfm"], 9.806_65),
    unit(Torque, "lbf·ft", &["lbft", "lbfft", "ftlb"], 1.355_818),
    unit(Torque, "ozf·in", &["ozin", "ozfin"], 0.007_061_552),
    unit(TorqueConstant, "N·m/A", &["nma"], 1.0),
    unit(TorqueConstant, "mN·m/A", &["mnma"], 1e-3),
    unit(Stiffness, "N·m/rad", &["nmrad"], 1.0),
    unit(Stiffness, "N·m/°", &["nmdeg", "nm°"], 180.0 / PI),
    unit(Damping, "N·m·s/rad", &["nmsrad"], 1.0),
    unit(Damping, "N·m·s/°", &["nmsdeg", "nms°"], 180.0 / PI),
    unit(Inertia, "kg·m²", &["kgm2", "kgm²"], 1.0),
    unit(Inertia, "kg·cm²", &["kgcm2", "kgcm²"], 1e-4),
    unit(Inertia, "g·cm²", &["gcm2", "gcm²"], 1e-7),
    unit(Temperature, "°C", &["°c", "c", "celsius", "degc"], 1.0),
    Unit { zero: -273.15, ..unit(Temperature, "K", &["k", "kelvin"], 1.0) },
    Unit { zero: -32.0 / 1.8, ..unit(Temperature, "°F", &["°f", "f", "fahrenheit", "degf"], 1.0 / 1.8) },
    unit(Share, "%", &["%", "percent", "pct"], 1.0),
    unit(Share, "‰", &["‰", "permille"], 0.1),
];

impl Unit {
    /// Returns the unit of the keys that is written as `name` in their table.
    pub(super) fn of_key(name: &str) -> Option<&'static Self> {
        UNITS.iter().find(|unit| unit.name == name)
    }

    /// Returns the unit with this spelling that measures the same as `self`, or any other.
    pub(super) fn spelt(&self, text: &str) -> Option<&'static Self> {
        let same = UNITS.iter().find(|unit| unit.quantity == self.quantity && unit.is_spelt(text));
        same.or_else(|| UNITS.iter().find(|unit| unit.is_spelt(text)))
    }

    fn is_spelt(&self, text: &str) -> bool {
        let text = text.to_lowercase().replace("-per-", "");
        let letters: String = text.chars().filter(|letter| !"·*/.^-_ ".contains(*letter)).collect();
        self.spellings.contains(&letters.as_str())
    }

    /// Converts a value of the unit `from`; `None` for one of another quantity.
    pub(super) fn convert(&self, value: f64, from: &Self) -> Option<f64> {
        let base = value * from.size + from.zero;
        (self.quantity == from.quantity).then(|| (base - self.zero) / self.size)
    }

    /// `30 rpm`, `3°`.
    pub(super) fn with(&self, value: &str) -> String {
        let space = if self.name.starts_with('°') || self.name == "%" { "" } else { " " };
        format!("{value}{space}{}", self.name)
    }

    /// The name of its quantity.
    pub(super) const fn quantity(&self) -> &'static str {
        self.quantity.name()
    }

    pub(super) const fn name(&self) -> &'static str {
        self.name
    }
}

/// A number as people write it.
#[derive(Debug, PartialEq)]
pub(super) enum Reading {
    /// No number is at the begin of the text.
    None,
    /// In the unit of the key, as it is written in a file.
    Number(String),
    /// The text after the number is no unit of the key.
    Foreign(String),
}

/// Reads a number with an own unit or base, for a key with the unit `unit`: 1000 of `1 s` in ms.
pub(super) fn reading(text: &str, unit: &str, is_integer: bool) -> Reading {
    let text = text.trim();
    if let Some(number) = is_integer.then(|| in_base(text)).flatten() {
        return Reading::Number(number);
    }
    let (value, rest) = match pi(text) {
        Some((value, rest)) if unit == "rad" => (value, rest),
        _ => match decimal(text) {
            Some(read) => read,
            None => return Reading::None,
        },
    };
    match in_unit(value, rest, unit) {
        Some(value) if is_integer && value.fract() != 0.0 => Reading::None,
        Some(value) => Reading::Number(short(value)),
        None => Reading::Foreign(rest.to_owned()),
    }
}

/// Converts a value with the text `rest` after it.
fn in_unit(value: f64, rest: &str, unit: &str) -> Option<f64> {
    let own = Unit::of_key(unit);
    let converted = own.and_then(|own| own.convert(value, own.spelt(rest)?));
    match rest {
        "" => Some(value),
        "k" if !unit.is_empty() => converted.or(Some(1e3 * value)),
        "M" if !unit.is_empty() => Some(1e6 * value),
        _ => converted.map(round),
    }
}

/// Without the rounding errors of a conversion.
fn round(value: f64) -> f64 {
    let whole = value.round();
    if (value - whole).abs() < 1e-9 * whole.abs().max(1.0) { whole } else { value }
}

/// `0x10` of `10h` or `0X10`, 3 of `0b11`, 15 of `0o17`.
fn in_base(text: &str) -> Option<String> {
    let lower = text.to_ascii_lowercase();
    let is_digits = |digits: &&str| digits.chars().all(|digit| digit.is_ascii_alphanumeric());
    let of = |digits: &str, radix| i64::from_str_radix(Some(digits).filter(is_digits)?, radix).ok();
    if let Some(digits) = lower.strip_prefix("0x") {
        return of(digits, 16).map(|_| format!("0x{}", &text[2..]));
    }
    if let Some(digits) = lower.strip_suffix('h') {
        // Other texts end with `h`, too: `each`.
        let is_number = digits.starts_with(|digit: char| digit.is_ascii_digit());
        return of(digits, 16).filter(|_| is_number).map(|value| format!("{value:#x}"));
    }
    let binary = lower.strip_prefix("0b").and_then(|digits| of(digits, 2));
    binary.or_else(|| of(lower.strip_prefix("0o")?, 8)).map(|value| value.to_string())
}

/// Splits a text into the number at its begin, with a point or a comma, and the rest.
fn decimal(text: &str) -> Option<(f64, &str)> {
    let end = text.find(|c: char| !(c.is_ascii_digit() || "+-.,".contains(c))).unwrap_or(text.len());
    let value = text[..end].replace(',', ".").parse::<f64>().ok()?;
    Some((value, text[end..].trim())).filter(|(value, _)| value.is_finite())
}

/// `pi`, `-pi/2`, `π / 4`.
fn pi(text: &str) -> Option<(f64, &str)> {
    let (sign, rest) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
    let rest = rest.strip_prefix("pi").or_else(|| rest.strip_prefix('π'))?.trim();
    let Some(divisor) = rest.strip_prefix('/') else { return Some((sign * PI, rest)) };
    let (divisor, rest) = decimal(divisor.trim())?;
    (divisor > 0.0).then(|| (sign * PI / divisor, rest))
}

/// A number with four decimals at most; smaller ones have three digits.
pub(super) fn short(value: f64) -> String {
    let size = value.abs();
    if size >= 1e15 || (size > 0.0 && size < 1e-6) {
        return format!("{value:e}");
    }
    let decimals = if size > 0.0 && size < 0.01 { 2 - size.log10().floor() as i32 } else { 4 };
    let text = format!("{value:.*}", usize::try_from(decimals).unwrap_or(4));
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// A number of an error; a long one with an exponent.
pub(super) struct Shown(pub(super) f64);

impl std::fmt::Display for Shown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0.abs() >= 1e15 && self.0.is_finite() {
            true => write!(f, "{:e}", self.0),
            false => write!(f, "{}", self.0),
        }
    }
}
