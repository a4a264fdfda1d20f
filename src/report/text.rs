//! Numbers as people read them.

use crate::report::record::{Measured, Suite, Summary, Unit};

/// A value in its unit, to three significant digits.
pub fn value(x: f64, unit: Unit) -> String {
    match unit {
        Unit::Seconds if x != 0.0 && x.abs() < 1e-3 => format!("{} us", digits(x * 1e6)),
        Unit::Seconds if x.abs() < 0.1 => format!("{} ms", digits(x * 1e3)),
        Unit::Seconds => format!("{} s", digits(x)),
        Unit::Share => format!("{} %", digits(100.0 * x)),
        Unit::RaysPerSecond => format!("{} Mrays/s", digits(x / 1e6)),
        Unit::Bytes => {
            let scales = [(1u64 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")];
            let (scale, name) = scales.into_iter().find(|(s, _)| x >= *s as f64).unwrap_or((1, "B"));
            format!("{} {name}", digits(x / scale as f64))
        }
        Unit::Count => count(x),
        Unit::Plain => digits(x),
    }
}

/// A round value beside an axis: as short as it can be.
pub fn tick(x: f64, unit: Unit) -> String {
    let text = value(x, unit);
    let (number, name) = text.split_once(' ').map_or((text.as_str(), ""), |(n, u)| (n, u));
    let short = match number.split_once('.') {
        Some(_) if !number.contains('e') => number.trim_end_matches('0').trim_end_matches('.'),
        _ => number,
    };
    format!("{short} {name}").trim_end().to_string()
}

/// Three significant digits; scientific where that is shorter to read.
fn digits(x: f64) -> String {
    let size = x.abs();
    if size == 0.0 {
        return "0".into();
    }
    if !(1e-3..1e6).contains(&size) {
        return format!("{x:.1e}");
    }
    let decimals = (2 - size.log10().floor() as i32).max(0) as usize;
    format!("{x:.decimals$}")
}

/// A whole number in groups of three digits.
fn count(x: f64) -> String {
    // A median of two counts may lie between them.
    if (x.fract() != 0.0 && x.abs() < 100.0) || x.abs() >= 1e15 {
        return digits(x);
    }
    let plain = format!("{:.0}", x.abs());
    let mut text = String::new();
    for (k, c) in plain.chars().enumerate() {
        if k > 0 && (plain.len() - k) % 3 == 0 {
            text.push(',');
        }
        text.push(c);
    }
    if x < 0.0 { format!("-{text}") } else { text }
}

/// Median, and the range where there is one.
pub fn samples(samples: &[f64], unit: Unit) -> String {
    let Some(s) = Summary::of(samples) else { return "-".into() };
    let median = value(s.median, unit);
    let (low, high) = (value(s.low, unit), value(s.high, unit));
    if low == high {
        return median;
    }
    // The unit once, where it is the same.
    let name = |text: &str| text.split_once(' ').map(|t| t.1.to_string());
    let same = name(&low) == name(&median) && name(&high) == name(&median);
    let bare =
        |text: &str| if same { text.split(' ').next().unwrap_or(text).to_string() } else { text.to_string() };
    format!("{median} ({} to {})", bare(&low), bare(&high))
}

/// Median and range of a quantity.
pub fn measured(m: &Measured) -> String {
    samples(&m.samples, m.unit)
}

/// The command line, as one would type it.
pub fn command(suite: &Suite) -> String {
    let mut words = suite.machine.command.iter();
    let program = words.next().map_or("twopass", |p| p.rsplit('/').next().unwrap_or(p));
    let quoted = |w: &String| if w.contains([' ', '"', '\'']) { format!("{w:?}") } else { w.clone() };
    std::iter::once(program.to_string()).chain(words.map(quoted)).collect::<Vec<_>>().join(" ")
}

/// Where and when a suite ran, in one sentence.
pub fn machine(suite: &Suite) -> String {
    let m = &suite.machine;
    let versions: Vec<String> = m.versions.iter().map(|(name, v)| format!("{name} {v}")).collect();
    format!("{}, {} of {} threads, {}; {}", m.cpu, m.threads, m.cores, m.date, versions.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_their_units() {
        let cases = [
            (0.92, Unit::Seconds, "0.920 s"),
            (0.0231, Unit::Seconds, "23.1 ms"),
            (2e-5, Unit::Seconds, "20.0 us"),
            (0.0142, Unit::Share, "1.42 %"),
            (-0.000_012, Unit::Share, "-0.00120 %"),
            (15.46e6, Unit::RaysPerSecond, "15.5 Mrays/s"),
            (1536.0, Unit::Bytes, "1.50 KiB"),
            (12.0, Unit::Bytes, "12.0 B"),
            (1_234_567.0, Unit::Count, "1,234,567"),
            (16.0, Unit::Count, "16"),
            (16.5, Unit::Count, "16.5"),
            (2_193_463.4, Unit::Count, "2,193,463"),
            (0.731, Unit::Plain, "0.731"),
            (3.2e-9, Unit::Plain, "3.2e-9"),
            (0.0, Unit::Plain, "0"),
        ];
        for (x, unit, text) in cases {
            assert_eq!(value(x, unit), text);
        }
        assert_eq!(tick(0.05, Unit::Share), "5 %");
        assert_eq!(tick(100.0, Unit::Count), "100");
        assert_eq!(tick(1.0, Unit::Plain), "1");
        assert_eq!(tick(1e-8, Unit::Plain), "1.0e-8");
        assert_eq!(samples(&[1.0, 3.0, 2.0], Unit::Plain), "2.00 (1.00 to 3.00)");
        assert_eq!(samples(&[1.0], Unit::Plain), "1.00");
        assert_eq!(samples(&[0.5, 0.05, 0.6], Unit::Seconds), "0.500 s (50.0 ms to 0.600 s)");
        assert_eq!(samples(&[0.015, 0.011, 0.019], Unit::Share), "1.50 % (1.10 to 1.90)");
    }
}
