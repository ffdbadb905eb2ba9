//! Recognition of places without a vocabulary: an inverted index over parts of the descriptors.
//!
//! Multi-index hashing (`[NOROUZI12]`): two descriptors that differ in few bits agree exactly in
//! one of their sixteen parts of 16 bits with high probability (0.9 for 30 differing bits).
//! Whatever shares a part is compared in full, so a query returns real correspondences with every
//! place, which the geometric check needs next.

use super::Descriptor;
use super::matching::{DescriptorMatch, Nearest};
use std::collections::BTreeMap;

/// Settings of a query.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceConfig {
    /// Largest number of differing bits of two descriptors of one point. Default 50.
    pub max_distance: u32,
    /// The closest descriptor of a place must be below this times its second. Default 0.85.
    pub max_ratio: f32,
    /// Fewest correspondences of a candidate. Default 10.
    pub min_matches: usize,
    /// Most candidates. Default 5.
    pub max_candidates: usize,
}

impl Default for PlaceConfig {
    fn default() -> Self {
        Self {
            max_distance: 50,
            max_ratio: 0.85,
            min_matches: 10,
            max_candidates: 5,
        }
    }
}

/// A place that looks like the query.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceCandidate {
    /// The identity given to [`PlaceIndex::add`].
    pub place: u64,
    /// Sum over the correspondences of their rarity: comparable within one query only.
    pub score: f64,
    /// Correspondences: `a_idx` in the query, `b_idx` in the place. One to one.
    pub matches: Vec<DescriptorMatch>,
}

const NUM_PARTS: usize = 16;
const NUM_KEYS: usize = 1 << 16;
const END: u32 = u32::MAX;
/// A list longer than this is of no use (smooth patches share their bits) and is not followed
/// further; the newest come first.
const MAX_LIST: usize = 128;

/// One stored descriptor.
#[derive(Clone, Debug)]
struct Entry {
    descriptor: Descriptor,
    place: u64,
    index: u32,
    /// The next entry with the same key, for each part.
    next: [u32; NUM_PARTS],
}

/// Descriptors of all places, findable by any of their parts. About 4 MB as soon as there are any,
/// and 100 bytes per descriptor.
#[derive(Clone, Debug)]
pub struct PlaceIndex {
    heads: Vec<u32>,
    entries: Vec<Entry>,
    /// Number of descriptors of each place.
    places: BTreeMap<u64, usize>,
}

impl Default for PlaceIndex {
    fn default() -> Self {
        Self::new()
    }
}

impl PlaceIndex {
    /// An index without places.
    #[must_use]
    pub fn new() -> Self {
        Self {
            heads: Vec::new(),
            entries: Vec::new(),
            places: BTreeMap::new(),
        }
    }

    /// Number of places.
    #[must_use]
    pub fn num_places(&self) -> usize {
        self.places.len()
    }

    /// Memory that it takes, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.heads.capacity() * size_of::<u32>() + self.entries.capacity() * size_of::<Entry>()
    }

    /// Adds a place with its descriptors; returns whether it was new (nothing is added otherwise).
    pub fn add(&mut self, place: u64, descriptors: &[Descriptor]) -> bool {
        let is_full = self.entries.len() + descriptors.len() >= END as usize;
        if self.places.contains_key(&place) || is_full {
            return false;
        }
        self.places.insert(place, descriptors.len());
        self.heads.resize(NUM_PARTS * NUM_KEYS, END);
        for (index, descriptor) in descriptors.iter().enumerate() {
            let id = self.entries.len() as u32;
            let mut next = [END; NUM_PARTS];
            for (part, link) in next.iter_mut().enumerate() {
                let head = &mut self.heads[head_of(descriptor, part)];
                *link = std::mem::replace(head, id);
            }
            self.entries.push(Entry {
                descriptor: *descriptor,
                place,
                index: index as u32,
                next,
            });
        }
        true
    }

    /// Places that share many descriptors with the query, best first; `is_allowed` excludes places
    /// (such as those next to the query).
    #[must_use]
    pub fn query(
        &self,
        descriptors: &[Descriptor],
        config: &PlaceConfig,
        is_allowed: impl Fn(u64) -> bool,
    ) -> Vec<PlaceCandidate> {
        if self.entries.is_empty() {
            return Vec::new();
        }
        let allowed = self.places.keys().filter(|place| is_allowed(**place));
        let num_allowed = allowed.count();
        let mut candidates: BTreeMap<u64, PlaceCandidate> = BTreeMap::new();
        let mut seen = vec![u32::MAX; self.entries.len()];
        for (query_idx, descriptor) in descriptors.iter().enumerate() {
            let nearest = self.nearest_per_place(descriptor, query_idx, config, &mut seen);
            let allowed: Vec<(u64, DescriptorMatch)> = nearest
                .iter()
                .filter(|(place, n)| is_allowed(**place) && n.is_distinct(config.max_ratio))
                .map(|(place, n)| (*place, n.best))
                .collect();
            // what every place has tells nothing; what one has tells most
            let rarity = ((num_allowed as f64 + 1.0) / (allowed.len() as f64 + 0.5)).ln();
            for (place, found) in allowed {
                let candidate = candidates.entry(place).or_insert_with(|| PlaceCandidate {
                    place,
                    score: 0.0,
                    matches: Vec::new(),
                });
                candidate.score += rarity.max(0.0);
                candidate.matches.push(found);
            }
        }
        let mut ranked: Vec<PlaceCandidate> = candidates
            .into_values()
            .map(|mut candidate| {
                let before = candidate.matches.len();
                candidate.matches = one_to_one(candidate.matches);
                candidate.score *= candidate.matches.len() as f64 / before.max(1) as f64;
                candidate
            })
            .filter(|candidate| candidate.matches.len() >= config.min_matches)
            .collect();
        ranked.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.place.cmp(&b.place)));
        ranked.truncate(config.max_candidates);
        ranked
    }

    /// The closest descriptor of each place that shares a part with the query.
    fn nearest_per_place(
        &self,
        descriptor: &Descriptor,
        query_idx: usize,
        config: &PlaceConfig,
        seen: &mut [u32],
    ) -> BTreeMap<u64, Nearest> {
        let mut nearest: BTreeMap<u64, Nearest> = BTreeMap::new();
        // all lists at the same pace: the processor fetches their next entries from memory at once
        let mut ids: [u32; NUM_PARTS] =
            std::array::from_fn(|part| self.heads[head_of(descriptor, part)]);
        for _ in 0..MAX_LIST {
            if ids.iter().all(|id| *id == END) {
                break;
            }
            for (part, id) in ids.iter_mut().enumerate().filter(|(_, id)| **id != END) {
                let entry = &self.entries[*id as usize];
                // compared with this query before, through another part
                let last = std::mem::replace(&mut seen[*id as usize], query_idx as u32);
                *id = entry.next[part];
                if last == query_idx as u32 {
                    continue;
                }
                let distance = descriptor.distance(&entry.descriptor);
                if distance > config.max_distance {
                    continue;
                }
                let found = DescriptorMatch {
                    a_idx: query_idx,
                    b_idx: entry.index as usize,
                    distance,
                };
                let first = Nearest::of(found);
                nearest
                    .entry(entry.place)
                    .and_modify(|known| known.add(found))
                    .or_insert(first);
            }
        }
        nearest
    }
}

fn head_of(descriptor: &Descriptor, part: usize) -> usize {
    part * NUM_KEYS + usize::from(descriptor.chunk(part))
}

/// Keeps the closest of the matches that share a descriptor of the place.
fn one_to_one(matches: Vec<DescriptorMatch>) -> Vec<DescriptorMatch> {
    let mut best: BTreeMap<usize, DescriptorMatch> = BTreeMap::new();
    for found in matches {
        best.entry(found.b_idx)
            .and_modify(|kept| {
                if found.distance < kept.distance {
                    *kept = found;
                }
            })
            .or_insert(found);
    }
    let mut kept: Vec<DescriptorMatch> = best.into_values().collect();
    kept.sort_by_key(|m| m.a_idx);
    kept
}
