#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use super::*;
use crate::DepthPixel;
use monogrid_depth::DenseDepth;
use monogrid_image::{GrayImage, Image, to_gray8};
use std::io::{Seek, SeekFrom, Write};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A store with room for this many bytes of both kinds.
fn store(keyframes: usize, prepared: usize) -> Store {
    Store::new(&MemoryConfig {
        keyframes_mb: keyframes as f64 / 1e6,
        prepared_mb: prepared as f64 / 1e6,
    })
}

/// A value of 1200 bytes.
fn pixels(id: u16) -> Vec<DepthPixel> {
    let pixel = |y| DepthPixel {
        x: id,
        y,
        idepth: 0.1 + f32::from(id) / 3.0,
        idepth_var: f32::MIN_POSITIVE * f32::from(y),
    };
    (0..100).map(pixel).collect()
}

#[test]
fn what_was_not_used_for_longest_leaves_and_comes_back_the_same() {
    let store = store(3 * 1200, 0);
    store.spill_into(tempfile::tempfile().unwrap());
    let kept: Vec<Kept<Vec<DepthPixel>>> = (0..3).map(|id| store.keep(pixels(id))).collect();
    assert_eq!(store.bytes().file, 0);
    kept[0].get().unwrap();
    let more = store.keep(pixels(3));
    // the second was not used since
    let is_here = |number: u64| store.cache().is_here(number);
    assert_eq!([0, 1, 2, 3].map(is_here), [true, false, true, true]);
    let StoreBytes { own, file, .. } = store.bytes();
    assert!(own == 3 * 1200 && file > 0);
    for (id, kept) in (0..).zip(kept.iter().chain([&more])) {
        assert_eq!(*kept.get().unwrap(), pixels(id));
        assert!(store.bytes().own <= 3 * 1200);
    }
    // everything is written once
    let file = store.bytes().file;
    for kept in kept.iter().rev() {
        kept.get().unwrap();
    }
    assert_eq!((store.bytes().file, store.failure()), (file, None));
    drop((kept, more));
    assert_eq!(store.bytes(), StoreBytes::default());
}

#[test]
fn images_and_dense_depth_come_back_the_same_from_their_bytes() {
    let grey = GrayImage::from_fn(7, 5, |x, y| (x * 31 + y * 7) as f32 + 0.4);
    let image = grey.map(to_gray8);
    assert_eq!(Image::unpack(&image.pack()).unwrap(), image);
    let depth = |factor: f32| GrayImage::from_fn(4, 3, |x, y| factor * (x + 4 * y) as f32);
    let dense = DenseDepth {
        idepth: depth(0.3),
        sigma: depth(0.01),
    };
    let bytes = dense.pack();
    assert_eq!(DenseDepth::unpack(&bytes).unwrap(), dense);
    // what is cut off is no value
    assert!(DenseDepth::unpack(&bytes[..bytes.len() - 8]).is_none());
    assert!(Vec::<DepthPixel>::unpack(&pixels(1).pack()[1..]).is_none());
}

#[test]
fn a_value_in_use_is_not_read_again() {
    let store = store(0, 0);
    store.spill_into(tempfile::tempfile().unwrap());
    let kept = store.keep(pixels(0));
    let used = kept.get().unwrap();
    let _other = store.keep(pixels(1));
    assert!(!store.cache().is_here(0));
    assert!(Arc::ptr_eq(&used, &kept.get().unwrap()));
}

#[test]
fn without_a_file_all_values_of_their_own_stay() {
    let store = store(0, 0);
    let kept: Vec<Kept<Vec<DepthPixel>>> = (0..3).map(|id| store.keep(pixels(id))).collect();
    assert_eq!(store.bytes().own, 3 * 1200);
    for (id, kept) in (0..).zip(&kept) {
        assert_eq!(*kept.get().unwrap(), pixels(id));
    }
}

#[test]
fn what_follows_from_others_is_made_again_as_seldom_as_there_is_room() {
    for (room, expected) in [(2 * 1200, 2), (1200, 3)] {
        let store = store(0, room);
        let made = Arc::new(AtomicUsize::new(0));
        let source = store.keep(pixels(7));
        let derived: Vec<Kept<Vec<DepthPixel>>> = (0..2)
            .map(|_| {
                let (source, made) = (source.clone(), Arc::clone(&made));
                store.derive(move || {
                    made.fetch_add(1, Ordering::Relaxed);
                    Some(source.get()?.to_vec())
                })
            })
            .collect();
        assert_eq!(made.load(Ordering::Relaxed), 0);
        for derived in [&derived[0], &derived[1], &derived[0]] {
            assert_eq!(*derived.get().unwrap(), pixels(7));
        }
        assert_eq!(made.load(Ordering::Relaxed), expected);
        assert!(store.bytes().derived <= room);
    }
}

#[test]
fn a_damaged_file_is_told_and_does_no_other_harm() {
    let mut file = tempfile::tempfile().unwrap();
    let store = store(0, 0);
    store.spill_into(file.try_clone().unwrap());
    let kept: Vec<Kept<Vec<DepthPixel>>> = (0..3).map(|id| store.keep(pixels(id))).collect();
    let image = store.derive({
        let source = kept[0].clone();
        move || Some(source.get()?.to_vec())
    });
    file.seek(SeekFrom::Start(50)).unwrap();
    file.write_all(&[255; 20]).unwrap();
    assert!(kept[0].get().is_none() && image.get().is_none());
    assert!(store.failure().unwrap().contains("cannot be read back"));
    let lost = store.check().unwrap_err().to_string();
    assert!(lost.contains("cannot be read back") && lost.contains("keyframes_mb"));
    assert_eq!(*kept[1].get().unwrap(), pixels(1));
}

#[test]
fn a_file_that_cannot_be_written_keeps_values_in_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scratch");
    std::fs::write(&path, "").unwrap();
    let store = store(0, 0);
    store.spill_into(File::open(path).unwrap());
    let kept: Vec<Kept<Vec<DepthPixel>>> = (0..3).map(|id| store.keep(pixels(id))).collect();
    assert!(store.failure().unwrap().contains("stay in memory"));
    // nothing is lost
    assert_eq!(store.check(), Ok(()));
    for (id, kept) in (0..).zip(&kept) {
        assert_eq!(*kept.get().unwrap(), pixels(id));
    }
}
