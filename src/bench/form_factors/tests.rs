//! Values, on small sweeps.

use super::cases::named;
use super::*;
use crate::bench::Settings;
use crate::embree::Device;

/// Runs `test` with a context of a quick run on one thread.
fn with_context(test: impl FnOnce(&Context)) {
    let settings = Settings { quick: true, seed: 0, cache: "unused".into(), program: None, foreign: None };
    let device = Device::new(1).expect("Embree");
    test(&Context { settings: &settings, device: &device, observer: &|_| () });
}

/// Factors by a method, and the answer.
fn found(context: &Context, name: &str, method: Method, setting: u32) -> (Configuration, Truth, Factors) {
    let configuration = named(context, name).expect("a configuration");
    let visibility = Visibility::new(context.device, &configuration.scene).expect("a tree");
    let truth = Truth::new(&visibility, &configuration).expect("an answer");
    let factors = method.find(context, &configuration, setting, 1).expect("factors").0;
    (configuration, truth, factors)
}

/// Unit squares at distance 1 (Howell C-11: 0.1998249) and at right angles (C-14: 0.2000438): what the answers' rows sum
/// to, over the squares, and slivers too.
#[test]
fn answers_are_the_closed_forms() {
    with_context(|context| {
        for (name, exact) in
            [("parallel", 0.199_824_895), ("right-angle", 0.200_043_776), ("slivers", 0.200_043_776)]
        {
            let (configuration, truth, _) = found(context, name, Method::Exact, 3);
            let mesh = &configuration.mesh;
            let sum: f64 =
                (0..mesh.len()).map(|e| mesh.area(e as u32) * truth.sum(e).expect("every row is held")).sum();
            // Both squares' rows, of area 1 each.
            assert!((0.5 * sum - exact).abs() < 2e-8, "{name}: {}", 0.5 * sum);
        }
    });
}

/// Between spheres: all that leaves the inner one lands on the outer one; rows of both sum to 1; by reciprocity a quarter, about,
/// of what leaves the outer facets lands on the inner ones (the ratio of the facets' areas is that of the spheres').
#[test]
fn spheres_close() {
    with_context(|context| {
        let (configuration, truth, factors) = found(context, "spheres", Method::Sobol, 4096);
        for e in 0..configuration.mesh.len() {
            let sum = truth.sum(e).expect("every row is held");
            assert!((sum - 1.0).abs() < 0.01, "element {e}: {sum}");
        }
        let inner: f64 = (0..factors.nodes())
            .filter(|e| factors.names[factors.object[*e] as usize] == "outer")
            .map(|e| {
                let (columns, values, _) = factors.row(e);
                let to_inner = |j: &u32| factors.names[factors.object[*j as usize] as usize] == "inner";
                let sum: f64 = columns.iter().zip(values).filter(|(j, _)| to_inner(j)).map(|(_, f)| f).sum();
                sum * factors.areas[e]
            })
            .sum();
        let area: f64 = (128..256).map(|e| factors.areas[e]).sum();
        assert!((inner / area - 0.25).abs() < 1e-3, "{}", inner / area);
    });
}

/// Distances, closure and reciprocity of factors that are off by known amounts.
#[test]
fn distances_are_what_was_added() {
    with_context(|context| {
        let (configuration, truth, mut factors) = found(context, "parallel", Method::Exact, 9);
        let n = configuration.mesh.len();
        let clean = truth.distance(&factors);
        assert!(clean.rms < 1e-8 && clean.largest < 1e-8, "{clean:?}");
        assert!(reciprocity(&factors, None) < 1e-15);
        let (square, largest, sum) =
            factors.values.iter().fold((0.0, 0.0f64, 0.0), |(s, m, t), f| (s + f * f, m.max(*f), t + f));
        // Every factor of the first row 10 % up.
        let row = factors.start[0]..factors.start[1];
        let (mut moved, mut most, mut added) = (0.0, 0.0f64, 0.0);
        for f in &mut factors.values[row] {
            let step = 0.1 * *f;
            *f += step;
            (moved, most, added) = (moved + step * step, most.max(step), added + step);
        }
        let d = truth.distance(&factors);
        assert!((d.rms / (moved / square).sqrt() - 1.0).abs() < 1e-6, "{d:?}");
        assert!((d.largest / (most / largest) - 1.0).abs() < 1e-6, "{d:?}");
        assert!(!d.unresolved);
        assert!((closure(&factors) - added).abs() < 1e-12);
        // All areas are equal: a pair's exchange areas sum to what both factors do.
        let expected = added / (sum + added);
        assert!(
            (reciprocity(&factors, None) / expected - 1.0).abs() < 1e-9,
            "{}",
            reciprocity(&factors, None)
        );
        assert_eq!(n, 32);
    });
}

/// Random points: the mean squared error of a factor F by N rays is F (1 - F) / N, summed over the matrix, to 10 % over 20
/// seeds (32 rows each; a row's error has a relative spread of about 1/sqrt(16 / 2)). Sobol points, a few of which hit each
/// element, have about half of it.
#[test]
fn random_rays_err_as_theory_says() {
    with_context(|context| {
        const RAYS: u32 = 1024;
        let configuration = named(context, "parallel").expect("a configuration");
        let visibility = Visibility::new(context.device, &configuration.scene).expect("a tree");
        let truth = Truth::new(&visibility, &configuration).expect("an answer");
        let exact = Method::Exact.find(context, &configuration, 9, 0).expect("factors").0;
        let (spread, square) =
            exact.values.iter().fold((0.0, 0.0), |(v, s), f| (v + f * (1.0 - f), s + f * f));
        let expected = spread / f64::from(RAYS) / square;
        let mean = |method: Method| {
            let one = |seed| {
                let factors = method.find(context, &configuration, RAYS, seed).expect("factors").0;
                truth.distance(&factors).rms.powi(2)
            };
            (0..20).map(one).sum::<f64>() / 20.0
        };
        let random = mean(Method::Random) / expected;
        assert!((random - 1.0).abs() < 0.1, "{random}");
        let sobol = mean(Method::Sobol) / expected;
        assert!(sobol < 0.7, "{sobol}");
    });
}

/// A sweep's records: errors that do not depend on the threads, residuals where they mean something.
#[test]
fn a_sweep_holds_all_quantities() {
    with_context(|context| {
        let configuration = Configuration { longest: 2e-3, ..named(context, "right-angle").expect("one") };
        let subject = sweep(context, &configuration).expect("a sweep");
        assert_eq!(subject.series.len(), configuration.methods().len() * thread_counts(context).len());
        for series in &subject.series {
            assert!(!series.points.is_empty(), "{}", series.name);
            for point in &series.points {
                for quantity in [TIME, RMS, LARGEST, RECIPROCITY] {
                    assert!(point.get(quantity).is_some(), "{} {quantity}", series.name);
                }
            }
        }
        let value = |name: &str, k: usize, q: &str| {
            let series = subject.series.iter().find(|s| s.name.starts_with(name)).expect("a series");
            series.points[k].get(q).map(|m| m.samples[0])
        };
        // The centre of an element sees its neighbour across the edge as it is: coarse pixels are some 10 % off.
        assert!(value("hemi-cube, centre", 0, RMS).is_some_and(|e| e > 0.02 && e < 0.6));
        // How many settings there are depends on the machine's speed.
        for point in subject.series.iter().filter(|s| s.name.starts_with("exact")).flat_map(|s| &s.points) {
            assert!(point.get(RMS).is_some_and(|m| m.samples[0] < 10f64.powf(-point.parameter)), "{point:?}");
        }
        assert_eq!(value("exact", 0, CLOSURE), None);
        assert!(value("rays, Sobol, r", 0, RECIPROCITY).is_some_and(|r| r < 1e-12));
        assert!(value("rays, random", 0, RECIPROCITY).is_some_and(|r| r > 0.1));
        assert!(value("rays, random", 0, CLOSURE).is_some_and(|r| r < 1e-6));
        assert_eq!(value("hemi-cubes n x n, 8 px", 0, DIRECTIONS), Some(768.0));
        let all = compare::compared(context, vec![subject]);
        assert_eq!(all.subjects.len(), 2);
        assert!(all.subjects[0].notes[0].contains("of 1 configurations"));
    });
}

/// Light by accurate factors is the answer's, up to the answer's own noise (0.5 % in a quick run); by rays it errs as noise does, and
/// less where the lamp's factors are found pair by pair; with a tenth of every factor missing it is dark by more than that.
#[test]
fn light_errs_with_the_factors() {
    with_context(|context| {
        let (configuration, truth, coarse) = found(context, "cornell", Method::Sobol, 256);
        let light = Light::new(&configuration, &truth).expect("the box has a lamp");
        let by = |method, setting| light.error(&found(context, "cornell", method, setting).2);
        let (fine, automatic, exact) =
            (by(Method::Sobol, 4096), by(Method::Automatic, 256), by(Method::Pairs, 3));
        let coarse = light.error(&coarse);
        assert!(
            exact < 0.01 && automatic < 0.2 * coarse && fine < 0.3 * coarse && coarse < 0.5,
            "{coarse} {fine} {automatic} {exact}"
        );
        let mut less = found(context, "cornell", Method::Pairs, 3).2;
        less.values.iter_mut().for_each(|v| *v *= 0.9);
        let dark = light.error(&less);
        assert!((0.1..0.5).contains(&dark), "{dark}");
        let (squares, truth, _) = found(context, "parallel", Method::Exact, 3);
        assert!(Light::new(&squares, &truth).is_none());
    });
}
