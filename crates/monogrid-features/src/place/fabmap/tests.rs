use super::likelihood::{Detector, Likelihoods};
use super::tree::{Node, Occurrences, chow_liu, maximum_spanning_tree};
use super::words::{k_majority, majority, nearest};
use super::*;
use crate::{Descriptor, Rng};
use std::sync::Arc;

const DETECTOR: Detector = Detector {
    p_seen: 0.39,
    p_phantom: 0.01,
};

fn random_descriptor(rng: &mut Rng) -> Descriptor {
    Descriptor(std::array::from_fn(|_| rng.next_u64()))
}

/// `descriptor` with `count` random bits changed.
fn disturbed(descriptor: &Descriptor, count: usize, rng: &mut Rng) -> Descriptor {
    let mut changed = *descriptor;
    for _ in 0..count {
        let bit = rng.below(256);
        changed.0[bit / 64] ^= 1 << (bit % 64);
    }
    changed
}

/// Images of `num_words` words where each depends on the one before.
fn dependent_images(num_words: u16, num_images: usize, seed: u64) -> Vec<Vec<u16>> {
    let mut rng = Rng::new(seed);
    (0..num_images)
        .map(|_| {
            let mut is_before = false;
            let chain = (0..num_words).filter(|word| {
                let p = match (is_before, word % 3) {
                    (true, 0) => 0.3,
                    (true, _) => 0.8,
                    (false, _) => 0.15,
                };
                is_before = rng.uniform() < p;
                is_before
            });
            chain.collect()
        })
        .collect()
}

#[test]
fn the_majority_has_the_least_sum_of_distances() {
    let mut rng = Rng::new(3);
    for count in [1, 2, 5, 8] {
        let all: Vec<Descriptor> = (0..count).map(|_| random_descriptor(&mut rng)).collect();
        let cost = |d: &Descriptor| all.iter().map(|o| o.distance(d)).sum::<u32>();
        let median = majority(&all);
        // the cost is a sum over bits: no single change helps, so nothing does
        for bit in 0..256 {
            let mut other = median;
            other.0[bit / 64] ^= 1 << (bit % 64);
            assert!(cost(&other) >= cost(&median));
        }
    }
}

#[test]
fn clusters_are_found_again() {
    let mut rng = Rng::new(5);
    let centres: Vec<Descriptor> = (0..20).map(|_| random_descriptor(&mut rng)).collect();
    let all: Vec<Descriptor> = (0..2000)
        .map(|i| disturbed(&centres[i % 20], 30, &mut rng))
        .collect();
    // three words per centre: with one, the draw of the seeds leaves some centres without
    let words = k_majority(&all, 60, 20, 7, |_| ());
    assert_eq!(words, k_majority(&all, 60, 20, 7, |_| ()));
    for centre in &centres {
        let (_, distance) = nearest(&words, centre).unwrap();
        assert!(distance <= 10, "{distance}");
    }
    // fewer different descriptors than words asked for
    assert_eq!(k_majority(&[centres[0]; 9], 5, 3, 1, |_| ()), [centres[0]]);
    assert!(k_majority(&[], 5, 3, 1, |_| ()).is_empty());
}

#[test]
fn mutual_information_is_that_of_the_enumerated_joint() {
    let images = dependent_images(6, 150, 1);
    let occurrences = Occurrences::new(6, &images);
    let has = |image: &Vec<u16>, word: usize| image.contains(&(word as u16));
    let entropy = |counts: &[f64]| -> f64 {
        let share = counts.iter().map(|c| c / 150.0).filter(|p| *p > 0.0);
        -share.map(|p| p * p.ln()).sum::<f64>()
    };
    for a in 0..6 {
        for b in 0..6 {
            let (mut of_a, mut of_b, mut joint) = ([0.0; 2], [0.0; 2], [0.0; 4]);
            for image in &images {
                let (x, y) = (usize::from(has(image, a)), usize::from(has(image, b)));
                of_a[x] += 1.0;
                of_b[y] += 1.0;
                joint[2 * x + y] += 1.0;
            }
            // I(a, b) = H(a) + H(b) - H(a, b)
            let expected = entropy(&of_a) + entropy(&of_b) - entropy(&joint);
            let found = occurrences.mutual_information(a, b);
            assert!(
                (found - expected).abs() < 1e-12,
                "{a} {b}: {found} {expected}"
            );
        }
    }
}

/// Sum of the mutual information along the edges; `None` when they are no tree.
fn weight(edges: &[(usize, usize)], occurrences: &Occurrences, num_words: usize) -> Option<f64> {
    let mut component: Vec<usize> = (0..num_words).collect();
    for &(a, b) in edges {
        let (from, to) = (component[a], component[b]);
        if from == to {
            return None;
        }
        for c in &mut component {
            if *c == from {
                *c = to;
            }
        }
    }
    let information = edges
        .iter()
        .map(|&(a, b)| occurrences.mutual_information(a, b));
    Some(information.sum())
}

#[test]
fn the_tree_is_the_best_of_all_trees() {
    let pairs: Vec<(usize, usize)> = (0..5).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
    for seed in 0..20 {
        let occurrences = Occurrences::new(5, &dependent_images(5, 60, seed));
        let mut best = f64::NEG_INFINITY;
        let mut num_trees = 0;
        for chosen in 0u32..1 << pairs.len() {
            if chosen.count_ones() != 4 {
                continue;
            }
            let bits = 0..pairs.len();
            let edges: Vec<(usize, usize)> = bits
                .filter(|i| chosen >> i & 1 == 1)
                .map(|i| pairs[i])
                .collect();
            if let Some(weight) = weight(&edges, &occurrences, 5) {
                num_trees += 1;
                best = best.max(weight);
            }
        }
        assert_eq!(num_trees, 125, "Cayley: 5^3");
        let parents = maximum_spanning_tree(&occurrences);
        let edges: Vec<(usize, usize)> = parents
            .iter()
            .enumerate()
            .filter_map(|(word, parent)| Some((word, (*parent)?)))
            .collect();
        assert_eq!(edges.len(), 4);
        let found = weight(&edges, &occurrences, 5).expect("not a tree");
        assert!((found - best).abs() < 1e-12, "{found} instead of {best}");
    }
}

/// A tree that branches: 0 - 1 - 2, 1 - 3, 0 - 4.
fn toy_nodes() -> Vec<Node> {
    let node = |parent, p, given: [f64; 2]| Node {
        parent,
        p,
        p_given_parent: given,
    };
    vec![
        node(None, 0.2, [0.2, 0.2]),
        node(Some(0), 0.14, [0.05, 0.5]),
        node(Some(1), 0.18, [0.1, 0.7]),
        node(Some(1), 0.29, [0.3, 0.2]),
        node(Some(0), 0.1, [0.08, 0.18]),
    ]
}

/// Whether each of the words is in an image with this number.
fn bits(number: usize) -> [bool; 5] {
    std::array::from_fn(|i| number >> i & 1 == 1)
}

fn words(number: usize) -> Vec<u16> {
    (0..5u16)
        .filter(|i| bits(number)[usize::from(*i)])
        .collect()
}

#[test]
fn words_given_things_follow_from_bayes_rule() {
    // p(z | e, z_p) from p(e | z) p(z | z_p), where p(e | z) is Bayes' of the detector
    for node in toy_nodes() {
        let existence = 0.37; // cancels
        for (e, z_parent) in [(false, false), (false, true), (true, false), (true, true)] {
            let given = node.p_given_parent[usize::from(z_parent)];
            let of = |p: f64, is: bool| if is { p } else { 1.0 - p };
            let joint = |z: bool| {
                let seen = if e {
                    DETECTOR.p_seen
                } else {
                    DETECTOR.p_phantom
                };
                let p_e_given_z = of(seen, z) * of(existence, e) / of(node.p, z);
                p_e_given_z * of(given, z)
            };
            for z in [false, true] {
                let expected = joint(z) / (joint(true) + joint(false));
                let found = DETECTOR.word(&node, z, e, z_parent);
                assert!((found - expected).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn likelihood_is_the_sum_over_all_that_may_exist() {
    let nodes = toy_nodes();
    let likelihoods = Likelihoods::new(&nodes, DETECTOR);
    for place in 0..32 {
        let mut total = 0.0;
        for image in 0..32 {
            // sum over e of p(e | L) p(Z | e), every factor from its definition
            let mut expected = 0.0;
            for things in 0..32 {
                let (z, e, seen) = (bits(image), bits(things), bits(place));
                let mut p = 1.0;
                for (q, node) in nodes.iter().enumerate() {
                    let prior = DETECTOR.existence(node.p);
                    let detect = |e: bool| {
                        let p = if e {
                            DETECTOR.p_seen
                        } else {
                            DETECTOR.p_phantom
                        };
                        if seen[q] { p } else { 1.0 - p }
                    };
                    let with = detect(true) * prior;
                    let existence = with / (with + detect(false) * (1.0 - prior));
                    p *= if e[q] { existence } else { 1.0 - existence };
                    let z_parent = node.parent.is_some_and(|parent| z[parent]);
                    p *= DETECTOR.word(node, z[q], e[q], z_parent);
                }
                expected += p;
            }
            let query = likelihoods.query(&words(image));
            let found = query.ln_likelihood(&words(place)).exp();
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            total += found;
        }
        assert!((total - 1.0).abs() < 1e-12, "not a distribution: {total}");
    }
    let mean_field: f64 = (0..32)
        .map(|image| likelihoods.query(&words(image)).mean_field.exp())
        .sum();
    assert!((mean_field - 1.0).abs() < 1e-12, "{mean_field}");
}

#[test]
fn a_prior_follows_from_how_often_the_word_is_seen() {
    let existence = DETECTOR.existence(0.2);
    let seen = 0.39 * existence + 0.01 * (1.0 - existence);
    assert!((seen - 0.2).abs() < 1e-12);
    // after an image: more with the word, less without, and the mean is as before
    let (with, without) = (
        DETECTOR.existence_after(existence, true),
        DETECTOR.existence_after(existence, false),
    );
    assert!(with > existence && without < existence);
    assert!((0.2 * with + 0.8 * without - existence).abs() < 1e-12);
}

/// Descriptors of places made of random things, and two looks at each.
fn world(num_places: usize, seed: u64) -> (Vec<Vec<Descriptor>>, Vec<Vec<Descriptor>>) {
    let mut rng = Rng::new(seed);
    let mut thing_rng = Rng::new(99);
    let things: Vec<Descriptor> = (0..300)
        .map(|_| random_descriptor(&mut thing_rng))
        .collect();
    let mut looks = (Vec::new(), Vec::new());
    for _ in 0..num_places {
        let there: Vec<usize> = (0..60).map(|_| rng.below(300)).collect();
        let mut look = || -> Vec<Descriptor> {
            let mut seen = Vec::new();
            for thing in &there {
                if rng.uniform() < 0.6 {
                    seen.push(disturbed(&things[*thing], 20, &mut rng));
                }
            }
            seen
        };
        looks.0.push(look());
        looks.1.push(look());
    }
    looks
}

fn trained() -> PlaceVocabulary {
    let config = VocabularyConfig {
        max_words: 300,
        max_samples: 150,
        ..VocabularyConfig::default()
    };
    PlaceVocabulary::train(&world(200, 1).0, &config, |_| ()).unwrap()
}

#[test]
fn places_are_recognised_and_strangers_are_new() {
    let vocabulary = Arc::new(trained());
    for is_mean_field in [false, true] {
        let config = FabMapConfig {
            p_seen: 0.6,
            is_mean_field,
            ..FabMapConfig::default()
        };
        let mut map = FabMap::new(Arc::clone(&vocabulary), config);
        let (first, second) = world(30, 2);
        for (place, look) in (0u64..).zip(&first) {
            assert!(map.add(place, look));
            assert!(!map.add(place, look));
        }
        assert_eq!(map.num_places(), 30);
        let mut new_without = 0.0;
        for (place, look) in (0u64..).zip(&second) {
            let beliefs = map.query(look, |_| true);
            assert_eq!(beliefs.places[0].place, place);
            assert!(beliefs.places[0].probability > 0.9, "{beliefs:?}");
            let sum: f64 = beliefs.places.iter().map(|b| b.probability).sum();
            assert!((sum + beliefs.new_place - 1.0).abs() < 1e-9);
            let without = map.query(look, |other| other != place);
            new_without += without.new_place / 30.0;
            assert_eq!(without.places.len(), 29);
        }
        // now and then one of 29 strangers is more alike than all of the 150 samples
        let least = if is_mean_field { 0.5 } else { 0.75 };
        assert!(new_without > least, "{new_without}");
        // strangers, nothing at all, and no place allowed
        let (strangers, _) = world(10, 77);
        let new = strangers.iter().map(|l| map.query(l, |_| true).new_place);
        let mean = new.sum::<f64>() / 10.0;
        assert!(mean > 0.5, "{mean}");
        assert!(map.query(&[], |_| true).new_place > 0.5);
        assert!((map.query(&second[0], |_| false).new_place - 1.0).abs() < 1e-12);
    }
}

#[test]
fn training_is_reproducible_and_refuses_too_little() {
    let vocabulary = trained();
    assert_eq!(vocabulary, trained());
    assert_eq!(vocabulary.num_samples(), 150);
    assert!(vocabulary.num_words() > 250);
    let train = |images: &[Vec<Descriptor>], max_words| {
        let config = VocabularyConfig {
            max_words,
            ..VocabularyConfig::default()
        };
        PlaceVocabulary::train(images, &config, |_| ()).unwrap_err()
    };
    let images = world(20, 1).0;
    assert!(matches!(
        train(&images[..9], 100),
        TrainingError::FewImages { found: 9, .. }
    ));
    assert!(matches!(train(&images, 1), TrainingError::NumWords { .. }));
    assert!(matches!(
        train(&images, 70_000),
        TrainingError::NumWords { .. }
    ));
    let same = vec![vec![Descriptor::default()]; 20];
    assert_eq!(train(&same, 10), TrainingError::FewWords { found: 1 });
}

#[test]
fn files_are_read_as_written_and_damage_is_noticed() {
    let vocabulary = trained();
    let bytes = vocabulary.to_bytes();
    assert_eq!(PlaceVocabulary::from_bytes(&bytes), Ok(vocabulary.clone()));
    for length in 0..bytes.len().min(200) {
        assert!(PlaceVocabulary::from_bytes(&bytes[..length]).is_err());
    }
    let mut rng = Rng::new(4);
    for _ in 0..200 {
        let mut damaged = bytes.clone();
        damaged[rng.below(bytes.len())] ^= 1 << rng.below(8);
        assert!(PlaceVocabulary::from_bytes(&damaged).is_err());
    }
    assert_eq!(
        PlaceVocabulary::from_bytes(b"PNG and so on"),
        Err(VocabularyError::Magic)
    );
    // a sound checksum over nonsense
    let mut nonsense = vocabulary.clone();
    nonsense.nodes[3].parent = Some(12_345);
    assert_eq!(
        PlaceVocabulary::from_bytes(&nonsense.to_bytes()),
        Err(VocabularyError::Content {
            what: "parent",
            index: 3
        })
    );
    let mut nonsense = vocabulary.clone();
    nonsense.nodes[5].p = f64::NAN;
    assert!(PlaceVocabulary::from_bytes(&nonsense.to_bytes()).is_err());
    let mut nonsense = vocabulary;
    nonsense.samples[0] = vec![9, 9];
    assert!(PlaceVocabulary::from_bytes(&nonsense.to_bytes()).is_err());
}

#[test]
fn the_tree_of_many_words_keeps_probabilities_open() {
    // words that are always, and never, there
    let mut images = dependent_images(8, 40, 3);
    for image in &mut images {
        image.retain(|w| *w != 2 && *w != 5);
        image.push(5);
    }
    for node in chow_liu(&Occurrences::new(8, &images)) {
        let [absent, there] = node.p_given_parent;
        assert!([node.p, absent, there].iter().all(|p| *p > 0.0 && *p < 1.0));
    }
}

#[test]
fn the_built_in_vocabulary_is_sound_and_small() {
    let vocabulary = PlaceVocabulary::built_in().unwrap();
    assert!(vocabulary.num_words() > 1000 && vocabulary.num_samples() >= 100);
    assert!(vocabulary.to_bytes().len() < 2_000_000);
}
