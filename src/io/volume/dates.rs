//! Times that are counted from a date, as CF's units have it: "hours since 2000-01-01 06:00".
//!
//! Files of one series may each count from a date of their own. Their times are turned into those
//! of another unit, where the calendar is one whose days are counted here.

/// A date, with the seconds of its day less those of its time zone.
struct Date {
    year: i64,
    month: i64,
    day: i64,
    seconds: f64,
}

/// Factor and summand by which times in one unit become times in another: `None` where one of them
/// has no date, or the calendar is another.
pub(crate) fn conversion(from: &str, to: &str, calendar: &str) -> Option<[f64; 2]> {
    let ((own, from), (other, to)) = (parsed(from)?, parsed(to)?);
    let days = days(&from, calendar)? - days(&to, calendar)?;
    let seconds = days as f64 * 86400.0 + (from.seconds - to.seconds);
    Some([own / other, seconds / other])
}

/// The seconds of a unit, and its date.
fn parsed(text: &str) -> Option<(f64, Date)> {
    let lower = text.trim().to_ascii_lowercase();
    let (unit, date) = lower.split_once(" since ")?;
    let seconds = match unit.trim() {
        "milliseconds" | "millisecond" | "msec" | "ms" => 1e-3,
        "seconds" | "second" | "secs" | "sec" | "s" => 1.0,
        "minutes" | "minute" | "mins" | "min" => 60.0,
        "hours" | "hour" | "hrs" | "hr" | "h" => 3600.0,
        "days" | "day" | "d" => 86400.0,
        _ => return None,
    };
    Some((seconds, date_of(date.trim())?))
}

fn date_of(text: &str) -> Option<Date> {
    let (date, rest) = match text.find(['t', ' ']) {
        Some(at) => (&text[..at], text[at + 1..].trim()),
        None => (text, ""),
    };
    let parts: Vec<i64> = date.split('-').map(|word| word.parse().ok()).collect::<Option<_>>()?;
    let [year, month, day] = parts[..] else { return None };
    let good = (1..=12).contains(&month) && (1..=31).contains(&day) && (0..=99_999).contains(&year);
    good.then_some(Date { year, month, day, seconds: seconds_of(rest)? })
}

/// The seconds of "06:00:00.5", with "Z", "UTC", "+02:00" or nothing behind it.
fn seconds_of(text: &str) -> Option<f64> {
    let text = text.trim_end_matches("utc").trim_end_matches('z').trim();
    let (time, zone) = match text.rfind(['+', '-']) {
        Some(at) => (text[..at].trim(), Some((text.as_bytes()[at] == b'-', &text[at + 1..]))),
        None => (text, None),
    };
    let clock = |text: &str| -> Option<f64> {
        let words: Vec<f64> = text.split(':').map(|word| word.parse().ok()).collect::<Option<_>>()?;
        let good = words.len() <= 3 && words.iter().all(|n| (0.0..=60.0).contains(n));
        good.then(|| words.iter().zip([3600.0, 60.0, 1.0]).map(|(n, of)| n * of).sum())
    };
    let time = if time.is_empty() { 0.0 } else { clock(time)? };
    let zone = match zone {
        None => 0.0,
        Some((is_west, zone)) => clock(zone)? * if is_west { -1.0 } else { 1.0 },
    };
    Some(time - zone)
}

/// The number of a day in a calendar of CF.
fn days(date: &Date, calendar: &str) -> Option<i64> {
    let &Date { year, month, day, .. } = date;
    const BEFORE: [i64; 12] = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];
    let before = BEFORE[month as usize - 1];
    let civil = || {
        let y = if month > 2 { year } else { year - 1 };
        let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
        365 * y + y.div_euclid(4) - y.div_euclid(100) + y.div_euclid(400) + of_year
    };
    match calendar.to_ascii_lowercase().as_str() {
        // Before this date their calendar is another.
        "" | "standard" | "gregorian" => ((year, month, day) >= (1582, 10, 15)).then(civil),
        "proleptic_gregorian" => Some(civil()),
        "noleap" | "365_day" => Some(365 * year + before + day - 1),
        "all_leap" | "366_day" => Some(366 * year + before + i64::from(month > 2) + day - 1),
        "360_day" => Some(360 * year + 30 * (month - 1) + day - 1),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `cftime` has them.
    #[test]
    fn times_are_counted_from_another_date() {
        for (from, to, calendar, expected) in [
            ("hours since 2000-01-02", "hours since 2000-01-01", "", Some([1.0, 24.0])),
            ("days since 2000-03-01", "hours since 2000-02-01 00:00:00", "standard", Some([24.0, 696.0])),
            ("days since 2000-03-01", "days since 2000-02-01", "noleap", Some([1.0, 28.0])),
            ("days since 2000-03-01", "days since 2000-02-01", "360_day", Some([1.0, 30.0])),
            ("days since 1900-01-01", "days since 2000-01-01", "gregorian", Some([1.0, -36524.0])),
            ("minutes since 2000-1-1T02:00:00Z", "hours since 2000-01-01", "", Some([1.0 / 60.0, 2.0])),
            ("h since 2000-01-01 02:00 +02:00", "h since 2000-01-01 00:00 UTC", "", Some([1.0, 0.0])),
            ("days since 0001-01-01", "days since 2000-01-01", "", None),
            (
                "days since 0001-01-01",
                "days since 2000-01-01",
                "proleptic_gregorian",
                Some([1.0, -730_119.0]),
            ),
            ("months since 2000-01-01", "days since 2000-01-01", "", None),
            ("hours", "hours since 2000-01-01", "", None),
            ("hours since 2000-13-01", "hours since 2000-01-01", "", None),
            ("hours since µ", "hours since 2000-01-01", "", None),
            ("hours since 2000-01-01", "hours since 2000-01-01", "julian", None),
        ] {
            assert_eq!(conversion(from, to, calendar), expected, "{from}, {to}");
        }
    }
}
