"""Maximum likelihood in SciPy: current, R and ωL as B-splines in slow time, a trust-region fit to phasors.

Half-cycle by half-cycle:

1. phasors of V and I, one each switching period (demodulation);
2. I(t) as a B-spline by least squares;
3. R and ωL as B-splines through V = R·I + ωL·(jI + I'/ω), with a penalty on bends whose weight is the one of
   largest restricted likelihood (REML), so that nothing is tuned by hand;
4. all coefficients together by `scipy.optimize.least_squares`, the noise of both channels in its place.

Knots lie closer near the zero crossings, where R and L change fastest.
"""

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares

import demodulation

CURRENT_INTERVALS = 24
IMPEDANCE_INTERVALS = 24
# Share of cosine in the spacing of the knots: 0 is even, 1 leaves the ends with a hundredth of the middle.
GRADING = 0.8
# REML's grid: weight of the penalty against the data.
WEIGHTS = np.logspace(-9, 6, 61)


class Basis:
    """Cubic B-splines from the first to the last of `t_s`, values and slopes at these times."""

    def __init__(self, t_s, intervals):
        u = np.linspace(0, 1, intervals + 1)
        share = (1 - GRADING) * u + GRADING * 0.5 * (1 - np.cos(np.pi * u))
        knots = t_s[0] + share * (t_s[-1] - t_s[0])
        knots = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
        spline = BSpline(knots, np.eye(len(knots) - 4), 3)
        self.values, self.slopes = spline(t_s), spline.derivative()(t_s)


def identify(capture):
    found = [half_cycle(capture, *half) for half in capture.half_cycles()]
    return tuple(np.concatenate(column) for column in zip(*found))


def half_cycle(capture, first, end):
    t_s, v, i, _ = demodulation.phasors(capture, first, end)
    omega = 2 * np.pi * capture.f_sw_hz
    scale = np.sqrt(np.mean(np.abs(v) ** 2) / np.mean(np.abs(i) ** 2))
    # Both in ampere: impedances are then in units of the mean one.
    unit = np.sqrt(np.mean(np.abs(i) ** 2))
    v, i = v / (scale * unit), i / unit
    current, impedance = Basis(t_s, CURRENT_INTERVALS), Basis(t_s, IMPEDANCE_INTERVALS)

    i_start, i_noise = fitted(current, i)
    _, v_noise = fitted(current, v)
    bend = np.diff(np.eye(impedance.values.shape[1]), 2, axis=0)
    smooth, slope = current.values @ i_start, current.slopes @ i_start
    start, weight, variance = restricted_likelihood(impedance.values, smooth, slope / omega, v, bend)
    problem = Problem(current, impedance, omega, v, i, v_noise, i_noise)
    # The penalty in units of the voltage's noise.
    problem.penalty = np.sqrt(weight / variance) * bend
    x = np.concatenate([i_start.real, i_start.imag, start])
    x = least_squares(problem.residuals, x, problem.jacobian, method="trf", x_scale="jac", max_nfev=20).x
    r, reactance = problem.impedances(x)
    return t_s, scale * r, scale * reactance / omega


def fitted(basis, x):
    """Coefficients of a complex B-spline by least squares, and the deviation of one component from it."""
    coefficients = np.linalg.lstsq(basis.values, x, rcond=None)[0]
    rest = x - basis.values @ coefficients
    free = len(x) - basis.values.shape[1]
    return coefficients, np.sqrt(0.5 * np.sum(np.abs(rest) ** 2) / free)


def restricted_likelihood(values, i, slope, v, bend):
    """R and ωL for a given current, the penalty's weight, and the variance of a component of the rest."""
    d = 1j * i + slope
    rows = [np.hstack([part(i)[:, None] * values, part(d)[:, None] * values]) for part in (np.real, np.imag)]
    a, b = np.vstack(rows), np.concatenate([v.real, v.imag])
    both = np.kron(np.eye(2), bend.T @ bend)
    normal, right = a.T @ a, a.T @ b
    rank, unpenalised = 2 * len(bend), 4
    best = (np.inf,)
    for weight in WEIGHTS:
        factor = cho_factor(normal + weight * both + 1e-14 * np.eye(len(normal)), lower=True)
        x = cho_solve(factor, right)
        squares = np.sum((a @ x - b) ** 2) + weight * x @ both @ x
        free = len(b) - unpenalised
        log_determinant = 2 * np.sum(np.log(np.diag(factor[0])))
        score = free * np.log(squares / free) + log_determinant - rank * np.log(weight)
        if score < best[0]:
            best = (score, x, weight, squares / free)
    return best[1:]


class Problem:
    """Residuals in units of their standard deviation; unknowns Re I, Im I, R, ωL, as coefficients."""

    def __init__(self, current, impedance, omega, v, i, v_noise, i_noise):
        self.current, self.impedance = current, impedance
        self.rate = current.slopes / omega
        self.v, self.i, self.v_noise, self.i_noise = v, i, v_noise, i_noise

    def parts(self, x):
        n, m = self.current.values.shape[1], self.impedance.values.shape[1]
        i = x[:n] + 1j * x[n : 2 * n]
        return i, x[2 * n : 2 * n + m], x[2 * n + m :]

    def impedances(self, x):
        _, r, reactance = self.parts(x)
        return self.impedance.values @ r, self.impedance.values @ reactance

    def residuals(self, x):
        coefficients, r, reactance = self.parts(x)
        i = self.current.values @ coefficients
        d = 1j * i + self.rate @ coefficients
        of_r, of_x = self.impedances(x)
        v = (of_r * i + of_x * d - self.v) / self.v_noise
        i = (i - self.i) / self.i_noise
        return np.concatenate([v.real, v.imag, i.real, i.imag, self.penalty @ r, self.penalty @ reactance])

    def jacobian(self, x):
        coefficients, _, _ = self.parts(x)
        i = self.current.values @ coefficients
        d = 1j * i + self.rate @ coefficients
        of_r, of_x = (z[:, None] for z in self.impedances(x))
        by_i = ((of_r + 1j * of_x) * self.current.values + of_x * self.rate) / self.v_noise
        by_r = i[:, None] * self.impedance.values / self.v_noise
        by_x = d[:, None] * self.impedance.values / self.v_noise
        own = self.current.values / self.i_noise
        none, zero = np.zeros_like(own), np.zeros((len(own), self.impedance.values.shape[1]))
        silent = np.zeros((len(self.penalty), self.current.values.shape[1]))
        off = np.zeros_like(self.penalty)
        return np.block(
            [
                [by_i.real, -by_i.imag, by_r.real, by_x.real],
                [by_i.imag, by_i.real, by_r.imag, by_x.imag],
                [own, none, zero, zero],
                [none, own, zero, zero],
                [silent, silent, self.penalty, off],
                [silent, silent, off, self.penalty],
            ]
        )
