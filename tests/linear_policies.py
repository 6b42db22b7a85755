"""Policies of linear MPCs that are never bounded: the exact law, by hand, and that law broken. Of a beam with one input
and of two carts with two, of which one output is a difference of states and one is not tracked.
"""

from dataclasses import dataclass, replace
from math import factorial

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.control.policy.kernels import TrainingRange
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.core import RungeKutta, System, bounded
from tests.one_joint import Linear

SEAL = "5ea1"
SMALL = 1e-5
BROKEN_BY = 5.0  # units of the first input


@dataclass(frozen=True, kw_only=True)
class Carts(System):
    """Two carts of 1 kg joined by a spring and a damper, each pushed; the first is also held by a spring.

    x1'' = u1 - s x1 - k (x1 - x2) - c (v1 - v2) - c v1,  x2'' = u2 + k (x1 - x2) + c (v1 - v2) - c v2.
    """

    states = ("one [m]", "two [m]", "speed_one [m/s]", "speed_two [m/s]")
    inputs = ("push_one [N]", "push_two [N]")
    outputs = ("one", "speed_two", "stretch [m]")
    stepper = RungeKutta()

    held: float = bounded(2.0, 0.1, 10.0, unit="N/m")
    """s."""
    spring: float = bounded(5.0, 0.1, 50.0, unit="N/m")
    """k."""
    damping: float = bounded(1.5, 0.0, 10.0, unit="N s/m")
    """c."""

    def law(self, x, u):
        force = self.spring * (x[0] - x[1]) + self.damping * (x[2] - x[3])
        first = u[0] - self.held * x[0] - force - self.damping * x[2]
        return x[2], x[3], first, u[1] + force - self.damping * x[3]

    def output(self, x, u):
        return x[0], x[3], x[1] - x[0]


@dataclass(frozen=True)
class Case:
    """A linear system, as one and by matrices: x+ = a x + b u + offset over a period, y = c x."""

    system: System
    problem: ControlProblem
    a: np.ndarray
    b: np.ndarray
    offset: np.ndarray
    c: np.ndarray

    @property
    def tracked(self):
        return [k for k, weight in enumerate(self.problem.output_weights) if weight]

    @property
    def size(self):
        """Of an instance."""
        (p, n), m = self.c.shape, self.b.shape[1]
        return n + 2 * m + self.problem.horizon * p

    def parts(self, flat):
        (p, n), m = self.c.shape, self.b.shape[1]
        return flat[:n], flat[n : n + m], flat[n + m : n + 2 * m], flat[n + 2 * m :].reshape(-1, p)

    def least_squares(self, flat):
        """|| M U - v ||^2 is the cost, U the inputs in a row."""
        state, disturbance, previous, preview = self.parts(flat)
        problem, m, n = self.problem, self.b.shape[1], self.problem.horizon
        weights = np.sqrt(problem.output_weights) / np.array(problem.output_scales)
        x, effect, rows, right = np.array(state), np.zeros((len(self.a), n * m)), [], []
        for i in range(n):
            x, effect = self.a @ x + self.b @ disturbance + self.offset, self.a @ effect
            effect[:, i * m : (i + 1) * m] += self.b
            rows.append(weights[:, None] * (self.c @ effect))
            right.append(weights * (preview[i] - self.c @ x))
        changes = np.eye(n * m) - np.eye(n * m, k=-m)
        rows.append(np.tile(np.sqrt(problem.rate_weights), n)[:, None] * changes)
        right.append(np.concatenate([np.sqrt(problem.rate_weights) * previous, np.zeros((n - 1) * m)]))
        rows.append(np.diag(np.tile(np.sqrt(problem.input_weights), n)))
        right.append(np.zeros(n * m))
        return np.vstack(rows), np.concatenate(right)

    def plan(self, flat):
        """The best inputs (horizon, m), by the normal equations."""
        matrix, right = self.least_squares(flat)
        return np.linalg.solve(matrix.T @ matrix, matrix.T @ right).reshape(-1, self.b.shape[1])


def _beam():
    system = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
    problem = ControlProblem(
        horizon=8,
        period=0.02,
        substeps=4,
        output_weights=(25.0,),
        output_scales=(0.0227,),
        rate_weights=(1.0,),
        input_low=(-100.0,),  # never reached: the exact law is linear
        input_high=(100.0,),
        smoothing=0.005,
        max_iterations=50,
    ).sized(system)
    h = problem.period / problem.substeps
    half = 0.5 * h * system.damping  # trapezoidal damping, the rest semi-implicit
    velocity = np.array([-h * system.stiffness, 1 - half]) / (1 + half)
    a = np.array([np.array([1.0, 0.0]) + h * velocity, velocity])
    b = (h * system.gain / (1 + half) * np.array([h, 1.0]))[:, None]
    a, b = _over(a, b, problem.substeps)
    return Case(system, problem, a, b, -b[:, 0] * system.centre, np.array([[1.0, 0.0]]))


def _carts():
    system = Carts()
    problem = ControlProblem(
        horizon=6,
        period=0.1,
        substeps=2,
        output_weights=(50.0, 0.0, 20.0),
        output_scales=(0.5, 1.0, 0.5),
        rate_weights=(1.0, 0.5),
        input_weights=(0.0, 0.01),
        input_low=(-100.0, -40.0),
        input_high=(100.0, 160.0),
        max_iterations=50,
    ).sized(system)
    h, s, k, d = problem.period / problem.substeps, system.held, system.spring, system.damping
    rates = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-s - k, k, -2 * d, d], [k, -k, d, -2 * d]], dtype=float)
    power = [np.linalg.matrix_power(h * rates, i) for i in range(5)]
    a = sum(power[i] / factorial(i) for i in range(5))  # Runge-Kutta of order four
    b = h * sum(power[i] / factorial(i + 1) for i in range(4)) @ np.eye(4)[:, 2:]
    a, b = _over(a, b, problem.substeps)
    c = np.array([[1.0, 0, 0, 0], [0, 0, 0, 1.0], [-1.0, 1.0, 0, 0]])
    return Case(system, problem, a, b, np.zeros(4), c)


def _over(a, b, steps):
    """Matrices of so many steps with the input held."""
    return np.linalg.matrix_power(a, steps), sum(np.linalg.matrix_power(a, k) for k in range(steps)) @ b


BEAM, CARTS = _beam(), _carts()
CASES = {"beam": BEAM, "carts": CARTS}


def exact_policy(case):
    """The exact law u = K [x, d, u_previous, q] + k."""
    return _policy(case, 0.0, 0.0)


def broken_policy(case):
    """The exact law, but the first input is off by a constant where its estimated disturbance is positive."""
    return _policy(case, 1e9, BROKEN_BY / 2)


def _policy(case, switch, effect):
    """Hidden units so small that they are straight, and one more that is switched by the first disturbance."""
    problem, (p, n), m = case.problem, case.c.shape, case.b.shape[1]
    count, tracked = problem.horizon * m, case.tracked
    offset = case.plan(np.zeros(case.size)).ravel()
    gains = np.array([case.plan(row).ravel() - offset for row in np.eye(case.size)]).T
    previews = gains[:, n + 2 * m :].reshape(count, -1, p)[:, :, tracked]
    output_map = case.c[tracked]
    gains = np.hstack([gains[:, : n + 2 * m], previews.reshape(count, -1)])
    gains[:, :n] += previews.sum(axis=1) @ output_map  # of the features the preview is q - C x
    low, high = np.tile(problem.input_low, problem.horizon), np.tile(problem.input_high, problem.horizon)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    features = gains.shape[1]
    switches, effects = np.zeros(features), np.where(np.arange(count) % m == 0, effect, 0.0)
    switches[n] = switch
    return Policy(
        problem=problem,
        model=SEAL,
        rig="cam_beam",
        output_map=output_map,
        centre=np.zeros(features),
        scale=np.ones(features),
        layers=(
            (np.vstack([SMALL * gains, switches]), np.zeros(count + 1)),
            (np.column_stack([np.eye(count) / SMALL, effects]) / half[:, None], (offset + effects - middle) / half),
        ),
        training_range=TrainingRange(
            low=np.full(features, -1e3), high=np.full(features, 1e3), whitening=np.zeros((features,) * 2), reach=1.0
        ),
    )


def checked(policy, seed=0):
    """With self-check vectors, which are its own answers."""
    features = np.random.default_rng(seed).normal(scale=0.01, size=(3, len(policy.centre)))
    return replace(policy, check=(features, policy.evaluate(features)))
