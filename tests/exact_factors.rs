//! Exact form factors against closed forms and high-precision values.

mod common;

use common::*;
use glam::DVec3;
use twopass::form_factor::analytic::{EXACT, Polygon, differential, exchange};

fn poly(points: &[Point]) -> Polygon {
    let p: Vec<DVec3> = points.iter().map(|p| DVec3::from_array(*p)).collect();
    let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize();
    Polygon::new(&p, normal)
}

#[test]
fn oracle_pairs() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    for e in &entries {
        match e["kind"].as_str().unwrap_or_default() {
            "polygon_polygon" => {
                let (p, q) = (polygon(&e["poly1"]), polygon(&e["poly2"]));
                if p.len() > 4 || q.len() > 4 {
                    continue;
                }
                let (p, q) = (poly(&p), poly(&q));
                let want = e["F12"].as_f64().expect("factor");
                let start = std::time::Instant::now();
                let got = exchange(&p, &q, EXACT) / p.area();
                let t = start.elapsed().as_secs_f64();
                let fast = exchange(&p, &q, 1e-4) / p.area();
                let rel = |g: f64| if want > 0.0 { (g / want - 1.0).abs() } else { g };
                eprintln!("{} {want:.6e} {:.1e} fast {:.1e} {:.0} us", e["id"], rel(got), rel(fast), t * 1e6);
            }
            "point_polygon" => {
                let v = |k: &str| DVec3::from_slice(&numbers(&e["params"][k]));
                let got =
                    differential(v("point"), v("normal").normalize(), &poly(&polygon(&e["params"]["poly"])));
                eprintln!("{} {}", e["id"], got / e["F12"].as_f64().expect("factor") - 1.0);
            }
            _ => {}
        }
    }
}
