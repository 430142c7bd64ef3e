//! State of the time stepping: field strength and flux density per depth node at the two known
//! instants, and the coefficients that one half of a step leaves for the other.

use pulp::Arch;

use super::nodes::OneMetal;

/// Flux linkage at the next instant as a function of the current then: λ = λ0 + L i.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FluxLine {
    /// λ0 in weber.
    pub lambda0_wb: f64,
    /// L in henry.
    pub l_h: f64,
}

/// Values of a quantity at the two known instants.
#[derive(Clone, Debug)]
pub(super) struct History<T> {
    pub(super) now: T,
    pub(super) before: T,
}

/// State of the load in time, with `N` rings.
#[derive(Clone, Debug)]
pub struct RingLoad<const N: usize, C = OneMetal> {
    pub(super) arch: Arch,
    pub(super) nodes: C,
    pub(super) l0_h: f64,
    pub(super) p: [f64; N],
    pub(super) w: [f64; N],
    pub(super) s: [[f64; N]; N],
    /// H per depth node (surface first), in A/m.
    pub(super) h: History<Vec<[f64; N]>>,
    /// B per depth node, in tesla.
    pub(super) b: History<Vec<[f64; N]>>,
    /// Flux that crossed the surface beyond the surface half cell, in Wb/m.
    pub(super) a_inner: History<[f64; N]>,
    /// H_n = e H_{n−1} + f after elimination.
    pub(super) e: Vec<[f64; N]>,
    pub(super) f: Vec<[f64; N]>,
    /// Predicted slope and offset of B at each node: B = slope·H + offset.
    pub(super) slope: Vec<[f64; N]>,
    pub(super) offset: Vec<[f64; N]>,
    pub(super) surface: Surface<N>,
}

/// Result of [`RingLoad::predict`], kept for `commit`: A = a0 + a1 i = base + gain H.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface<const N: usize> {
    pub(super) a0: [f64; N],
    pub(super) a1: [f64; N],
    pub(super) base: [f64; N],
    pub(super) gain: [f64; N],
    pub(super) inner_base: [f64; N],
}
