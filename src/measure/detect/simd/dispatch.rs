//! Loops over lanes in the widest registers that the processor has.

/// A function whose body, an `#[inline(always)]` function, is compiled three times: for any processor, for one with AVX2,
/// for one with AVX-512. All give the same bits: the order of sums is fixed, and only what says so is fused.
/// Generic parameters stand in square brackets.
macro_rules! wide {
    (
        $(#[$doc:meta])*
        $vis:vis fn $name:ident $([$($of:tt)*])? ($($arg:ident: $kind:ty),* $(,)?) $(-> $out:ty)? = $body:path
    ) => {
        $(#[$doc])*
        $vis fn $name $(<$($of)*>)? ($($arg: $kind),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma,avx512f,avx512bw,avx512dq,avx512vl")]
                fn widest $(<$($of)*>)? ($($arg: $kind),*) $(-> $out)? {
                    $body($($arg),*)
                }
                #[target_feature(enable = "avx2,fma")]
                fn widely $(<$($of)*>)? ($($arg: $kind),*) $(-> $out)? {
                    $body($($arg),*)
                }
                use std::arch::is_x86_feature_detected as has;
                let avx2 = has!("avx2") && has!("fma");
                if avx2 && has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl") {
                    // SAFETY: the processor has all of them.
                    #[allow(unsafe_code)]
                    return unsafe { widest($($arg),*) };
                }
                if avx2 {
                    // SAFETY: the processor has both.
                    #[allow(unsafe_code)]
                    return unsafe { widely($($arg),*) };
                }
            }
            $body($($arg),*)
        }
    };
}

pub(in crate::detect) use wide;
