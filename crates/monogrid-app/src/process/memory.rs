//! What the allocator of the system does with memory that is free again.
//!
//! glibc gives every thread a heap of its own and keeps what was freed in it, between blocks that
//! live long: with images that are made and dropped for every frame, twice as much memory as is in
//! use.

#![cfg_attr(
    all(target_os = "linux", target_env = "gnu"),
    allow(
        unsafe_code,
        reason = "calls of the allocator that take no pointers; there are no safe ones for them"
    )
)]

/// Heaps of the allocator: the thread that tracks and the graph's seldom wait for each other.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MAX_HEAPS: libc::c_int = 2;

/// Lets the threads share few heaps. To be called before there are any.
pub fn share_heaps() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: takes two numbers and changes a setting of the allocator behind its own lock
    unsafe {
        // refused by another allocator in its place: then everything stays as it is
        let _ = libc::mallopt(libc::M_ARENA_MAX, MAX_HEAPS);
    }
}

/// Gives pictures of large sources back to the system as soon as they are free: kept for the next
/// ones, they are as much again as those in use. Working images are smaller, and stay. To be called
/// at the start.
pub fn keep_no_large_pictures() {
    give_back_at_once(2 << 20);
}

/// Gives large blocks back to the system as soon as they are free, for a run that must stay within
/// a limit: matrices of an adjustment and lists of a report leave no holes. Costs a few percent of
/// the time, since the system fills such blocks with zeros.
pub fn keep_little() {
    // a working image of floats at 640x480 is as large, one at 320x240 is not
    give_back_at_once(512 << 10);
}

/// Gives smaller blocks back too, for what comes after the last frame: keyframes are read back one
/// after the other while long lists grow, and leave holes between them.
pub fn keep_least() {
    // a level of a pyramid but for its smallest
    give_back_at_once(64 << 10);
}

/// Blocks from this size on, bytes.
#[cfg_attr(not(all(target_os = "linux", target_env = "gnu")), allow(unused))]
fn give_back_at_once(large: i32) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: as in `share_heaps`; blocks that are in use stay where they are
    unsafe {
        let _ = libc::mallopt(libc::M_MMAP_THRESHOLD, large);
        let _ = libc::mallopt(libc::M_TRIM_THRESHOLD, 2 * large);
    }
}

/// Gives free memory back to the system. Costs a few milliseconds, and those pages that are needed
/// again their zeros.
pub fn give_back() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: gives back only pages that no block lies in, behind the allocator's own locks
    unsafe {
        let _ = libc::malloc_trim(0);
    }
}

#[cfg(all(test, target_os = "linux", target_env = "gnu"))]
mod tests {
    use super::*;
    use crate::process::usage::rss_bytes;

    #[test]
    fn large_pictures_are_given_back_between_others_that_stay() {
        const PICTURE: usize = 3 << 20;
        keep_no_large_pictures();
        // after one was given back, the allocator would keep those of its size
        drop(vec![1u8; PICTURE]);
        let before = rss_bytes().unwrap();
        let mut pictures: Vec<Vec<u8>> = (0..64).map(|_| vec![1; PICTURE]).collect();
        for picture in pictures.iter_mut().step_by(2) {
            *picture = Vec::new();
        }
        let held = rss_bytes().unwrap().saturating_sub(before);
        let expected = 32 * PICTURE as u64;
        assert!(held < expected * 5 / 4, "{held} instead of {expected}");
        assert_eq!(pictures.len(), 64);
    }
}
