"""Trial fits: how far from the truth fits to an experiment would end, over simulated records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.extensions.experiment_design.information import Knowledge, by_secants, has_corners, run_of
from hybrid_sysid_ros.extensions.experiment_design.search import Bench
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


def are_needed(system: System, rig: Rig) -> bool:
    """Whether a law has corners that information does not know: of one in a loop it is by derivatives, see
    :func:`~.information.by_secants`. A law with weights takes too long to fit.
    """
    return has_corners(system) and not by_secants(system, rig) and not len(system.weights)


def worst_error(bench: Bench, driving: Array, wanted: Sequence[int]) -> float:
    """The largest error of the wanted numbers in their sizes, root mean square over fits; infinite where one fails.

    Each system that the model's records leave open is the truth of one record, with the sensors' noise, and the fit to
    it begins at the model, as that to the real record will. No sensitivity shows the other minima that a fit may end
    in, such as those between which it is decided where dry friction ends a motion.

    driving: (steps, inputs). wanted: places among the model's free numbers, which are all physical.
    """
    model, names = bench.model, bench.model.names
    held = [item.name for item in model.system.parameters if not item.fixed and item.name not in names]
    squares = np.zeros(len(names))
    for number, system in enumerate(bench.systems[1:]):
        try:
            experiment = experiment_of(model, simulated(bench, system, driving, seed=number))
            found = fit(model.system, [experiment], stages=(None,), hold=held, again=True).system.named
        except UserError:
            return np.inf
        squares += np.square([found[name] - system.named[name] for name in names])
    errors = np.sqrt(squares / max(len(bench.systems) - 1, 1)) / Knowledge.of(model).sizes
    return float(np.max(errors[list(wanted)]))


def simulated(bench: Bench, system: System, driving: Array, *, seed: int) -> Record:
    """A record of an experiment with a system, whose law goes on where the model's ends. driving: (steps, inputs)."""
    step = bench.sampling.step
    inputs, _ = bench.run(system, driving)
    low, high = (end(_states(system, inputs, step), axis=0) for end in (np.min, np.max))
    whole = system.trained_on(2.0 * low - high, 2.0 * high - low)
    inputs, _ = bench.run(whole, driving)
    starts, first = run_of(whole, len(inputs) + 1)
    _, outputs = rollouts(whole, starts, first, inputs, step=step)
    noise = [abs(sensor.scale) * sensor.floor_of(bench.sampling.period) for sensor in bench.rig.sensors]
    return Record(
        name="trial",
        time=step * np.arange(len(outputs), dtype=np.float64),
        input=np.concatenate([inputs, inputs[-1:]]),
        output=outputs + noise * np.random.default_rng(seed).normal(size=outputs.shape),
        rig=bench.rig.name,
    )


def _states(system: System, inputs: Array, step: float) -> Array:
    """Of a run from rest, (steps + 1, states)."""
    starts, first = run_of(system, len(inputs) + 1)
    return rollouts(system, starts, first, inputs, step=step)[0]
