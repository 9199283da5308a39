//! Numbers on a terminal.

/// Formats `value` with `digits` decimals, an unknown one as a dash, and a zero without a minus
/// sign.
pub fn number(value: Option<f64>, digits: usize) -> String {
    let Some(value) = value.filter(|value| value.is_finite()) else { return "-".to_owned() };
    let text = format!("{value:.digits$}");
    let is_zero = text.chars().all(|letter| matches!(letter, '-' | '0' | '.'));
    if is_zero { text.trim_start_matches('-').to_owned() } else { text }
}

/// Parses a number from `least` to `most`.
///
/// # Errors
///
/// The expected range, as text for clap.
pub fn within(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| format!("expected {least} to {most}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_code_below_zero_is_zero() {
        assert_eq!(number(Some(-0.0004), 3), "0.000");
        assert_eq!(number(Some(-0.0006), 3), "-0.001");
        assert_eq!(number(Some(f64::NAN), 3), "-");
        assert_eq!(number(None, 3), "-");
    }

    #[test]
    fn out_of_range_and_nonnumbers_are_refused() {
        assert_eq!(within("0.5", 0.5, 2.0), Ok(0.5));
        for wrong in ["0.4", "2.1", "nan", "inf", "", "1s"] {
            assert_eq!(within(wrong, 0.5, 2.0), Err("expected 0.5 to 2".to_owned()));
        }
    }
}
