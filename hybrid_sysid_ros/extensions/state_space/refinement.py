"""Refinement of a state-space model by the error of its simulation: Levenberg-Marquardt with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cdf2rdf, schur

from hybrid_sysid_ros.extensions.state_space.subspace import Matrices, Stretch
from hybrid_sysid_ros.extensions.state_space.tangents import Sizes, raise_to_largest, simulate_states, tangents
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

CHUNK = 2048
"""Samples whose derivatives are held at once."""
SEPARATE = 1e6
"""Condition of the eigenvectors below which each block of poles gets states of its own."""
ENDLESS = 1e6
"""Argument of a power that means that a simulation diverges."""
FLAT = 1e-9
"""Least sensitivity to a weight in its scaling, relative to the largest one: a column may be zero."""
PATIENCE = 8
"""Steps in a row that may fail to make the error smaller."""
ANSWER = 0.1
"""Prior deviation of what an output moves, in its deviation, after an input that moves by its own for one sample: a
record has tens of samples in the time in which a system answers.
"""
CALM = 500
"""Samples over which a model is asked to rest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """Weights (size,) and first states (stretches, states) after a refinement."""

    weights: Array
    firsts: Array
    mean_square: float
    """Mean squared error over all stretches, in the outputs' variance."""
    evaluations: int


def weights_of(model: Matrices, sizes: Sizes) -> Array:
    """Weights (size,) of a linear model in coordinates in which A has nothing but blocks of two along the diagonal,
    with a hidden layer of zeros. Where poles lie so close together that no such coordinates are usable, as with two
    integrators, A has further numbers above the blocks (Schur's form, which is reached by a rotation).
    """
    n, m = sizes.states, sizes.inputs
    poles, vectors = np.linalg.eig(model.a)
    if np.linalg.cond(vectors) < SEPARATE:
        a, turn = cdf2rdf(poles + 0j, vectors + 0j)
        back = np.linalg.inv(turn)
    else:
        a, turn = schur(model.a, output="real")
        back = turn.T
    weights = np.zeros(sizes.count)
    state = weights[: sizes.units_at].reshape(n, sizes.wide)
    state[:, :n], state[:, n : n + m] = a, back @ model.b
    output = weights[sizes.readout_at :].reshape(sizes.outputs, sizes.wide)
    output[:, :n], output[:, n : n + m], output[:, -1] = model.c @ turn, model.d, model.level
    return weights


def free_weights(weights: Array, sizes: Sizes, *, through: bool) -> NDArray[np.int64]:
    """Indices of the weights that are fitted: of A only the blocks of two along the diagonal, each of which has two
    real poles or a pair, since coordinates exist in which the rest is what it is.
    """
    n, m, wide = sizes.states, sizes.inputs, sizes.wide
    state, output = np.zeros((n, wide), dtype=bool), np.ones((sizes.outputs, wide), dtype=bool)
    state[:, n : n + m] = True
    state[:, -1] = sizes.units > 0
    output[:, n : n + m] = through
    a, k = weights[: sizes.units_at].reshape(n, wide)[:, :n], 0
    while k < n:
        pair = k + 1 < n and not (k + 2 < n and a[k + 1, k] == 0.0 and a[k + 2, k + 1] != 0.0)
        end = k + (2 if pair else 1)
        state[k:end, k:end] = True
        k = end
    units = np.ones(sizes.readout_at - sizes.units_at, dtype=bool)
    return np.flatnonzero(np.concatenate([state.ravel(), units, output.ravel()])).astype(np.int64)


def refine(
    weights: Array,
    sizes: Sizes,
    stretches: Sequence[Stretch],
    *,
    through: bool,
    ridge: float = 0.0,
    iterations: int = 50,
    tolerance: float = 1e-4,
    firsts: Array | None = None,
    widest: float = np.inf,
    progress: Any = None,
) -> Refined:
    """Weights that make the squared errors of the simulations over all stretches least, each from a first state that is
    fitted too.

    ridge: weight of the squared weights of the hidden layer, relative to the sum of squares. It ends where a step gains
    less than ``tolerance`` of the error three times in a row. widest: largest magnitude of the linear part's poles.
    Raises UserError where the first simulation diverges.

    A hidden layer is bounded. So where the linear part is stable, states are bounded whatever comes; where it is not,
    they run away from where the layer saturates, which the records may not show. Poles of a stable
    one stay within the unit circle.

    The tangent-linear model gives the derivatives; the first states are eliminated from the normal equations.
    """
    free = free_weights(weights, sizes, through=through)
    roles = _roles(free, sizes)
    starts = np.zeros((len(stretches), sizes.states)) if firsts is None else firsts.copy()
    total = sum(outputs.size for _, outputs in stretches)
    held = ridge * total * ((free >= sizes.units_at) & (free < sizes.readout_at)).astype(np.float64)
    weights, damping, failed, slow, evaluations = _rescaled(weights, sizes, starts, stretches), 1e-3, 0, 0, 1
    widest = min(widest, max(1.0, linear_radius(weights, sizes))) if sizes.units else widest
    cost, system = _normal(weights, sizes, stretches, starts, free, roles)
    if not np.isfinite(cost):
        raise UserError("state space: the model that it begins with diverges; take another order")
    cost += float(held @ weights[free] ** 2)
    for number in range(iterations):
        step, moved = _step(system, held, weights[free], damping)
        trial, moved_starts = weights.copy(), starts + moved
        trial[free] += step
        trial = _rescaled(shrunk(trial, sizes, widest), sizes, moved_starts, stretches)
        found, following = _normal(trial, sizes, stretches, moved_starts, free, roles)
        with np.errstate(over="ignore", invalid="ignore"):
            found += float(held @ trial[free] ** 2)
        evaluations += 1
        if not found < cost:
            damping, failed = damping * 8.0, failed + 1
            if failed > PATIENCE:
                break
            continue
        slow = slow + 1 if cost - found < tolerance * cost else 0
        weights, starts, system, cost, failed = trial, moved_starts, following, found, 0
        damping = max(damping * 0.2, 1e-12)
        if progress is not None:
            progress(number + 1, np.sqrt(cost / total))
        if slow >= 3:
            break
    square = (cost - float(held @ weights[free] ** 2)) / total
    return Refined(weights=weights, firsts=starts, mean_square=square, evaluations=evaluations)


def linear_radius(weights: Array, sizes: Sizes) -> float:
    """Magnitude of the largest pole of the linear part."""
    state = weights[: sizes.units_at].reshape(sizes.states, sizes.wide)
    return float(np.abs(np.linalg.eigvals(state[:, : sizes.states])).max())


def shrunk(weights: Array, sizes: Sizes, widest: float) -> Array:
    """The same model, with all poles of the linear part nearer to zero by what the largest one exceeds."""
    radius, changed = linear_radius(weights, sizes), weights.copy()
    if radius > widest:
        changed[: sizes.units_at].reshape(sizes.states, sizes.wide)[:, : sizes.states] *= widest / radius
    return changed


def simulated(weights: Array, sizes: Sizes, inputs: Array, first: Array) -> Array:
    """Outputs (samples, outputs) of a simulation from a first state (states,)."""
    states = np.empty((len(inputs), sizes.states))
    simulate_states(weights, sizes.numbers, inputs, first.copy(), states)
    output = weights[sizes.readout_at :].reshape(sizes.outputs, sizes.wide)
    return np.asarray(np.column_stack([states, inputs]) @ output[:, :-1].T + output[:, -1])


def without_last(found: Refined, sizes: Sizes, stretches: Sequence[Stretch]) -> Refined:
    """A refinement as that of these stretches alone, which were followed by one more."""
    pairs = zip(stretches, found.firsts, strict=False)
    errors = [simulated(found.weights, sizes, inputs, first) - outputs for (inputs, outputs), first in pairs]
    square = float(np.mean(np.concatenate(errors) ** 2))
    return replace(found, firsts=found.firsts[: len(stretches)], mean_square=square)


def unit_states(
    weights: Array, sizes: Sizes, stretches: Sequence[Stretch], firsts: Array | None
) -> tuple[Array, Array]:
    """The same model with states of mean square one over the stretches, and its first states (stretches, states)."""
    n, changed = sizes.states, weights.copy()
    starts = np.zeros((len(stretches), n)) if firsts is None else firsts.copy()
    squares = np.zeros(n)
    for (inputs, _), first in zip(stretches, starts, strict=True):
        states = np.empty((len(inputs), n))
        simulate_states(weights, sizes.numbers, inputs, first.copy(), states)
        squares += np.sum(states**2, axis=0)
    size = np.sqrt(squares / sum(len(inputs) for inputs, _ in stretches))
    size = np.where(np.isfinite(size) & (size > 0.0), size, 1.0)
    state = changed[: sizes.units_at].reshape(n, sizes.wide)
    units = changed[sizes.units_at : sizes.readout_at].reshape(sizes.units, sizes.wide + sizes.states)
    output = changed[sizes.readout_at :].reshape(sizes.outputs, sizes.wide)
    state /= size[:, None]
    units[:, sizes.wide :] /= size
    for rows in (state, units, output):
        rows[:, :n] *= size
    return changed, starts / size


def _roles(free: NDArray[np.int64], sizes: Sizes) -> NDArray[np.int64]:
    """What each free weight is, (free, 3): its kind, and its row and column there.

    0: an entry of the state's map; 1: of a unit's row, 2: of a unit's column; 3: of the outputs' map.
    """
    found = np.zeros((len(free), 3), dtype=np.int64)
    wide, unit = sizes.wide, sizes.wide + sizes.states
    for c, index in enumerate(free):
        if index < sizes.units_at:
            found[c] = 0, index // wide, index % wide
        elif index < sizes.readout_at:
            row, column = divmod(int(index) - sizes.units_at, unit)
            found[c] = (1, row, column) if column < wide else (2, row, column - wide)
        else:
            row, column = divmod(int(index) - sizes.readout_at, wide)
            found[c] = 3, row, column
    return found


Normal = tuple[Array, Array, Array, Array, Array]
"""H (free, free), g (free,), and of each stretch mixed (stretches, free, states), own (stretches, states, states) and
right (stretches, states)."""


def _normal(
    weights: Array,
    sizes: Sizes,
    stretches: Sequence[Stretch],
    starts: Array,
    free: NDArray[np.int64],
    roles: NDArray[np.int64],
) -> tuple[float, Normal]:
    """Sum of squared errors, infinite where a simulation or its derivatives diverge, and the normal equations."""
    n, p, count = sizes.states, sizes.outputs, len(free)
    squares, right = np.zeros((count, count)), np.zeros(count)
    mixed = np.zeros((len(stretches), count, n))
    own, by_own, cost = np.zeros((len(stretches), n, n)), np.zeros((len(stretches), n)), 0.0
    room = np.empty((CHUNK * p, count + n))
    for r, (inputs, outputs) in enumerate(stretches):
        x, tangent = starts[r].copy(), np.zeros((n, count + n))
        tangent[:, count:] = np.eye(n)
        for begin in range(0, len(inputs), CHUNK):
            part, wanted = inputs[begin : begin + CHUNK], outputs[begin : begin + CHUNK]
            errors = np.empty(wanted.shape)
            jacobian = room[: wanted.size]
            tangents(weights, sizes.numbers, roles, part, wanted, x, tangent, errors, jacobian)
            flat = errors.ravel()
            with np.errstate(over="ignore", invalid="ignore"):
                cost += float(flat @ flat)
                product, along = jacobian.T @ jacobian, jacobian.T @ flat
            if not (np.isfinite(cost) and np.isfinite(product).all()):
                return np.inf, (squares, right, mixed, own, by_own)
            squares += product[:count, :count]
            mixed[r] += product[:count, count:]
            own[r] += product[count:, count:]
            right += along[:count]
            by_own[r] += along[count:]
    return cost, (squares, right, mixed, own, by_own)


def _step(system: Normal, held: Array, values: Array, damping: float) -> tuple[Array, Array]:
    """Changes of the free weights (free,) and of the first states (stretches, states)."""
    squares, right, mixed, own, by_own = system
    matrix, vector = squares + np.diag(held), right - held * values
    inverses = []
    for r in range(len(own)):
        inner = own[r] + np.diag(damping * np.diag(own[r]) + 1e-12 * np.trace(own[r]) + 1e-300)
        inverses.append(np.linalg.pinv(inner, rcond=1e-14, hermitian=True))
        matrix = matrix - mixed[r] @ inverses[-1] @ mixed[r].T
        vector = vector - mixed[r] @ inverses[-1] @ by_own[r]
    scale = np.sqrt(np.diag(squares) + held)
    scale = np.maximum(scale, FLAT * scale.max())
    scaled = matrix / scale / scale[:, None]
    scaled[np.diag_indices(len(scaled))] += damping
    step = np.linalg.lstsq(scaled, vector / scale, rcond=1e-14)[0] / scale
    moved = [inverse @ (by_own[r] - mixed[r].T @ step) for r, inverse in enumerate(inverses)]
    return step, np.array(moved)


def _rescaled(weights: Array, sizes: Sizes, starts: Array, stretches: Sequence[Stretch]) -> Array:
    """The same model, with the largest argument of each power over the stretches at 1, so that its limit means
    something.
    """
    if not (sizes.power and sizes.units):
        return weights
    largest = np.zeros(sizes.units)
    for (inputs, _), first in zip(stretches, starts, strict=True):
        raise_to_largest(weights, sizes.numbers, inputs, first.copy(), largest)
    changed = weights.copy()
    units = changed[sizes.units_at : sizes.readout_at].reshape(sizes.units, sizes.wide + sizes.states)
    factor = np.where((largest > 0.0) & (largest < ENDLESS), largest, 1.0)[:, None]
    units[:, : sizes.wide] /= factor
    units[:, sizes.wide :] *= factor**sizes.power
    return changed


def acting(stretch: Stretch, dead: Sequence[int]) -> Stretch:
    """The inputs that act at each sample, from that on at which the record has all of them, and the outputs there."""
    inputs, outputs = stretch
    longest = max(dead, default=0)
    if not longest:
        return stretch
    columns = [column[longest - late : len(column) - late] for column, late in zip(inputs.T, dead, strict=True)]
    return np.ascontiguousarray(np.stack(columns, axis=1)), outputs[longest:]


def calm(level: Array, mean_square: float, inputs: int) -> Stretch:
    """A little noise of the inputs, over which outputs rest at a level (outputs,).

    It adds sigma^2 |h|^2 / ANSWER^2 to the squared errors, with h the impulse responses and sigma^2 the mean squared
    error: the prior h ~ N(0, ANSWER^2), which keeps small what the records do not excite, such as modes that answer to
    jumps alone (training with noise: Bishop 1995, Neural Computation 7(1)).
    """
    noise = np.random.default_rng(0).normal(size=(CALM, inputs))
    return np.sqrt(mean_square / CALM) / ANSWER * noise, np.tile(level, (CALM, 1))
