//! Loops compiled for the widest vectors of the machine.
//!
//! [`wide`] compiles a function three times, for AVX-512, for AVX2 and for any machine; its first argument, a [`Machine`], says which one runs.
//! Nothing is fused and no sum is taken in another order, so all three give the same results to the bit.
//!
//! The wrong tool where a loop calls what does not vectorize: it stays as slow as it is.

/// The instructions that this machine has, or fewer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Machine(Vectors);

/// Kinds of vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Vectors {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Any,
}

impl Machine {
    /// This machine.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let avx2 = has!("avx2") && has!("bmi1") && has!("bmi2");
            let wide = has!("avx512f") && has!("avx512bw") && has!("avx512vl") && has!("avx512dq");
            if avx2 && wide {
                return Self(Vectors::Avx512);
            }
            if avx2 {
                return Self(Vectors::Avx2);
            }
        }
        Self(Vectors::Any)
    }

    /// Every machine that this one can stand for, the plainest first.
    #[cfg(test)]
    pub(crate) fn all() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        {
            let all = [Vectors::Any, Vectors::Avx2, Vectors::Avx512].map(Self);
            let count = all.iter().position(|&machine| machine == Self::detect());
            all[..=count.unwrap_or(0)].to_vec()
        }
        #[cfg(not(target_arch = "x86_64"))]
        vec![Self(Vectors::Any)]
    }

    /// Whether what is written for AVX-512 by hand may run.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn has_avx512(self) -> bool {
        self.0 == Vectors::Avx512
    }

    pub(crate) fn vectors(self) -> Vectors {
        self.0
    }
}

/// Defines a function whose body is compiled for all [`Vectors`]; its first argument is the [`Machine`] to run on.
macro_rules! wide {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name(machine: $crate::wide::Machine, $($arg: $type),*) $(-> $ret)? {
            #[inline(always)]
            fn body($($arg: $type),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,bmi1,bmi2")]
            fn avx2($($arg: $type),*) $(-> $ret)? {
                body($($arg),*)
            }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq,bmi1,bmi2")]
            fn avx512($($arg: $type),*) $(-> $ret)? {
                body($($arg),*)
            }

            match machine.vectors() {
                // SAFETY: the machine has the instructions.
                #[cfg(target_arch = "x86_64")]
                $crate::wide::Vectors::Avx512 => unsafe { avx512($($arg),*) },
                // SAFETY: the machine has the instructions.
                #[cfg(target_arch = "x86_64")]
                $crate::wide::Vectors::Avx2 => unsafe { avx2($($arg),*) },
                $crate::wide::Vectors::Any => body($($arg),*),
            }
        }
    };
}
pub(crate) use wide;
