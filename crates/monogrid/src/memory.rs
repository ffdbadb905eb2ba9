//! What the allocator of the system does with memory that is free again.

/// Blocks from this size on, bytes, go back to the system as soon as they are free.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const LARGE_BLOCK: libc::c_int = 256 << 10;

/// Lets blocks as large as images go back to the system when they are free.
///
/// glibc raises its own limit to the largest block that was ever free, up to 32 MB; from then on images of all
/// sizes lie between long-lived blocks, and as much again as is in use is held by the gaps.
pub fn return_large_blocks() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[allow(
        unsafe_code,
        reason = "a setting of the allocator, changed before any other thread exists; there is no safe call for it"
    )]
    unsafe {
        // refused by other allocators in its place: then everything stays as it is
        let _ = libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BLOCK);
    }
}
