//! Loops that are compiled twice: as the target has it, and for AVX2.
#![allow(
    unsafe_code,
    reason = "instructions that not every processor has, asked for before"
)]

/// Defines a function that runs on wider vectors where the processor has them. The results are the
/// same bits: the operations are those of IEEE in the order in which they are written, and none are
/// joined.
macro_rules! for_avx2 {
    (
        $(#[$doc:meta])*
        $vis:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $returned:ty)?
        $body:block
    ) => {
        $(#[$doc])*
        #[inline]
        $vis fn $name($($argument: $type),*) $(-> $returned)? {
            #[inline(always)]
            fn any($($argument: $type),*) $(-> $returned)? $body
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide($($argument: $type),*) $(-> $returned)? {
                    any($($argument),*)
                }
                if is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has AVX2.
                    #[allow(unsafe_code, reason = "the processor was asked")]
                    return unsafe { wide($($argument),*) };
                }
            }
            any($($argument),*)
        }
    };
}

pub(crate) use for_avx2;
