#!/usr/bin/env python3
"""CPU time of one full-batch epoch of the paper's two networks on 50 000 points, one thread: this
crate's backends against JAX in the same run.

    pip install "jax[cpu]"
    cargo build --release -p ihd-pinn --examples
    python3 host/pinn/peers/epoch.py target/release/examples/measure

Processor time, not wall time, so that other programs on the machine disturb less. The networks are
those of the preset paper-repaired: 8-64-64-64-2 sine with tangent, 2-16-16-16-16-2 tanh and softplus,
eq. (7), one step of Adam.
"""

import os
import resource
import subprocess
import sys
import time

os.environ["XLA_FLAGS"] = (
    "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("RAYON_NUM_THREADS", "1")
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

POINTS = 50_000


def children_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def own_ms(measure, backend, few, many):
    """Milliseconds of one epoch: the difference between trainings of `many` and `few` epochs."""

    def training_s(epochs):
        before = children_s()
        subprocess.run(
            [
                measure,
                "preset=paper-repaired",
                "rate=5e6",
                "downsampling=1",
                "khz=45",
                f"backend={backend}",
                f"max_iterations={epochs}",
            ],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        return children_s() - before

    return 1e3 * (training_s(many) - training_s(few)) / (many - few)


def jax_ms(epochs):
    import jax
    import jax.numpy as jnp
    import numpy as np

    rng = np.random.default_rng(1)

    def layers(widths):
        shapes = zip(widths[:-1], widths[1:])
        limits = [((a, b), np.sqrt(6 / (a + b))) for a, b in shapes]
        return [
            (
                jnp.asarray(rng.uniform(-limit, limit, shape), jnp.float32),
                jnp.zeros(shape[1], jnp.float32),
            )
            for shape, limit in limits
        ]

    theta = (layers([8, 64, 64, 64, 2]), layers([2, 16, 16, 16, 16, 2]))
    fast, rate = (
        jnp.asarray(rng.uniform(-1, 1, (POINTS, 8)), jnp.float32) for _ in range(2)
    )
    slow = jnp.asarray(rng.uniform(-1, 1, (POINTS, 2)), jnp.float32)
    v, i = (jnp.asarray(rng.uniform(-1, 1, POINTS), jnp.float32) for _ in range(2))

    def mlp(weights, activation, x):
        for w, b in weights[:-1]:
            x = activation(x @ w + b)
        w, b = weights[-1]
        return x @ w + b

    def loss(theta):
        said, said_rate = jax.jvp(
            lambda x: mlp(theta[0], jnp.sin, x), (fast,), (rate,)
        )
        y = jax.nn.softplus(mlp(theta[1], jnp.tanh, slow))
        physics = said[:, 0] - 0.7 * y[:, 0] * said[:, 1] - 0.9 * y[:, 1] * said_rate[:, 1]
        data = jnp.mean((said[:, 0] - v) ** 2) + jnp.mean((said[:, 1] - i) ** 2)
        return 5.0 * jnp.mean(physics**2) + data

    @jax.jit
    def step(theta, mean, square, count):
        gradient = jax.grad(loss)(theta)
        mean = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, mean, gradient)
        square = jax.tree.map(lambda s, g: 0.999 * s + 0.001 * g * g, square, gradient)

        def move(x, m, s):
            m, s = m / (1 - 0.9**count), s / (1 - 0.999**count)
            return x - 1e-3 * m / (jnp.sqrt(s) + 1e-8)

        return jax.tree.map(move, theta, mean, square), mean, square

    zeros = jax.tree.map(jnp.zeros_like, theta)
    state = (theta, zeros, zeros)
    state = jax.block_until_ready(step(*state, 1.0))
    started = time.process_time()
    for epoch in range(epochs):
        state = step(*state, epoch + 2.0)
    jax.block_until_ready(state)
    return 1e3 * (time.process_time() - started) / epochs


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    measure = sys.argv[1]
    fused = own_ms(measure, "fused", 2, 22)
    rows = [("fused", fused)]
    rows += [(name, own_ms(measure, name, 2, 7)) for name in ("flex", "ndarray")]
    rows.append(("jax", jax_ms(20)))
    print("backend   ms/epoch   times fused")
    for name, ms in rows:
        print(f"{name:8}  {ms:8.1f}   {ms / fused:6.2f}")


if __name__ == "__main__":
    main()
