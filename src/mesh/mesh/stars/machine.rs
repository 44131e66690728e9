//! Which vectors a machine has, and the code that is compiled for each.
#![allow(unsafe_code)]

use super::wide::{Neighbourhood, View};
use super::{Grid, Star};
#[cfg(target_arch = "x86_64")]
use crate::simd::{Avx2, Avx512, F32x8, F32x16, F64x4, F64x8, may_use_all};
use crate::simd::{F32s, F64s, Plain, Vec4x2};

/// The vectors that a machine has.
#[derive(Clone, Copy, Debug)]
pub(super) enum Vectors {
    #[cfg(target_arch = "x86_64")]
    Wide(Wide),
    #[cfg(target_arch = "x86_64")]
    Narrow(Narrow),
    Plain(AnyMachine),
}

impl Vectors {
    /// The widest ones.
    pub(super) fn found() -> Self {
        Self::all().into_iter().flatten().next().expect("all machines have plain ones")
    }

    /// All that there are, the widest first.
    pub(super) fn all() -> [Option<Self>; 3] {
        #[cfg(target_arch = "x86_64")]
        let [wide, narrow] = [Wide::found().map(Self::Wide), Narrow::found().map(Self::Narrow)];
        #[cfg(not(target_arch = "x86_64"))]
        let [wide, narrow] = [None, None];
        [wide, narrow, Some(Self::Plain(AnyMachine))]
    }
}

/// Lanes of `f32`, and half as many of `f64`.
pub(super) trait Batch: F32s {
    type Doubles: F64s<Token = Self::Token>;
    /// Whether there are registers for the points nearby.
    const HOLDS: bool;
}

impl Batch for Vec4x2 {
    type Doubles = Plain<f64, 4>;
    const HOLDS: bool = false;
}

#[cfg(target_arch = "x86_64")]
impl Batch for F32x8 {
    type Doubles = F64x4;
    const HOLDS: bool = false;
}

#[cfg(target_arch = "x86_64")]
impl Batch for F32x16 {
    type Doubles = F64x8;
    const HOLDS: bool = true;
}

/// A machine that has some: code that is compiled for them.
pub(super) trait Machine: Copy {
    type Batch: Batch;
    /// [`Neighbourhood::gather`].
    fn gather(
        self,
        near: &mut Neighbourhood,
        grid: &Grid,
        rows: &[[u32; 2]],
        p: [f32; 3],
        reach: f32,
    ) -> bool;
    /// [`Neighbourhood::close`].
    fn close<const N: usize>(
        self,
        near: &mut Neighbourhood,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star;
}

/// Any machine.
#[derive(Clone, Copy, Debug)]
pub(super) struct AnyMachine;

impl Machine for AnyMachine {
    type Batch = Vec4x2;
    fn gather(
        self,
        near: &mut Neighbourhood,
        grid: &Grid,
        rows: &[[u32; 2]],
        p: [f32; 3],
        reach: f32,
    ) -> bool {
        near.gather::<Vec4x2>((), grid, rows, p, reach)
    }
    fn close<const N: usize>(
        self,
        near: &mut Neighbourhood,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star {
        near.close::<N, Vec4x2>((), view, is_outer)
    }
}

/// A machine with these vectors, and with what else the code is compiled for.
#[cfg(target_arch = "x86_64")]
macro_rules! machine {
    ($(#[$doc:meta])* $name:ident($token:ident), $batch:ident, compiled for $features:tt, also $($also:literal = $detected:tt),*) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub(super) struct $name($token);

        impl $name {
            fn found() -> Option<Self> {
                let also = may_use_all!($($also = $detected),*);
                $token::found().filter(|_| also).map(Self)
            }
        }

        impl Machine for $name {
            type Batch = $batch;
            fn gather(
                self,
                near: &mut Neighbourhood,
                grid: &Grid,
                rows: &[[u32; 2]],
                p: [f32; 3],
                reach: f32,
            ) -> bool {
                #[target_feature(enable = $features)]
                fn gather(
                    token: $token,
                    near: &mut Neighbourhood,
                    grid: &Grid,
                    rows: &[[u32; 2]],
                    p: [f32; 3],
                    reach: f32,
                ) -> bool {
                    near.gather::<$batch>(token, grid, rows, p, reach)
                }
                // SAFETY: the features were found when this was made.
                unsafe { gather(self.0, near, grid, rows, p, reach) }
            }
            fn close<const N: usize>(
                self,
                near: &mut Neighbourhood,
                view: &View,
                is_outer: impl Fn([u32; 3]) -> bool,
            ) -> Star {
                #[target_feature(enable = $features)]
                fn close<const N: usize>(
                    token: $token,
                    near: &mut Neighbourhood,
                    view: &View,
                    is_outer: impl Fn([u32; 3]) -> bool,
                ) -> Star {
                    near.close::<N, $batch>(token, view, is_outer)
                }
                // SAFETY: the features were found when this was made.
                unsafe { close::<N>(self.0, near, view, is_outer) }
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
machine! {
    /// A machine with AVX2.
    Narrow(Avx2), F32x8,
    compiled for "avx2,fma,bmi1,bmi2,popcnt,lzcnt",
    also "LZCNT" = "lzcnt", "POPCNT" = "popcnt"
}

#[cfg(target_arch = "x86_64")]
machine! {
    /// A machine with AVX-512.
    Wide(Avx512), F32x16,
    compiled for "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt",
    also "LZCNT" = "lzcnt", "POPCNT" = "popcnt", "AVX512DQ" = "avx512dq"
}
