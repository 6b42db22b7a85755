"""A loop as a C unit: its objects in Python, the translation of its kernels, and the texts of its files."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.control.mpc.calls import CALL
from hybrid_sysid_ros.control.mpc.horizon import PROGRESS as SOLUTION
from hybrid_sysid_ros.control.mpc.horizon import Horizon
from hybrid_sysid_ros.control.mpc.quadratic_program import SOFT, TOLERANCE
from hybrid_sysid_ros.control.policy.kernels import FEATURES, PLACES, TRACKED
from hybrid_sysid_ros.control.safety.supervision import SUPERVISION
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.wrappers import Stabilised
from hybrid_sysid_ros.estimation.belief import CHANNEL, CORE, MOMENT, READING
from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.unit import loop_kernels as kernels
from hybrid_sysid_ros.extensions.export.unit.layout import MemoryLayout
from hybrid_sysid_ros.extensions.export.unit.observation_kernels import observe
from hybrid_sysid_ros.extensions.export.unit.printed_loop import (
    FILTER,
    PROGRESS,
    STAMPS,
    InitialStates,
    LoopNumbers,
    PrintedLoop,
)
from hybrid_sysid_ros.extensions.export.unit.printing import Printer, layout_of
from hybrid_sysid_ros.extensions.export.unit.python_loop import LARGEST_STAMP, RESTART, PythonLoop
from hybrid_sysid_ros.extensions.export.unit.records import RECORD_NAMES, guard_records, record_type, watch_records
from hybrid_sysid_ros.extensions.export.unit.translator import Translator
from hybrid_sysid_ros.extensions.export.unit.values import BOOL, REAL, KnownValue, NumberValue, literal
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

UNIT_TEMPLATES = Path(__file__).parent / "c"
RECORDS = [(CORE, "core"), (CHANNEL, "channel"), (MOMENT, "moment"), (READING, "reading")]
RECORDS += [(record_type(kind), name) for kind, name in RECORD_NAMES.items()]
RECORDS += [
    (SOLUTION, "solution"),
    (PROGRESS, "progress"),
    (STAMPS, "stamps"),
    (CALL, "call"),
    (SUPERVISION, "supervision"),
]
OF_FLOATS = {"RISE": 1e-6, "DIFFERENCE": 3.5e-4, "VIOLATION": 1e-5, "INPUT_ROUNDING": 1e-6, "WAIT_ROUNDING": 1e-6}
"""Constants of kernels that the rounding of doubles chose, for that of floats, 1e-7; the second is its root."""
EXCHANGE = """/* Let a further estimate be the loop's, and that one the further one. */
static void @{name}_exchange(@{name}_memory *unit, int which)
{
    @{name}_filter *other = unit->further[which - 1];

    unit->further[which - 1] = unit->filter;
    unit->filter = other;
}
"""
NARROW = {"WIDE": 8, "HALF": 8, "CHAINS": 1}
"""Units of a network side by side, in one sum each: they fit into the registers of a small processor."""
RESIDUAL = 1e-4
"""Residual at which an iteration in floats has converged: smaller ones are rounding, and it would never end."""


def loop_of(rig: Rig, python: PythonLoop) -> PrintedLoop:
    """The objects of a loop, all of them as before its first measurement.

    Raises UserError for what has no translation yet.
    """
    python.reset()
    estimator, mpc, supervisor, guarded = python.estimator, python.mpc, python.supervisor, python.guarded
    system, memory, tuning = estimator.system, estimator._memory, estimator.tuning
    if tuning.channels:
        raise UserError(f"export: channel {next(iter(tuning.channels))} of the estimator can't be printed as C yet")
    progress, stamps = np.zeros(1, PROGRESS), np.zeros(1, STAMPS)
    stamps["last"] = progress["answered"] = np.nan
    followed, m = len(tuning.followed), len(system.inputs)
    offsets = np.zeros((followed, m)) if estimator._offsets is None else np.array(estimator._offsets)
    named = system.named
    offset, by_outputs, by_inputs = affine_initial_states(system)
    _clear(mpc.shooting.horizon)
    return PrintedLoop(
        progress=progress,
        stamps=stamps,
        settings=LoopNumbers(
            period=float(estimator.period),
            patience=int(tuning.patience),
            stale_after=python.stale_after,
            zero_after=python.zero_after,
        ),
        initial=InitialStates(
            offset=offset,
            by_outputs=by_outputs,
            by_inputs=by_inputs,
            parameters=np.array([named[name] for name in tuning.followed]),
            offsets=np.ascontiguousarray(offsets),
        ),
        memory=tuple(memory),
        outputs=np.zeros(len(system.outputs)),
        applied=np.zeros(m),
        out=np.zeros(estimator._parts[-1]),
        P=np.zeros((estimator._size, estimator._size)),
        mpc=mpc.compiled,
        instance=(supervisor or mpc).instance,
        plan=np.zeros(m),
        command=np.array([actuator.rest for actuator in rig.actuators]),
        gains=np.array(mpc.system.gains) if isinstance(mpc.system, Stabilised) else np.zeros((0, len(system.states))),
        low=np.array(rig.limits[0], dtype=float),
        high=np.array(rig.limits[1], dtype=float),
        on_way=python.on_way,
        supervisor=None if supervisor is None else supervisor.compiled,
        guard=guard_records(guarded.guard.memory),
        monitor=watch_records(python.monitored),
        at_rest=np.array([actuator.rest for actuator in rig.actuators]),
        reach_low=python.reach[0].copy(),
        reach_high=python.reach[1].copy(),
        now=np.zeros(len(system.outputs)),
        times=np.array(guarded.times),
        preview=(supervisor or mpc).instance.preview.reshape(-1),
    )


def _clear(horizon: Horizon) -> None:
    """Zero what first calls have left in a horizon's memory, for what begins as zero takes no room in flash."""
    parts = (horizon.last, horizon.linear, horizon.step, horizon.lagrangian, horizon.work)
    for part in (horizon, *parts):
        for item in fields(part):
            value = getattr(part, item.name)
            if isinstance(value, np.ndarray) and value.dtype == float:
                value[...] = 0.0


def _widest(loop: PrintedLoop) -> dict[str, float]:
    """Sizes of scratch memory that are smaller than for any policy."""
    if loop.supervisor is None:
        return {}
    sizes = loop.supervisor.sizes
    first, widths = PLACES + int(sizes[TRACKED]), [int(sizes[FEATURES]), len(loop.supervisor.flat)]
    while first < len(sizes):
        depth = int(sizes[first])
        widths += [(int(width) + 7) // 8 * 8 for width in sizes[first + 1 : first + 2 + depth]]
        first += 2 + depth
    return {"WIDEST": max(widths)}


def affine_initial_states(system: System) -> tuple[Array, Array, Array]:
    """Offset (n,) and derivatives (n, p), (n, m) of the initial states by the first outputs and inputs.

    Raises UserError where they are no affine function.
    """
    p, m, of = len(system.outputs), len(system.inputs), system.record_map().states_from_record

    def states(outputs: Array, inputs: Array) -> Array:
        return of(outputs[None], np.zeros((1, p)), inputs[None])[0]

    offset = states(np.zeros(p), np.zeros(m))
    by_outputs = np.array([states(row, np.zeros(m)) - offset for row in np.eye(p)]).T.reshape(len(offset), p)
    by_inputs = np.array([states(np.zeros(p), row) - offset for row in np.eye(m)]).T.reshape(len(offset), m)
    random = np.random.default_rng(0)
    for _ in range(8):
        y, u = random.normal(size=p) * 10.0, random.normal(size=m) * 10.0
        if not np.allclose(states(y, u), offset + by_outputs @ y + by_inputs @ u, rtol=1e-9, atol=1e-9):
            raise UserError(f"export: the initial states of {type(system).__name__} are no affine map of its outputs")
    return offset, np.ascontiguousarray(by_outputs), np.ascontiguousarray(by_inputs)


def translated(loop: PrintedLoop, arrays: dict[str, Array], rig: str, *, single: bool) -> Printer:
    """The kernels of a loop in C. arrays: those of the estimator, by name. single: numbers are floats."""
    mutable: dict[str, set[str]] = {}
    constants = _widest(loop) | NARROW | (OF_FLOATS if single else {})
    if single:
        mpc = replace(loop.mpc, tolerance=max(loop.mpc.tolerance, RESIDUAL))
        supervisor = None if loop.supervisor is None else replace(loop.supervisor, mpc=mpc)
        loop = loop._replace(mpc=mpc, supervisor=supervisor)
    while True:
        layout = layout_of(RECORDS, mutable)
        _name_arrays(layout, loop, arrays)
        translator = Translator(layout, rig, "f" if single else "", constants)
        translator.call(observe, [KnownValue(loop), NumberValue(REAL, "time")])  # type: ignore[arg-type]
        switches = NumberValue(BOOL, "governed"), NumberValue(BOOL, "alone")
        translator.call(kernels.decide, [KnownValue(loop), *switches])  # type: ignore[arg-type]
        for kernel in (kernels.expect_outputs, kernels.judge, kernels.find_plan_at_rest, kernels.sent, kernels.lead):
            translator.call(kernel, [KnownValue(loop)])  # type: ignore[arg-type]
        translator.call(kernels.look_forward, [KnownValue(loop), NumberValue(REAL, "elapsed")])  # type: ignore[arg-type]
        if single:
            translator.call(kernels.rebase, [KnownValue(loop)])  # type: ignore[arg-type]
        translator.call(kernels.forget_measurements, [KnownValue(loop)])  # type: ignore[arg-type]
        translator.call(kernels.begin_control, [KnownValue(loop)])  # type: ignore[arg-type]
        if not layout.complete:
            continue
        solver = ("hessian", "gradient", "rows", "lower", "upper", "states", "solution", "multipliers")
        owned = (
            *("outputs", "applied", "plan", "command", "instance", "P", "out", "now", "progress"),
            *("guard_core", "guard_failsafe", "guard_governor"),
            *(f"program_{name}" for name in solver),
        )
        layout.used = {name for item in translator.functions.values() for name in item.arrays}
        for name in owned:
            if name in layout.places:  # there may be no rows
                layout.places[name].write()
                layout.used.add(name)
        return Printer(translator, FILTER, loop.monitor.estimates)


def _name_arrays(layout: MemoryLayout, loop: PrintedLoop, arrays: dict[str, Array]) -> None:
    cores, channels, moments, readings, inputs = loop.memory
    layout.add("progress", loop.progress)
    layout.add("stamps", loop.stamps)
    for name in (
        "outputs",
        "applied",
        "plan",
        "command",
        "out",
        "P",
        "gains",
        "low",
        "high",
        "now",
        "reach_low",
        "reach_high",
    ):
        layout.add(name, getattr(loop, name))
    for name, value in (("core", cores), ("channels", channels), ("moments", moments), ("readings", readings)):
        layout.add(name, value)
    layout.add("past", inputs)
    layout.add("instance", loop.instance.state)
    layout.add("initial", loop.initial)
    layout.add("belief", arrays)
    layout.add("inputs_at_rest", loop.at_rest)
    layout.add("preview_times", loop.times)
    layout.add("guard", loop.guard)
    layout.add("monitor", loop.monitor)
    layout.add("model", loop.mpc.prediction)
    layout.add("horizon", loop.mpc.horizon)
    layout.add("program", loop.mpc.program)
    layout.add("call", loop.mpc.call)
    layout.add("on_way", loop.on_way)
    if loop.supervisor is not None:
        layout.add("policy", loop.supervisor)


def texts(
    printer: Printer,
    loop: PrintedLoop,
    *,
    title: str,
    about: dict[str, str],
    seal: str,
    soft: tuple[Array, Array] | None,
) -> dict[str, str]:
    """The texts of NAME.h and NAME.c. seal: of the model. soft: weights of soft constraints, square and linear."""
    translator, rig, program, instance = printer.translator, printer.rig, loop.mpc.program, loop.instance
    horizon, p = instance.preview.shape
    n, m = len(instance.state), len(instance.previous)
    functions = printer.functions()
    beginnings, copies = printer.beginnings()
    variables, rows, count = len(program.gradient), len(program.rows), printer.count
    soft_tables, soft_lines = _soft(printer, soft)
    values = {
        "name": rig,
        "NAME": rig.upper(),
        "title": title,
        "seal": seal,
        "about": "\n".join(f" * {key}: {value}" for key, value in about.items()),
        "real": "float" if translator.suffix else "double",
        "states": n,
        "inputs": m,
        "outputs": p,
        "horizon": horizon,
        "preview": n + 2 * m,
        "restart": RESTART,
        "largest_stamp": f"{LARGEST_STAMP:g}",
        "stale_after": f"{loop.settings.stale_after:g}",
        "zero_after": f"{loop.settings.zero_after:g}",
        "records": printer.records() + (printer.filter() if count > 1 else ""),
        "memory": printer.memory(),
        "filters": f"    {rig}_filter filters[{count}], *filter, *further[{count - 1}];\n" if count > 1 else "",
        "exchange": Text(EXCHANGE).substitute(name=rig) if count > 1 else "",
        "arena": _arena(variables, rows, int(np.sum(program.states & SOFT != 0))),
        "structures": printer.structures(),
        "tables": printer.tables(),
        "functions": functions,
        "beginnings": beginnings + soft_tables,
        "copies": copies,
        "variables": variables,
        "constraints": variables + rows,
        "rows": "    unit->problem.A = unit->program_rows;" if rows else "    unit->problem.A = NULL;",
        "tolerance": literal(max(TOLERANCE, 1e-6) if translator.suffix else TOLERANCE, translator.suffix),
        "single": "#ifndef DAQP_SINGLE_PRECISION\n#define DAQP_SINGLE_PRECISION\n#endif\n" if translator.suffix else "",
        "rebase": _rebased(printer) if translator.suffix else "",
        "soft": soft_lines,
        "observe": printer.entry(observe, f"({rig}_real)(time - unit->origin)"),
        "expect": printer.entry(kernels.expect_outputs, ""),
        "judge": printer.entry(kernels.judge, ""),
        "decide": printer.entry(kernels.decide, "now != NULL, alone"),
        "find_rest": printer.entry(kernels.find_plan_at_rest, ""),
        "sent": printer.entry(kernels.sent, ""),
        "lead": printer.entry(kernels.lead, ""),
        "begin_monitor": printer.begun_again("monitor_"),
        "begin_guard": printer.begun_again("guard_"),
        "prepare": printer.entry(kernels.look_forward, "elapsed"),
        "forget_estimate": printer.entry(kernels.forget_measurements, ""),
        "forget_plan": printer.entry(kernels.begin_control, ""),
    }
    return {
        f"{rig}{ending}": Text((UNIT_TEMPLATES / f"loop{ending}").read_text(encoding="utf-8")).substitute(values)
        for ending in (".h", ".c")
    }


def _rebased(printer: Printer) -> str:
    """Lines that count time from the newest measurement on: a float that counts hours can't tell milliseconds."""
    return (
        f"    if ({printer.place('stamps')}[0].started) {{\n"
        f"        unit->origin += (double){printer.entry(kernels.rebase, '')};\n"
        "    } else if (isfinite(time)) {\n"
        "        unit->origin = time;\n"
        "    }\n"
    )


def most_active(loop: PrintedLoop) -> int:
    """How many constraints can be active in the solver: one for each variable and each soft constraint."""
    return len(loop.mpc.program.gradient) + int(np.sum(loop.mpc.program.states & SOFT != 0)) + 1


def _arena(variables: int, rows: int, soft: int) -> int:
    """Numbers that the solver needs at most."""
    wide, constraints = variables + soft + 1, variables + rows
    iterates = 6 * wide + wide * (wide + 1) // 2 + 3 * variables
    problem = variables * rows + 4 * constraints + rows + variables * (variables + 1) // 2 + variables
    return iterates + problem + (4 * constraints if soft else 0) + 32


def _soft(printer: Printer, soft: tuple[Array, Array] | None) -> tuple[str, str]:
    """Constants and lines that set the weights of soft constraints."""
    if soft is None:
        return "", ""
    names = [f"{printer.rig}_soft_{kind}" for kind in ("quadratic", "linear")]
    tables = "\n".join(
        printer.table(name, values).replace("static const", "static") for name, values in zip(names, soft, strict=True)
    )
    given = ", ".join(name for name in names for _ in range(2))
    return tables, f"    daqp_set_soft_weights(&unit->workspace, {given});"
