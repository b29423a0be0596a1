//! Loops over lanes in the widest registers that the processor has.

/// A function whose body, an `#[inline(always)]` function, is compiled twice: for any processor and for
/// one with AVX2. Both give the same bits: the order of sums is fixed, and nothing is fused.
macro_rules! wide {
    ($(#[$doc:meta])* $vis:vis fn $name:ident($($arg:ident: $kind:ty),* $(,)?) $(-> $out:ty)? = $body:path) => {
        $(#[$doc])*
        $vis fn $name($($arg: $kind),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn widely($($arg: $kind),*) $(-> $out)? {
                    $body($($arg),*)
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has AVX2.
                    #[allow(unsafe_code)]
                    return unsafe { widely($($arg),*) };
                }
            }
            $body($($arg),*)
        }
    };
}

pub(super) use wide;
