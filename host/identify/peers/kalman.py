"""Extended Kalman filters by filterpy: the paper's four states, repaired, and the three that suffice.

In units of the capture's rms current and voltage, R and L as means over a switching period.

four: i, its change per sample, R, x4; eq. (15) to (19) with the repairs of docs/identification.md: the change per
sample, the voltage in the middle between two samples, L/T_s = x4 - R/2, a start from the mean phasors, Σ_w
without its cross term. Tuned as `ihd identify --method ekf` is.

three: i, R, L/T_s with the measured voltage as input, the trapezoidal rule as the circuit and the current
as the only measurement; the voltage's noise is the process noise of i.
"""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

import demodulation

# Standard deviations a sample of 20 ns, in units of the capture's rms: see `ihd_identify::ekf::EkfTuning`.
CURRENT, SLOPE, IMPEDANCE, START = 4e-4, 1.3e-3, 3e-4, 0.25
CURRENT_FLOOR, VOLTAGE_FLOOR = 4e-3, 6e-3
# Of the three states: of 3e-5, 1e-4, 3e-4, 6e-4 and 1.2e-3 the one with the least sum of errors over three captures.
THREE_IMPEDANCE = 3e-4
THREE_CURRENT_FLOOR, THREE_VOLTAGE_FLOOR = 1e-3, 2e-3


class Prepared:
    """Samples and mean impedance in units of rms, noise as the phasors leave it."""

    def __init__(self, capture):
        rms = lambda x: np.sqrt(np.mean(x**2))
        self.i_unit, self.v_unit = rms(capture.i_a), rms(capture.v_v)
        self.i, v = capture.i_a / self.i_unit, capture.v_v / self.v_unit
        self.v = 0.5 * (v + np.append(v[1:], v[-1]))
        self.omega_dt = 2 * np.pi * capture.f_sw_hz * capture.dt_s
        _, v_phasor, i_phasor, _ = demodulation.phasors(capture, 0, len(capture.t_s))
        z = np.vdot(i_phasor, v_phasor) / np.vdot(i_phasor, i_phasor) * self.i_unit / self.v_unit
        self.r, self.inductance, self.z = z.real, z.imag / self.omega_dt, abs(z)
        self.i_noise, self.v_noise = white(self.i), white(v)


def white(x):
    """Standard deviation of white noise: third differences forget the waveform, the median its edges."""
    difference = x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3]
    return np.median(np.abs(difference)) / 0.6745 / np.sqrt(20)


def four_states(capture):
    p = Prepared(capture)
    filter = ExtendedKalmanFilter(dim_x=4, dim_z=2)
    filter.x = np.array([0, 0, p.r, p.inductance + 0.5 * p.r])
    filter.F = np.eye(4)
    filter.F[0, 1] = 1
    filter.Q = np.diag(np.square([CURRENT, SLOPE, IMPEDANCE, IMPEDANCE / p.omega_dt]))
    filter.R = np.diag([max(p.i_noise, CURRENT_FLOOR) ** 2, max(p.v_noise, VOLTAGE_FLOOR) ** 2])
    filter.P = np.diag(np.square([1, p.omega_dt, START * p.z, START * p.z / p.omega_dt]))
    h = np.zeros((2, 4))
    h[0, 0] = 1

    def jacobian(x):
        h[1] = x[2], x[3], x[0], x[1]
        return h

    measured = lambda x: np.array([x[0], x[0] * x[2] + x[1] * x[3]])
    found = np.empty((len(p.i), 2))
    for k, z in enumerate(np.column_stack([p.i, p.v])):
        filter.predict()
        filter.update(z, jacobian, measured)
        found[k] = filter.x[2], filter.x[3] - 0.5 * filter.x[2]
    return means(capture, p, found)


class Trapezoidal(ExtendedKalmanFilter):
    """States i, R, L/T_s; `predict` takes the mean voltage of the step."""

    def predict_x(self, u=0):
        i, r, l = self.x
        below, above = l - 0.5 * r, l + 0.5 * r
        after = (below * i + u) / above
        self.F[0] = below / above, -0.5 * (i + after) / above, (i - after) / above
        self.x = np.array([after, r, l])


def three_states(capture, impedance=THREE_IMPEDANCE):
    p = Prepared(capture)
    filter = Trapezoidal(dim_x=3, dim_z=1)
    filter.x = np.array([p.i[0], p.r, p.inductance])
    filter.F = np.eye(3)
    v_noise = max(np.sqrt(0.5) * p.v_noise, THREE_VOLTAGE_FLOOR)
    filter.Q = np.diag(np.square([v_noise / p.inductance, impedance, impedance / p.omega_dt]))
    filter.R = np.array([[max(p.i_noise, THREE_CURRENT_FLOOR) ** 2]])
    filter.P = np.diag(np.square([1, START * p.z, START * p.z / p.omega_dt]))
    h = np.array([[1.0, 0.0, 0.0]])
    jacobian, measured = (lambda x: h), (lambda x: x[:1])
    found = np.empty((len(p.i), 2))
    found[0] = filter.x[1:]
    for k in range(1, len(p.i)):
        filter.predict(p.v[k - 1])
        filter.update(p.i[k : k + 1], jacobian, measured)
        found[k] = filter.x[1:]
    return means(capture, p, found)


def means(capture, prepared, found):
    """R in ohm and L in henry, one a switching period."""
    period = np.floor((capture.t_s - capture.t_s[0]) * capture.f_sw_hz).astype(int)
    count = np.bincount(period)
    mean = lambda x: np.bincount(period, x) / count
    ohm = prepared.v_unit / prepared.i_unit
    return mean(capture.t_s), ohm * mean(found[:, 0]), ohm * capture.dt_s * mean(found[:, 1])
