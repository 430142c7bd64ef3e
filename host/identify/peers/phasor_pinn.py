"""A physics-informed network on phasors in JAX: R(t) and ωL(t) as a small MLP, Adam and then L-BFGS.

Half-cycle by half-cycle: phasors of V and I, one each switching period; I(t) as a B-spline by least squares;
then a network of two layers sees sine and cosine of the mains phase and gives ln R and ln ωL, so that

    |V - R·I - ωL·(jI + I'/ω)|²/σ² + |θ|²/WIDTH²

becomes least over its weights θ; σ² is the noise that both B-splines leave. All in double precision.
"""

import os

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import minimize

import demodulation
from spline_fit import CURRENT_INTERVALS, Basis, fitted

jax.config.update("jax_enable_x64", True)

HIDDEN = (8, 8)
# Expected size of a weight: of .2, .3, .5, 1 and 2 the one with the least sum of errors over the table.
WIDTH = 0.5
ADAM_STEPS, ADAM_RATE = 300, 0.01
LBFGS_STEPS = 3000


def initial(seed):
    rng = np.random.default_rng(seed)
    widths = (2, *HIDDEN, 2)
    layers = [
        (rng.normal(0, np.sqrt(1 / a), (a, b)), np.zeros(b)) for a, b in zip(widths[:-1], widths[1:])
    ]
    layers[-1] = (0.1 * layers[-1][0], layers[-1][1])
    return ravel_pytree(jax.tree.map(jnp.asarray, layers))


START, UNRAVEL = initial(1)


def network(theta, features):
    x = features
    layers = UNRAVEL(theta)
    for w, b in layers[:-1]:
        x = jnp.tanh(x @ w + b)
    w, b = layers[-1]
    return jnp.exp(x @ w + b)


def loss(theta, data):
    features, v, i, d, mean, variance = data
    r, reactance = (network(theta, features) * mean).T
    rest = v - r * i - reactance * d
    return 0.5 * jnp.sum(jnp.abs(rest) ** 2) / variance + 0.5 * jnp.sum(theta**2) / WIDTH**2


gradient = jax.jit(jax.value_and_grad(loss))


@jax.jit
def adam(theta, data):
    def step(k, state):
        theta, mean, square = state
        g = jax.grad(loss)(theta, data)
        mean, square = 0.9 * mean + 0.1 * g, 0.999 * square + 0.001 * g * g
        count = k + 1.0
        change = mean / (1 - 0.9**count) / (jnp.sqrt(square / (1 - 0.999**count)) + 1e-8)
        return theta - ADAM_RATE * change, mean, square

    zeros = jnp.zeros_like(theta)
    return jax.lax.fori_loop(0, ADAM_STEPS, step, (theta, zeros, zeros))[0]


def identify(capture):
    found = [half_cycle(capture, *half) for half in capture.half_cycles()]
    return tuple(np.concatenate(column) for column in zip(*found))


def half_cycle(capture, first, end):
    t_s, v, i, _ = demodulation.phasors(capture, first, end)
    omega = 2 * np.pi * capture.f_sw_hz
    basis = Basis(t_s, CURRENT_INTERVALS)
    coefficients, i_noise = fitted(basis, i)
    _, v_noise = fitted(basis, v)
    i, d = basis.values @ coefficients, (1j * basis.values + basis.slopes / omega) @ coefficients
    z = np.vdot(i, v) / np.vdot(i, i)
    phase = 2 * np.pi * capture.mains_hz * t_s
    features = np.column_stack([np.abs(np.sin(phase)) - 0.6, np.sign(np.sin(phase)) * np.cos(phase)])
    variance = v_noise**2 + abs(z) ** 2 * i_noise**2
    data = tuple(jnp.asarray(x) for x in (features, v, i, d, np.array([z.real, z.imag]), variance))
    theta = np.asarray(adam(START, data))

    def value(theta):
        value, slope = gradient(theta, data)
        return float(value), np.asarray(slope)

    options = {"maxiter": LBFGS_STEPS, "maxfun": 2 * LBFGS_STEPS, "maxcor": 50, "ftol": 1e-13, "gtol": 1e-9}
    theta = minimize(value, theta, jac=True, method="L-BFGS-B", options=options).x
    r, reactance = np.asarray(network(jnp.asarray(theta), features)).T
    return t_s, z.real * r, z.imag * reactance / omega
