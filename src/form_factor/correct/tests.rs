use super::*;
use crate::sampling::seed_of;

/// A matrix of numbers without standard errors.
fn dense(areas: &[f64], rows: &[&[f64]], escaped: &[f64]) -> Factors {
    let n = areas.len();
    let mut factors = Factors {
        by_object: true,
        names: (0..n).map(|k| format!("s{k}")).collect(),
        object: (0..n as u32).collect(),
        areas: areas.to_vec(),
        emissivity: vec![1.0; n],
        rows: 0..n,
        start: vec![0],
        columns: Vec::new(),
        values: Vec::new(),
        errors: Vec::new(),
        escaped: escaped.to_vec(),
        absorbed: vec![0.0; n],
        rays: 0,
        seconds: 0.0,
        written: "raw",
    };
    for row in rows {
        for (j, v) in row.iter().enumerate().filter(|(_, v)| **v > 0.0) {
            factors.columns.push(j as u32);
            factors.values.push(*v);
        }
        factors.start.push(factors.columns.len());
    }
    factors
}

fn at(f: &Factors, i: usize, j: usize) -> f64 {
    let (columns, values, _) = f.row(i);
    columns.iter().position(|c| *c as usize == j).map_or(0.0, |k| values[k])
}

fn assert_obeys(f: &Factors, enforce: Enforce) {
    for i in 0..f.nodes() {
        let (columns, values, _) = f.row(i);
        for (j, v) in columns.iter().zip(values) {
            let (there, back) = (f.areas[i] * v, f.areas[*j as usize] * at(f, *j as usize, i));
            assert!(*v >= 0.0 && (there - back).abs() <= 1e-14 * there, "{i} {j}: {there} {back}");
        }
        let sum: f64 = values.iter().sum::<f64>() + f.escaped[i] + f.absorbed[i];
        assert!(enforce == Enforce::Reciprocity || (sum - 1.0).abs() < 1e-11, "row {i}: {sum}");
    }
}

/// A random number in [0, 1).
fn random(a: u32, b: u32) -> f64 {
    f64::from(seed_of(&[a, b, 9])) / f64::from(u32::MAX)
}

/// An exact closed matrix with these areas: product form `G_ij = p_i p_j`, with `p_i sum p = A_i`.
fn exact(areas: &[f64]) -> Vec<Vec<f64>> {
    let whole: f64 = areas.iter().sum();
    areas.iter().map(|_| areas.iter().map(|a| a / whole).collect()).collect()
}

#[test]
fn exact_matrices_stay() {
    let areas = [1.0, 2.0, 0.25, 4.0];
    let rows = exact(&areas);
    let rows: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
    for enforce in [Enforce::Reciprocity, Enforce::Closure] {
        let mut f = dense(&areas, &rows, &[0.0; 4]);
        let report = correct(&mut f, enforce).unwrap();
        assert!(report.largest_move < 1e-15, "{report:?}");
        assert_obeys(&f, enforce);
    }
}

/// Noise of 30 % comes nearer to the truth, in closed and open enclosures.
#[test]
fn noise_is_lessened() {
    let n = 24;
    let areas: Vec<f64> = (0..n).map(|i| 0.1 + random(i, 1)).collect();
    for open in [0.0, 0.3] {
        let truth: Vec<Vec<f64>> =
            exact(&areas).iter().map(|r| r.iter().map(|f| (1.0 - open) * f).collect()).collect();
        let noisy: Vec<Vec<f64>> = truth
            .iter()
            .enumerate()
            .map(|(i, row)| {
                row.iter()
                    .enumerate()
                    .map(|(j, f)| f * (0.7 + 0.6 * random(i as u32, 100 + j as u32)))
                    .collect()
            })
            .collect();
        let rows: Vec<&[f64]> = noisy.iter().map(Vec::as_slice).collect();
        let raw = dense(&areas, &rows, &vec![open; n as usize]);
        let rms = |f: &Factors| {
            let squares = (0..n as usize)
                .flat_map(|i| (0..n as usize).map(move |j| (i, j)))
                .map(|(i, j)| (at(f, i, j) - truth[i][j]).powi(2));
            (squares.sum::<f64>() / f64::from(n * n)).sqrt()
        };
        for enforce in [Enforce::Reciprocity, Enforce::Closure] {
            let mut f = raw.clone();
            let report = correct(&mut f, enforce).unwrap();
            assert_obeys(&f, enforce);
            eprintln!("open {open}: rms {:.2e} from {:.2e}, {report:?}", rms(&f), rms(&raw));
            // Two independent estimates of one number: their mean has 0.71 of the error.
            assert!(rms(&f) < 0.85 * rms(&raw));
            assert!(report.rms_move > 0.0 && report.largest_move < 0.1 && report.iterations < 10);
        }
    }
}

#[test]
fn what_cannot_close_is_named_and_left_alone() {
    // Two plates that see each other alone must have one area.
    let raw = dense(&[1.0, 2.0], &[&[0.0, 1.0], &[1.0, 0.0]], &[0.0; 2]);
    let mut f = raw.clone();
    let error = correct(&mut f, Enforce::Closure).unwrap_err().to_string();
    assert!(error.contains("s0") && error.contains("--enforce reciprocity"), "{error}");
    assert_eq!(f, raw);
    // With a way out they close.
    let mut f = dense(&[1.0, 2.0], &[&[0.0, 0.9], &[0.5, 0.0]], &[0.1, 0.5]);
    correct(&mut f, Enforce::Closure).unwrap();
    assert_obeys(&f, Enforce::Closure);
    // A surface that sees nothing at all has no sum to scale.
    let mut f = dense(&[1.0, 1.0, 1.0], &[&[0.0, 1.0, 0.0], &[1.0, 0.0, 0.0], &[0.0; 3]], &[0.0; 3]);
    assert!(correct(&mut f, Enforce::Closure).unwrap_err().to_string().contains("s2"));
}

/// Of a closed matrix with a lamp, whose factors are exact, and estimates with noise of 10 % that say so; the first two
/// nodes are the lamp's. `stray` is what the lamp's own factors miss.
fn with_a_lamp(n: usize, stray: f64) -> Factors {
    let areas: Vec<f64> = (0..n as u32).map(|i| 0.1 + random(i, 1)).collect();
    let lamp = |i: usize, j: usize| i < 2 || j < 2;
    let rows: Vec<Vec<f64>> = exact(&areas)
        .iter()
        .enumerate()
        .map(|(i, row)| {
            let noise = |j: usize| match lamp(i, j) {
                true => 1.0 + stray,
                false => 0.9 + 0.2 * random(i as u32, 100 + j as u32),
            };
            row.iter().enumerate().map(|(j, f)| f * noise(j)).collect()
        })
        .collect();
    let slices: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
    let mut factors = dense(&areas, &slices, &vec![0.0; n]);
    for (i, row) in rows.iter().enumerate() {
        factors.errors.extend(row.iter().enumerate().map(|(j, f)| if lamp(i, j) { 0.0 } else { 0.06 * f }));
    }
    factors
}

#[test]
fn exact_factors_stay_where_estimates_can_close_the_rows() {
    let n = 24;
    let raw = with_a_lamp(n, 0.0);
    let mut f = raw.clone();
    let report = correct(&mut f, Enforce::Closure).unwrap();
    assert_obeys(&f, Enforce::Closure);
    assert!(report.closure_before > 1e-3 && report.largest_move > 1e-4, "{report:?}");
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))).filter(|(i, j)| *i < 2 || *j < 2) {
        let (before, after) = (at(&raw, i, j), at(&f, i, j));
        assert!((after - before).abs() <= 1e-9 * before, "{i} {j}: {before} {after}");
    }
    assert_eq!(report.exact_factors, 2 * n + 2 * (n - 2));
    assert!(report.largest_relative_move_of_exact < 1e-9, "{report:?}");
    assert!(report.rms_move_in_standard_errors < Some(3.0), "{report:?}");
    assert!(report.largest_move_in_standard_errors < Some(10.0), "{report:?}");
    assert!(!report.line().contains("without standard errors"), "{}", report.line());
}

/// A lamp's rows, of exact factors alone, that do not close: they move by what they miss, and their errors say so.
#[test]
fn exact_factors_move_where_nothing_else_can() {
    let n = 24;
    let raw = with_a_lamp(n, 1e-3);
    let mut f = raw.clone();
    let report = correct(&mut f, Enforce::Closure).unwrap();
    assert_obeys(&f, Enforce::Closure);
    for (k, entry) in (f.start[0]..f.start[1]).enumerate() {
        let (before, after, error) = (at(&raw, 0, k), f.values[entry], f.errors[entry]);
        let moved = (after - before).abs();
        assert!(moved < 3e-2 * before && error >= (1.0 - 1e-9) * moved, "{k}: {before} {after} +- {error}");
    }
    assert!(report.largest_relative_move_of_exact > 1e-4, "{report:?}");
    assert!(report.line().contains("without standard errors"), "{}", report.line());
    assert!(report.rms_move_in_standard_errors < Some(3.0), "{report:?}");
    // No error is said to be smaller than before.
    for (k, error) in raw.errors.iter().enumerate() {
        let (i, j) = (k / n, k % n);
        assert!(i.min(j) > 1 || f.errors[k] >= *error, "{i} {j}");
    }
}

/// Rows of integrals that are a thousand times as good as those beside them, and fall as little short of their sums: their multipliers are large.
#[test]
fn precise_rows_close_beside_noisy_ones() {
    let mut raw = with_a_lamp(24, -1e-4);
    for (k, error) in raw.errors.iter_mut().enumerate().filter(|(_, e)| **e == 0.0) {
        *error = if k % 3 == 0 { 1e-5 * raw.values[k] } else { 0.0 };
    }
    let report = correct(&mut raw, Enforce::Closure).unwrap();
    assert_obeys(&raw, Enforce::Closure);
    assert!(report.largest_relative_move_of_exact < 1e-2, "{report:?}");
}

/// Pairs are one estimate for both directions, and no better for being written twice.
#[test]
fn one_estimate_for_both_directions_keeps_its_error() {
    let mut f = dense(&[1.0, 2.0], &[&[0.0, 0.5], &[0.25, 0.0]], &[0.5, 0.75]);
    f.errors = vec![0.01, 0.005];
    correct(&mut f, Enforce::Reciprocity).unwrap();
    assert_eq!(f.errors, [0.01, 0.005]);
    // Randomisations that agree by chance in both directions are not exact.
    let mut f = dense(&[1.0, 1.0], &[&[0.0, 0.5], &[0.52, 0.0]], &[0.5, 0.48]);
    f.errors = vec![0.0, 0.0];
    correct(&mut f, Enforce::Reciprocity).unwrap();
    assert!((f.errors[0] - 0.01).abs() < 1e-12, "{:?}", f.errors);
    // Two that differ are better together.
    let mut f = dense(&[1.0, 1.0], &[&[0.0, 0.5], &[0.51, 0.0]], &[0.5, 0.49]);
    f.errors = vec![0.01, 0.01];
    correct(&mut f, Enforce::Reciprocity).unwrap();
    assert!((f.errors[0] - 0.01 / 2f64.sqrt()).abs() < 1e-4, "{:?}", f.errors);
}
