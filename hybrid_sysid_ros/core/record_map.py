"""The record map: which states of a system follow from the outputs and inputs of a record, and how."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core.declaration import Variable
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class RecordMap:
    """How the states of a system follow from a record. States are indices; a system may replace single fields."""

    reconstructible: Mapping[int, tuple[int, bool]]
    """States that a record shows: state -> output, and whether the state is that output's rate of change."""
    delay_line: range = range(0)
    """States that hold earlier outputs and inputs; their initial values follow from the past of a record."""
    unobserved: Sequence[int]
    """States of the law that no record shows; a fit estimates their initial values."""
    states_from_record: Callable[[Array, Array, Array], Array]
    """(outputs, rates, inputs) -> initial states of simulations (samples, states), zero where they are unknown.

    outputs, rates (samples, outputs): measured outputs and their rates of change. inputs (samples, inputs): mean
    inputs since each sample.
    """


def record_map(
    states: Sequence[Variable], outputs: Sequence[Variable], kinematics: Mapping[int, int], declared: int
) -> RecordMap:
    """The map of a system whose outputs have names of states: these are known, and so are the rates of positions among
    them. kinematics: position state -> velocity state. declared: number of the states of the law, which come first.
    """
    names = [item.name for item in states]
    direct = {names.index(item.name): k for k, item in enumerate(outputs) if item.name in names}
    known = {state: (column, False) for state, column in direct.items()}
    for state, column in direct.items():
        velocity = kinematics.get(state)
        if velocity is not None and velocity not in direct:
            known[velocity] = column, True

    def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
        found = np.zeros((len(outputs), len(states)))
        for state, (column, rate) in known.items():
            found[:, state] = (rates if rate else outputs)[:, column]
        return found

    rest = [index for index in range(declared) if index not in known]
    return RecordMap(reconstructible=known, unobserved=rest, states_from_record=states_from_record)
