use super::*;
use crate::Rng;
use crate::test_images::{Texture, add_noise};
use monogrid_geometry::Vec2;
use monogrid_image::{GrayImage, Pyramid};

const W: usize = 320;
const H: usize = 240;

fn features(image: GrayImage) -> Vec<Feature> {
    let config = FeatureConfig {
        max_features: 300,
        ..FeatureConfig::default()
    };
    extract(config, image)
}

fn extract(config: FeatureConfig, image: GrayImage) -> Vec<Feature> {
    FeatureExtractor::new(config).extract(&Pyramid::new(image, 4), None)
}

fn descriptors(features: &[Feature]) -> Vec<Descriptor> {
    features.iter().map(|f| f.descriptor).collect()
}

/// The partners of `a` in a place with the descriptors `b`.
fn matches(a: &[Descriptor], b: &[Descriptor]) -> Vec<DescriptorMatch> {
    let mut index = PlaceIndex::new();
    index.add(0, b);
    let config = PlaceConfig {
        min_matches: 1,
        ..PlaceConfig::default()
    };
    let mut places = index.query(a, &config, |_| true);
    places.pop().map_or(vec![], |place| place.matches)
}

#[test]
fn an_index_without_places_knows_none() {
    let texture = Texture::new(3);
    let seen = descriptors(&features(view(&texture, 0.0, 1.0, 1)));
    assert!(!seen.is_empty());
    let config = PlaceConfig::default();
    assert!(PlaceIndex::new().query(&seen, &config, |_| true).is_empty());
}

/// An image of the texture turned and enlarged about its centre, darker and noisy.
fn view(texture: &Texture, angle_deg: f64, scale: f64, seed: u64) -> GrayImage {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let mut image = texture
        .render(W, H, |x, y| {
            let (dx, dy) = ((x - 160.0) / scale, (y - 120.0) / scale);
            (160.0 + cos * dx - sin * dy, 120.0 + sin * dx + cos * dy)
        })
        .map(|v| 0.8 * v + 10.0);
    add_noise(&mut image, 1.5, seed);
    image
}

#[test]
fn distance_counts_bits() {
    let mut rng = Rng::new(3);
    for _ in 0..50 {
        let a = Descriptor(std::array::from_fn(|_| rng.next_u64()));
        let b = Descriptor(std::array::from_fn(|_| rng.next_u64()));
        let bit = |d: &Descriptor, i: usize| d.0[i / 64] >> (i % 64) & 1;
        let expected = (0..256).filter(|&i| bit(&a, i) != bit(&b, i)).count();
        assert_eq!(a.distance(&b) as usize, expected);
        assert_eq!(a.distance(&a), 0);
    }
}

#[test]
fn turned_and_enlarged_views_match_where_they_should() {
    let texture = Texture::new(21);
    let steered = |image| {
        let config = FeatureConfig {
            max_features: 300,
            is_steered: true,
            ..FeatureConfig::default()
        };
        extract(config, image)
    };
    let reference = steered(view(&texture, 0.0, 1.0, 1));
    for (angle_deg, scale, min_right) in [
        (0.0, 1.0, 0.9),
        (-95.0, 1.0, 0.8),
        (10.0, 1.15, 0.8),
        (0.0, 2.0, 0.5),
    ] {
        let other = steered(view(&texture, angle_deg, scale, 2));
        let matches = match_features(&reference, &other, 70, 0.85);
        let (sin, cos) = f64::to_radians(angle_deg).sin_cos();
        let centre = Vec2::new(160.0, 120.0);
        let right = matches
            .iter()
            .filter(|m| {
                let d = other[m.b_idx].pixel - centre;
                let back = Vec2::new(cos * d.x - sin * d.y, sin * d.x + cos * d.y) / scale + centre;
                let size = (1usize << reference[m.a_idx].level) as f64;
                (back - reference[m.a_idx].pixel).norm() < 3.0 * size
            })
            .count();
        // half of the area is lost at twice the size, and corners jump between levels
        assert!(
            right >= 20 && right as f64 >= min_right * matches.len() as f64,
            "angle {angle_deg}, scale {scale}: {right} of {} right",
            matches.len()
        );
    }
}

#[test]
fn one_partner_each_and_the_ratio_remove_doubtful_matches() {
    let mut rng = Rng::new(5);
    let a: Vec<Descriptor> = (0..40)
        .map(|_| Descriptor(std::array::from_fn(|_| rng.next_u64())))
        .collect();
    let mut b = a.clone();
    b.push(a[7]); // a twin of 7: not distinct
    let found = matches(&a, &b);
    assert_eq!(found.len(), 39);
    assert!(found.iter().all(|m| m.a_idx == m.b_idx && m.a_idx != 7));
    // two of a want the same b
    let doubled = [a[0], a[0]];
    assert_eq!(matches(&doubled, &a[..1]).len(), 1);
    assert!(matches(&[], &a).is_empty());
    assert!(matches(&a, &[]).is_empty());
}

#[test]
fn features_match_where_each_is_nearest_to_the_other_and_no_second_is_as_near() {
    let mut rng = Rng::new(6);
    let feature = |descriptor| Feature {
        pixel: Vec2::zeros(),
        level: 0,
        angle_rad: 0.0,
        descriptor,
    };
    let a: Vec<Feature> = (0..40)
        .map(|_| feature(Descriptor(std::array::from_fn(|_| rng.next_u64()))))
        .collect();
    // other bits of each than an index finds together, up to 60 of them
    let mut b: Vec<Feature> = a.iter().rev().copied().collect();
    for (i, feature) in b.iter_mut().enumerate() {
        feature.descriptor.0[i % 4] ^= (1u64 << (i + 21)) - 1;
    }
    let found = match_features(&a, &b, 60, 0.85);
    assert_eq!(found.len(), 40);
    assert!(found.iter().all(|m| m.a_idx + m.b_idx == 39));
    assert_eq!(match_features(&a, &b, 59, 0.85).len(), 39);
    // a twin leaves the partner in doubt, whichever side has it
    let with_twin = [&b[..], &b[3..4]].concat();
    assert_eq!(match_features(&a, &with_twin, 60, 0.85).len(), 39);
    let doubled = [&a[..], &a[3..4]].concat();
    let found = match_features(&doubled, &b, 60, 0.85);
    assert_eq!(found.len(), 40, "the first of two that are as near");
    assert!(match_features(&[], &b, 60, 0.85).is_empty());
    assert!(match_features(&a, &[], 60, 0.85).is_empty());
}

#[test]
fn a_place_is_recognised_among_others() {
    let mut index = PlaceIndex::new();
    for place in 0..5u64 {
        let seen = features(view(&Texture::new(100 + place), 0.0, 1.0, place));
        assert!(index.add(place, &descriptors(&seen)));
        assert!(!index.add(place, &descriptors(&seen)));
    }
    assert_eq!(index.num_places(), 5);
    let config = PlaceConfig::default();
    for place in 0..5u64 {
        let query = descriptors(&features(view(&Texture::new(100 + place), 8.0, 1.0, 50)));
        let found = index.query(&query, &config, |_| true);
        assert_eq!(found.first().map(|c| c.place), Some(place));
        assert!(found[0].matches.len() >= 60);
        let mut used: Vec<usize> = found[0].matches.iter().map(|m| m.b_idx).collect();
        used.sort_unstable();
        assert!(used.windows(2).all(|w| w[0] < w[1]), "not one to one");
        let others = index.query(&query, &config, |p| p != place);
        assert!(
            others
                .iter()
                .all(|c| c.place != place && c.score < found[0].score)
        );
    }
    let stranger = descriptors(&features(view(&Texture::new(999), 0.0, 1.0, 9)));
    let similar = index.query(&stranger, &config, |_| true);
    // smooth textures share some patches by chance
    let most = similar.iter().map(|c| c.matches.len()).max();
    assert!(
        most.unwrap_or(0) < 50,
        "a stranger shares {most:?} descriptors"
    );
}

#[test]
fn the_index_finds_what_brute_force_finds() {
    let mut rng = Rng::new(17);
    let stored: Vec<Descriptor> = (0..300)
        .map(|_| Descriptor(std::array::from_fn(|_| rng.next_u64())))
        .collect();
    let query: Vec<Descriptor> = stored
        .iter()
        .map(|d| {
            let mut changed = *d;
            for _ in 0..25 {
                let bit = rng.below(256);
                changed.0[bit / 64] ^= 1 << (bit % 64);
            }
            changed
        })
        .collect();
    let mut index = PlaceIndex::new();
    index.add(1, &stored);
    let found = index.query(&query, &PlaceConfig::default(), |_| true);
    let matches = &found[0].matches;
    assert!(matches.iter().all(|m| m.a_idx == m.b_idx));
    // 25 of 256 bits changed: a part of 16 bits survives with 0.19, one of sixteen with 0.965
    assert!(matches.len() > 275, "{} of 300", matches.len());
}

#[test]
fn nothing_is_described_at_the_border_or_of_nothing() {
    let extractor = FeatureExtractor::new(FeatureConfig::default());
    let pyramid = Pyramid::new(Texture::new(1).render(64, 48, |x, y| (x, y)), 4);
    let pixels = [
        Vec2::new(2.0, 20.0),
        Vec2::new(30.0, 24.0),
        Vec2::new(f64::NAN, 24.0),
    ];
    let described = extractor.describe(&pyramid, &pixels);
    assert!(described[0].is_none() && described[1].is_some() && described[2].is_none());
    assert!(extractor.extract(&Pyramid::default(), None).is_empty());
    let tiny = Pyramid::new(GrayImage::filled(3, 3, 1.0), 4);
    assert!(extractor.extract(&tiny, None).is_empty());
}
