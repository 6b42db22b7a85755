"""Problems of process control: a reactor that is tracked, one that earns money, and a fermentation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.mpc_gallery.case import Case
from hybrid_sysid_ros.control import ControlProblem, StageTerm
from hybrid_sysid_ros.core import RungeKutta, System
from hybrid_sysid_ros.core.mathematics import Scalar, exp, maximum

Values = Sequence[Scalar]


@dataclass(frozen=True, kw_only=True)
class StirredReactor(System):
    """Van de Vusse's reaction in a stirred tank with a cooled jacket; the feed is in 100 /h, the heat in MJ/h."""

    states = ("a [mol/l]", "b [mol/l]", "reactor [degC]", "jacket [degC]")
    inputs = ("feed [100/h]", "heat [MJ/h]")
    outputs = ("b",)
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        a, b, reactor, jacket = x
        feed, kelvin, capacity = 100.0 * u[0], reactor + 273.15, 0.9342 * 3.01
        first = 1.287e12 * exp(-9758.3 / kelvin) * a
        second = 1.287e12 * exp(-9758.3 / kelvin) * b
        third = 9.043e9 * exp(-8560.0 / kelvin) * a * a
        passed = 4032.0 * 0.215 * (reactor - jacket)
        released = (4.2 * first - 11.0 * second - 41.85 * third) / -capacity
        return (
            feed * (5.1 - a) - first - third,
            -feed * b + first - second,
            released + feed * (130.0 - reactor) - passed / (capacity * 10.01),
            (1000.0 * u[1] + passed) / (5.0 * 2.0),
        )


def reactor() -> Case:
    """The product's concentration is brought to 0.6 mol/l, the reactor below 140 degC (softly)."""
    problem = ControlProblem(
        horizon=20,
        period=0.005,
        substeps=4,
        output_weights=(1.0,),
        final_output_weights=(2.0,),
        rate_weights=(1e-3, 1e-3),
        input_low=(0.05, -8.5),
        input_high=(1.0, 0.0),
        terms=(StageTerm(name="hot", value="reactor", high=140.0, soft_quadratic=100.0),),
        max_iterations=300,
    )
    start = (0.8, 0.5, 134.14, 130.0)
    return Case(
        source="do-mpc, continuous stirred tank reactor, with nominal parameters",
        system=StirredReactor(),
        problem=problem,
        state=start,
        target=(0.6,),
        previous=(0.2, -4.0),
        drawn=("", "b"),
    )


def earning_reactor() -> Case:
    """The product that leaves is sold at a price that changes, cooling is paid for, the feed's rate is limited."""
    terms = (
        StageTerm(name="sales", value="-worth * feed * b", price=1.0),
        StageTerm(name="cooling", value="heat**2", price=0.002),
        StageTerm(name="hot", value="reactor", high=136.0, soft_linear=1.0),
    )
    problem = ControlProblem(
        horizon=30,
        period=0.01,
        substeps=6,
        output_weights=(0.0,),
        input_weights=(1e-3, 1e-4),
        input_low=(0.05, -8.5),
        input_high=(1.0, 0.0),
        rate_limits=(0.1, np.inf),
        terms=terms,
        stage_parameters=(("worth", (1.0,) * 15 + (2.0,) * 15),),
        max_iterations=300,
    )
    return Case(
        source="do-mpc's reactor with an economic cost",
        system=StirredReactor(),
        problem=problem,
        state=(0.8, 0.5, 134.14, 130.0),
        previous=(0.2, -4.0),
        drawn=("", "reactor"),
    )


@dataclass(frozen=True, kw_only=True)
class Fermenter(System):
    """Penicillin in a fed tank."""

    states = ("biomass [g/l]", "substrate [g/l]", "product [g/l]", "volume [l]")
    inputs = ("feed [l/min]",)
    outputs = ("product",)
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        biomass, substrate, product, volume = x
        growth = 0.02 * substrate / (0.05 + substrate + substrate * substrate / 5.0)
        thinned = u[0] / maximum(volume, 1.0)
        return (
            growth * biomass - thinned * biomass,
            -growth * biomass / 0.4 - 0.004 * biomass / 1.2 + thinned * (200.0 - substrate),
            0.004 * biomass - thinned * product,
            u[0],
        )


def fermenter() -> Case:
    """As much product as possible, with less than 3.7 g/l of biomass."""
    problem = ControlProblem(
        horizon=20,
        period=1.0,
        substeps=4,
        output_weights=(0.0,),
        rate_weights=(1.0,),
        input_low=(0.0,),
        input_high=(0.2,),
        state_low=(-np.inf, -0.01, -np.inf, -np.inf),
        state_high=(3.7, np.inf, 3.0, np.inf),
        soft_linear=(100.0,),
        terms=(StageTerm(name="harvest", value="product", price=-1.0),),
        max_iterations=300,
    )
    return Case(
        source="do-mpc, batch bioreactor",
        system=Fermenter(),
        problem=problem,
        state=(1.0, 0.5, 0.0, 120.0),
        drawn=("", "product"),
    )


CASES = {item.__name__: item for item in (reactor, earning_reactor, fermenter)}
"""What makes each case, by its name."""
