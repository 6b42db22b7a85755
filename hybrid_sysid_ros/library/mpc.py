"""The exact MPC of a rig, with further terms of its problem."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.control import Controller, ExactMpc
from hybrid_sysid_ros.library import arguments
from hybrid_sysid_ros.library.arguments import RigLike
from hybrid_sysid_ros.library.compiling import announce_compiling
from hybrid_sysid_ros.library.loops import settings_of, used_model
from hybrid_sysid_ros.models import Model as AnyModel
from hybrid_sysid_ros.runtime.configuration import controller_model, mpc_problem, wrap_for_rig
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError


def mpc(
    rig: RigLike,
    model: AnyModel | None = None,
    *,
    terms: Mapping[str, Any] | None = None,
    stage_parameters: Mapping[str, Any] | None = None,
    final_output_weights: ArrayLike | None = None,
    riccati_at: ArrayLike | None = None,
    intervals: ArrayLike | None = None,
    blocks: ArrayLike | None = None,
    operating_point: ArrayLike | None = None,
    tightening: Mapping[str, Any] | None = None,
    parameters: Mapping[str, Any] | None = None,
    solver: str = "exact",
) -> Controller:
    """The exact MPC of a rig: the problem of its file and its parameters, with further terms.

    terms: {name: {"value": formula, ...}} with the fields of :class:`hybrid_sysid_ros.control.StageTerm`: weight of its
    square, price, low and high, hard or soft_linear and soft_quadratic, final. A formula has names of states, inputs,
    outputs, of the model's parameters and of stage_parameters, in SI units. stage_parameters: their values, one or one
    for each stage; ``assign(name=values)`` of the controller changes them. Terms are added to those of the section mpc
    in the rig's file, and replace those of the same name. final_output_weights: of the outputs (p,) at the end of the
    horizon. riccati_at: outputs (p,) in SI units about which the cost of
    all time after the horizon is added at its end. intervals: lengths of uneven intervals, in periods, such as
    [1, 1, 2, 4]; blocks: numbers of periods through which inputs are held.
    operating_point: outputs (p,) in SI units at whose steady motion the inputs cost nothing. tightening: fields of
    ``Tightening`` of the extension tightening, by which soft bounds are moved in; without ``parameters`` the model's
    covariance counts. parameters: of the node controller, such as
    {"horizon": 10, "output_weight": 4.0, "input_rate": 40.0, "real_time": True}; rates are per second. solver: "exact",
    or "ipopt", the slow reference.

    Give it to :func:`simulate` as controller, or call its ``control(state, disturbance, previous_input, preview)``.
    Raises UserError for a formula that can't be evaluated, a hard bound on states, and values that don't cover the
    horizon.
    """
    announce_compiling()
    described = arguments.rig_of(rig)
    given = arguments.mapping_of(parameters, "parameters", '{"horizon": 10}')
    for name in given:
        if str(name).startswith("controller."):
            plain = name.removeprefix("controller.")
            raise UserError(f"parameters names {name!r}; those of the controller are meant here: write {plain!r}")
    values = settings_of(described, {f"controller.{name}": value for name, value in given.items()})["controller"]
    arguments.choice_of(solver, "solver", ("exact", "ipopt"))
    used = used_model(described, model)
    system = controller_model(described, used.system)
    more = arguments.mapping_of(terms, "terms", '{"power": {"value": "voltage**2", "price": 1.0}}')
    stage = arguments.mapping_of(stage_parameters, "stage_parameters", '{"limit": 1.0}')
    further: dict[str, Any] = {"intervals": intervals, "blocks": blocks, "operating_point": operating_point}
    further = {**arguments.plain(further), "terms": more or None, "stage_parameters": stage or None}
    for name, values_at in (("riccati_at", riccati_at), ("final_output_weights", final_output_weights)):
        if values_at is not None:
            further[name] = np.atleast_1d(arguments.array_of(values_at, name)).tolist()
    if tightening is not None:
        further["tightening"] = arguments.plain(tightening)
    given = {name: value for name, value in further.items() if value is not None}
    problem = mpc_problem(values, described, system, further=given, model=used)
    if solver == "exact":
        return wrap_for_rig(described, system, ExactMpc(system, problem, real_time=values["real_time"]))
    made: Controller = extensions.one("solvers", "ipopt")(system, problem)
    return wrap_for_rig(described, system, made)
