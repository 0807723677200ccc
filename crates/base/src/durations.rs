//! Durations given in seconds, as text for terminal lines, estimates and pages.

/// Formats a duration for a terminal line: `42 s`, `3.1 min`, `2.5 h`.
pub fn duration(seconds: f64) -> String {
    scaled(seconds, 1)
}

/// Formats an estimate, without tenths of minutes: `42 s`, `3 min`, `2.5 h`.
pub fn rough_duration(seconds: f64) -> String {
    scaled(seconds, 0)
}

fn scaled(seconds: f64, decimals_of_minutes: usize) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.decimals_of_minutes$} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// Formats a duration for a table: `0.042 s`, `3.1 s`, `4 min 05 s`, `2 h 03 min`; a dash if it is negative or not
/// finite.
pub fn exact_duration(seconds: f64) -> String {
    let whole = seconds.round();
    match seconds {
        s if !s.is_finite() || s < 0.0 => "–".to_owned(),
        s if s < 0.1 => format!("{s:.3} s"),
        s if s < 9.95 => format!("{s:.1} s"),
        _ if whole < 60.0 => format!("{whole:.0} s"),
        _ if whole < 3600.0 => format!("{:.0} min {:02.0} s", (whole / 60.0).floor(), whole % 60.0),
        _ => {
            let minutes = (whole / 60.0).round();
            format!("{:.0} h {:02.0} min", (minutes / 60.0).floor(), minutes % 60.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_follow_the_size() {
        for (seconds, usual, rough, exact) in [
            (0.042, "0 s", "0 s", "0.042 s"),
            (3.12, "3 s", "3 s", "3.1 s"),
            (89.4, "89 s", "89 s", "1 min 29 s"),
            (245.0, "4.1 min", "4 min", "4 min 05 s"),
            (5399.0, "90.0 min", "90 min", "1 h 30 min"),
            (7380.0, "2.0 h", "2.0 h", "2 h 03 min"),
        ] {
            assert_eq!((duration(seconds), rough_duration(seconds)), (usual.to_owned(), rough.to_owned()));
            assert_eq!(exact_duration(seconds), exact);
        }
        assert_eq!((exact_duration(f64::NAN), exact_duration(-1.0)), ("–".to_owned(), "–".to_owned()));
    }
}
