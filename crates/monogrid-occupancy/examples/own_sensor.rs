//! A sensor with a model of its own: a sonar, which says little about how far and much about what
//! is free.
//!
//! `cargo run --release -p monogrid-occupancy --example own_sensor`
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use monogrid_occupancy::*;

/// Free before the echo, perhaps occupied around it.
fn sonar(behind: f64, sigma: f64) -> f64 {
    match behind / sigma {
        ..-1.0 => 0.35,
        -1.0..=1.0 => 0.6,
        _ => 0.5,
    }
}

fn main() -> Result<(), MapError> {
    let own = SensorModel::Curve(SensorCurve {
        probability: sonar,
        reach: |sigma| 1.5 * sigma,
    });
    // an echo 2 m ahead, known to 0.1 m
    let scan = Scan::of_points(0, Similarity::IDENTITY, &[[0.0, 0.0, 2.0]], &[0.1]);
    for (name, model) in [("own", own), ("OctoMap's", SensorModel::OCTOMAP)] {
        let config = IntegrationConfig {
            model,
            rule: IntegrationRule::Rays,
            ..IntegrationConfig::default()
        };
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05))?;
        integrate(&mut map, &scan, &config, 1)?;
        let probability = |z: f64| match map.log_odds([0.0, 0.0, z]) {
            Some(log_odds) => format!("{:.2}", probability_from_log_odds(f64::from(log_odds))),
            None => "unknown".to_owned(),
        };
        let cells = [1.0, 1.92, 2.0, 2.08, 2.3].map(|z| format!("{z} m: {}", probability(z)));
        println!("{name}: {}", cells.join(", "));
    }
    Ok(())
}
