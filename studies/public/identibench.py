"""Any specification of identibench, run with a state space: python -m studies.public identibench NAME."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from hybrid_sysid_ros.commands.terminal import console, status
from hybrid_sysid_ros.core import Variable, rollouts
from hybrid_sysid_ros.extensions.state_space.identification import identify_state_space, options_of
from hybrid_sysid_ros.extensions.state_space.structure import StateSpaceStructure
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.models.structure import complete, parse
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.files import check_file, written_file

Predictor = Callable[[Array, Array, Mapping[str, Any]], Array]
"""(inputs (samples, inputs), first outputs (few, outputs), attributes) -> outputs (samples, outputs)."""


def command(
    name: Annotated[str, typer.Argument(help="A specification, such as Silverbox_Sim, CED_Sim or Ship_Sim.")],
    option: Annotated[
        list[str] | None, typer.Option("--option", help="Option of the structure, as NAME=VALUE, such as units=4.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the fit.", min=0)] = 0,
    out: Annotated[Path | None, typer.Option("--json", help="Write the results as JSON.")] = None,
) -> None:
    """Fit a state space to a specification's training records, and score it by the specification's own rules.

    identibench downloads the records, and keeps them where IDENTIBENCH_DATA_ROOT says.
    """
    if out is not None:
        check_file(out, suffix=".json")
    with extra("public"):
        import identibench
    if name not in identibench.all_benchmarks:
        raise UserError(f"identibench has no {name}; it has {', '.join(identibench.all_benchmarks)}")
    given = parse(option or [])
    _settings(given)
    try:
        found = identibench.run_benchmark(identibench.all_benchmarks[name], build_model, given, seed)
    except UserError:
        raise
    except Exception as error:  # of its downloads and its checks
        raise UserError(f"identibench can't run {name}: {error}") from error
    for test, scores in found["test_sets"].items():
        console.print(f"{name}, {test}: {', '.join(f'{metric} {value:.4g}' for metric, value in scores.items())}")
    if out is not None:
        with written_file(out) as partial:
            partial.write_text(json.dumps(found, default=str, indent=1) + "\n", encoding="utf-8")


def build_model(context: Any) -> Predictor:
    """A predictor that identibench can score, from the training records of its context; the hyperparameters are options
    of the structure ``state_space``. It is made for ``identibench.run_benchmark(specification, build_model)``.
    """
    split = context.spec.train_valid is not None
    sequences = list(context.get_train_valid_sequences() if split else context.get_train_sequences())
    inputs = tuple(Variable(name=name, unit="") for name in context.spec.u_cols)
    outputs = tuple(Variable(name=name, unit="") for name in context.spec.y_cols)
    window = max(int(getattr(context.spec.task, "init_window", 0)), 1)
    sampling = Sampling(step=1.0, period=1.0, initial_samples=window)
    records = [_prepared(item.u, item.y, sampling, f"sequence {number}") for number, item in enumerate(sequences)]
    settings = _settings(context.hyperparameters)
    seed = int(context.seed or 0) % 2**31
    reported: list[str] = []

    def progress(stage: str, count: int, error: float) -> None:
        if stage not in reported:
            reported.append(stage)
            status.print(f"  {stage}")

    system = identify_state_space(records, outputs, inputs, settings, seed=seed, progress=progress).system

    def predict(u: Array, first: Array, attributes: Mapping[str, Any]) -> Array:
        u = np.ascontiguousarray(u, dtype=float)
        known = len(first)
        state = np.zeros(len(system.states))
        if known > 1:
            state = initial_state(system, _prepared(u[:known], first, sampling, "start", len(state)))
        starts = np.array([[0, 0, len(u), 0]])
        return rollouts(system, starts, state[None], u, step=1.0)[1]

    return predict


def _settings(options: Mapping[str, Any]) -> Any:
    known = StateSpaceStructure.OPTIONS
    return options_of(complete({name: float(value) for name, value in options.items()}, known, "state_space"))


def _prepared(u: Array, y: Array, sampling: Sampling, name: str, states: int = 0) -> PreparedRecord:
    outputs = np.ascontiguousarray(y, dtype=float)
    return PreparedRecord(
        name=name,
        sampling=sampling,
        inputs=np.ascontiguousarray(u[:-1], dtype=float),
        outputs=outputs,
        states=np.zeros((len(outputs), states)),
    )
