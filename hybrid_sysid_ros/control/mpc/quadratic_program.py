"""Small dense quadratic programs inside compiled code, solved by DAQP.

Source: Arnstrom, Bemporad, Axehill (2022), A dual active-set solver for embedded quadratic programming using recursive
LDL' updates, IEEE TAC 67(8).
"""

from __future__ import annotations

import ctypes
import math
import weakref
from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.versions import DAQP_STRUCTURES

MATRICES, GRADIENT, BOUNDS, STATES = 1 | 2, 4, 8, 16
"""Changes since the last solution: hessian and rows, gradient, bounds, states of the constraints."""

ACTIVE, AT_LOWER, SOFT, KEPT = 1, 2, 8, 32
"""State flags of a constraint: in the working set, at its lower bound, soft, which is violated at a price, and soft but
kept, since leaving it costs more than it gains.
"""

TOLERANCE = 1e-9
"""Largest violation of a bound, relative to the length of its row."""

_WORKSPACE_BYTES = 4096  # the library's own structure takes 424
_POINTER = ctypes.c_size_t


class _Problem(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int) for name in ("variables", "constraints", "bounds")),
        *((name, _POINTER) for name in ("hessian", "gradient", "rows", "upper", "lower", "states", "hierarchy")),
        *((name, ctypes.c_int) for name in ("levels", "kind")),
    )


class _Settings(ctypes.Structure):
    _fields_ = (("primal_tolerance", ctypes.c_double), ("dual_tolerance", ctypes.c_double))


class _Result(ctypes.Structure):
    _fields_ = (
        *((name, _POINTER) for name in ("solution", "multipliers")),
        *((name, ctypes.c_double) for name in ("objective", "slack")),
        *((name, ctypes.c_int) for name in ("flag", "iterations", "nodes", "filling")),
        *((name, ctypes.c_double) for name in ("solve_time", "setup_time")),
    )


def _function(name: str, result: Any, *arguments: Any) -> Any:
    function = getattr(ctypes.CDLL(daqp.__file__), name)
    function.restype, function.argtypes = result, arguments
    return function


def _address(name: str) -> int:
    found = ctypes.cast(getattr(ctypes.CDLL(daqp.__file__), name), ctypes.c_void_p).value
    assert found is not None
    return found


@intrinsic
def _update(typingctx, function, changed, workspace, problem):  # type: ignore[no-untyped-def]
    """Call int daqp_update_ldp(int, workspace *, problem *) by its address."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number, place = ir.IntType(32), ir.IntType(64)
        target = builder.inttoptr(arguments[0], ir.FunctionType(number, [number, place, place]).as_pointer())
        return builder.sext(builder.call(target, [builder.trunc(arguments[1], number), *arguments[2:]]), place)

    return types.int64(types.int64, types.int64, types.int64, types.int64), build


@intrinsic
def _solve(typingctx, function, result, workspace):  # type: ignore[no-untyped-def]
    """Call void daqp_solve(result *, workspace *) by its address; return the result's flag."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number, place = ir.IntType(32), ir.IntType(64)
        target = builder.inttoptr(arguments[0], ir.FunctionType(ir.VoidType(), [place, place]).as_pointer())
        builder.call(target, arguments[1:])
        flag = builder.add(arguments[1], ir.Constant(place, _Result.flag.offset))
        return builder.sext(builder.load(builder.inttoptr(flag, number.as_pointer())), place)

    return types.int64(types.int64, types.int64, types.int64), build


@dataclass(frozen=True, kw_only=True, eq=False)
class Program(Shared):
    """min x'H x / 2 + f'x over lower <= [x; R x] <= upper, for compiled code.

    hessian (variables, variables), gradient (variables,), rows (rows, variables), lower and upper (variables + rows,),
    states and prices (variables + rows,) of the constraints, linear ones of the distance from soft ones, solution
    (variables,), multipliers (variables + rows,), positive at an upper bound: H x + f + [I R'] multipliers = 0. result:
    the library's result. addresses: those of its structures and functions.
    """

    hessian: Array
    gradient: Array
    rows: Array
    lower: Array
    upper: Array
    states: NDArray[np.int32]
    prices: Array
    solution: Array
    multipliers: Array
    result: NDArray[np.int32]
    addresses: NDArray[np.int64]


def quadratic_program(
    variables: int,
    rows: int,
    *,
    soft_rows: NDArray[np.bool_] | None = None,
    soft_linear: Array | None = None,
    soft_quadratic: Array | None = None,
) -> tuple[Program, tuple[Any, ...]]:
    """A program with ``variables`` bounded variables and ``rows`` rows; and its memory, which must live as long. The
    last part of that are the weights of soft constraints as the library has them, or None.

    soft_rows (rows,): rows that may be violated by s at the price soft_linear s + soft_quadratic s^2, (rows,) each.
    Raises UserError where the installed solver has other structures than those that are known here.
    """
    constraints = variables + rows
    program = Program(
        hessian=np.eye(variables),
        gradient=np.zeros(variables),
        rows=np.zeros((rows, variables)),
        lower=np.full(constraints, -1.0),
        upper=np.full(constraints, 1.0),
        states=np.zeros(constraints, np.int32),
        prices=np.zeros(constraints),
        solution=np.zeros(variables),
        multipliers=np.zeros(constraints),
        result=np.zeros(ctypes.sizeof(_Result) // 4, np.int32),
        addresses=np.zeros(5, np.int64),
    )
    if soft_rows is not None:
        program.states[variables:][soft_rows] = SOFT
    problem = _Problem(
        variables=variables,
        constraints=constraints,
        bounds=variables,
        hessian=program.hessian.ctypes.data,
        gradient=program.gradient.ctypes.data,
        rows=program.rows.ctypes.data if rows else 0,
        upper=program.upper.ctypes.data,
        lower=program.lower.ctypes.data,
        states=program.states.ctypes.data,
    )
    result = _Result.from_buffer(program.result.data)
    result.solution, result.multipliers = program.solution.ctypes.data, program.multipliers.ctypes.data
    # This call writes only the settings' address into an empty workspace.
    workspace = np.zeros(_WORKSPACE_BYTES // 8, np.int64)
    place = workspace.ctypes.data
    _function("allocate_daqp_settings", None, _POINTER)(place)
    (settings_place,) = workspace[workspace != 0]
    settings = _Settings.from_address(int(settings_place))
    as_known = (settings.primal_tolerance, settings.dual_tolerance) == (1e-6, 1e-12)
    DAQP_STRUCTURES.usable([] if as_known else ["settings in their known place"])
    settings.primal_tolerance = TOLERANCE
    flag = _function("setup_daqp", ctypes.c_int, _POINTER, _POINTER, _POINTER)(ctypes.addressof(problem), place, 0)
    if flag < 0:
        raise UserError(f"the quadratic program can't be set up (flag {flag}); check that the weights are finite")
    soft = None
    if soft_rows is not None and np.any(soft_rows):
        linear, quadratic = program.prices, np.zeros(constraints)
        linear[variables:] = 0.0 if soft_linear is None else soft_linear
        quadratic[variables:] = 0.5 / (1.0 if soft_quadratic is None else soft_quadratic)
        weigh = _function("daqp_set_soft_weights", ctypes.c_int, *[_POINTER] * 5)
        weigh(place, *(values.ctypes.data for values in (quadratic, quadratic, linear, linear)))
        soft = quadratic, linear
    functions = _address("daqp_update_ldp"), _address("daqp_solve")
    program.addresses[:] = ctypes.addressof(problem), place, ctypes.addressof(result), *functions
    weakref.finalize(workspace, _release, place).atexit = False  # a thread may still be solving then
    return program, (problem, workspace, result, soft)


def _release(place: int) -> None:
    _function("free_daqp_workspace", None, _POINTER)(place)
    _function("free_daqp_ldp", None, _POINTER)(place)


@inner
def solve(program: Program, changed: int) -> bool:
    """Solve a program whose parts ``changed`` have changed; True where ``solution`` and ``multipliers`` are optimal.

    The search begins at the working set in ``states``, where these are among the changes.
    """
    problem, workspace, result, update, search = program.addresses
    if _update(update, changed, workspace, problem) < 0:
        return False
    sound = _solve(search, result, workspace) > 0  # above 0 where it found the optimum
    for i in range(program.solution.shape[0]):
        sound = sound and math.isfinite(program.solution[i])
    return sound


@inner
def factorise(program: Program) -> bool:
    """Factorise new matrices before the next solution, which then only has new vectors."""
    problem, workspace, _, update, _ = program.addresses
    return _update(update, MATRICES, workspace, problem) >= 0  # type: ignore[no-any-return]


@inner
def keep_working_set(program: Program) -> int:
    """Let the next search begin with the working set of this solution; return how many constraints came or went. A soft
    constraint that is kept is marked: the search would take it for a violated one, and need a change for each.
    """
    changed = 0
    for i in range(program.states.shape[0]):
        state = program.states[i] & SOFT
        if program.multipliers[i] > 0.0:
            state |= ACTIVE
        elif program.multipliers[i] < 0.0:
            state |= ACTIVE | AT_LOWER
        if state & SOFT != 0 and abs(program.multipliers[i]) < program.prices[i]:
            state |= KEPT
        if state & ACTIVE != program.states[i] & ACTIVE:
            changed += 1
        program.states[i] = state
    return changed


@inner
def clear_working_set(program: Program) -> None:
    """Let the next search begin with an empty working set."""
    for i in range(program.states.shape[0]):
        program.states[i] &= SOFT
        program.multipliers[i] = 0.0
