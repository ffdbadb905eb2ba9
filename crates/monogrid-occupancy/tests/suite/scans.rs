//! Several scans at once against the same scans one after the other.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use crate::common::{OwnedScan, Random, room_scan};
use monogrid_occupancy::*;

const RULES: [IntegrationRule; 2] = [IntegrationRule::Rays, IntegrationRule::Fused];

fn config(rule: IntegrationRule) -> IntegrationConfig {
    IntegrationConfig {
        rule,
        ..IntegrationConfig::default()
    }
}

fn scans(count: u32) -> Vec<OwnedScan> {
    let mut random = Random(21);
    (0..count)
        .map(|id| room_scan(&mut random, id, 2500, 2.0))
        .collect()
}

fn map_with_budget(memory_budget_bytes: usize) -> OccupancyMap {
    OccupancyMap::new(MapConfig {
        resolution: 0.05,
        memory_budget_bytes,
        ..MapConfig::default()
    })
    .unwrap()
}

fn bytes_of(map: &OccupancyMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_ot(map, &mut bytes).unwrap();
    bytes
}

/// One scan after the other on one thread, up to the first error.
fn one_by_one(
    map: &mut OccupancyMap,
    scans: &[Scan],
    config: &IntegrationConfig,
) -> Result<IntegrationReport, MapError> {
    let mut sum = IntegrationReport::default();
    for scan in scans {
        let report = integrate(map, scan, config, 1)?;
        sum.points += report.points;
        sum.skipped += report.skipped;
        sum.brick_visits += report.brick_visits;
    }
    Ok(sum)
}

#[test]
fn scans_at_once_give_the_bytes_revisions_and_counts_of_scans_one_by_one() {
    let scans = scans(11);
    let scans: Vec<Scan> = scans.iter().map(OwnedScan::borrow).collect();
    for rule in RULES {
        let config = config(rule);
        let mut expected = map_with_budget(8 << 30);
        let sum = one_by_one(&mut expected, &scans, &config).unwrap();
        let bytes = bytes_of(&expected);
        assert!(bytes.len() > 20_000 && sum.points > 20_000 && sum.brick_visits > 1000);
        for threads in [0, 1, 2, 3, 7] {
            let mut map = map_with_budget(8 << 30);
            let report = integrate_scans(&mut map, &scans, &config, threads).unwrap();
            assert_eq!(report, sum, "{rule:?} {threads} threads");
            assert!(bytes_of(&map) == bytes, "{rule:?} {threads} threads");
            assert_eq!(map.revision(), expected.revision());
            let changed = |map: &OccupancyMap| map.bricks_changed_since(map.revision() - 2);
            assert_eq!(changed(&map), changed(&expected), "{rule:?} {threads}");
        }
        let mut empty = map_with_budget(8 << 30);
        let report = integrate_scans(&mut empty, &[], &config, 2).unwrap();
        assert!(empty.is_empty() && report == IntegrationReport::default());
    }
}

#[test]
fn the_map_holds_the_scans_before_one_that_cannot_be_used() {
    let mut unusable = scans(9);
    unusable[6].pose.scale = f64::NAN;
    let mut too_far = scans(9);
    too_far[6].pose.translation[1] = 1e9;
    for (rule, scans) in RULES
        .into_iter()
        .flat_map(|r| [(r, &unusable), (r, &too_far)])
    {
        let scans: Vec<Scan> = scans.iter().map(OwnedScan::borrow).collect();
        let config = config(rule);
        let mut expected = map_with_budget(8 << 30);
        one_by_one(&mut expected, &scans[..6], &config).unwrap();
        for threads in [1, 3] {
            let mut map = map_with_budget(8 << 30);
            let error = integrate_scans(&mut map, &scans, &config, threads).unwrap_err();
            assert!(matches!(error, MapError::Scan { id: 6, .. }), "{error}");
            assert!(map == expected, "{rule:?} {threads} threads");
        }
    }
}

#[test]
fn a_budget_that_holds_some_of_the_scans_is_an_error_after_the_same_scan() {
    let scans = scans(11);
    let scans: Vec<Scan> = scans.iter().map(OwnedScan::borrow).collect();
    for rule in RULES {
        let config = config(rule);
        let mut stopped = 0;
        for budget in [600_000, 1_000_000, 2_000_000, 6_000_000, 40_000_000] {
            let mut expected = map_with_budget(budget);
            let result = one_by_one(&mut expected, &scans, &config);
            stopped += usize::from(result.is_err() && !expected.is_empty());
            let mut map = map_with_budget(budget);
            let found = integrate_scans(&mut map, &scans, &config, 2);
            assert_eq!(found.is_ok(), result.is_ok(), "{rule:?} {budget}");
            assert!(map == expected, "{rule:?} {budget}");
        }
        assert!(stopped > 0, "{rule:?}: no budget ends the run on its way");
    }
}
