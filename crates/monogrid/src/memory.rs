//! What the allocator of the system does with memory that is free again.
//!
//! glibc gives every thread a heap of its own and keeps what was freed in it, between blocks that live long: with images that
//! are made and dropped for every frame, twice as much memory as is in use.

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
    unsafe {
        // refused by another allocator in its place: then everything stays as it is
        let _ = libc::mallopt(libc::M_ARENA_MAX, MAX_HEAPS);
    }
}

/// Gives large blocks back to the system as soon as they are free, for a run that must stay within a limit: matrices of an adjustment
/// and lists of a report leave no holes. Costs a few percent of the time, since the system fills such blocks with zeros.
pub fn keep_little() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    unsafe {
        let _ = libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BYTES);
        let _ = libc::mallopt(libc::M_TRIM_THRESHOLD, 2 * LARGE_BYTES);
    }
}

/// The same for smaller blocks, for what comes after the last frame: keyframes are read back one after the other while long lists grow,
/// and leave holes between them.
pub fn keep_least() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    unsafe {
        let _ = libc::mallopt(libc::M_MMAP_THRESHOLD, SMALL_BYTES);
        let _ = libc::mallopt(libc::M_TRIM_THRESHOLD, 2 * SMALL_BYTES);
    }
}

/// Blocks from this size on are large: a working image of floats at 640x480 is, one at 320x240 is not.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const LARGE_BYTES: libc::c_int = 512 << 10;

/// After the last frame: that of a level of a pyramid but for its smallest.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const SMALL_BYTES: libc::c_int = 64 << 10;

/// Gives free memory back to the system. Costs a few milliseconds, and those pages that are needed again their zeros.
pub fn give_back() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    unsafe {
        let _ = libc::malloc_trim(0);
    }
}
