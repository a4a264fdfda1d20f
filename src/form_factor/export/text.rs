//! CSV, JSON and View3D's format.

use super::Factors;
use crate::form_factor::ObjectTable;
use crate::{Error, Result};
use serde::Serialize;
use std::fmt::Write;

/// Long form, with a header; one line a pair. Objects: `from,to,area_from,form_factor,standard_error` with names, and a line
/// to `(escaped)` and `(absorbed)` for what lands on no object. Elements: `from,to,from_object,to_object,...` with
/// numbers, pairs above zero only, and -1 for what lands on no element. The standard error is left empty where there is none.
///
/// A table of objects in pandas: `read_csv("F.csv").pivot(index="from", columns="to", values="form_factor")`.
pub fn to_csv(factors: &Factors) -> Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let mut write = || -> std::result::Result<(), csv::Error> {
        let tail = ["area_from", "form_factor", "standard_error"];
        let objects = if factors.by_object { &[][..] } else { &["from_object", "to_object"] };
        csv.write_record(["from", "to"].iter().chain(objects).chain(&tail))?;
        let name = |node: usize| factors.names[factors.object[node] as usize].as_str();
        let mut line = |node: usize, to: (&str, &str), value: f64, error: Option<f64>| {
            let from = if factors.by_object { name(node).to_string() } else { node.to_string() };
            let mut fields = vec![from, to.0.to_string()];
            if !factors.by_object {
                fields.extend([name(node).to_string(), to.1.to_string()]);
            }
            let error = error.map(|e| e.to_string()).unwrap_or_default();
            fields.extend([factors.areas[node].to_string(), value.to_string(), error]);
            csv.write_record(&fields)
        };
        for (k, node) in factors.rows.clone().enumerate() {
            let (columns, values, errors) = factors.row(k);
            for (i, (j, value)) in columns.iter().zip(values).enumerate() {
                let to = name(*j as usize);
                let number = j.to_string();
                let to = (if factors.by_object { to } else { &number }, to);
                line(node, to, *value, errors.map(|e| e[i]))?;
            }
            for (what, share) in [("(escaped)", factors.escaped[k]), ("(absorbed)", factors.absorbed[k])] {
                if factors.by_object || share > 0.0 {
                    line(node, (if factors.by_object { what } else { "-1" }, what), share, None)?;
                }
            }
        }
        Ok(())
    };
    let failed = |e: String| Error::io("table", std::io::Error::other(e));
    write().map_err(|e| failed(e.to_string()))?;
    csv.into_inner().map_err(|e| failed(e.to_string()))
}

/// Elements as JSON: sparse rows as in SciPy's CSR.
#[derive(Serialize)]
struct ElementTable<'a> {
    elements: usize,
    objects: &'a [String],
    /// Object of each element.
    object: &'a [u32],
    areas: &'a [f64],
    rows: [usize; 2],
    indptr: &'a [usize],
    indices: &'a [u32],
    form_factors: &'a [f64],
    #[serde(skip_serializing_if = "<[f64]>::is_empty")]
    standard_errors: &'a [f64],
    escaped: &'a [f64],
    absorbed: &'a [f64],
    rays: u32,
    seconds: f64,
    written: &'static str,
}

/// JSON. Objects: [`ObjectTable`] with dense rows. Elements: `objects` (names), `object` and `areas` \[elements\], and the rows
/// `rows[0]..rows[1]` in SciPy's CSR form: row k holds `indices[indptr[k]..indptr[k + 1]]` and as many of `form_factors` and
/// (where there are) `standard_errors`.
pub fn to_json(factors: &Factors) -> Result<Vec<u8>> {
    let text = if factors.by_object {
        serde_json::to_vec(&table(factors))
    } else {
        serde_json::to_vec(&ElementTable {
            elements: factors.nodes(),
            objects: &factors.names,
            object: &factors.object,
            areas: &factors.areas,
            rows: [factors.rows.start, factors.rows.end],
            indptr: &factors.start,
            indices: &factors.columns,
            form_factors: &factors.values,
            standard_errors: &factors.errors,
            escaped: &factors.escaped,
            absorbed: &factors.absorbed,
            rays: factors.rays,
            seconds: factors.seconds,
            written: factors.written,
        })
    };
    let mut text = text.map_err(|e| Error::io("table", e.into()))?;
    text.push(b'\n');
    Ok(text)
}

fn table(factors: &Factors) -> ObjectTable {
    let n = factors.nodes();
    let dense = |values: &[f64]| -> Vec<Vec<f64>> { values.chunks(n).map(<[f64]>::to_vec).collect() };
    let errors = match factors.errors.is_empty() {
        true => vec![f64::NAN; factors.values.len()],
        false => factors.errors.clone(),
    };
    ObjectTable {
        objects: factors.names.clone(),
        areas: factors.areas.clone(),
        form_factors: dense(&factors.values),
        standard_errors: dense(&errors),
        escaped: factors.escaped.clone(),
        rays: factors.rays,
        seconds: factors.seconds,
        rows: (factors.rows.len() < n).then_some([factors.rows.start, factors.rows.end]),
        written: factors.written,
    }
}

/// View3D's text format (Walton, NISTIR 6925; versions 3.x, format 0), for all rows: a header line `program version format
/// enclosure emittances surfaces` (the last four are numbers; no emittances are included in the factors), a line of areas,
/// a line of factors for each surface, and a line of emissivities. Surfaces are elements or objects in order; emissivity is 1 less the
/// material's diffuse albedo. Areas and factors have nine significant digits, with an exponent where they are small, as C's `%.9g`
/// writes and View3D's `fscanf` reads them.
///
/// The enclosure flag says that View3D was to make rows sum to 1; it is set where closure was enforced.
pub fn to_view3d(factors: &Factors) -> Vec<u8> {
    let n = factors.nodes();
    let enclosed = u8::from(factors.written == "closure");
    let mut text = format!("twopass {} 0 {enclosed} 0 {n}\n", env!("CARGO_PKG_VERSION"));
    let mut line = |values: &mut dyn Iterator<Item = f64>, write: &dyn Fn(&mut String, f64)| {
        for (k, value) in values.enumerate() {
            if k > 0 {
                text.push(' ');
            }
            write(&mut text, value);
        }
        text.push('\n');
    };
    line(&mut factors.areas.iter().copied(), &general);
    let mut dense = vec![0.0; n];
    for row in 0..factors.rows.len() {
        let (columns, values, _) = factors.row(row);
        columns.iter().zip(values).for_each(|(j, v)| dense[*j as usize] = *v);
        line(&mut dense.iter().copied(), &general);
        columns.iter().for_each(|j| dense[*j as usize] = 0.0);
    }
    line(&mut factors.emissivity.iter().copied(), &|text, value| {
        // Writing to a string does not fail.
        let _ = write!(text, "{value:.3}");
    });
    text.into_bytes()
}

/// C's `%.9g`.
fn general(text: &mut String, value: f64) {
    const DIGITS: usize = 9;
    if value == 0.0 {
        text.push('0');
        return;
    }
    // Rounded first: that may carry into another digit.
    let scientific = format!("{value:.*e}", DIGITS - 1);
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let trimmed = |number: &str| match number.contains('.') {
        true => number.trim_end_matches('0').trim_end_matches('.').to_string(),
        false => number.to_string(),
    };
    let _ = if (-4..DIGITS as i32).contains(&exponent) {
        let decimals = (DIGITS as i32 - 1 - exponent) as usize;
        write!(text, "{}", trimmed(&format!("{value:.decimals$}")))
    } else {
        let sign = if exponent < 0 { '-' } else { '+' };
        write!(text, "{}e{sign}{:02}", trimmed(mantissa), exponent.abs())
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_as_c_writes_them() {
        let cases = [
            (0.0, "0"),
            (1.0, "1"),
            (0.25, "0.25"),
            (1.0 / 3.0, "0.333333333"),
            (0.9999999999, "1"),
            (1e-4, "0.0001"),
            (0.00001234567891234, "1.23456789e-05"),
            (6.25e-14, "6.25e-14"),
            (123456789.4, "123456789"),
            (1.5e12, "1.5e+12"),
            (1e-120, "1e-120"),
        ];
        for (value, expected) in cases {
            let mut text = String::new();
            general(&mut text, value);
            assert_eq!(text, expected);
        }
    }
}
