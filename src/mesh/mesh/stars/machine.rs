//! Which vectors a machine has, and the code that is compiled for each.
#![allow(unsafe_code)]

use super::batch::Batch;
use super::wide::{Neighbourhood, View};
use super::{Star, StarGrid};
#[cfg(target_arch = "x86_64")]
use crate::simd::{Avx2, Avx512, F32x8, F32x16, may_use_all};
use crate::simd::{Lanes, Vec4x2};

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

    /// [`Neighbourhood::star`].
    #[inline]
    pub(super) fn star(
        self,
        near: &mut Neighbourhood,
        grid: &StarGrid,
        rows: &[[u32; 2]],
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Wide(wide) => near.star(wide, grid, rows, view, is_outer),
            #[cfg(target_arch = "x86_64")]
            Self::Narrow(narrow) => near.star(narrow, grid, rows, view, is_outer),
            Self::Plain(plain) => near.star(plain, grid, rows, view, is_outer),
        }
    }
}

/// A machine that has some: code that is compiled for them.
pub(super) trait Machine: Copy {
    type Batch: Batch;
    /// [`Neighbourhood::gather`].
    fn gather(
        self,
        near: &mut Neighbourhood,
        grid: &StarGrid,
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
        grid: &StarGrid,
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
                grid: &StarGrid,
                rows: &[[u32; 2]],
                p: [f32; 3],
                reach: f32,
            ) -> bool {
                #[target_feature(enable = $features)]
                fn gather(
                    token: $token,
                    near: &mut Neighbourhood,
                    grid: &StarGrid,
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

impl Neighbourhood {
    /// Closes the star of point `p` among those within the reach.
    fn star<M: Machine>(
        &mut self,
        machine: M,
        grid: &StarGrid,
        rows: &[[u32; 2]],
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star {
        if !machine.gather(self, grid, rows, view.at, view.reach) {
            return Star::Doubtful;
        }
        // With AVX-512, at most 8.
        let star = match self.batches(M::Batch::LANES) {
            0..=2 => machine.close::<2>(self, view, is_outer),
            3 => machine.close::<3>(self, view, is_outer),
            4 => machine.close::<4>(self, view, is_outer),
            5 => machine.close::<5>(self, view, is_outer),
            6 => machine.close::<6>(self, view, is_outer),
            7 | 8 => machine.close::<8>(self, view, is_outer),
            9..=12 => machine.close::<12>(self, view, is_outer),
            _ => machine.close::<16>(self, view, is_outer),
        };
        if !matches!(star, Star::Whole) {
            self.close_gates();
        }
        star
    }
}
