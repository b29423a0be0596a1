//! Loops in the widest registers of the processor.

/// Defines a function whose body, an `#[inline(always)]` function, is compiled three times: for any processor, for one with
/// AVX2, for one with AVX-512. The results are identical bit for bit: the order of sums is fixed, and operations are fused
/// only explicitly. Generic parameters are given in square brackets.
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
                fn with_avx512 $(<$($of)*>)? ($($arg: $kind),*) $(-> $out)? {
                    $body($($arg),*)
                }
                #[target_feature(enable = "avx2,fma")]
                fn with_avx2 $(<$($of)*>)? ($($arg: $kind),*) $(-> $out)? {
                    $body($($arg),*)
                }
                use std::arch::is_x86_feature_detected as has;
                let avx2 = has!("avx2") && has!("fma");
                if avx2 && has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl") {
                    // SAFETY: the processor has all of them.
                    #[allow(unsafe_code)]
                    return unsafe { with_avx512($($arg),*) };
                }
                if avx2 {
                    // SAFETY: the processor has both.
                    #[allow(unsafe_code)]
                    return unsafe { with_avx2($($arg),*) };
                }
            }
            $body($($arg),*)
        }
    };
}

pub(crate) use wide;
