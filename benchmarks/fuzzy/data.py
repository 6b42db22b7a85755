"""Records and functions by which fuzzy models are measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.core import System, Variable, simulate
from hybrid_sysid_ros.identification import PreparedRecord
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.arrays import Array

RIG = Path(__file__).parent / "rational"
SEEDS = (0, 1, 2)
STEP = 0.05
SAMPLES, TESTED = 1000, 400
LEVEL, DRIVE = Variable(name="level", unit="1"), Variable(name="drive", unit="1")


def experiment(inputs: Array, outputs: Array, name: str) -> PreparedRecord:
    """Of inputs (samples, m) and outputs (samples + 1, 1)."""
    sampling = Sampling(step=STEP, period=STEP)
    return PreparedRecord(name=name, sampling=sampling, inputs=inputs, outputs=outputs, states=outputs)


def training(plant: System, seed: int, *, noise: float = 0.0) -> PreparedRecord:
    """The plant under uniform inputs within +-2, measured with noise."""
    random = np.random.default_rng(seed)
    inputs = random.uniform(-2.0, 2.0, (SAMPLES, 1))
    outputs = simulate(plant, np.zeros(1), inputs, step=STEP)
    return experiment(inputs, outputs + noise * random.normal(size=outputs.shape), f"seed {seed}")


def driven() -> Array:
    """U = sin(2 pi k / 250) + .8 sin(2 pi k / 25), (TESTED, 1)."""
    k = np.arange(TESTED)
    return np.asarray((np.sin(2.0 * np.pi * k / 250.0) + 0.8 * np.sin(2.0 * np.pi * k / 25.0))[:, None])


def free_run_error(plant: System, model: System) -> float:
    """Root mean square error of a free run under :func:`driven`, without noise."""
    runs = [simulate(system, np.zeros(1), driven(), step=STEP) for system in (plant, model)]
    return float(np.sqrt(np.mean((runs[0] - runs[1]) ** 2)))


def mackey_glass(length: int, *, delay: int = 17, start: float = 1.2, parts: int = 10) -> Array:
    """X' = .2 x(t - 17) / (1 + x(t - 17)^10) - .1 x(t), x(t <= 0) = 0 but x(0) = 1.2, at t = 0, 1, ...; Runge-Kutta of
    .1, the delayed value in the middle of a step by the mean of its ends.
    """
    h, back = 1.0 / parts, delay * parts
    x = np.zeros(back + length * parts + 1)
    x[back] = start

    def rate(now: float, before: float) -> float:
        return 0.2 * before / (1.0 + before**10) - 0.1 * now

    for i in range(back, len(x) - 1):
        first, last = x[i - back], x[i - back + 1]
        middle = 0.5 * (first + last)
        a = rate(x[i], first)
        b = rate(x[i] + 0.5 * h * a, middle)
        c = rate(x[i] + 0.5 * h * b, middle)
        d = rate(x[i] + h * c, last)
        x[i + 1] = x[i] + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return x[back::parts]


def sines(u: Array) -> Array:
    """.6 sin(pi u) + .3 sin(3 pi u) + .1 sin(5 pi u)."""
    terms = zip((0.6, 0.3, 0.1), (1.0, 3.0, 5.0), strict=True)
    return np.asarray(sum(a * np.sin(n * np.pi * u) for a, n in terms))


def of_inputs(inputs: Array, values: Array, name: str) -> PreparedRecord:
    """A function of inputs (samples, m) with values (samples,) as a record, each value a sample later."""
    return experiment(inputs, np.concatenate([values[:1], values])[:, None], name)


def predicted(model: System, inputs: Array) -> Array:
    """Values of a model of inputs alone, (samples,)."""
    return np.asarray(simulate(model, np.zeros(1), inputs, step=STEP)[1:, 0])


def named(count: int) -> Sequence[Variable]:
    """So many inputs."""
    return [Variable(name=f"u{i + 1}", unit="1") for i in range(count)]
