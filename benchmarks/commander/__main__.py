"""Commands: python -m benchmarks.commander [reading] [preview] [texts] [stops], all by default."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from random import Random
from time import perf_counter, process_time
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.commander import stops, texts
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.commander.language.forecast import Simulator
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.models import Model, Sampling, load
from hybrid_sysid_ros.rigs import folder as folders
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import TRAINED, defaults
from hybrid_sysid_ros.runtime.simulated_loop import simulated_loop
from hybrid_sysid_ros.support.errors import UserError

SECONDS = 10.0  # of the plans that are simulated
DOMAIN = 62
Found = dict[str, Any]


def interpreter_of(rig: Rig) -> Interpreter:
    """With the shipped model, or, where none is shipped, the rig itself and the exact MPC."""
    if (TRAINED / rig.name / "model").is_dir():
        return Interpreter.of(Simulator.of(rig, load(TRAINED / rig.name / "model")))
    none: dict[str, Any] = {"names": (), "covariance": np.zeros((0, 0)), "training_range": {}}
    model = Model(rig=rig.name, structure="gray", system=rig.system, sampling=Sampling(), **none)
    return Interpreter.of(Simulator.of(rig, model, policy="exact"))


def reading(arguments: argparse.Namespace) -> Found:
    """From a text to a checked plan, without a simulation, over the corpus of the tests."""
    from hybrid_sysid_ros.extensions.commander.tests.corpus import CORPUS

    interpreters = {name: interpreter_of(rigs.load(name)) for name in {name for name, _, _ in CORPUS}}
    for interpreter in interpreters.values():
        _ = interpreter.simulator.ability  # simulated before the clock runs, and kept
    taken, spent = [], []
    for _ in range(arguments.repeats):
        for name, text, _ in CORPUS:
            interpreter = interpreters[name]
            start = np.zeros(len(interpreter.vocabulary.outputs))
            began, processor = perf_counter(), process_time()
            texts.planned(interpreter, text, start)
            taken.append(1e3 * (perf_counter() - began))
            spent.append(1e3 * (process_time() - processor))
    found = {"ms": result.percentiles(taken), "processor_ms": result.percentiles(spent)}
    return {"sentences": len(CORPUS), **found}


def preview(arguments: argparse.Namespace) -> Found:
    """From a text to the forecast of a plan of 10 s, for each rig."""
    found: Found = {}
    for name in folders.names():
        interpreter = interpreter_of(rigs.load(name))
        output = next(item for item in interpreter.vocabulary.outputs if item.tracked)
        text = f"go to {0.3 * output.high:.3g} {output.unit} in {0.5 * SECONDS:g} s then wait {0.5 * SECONDS:g} s"
        if len(interpreter.vocabulary.tracked) > 1:
            text = text.replace("go to", f"set {output.name} to")
        interpreter.rehearse(text)
        taken, spent = [], []
        for _ in range(arguments.repeats):
            began, processor = perf_counter(), process_time()
            reply = interpreter.rehearse(text)
            taken.append(perf_counter() - began)
            spent.append(process_time() - processor)
        times = {"s": result.percentiles(taken), "processor_s": result.percentiles(spent)}
        found[name] = {"text": text, "reply": reply.line, "accepted": reply.accepted, **times}
    return found


def random_texts(arguments: argparse.Namespace) -> Found:
    """Random texts at all rigs: what is planned keeps the limits; some of it is carried out at the simulated rig."""
    found: Found = {"texts": arguments.texts, "seed": arguments.seed, "rigs": {}}
    names = list(folders.names())
    for name in names:
        interpreter, random = interpreter_of(rigs.load(name)), Random(f"{arguments.seed} {name}")
        vocabulary, ability = interpreter.vocabulary, interpreter.simulator.ability
        counts = {"texts": 0, "planned": 0, "broken": 0}
        for _ in range(arguments.texts // len(names)):
            start = np.array([0.5 * random.uniform(o.low, o.high) if o.tracked else 0.0 for o in vocabulary.outputs])
            said = texts.text(random, vocabulary)
            plan = texts.planned(interpreter, said, start)
            counts["texts"] += 1
            if plan is not None:
                counts["planned"] += 1
                counts["broken"] += bool(texts.broken(plan, vocabulary, ability))
        found["rigs"][name] = counts | carried_out(interpreter, random, arguments.simulated)
    return found


def carried_out(interpreter: Interpreter, random: Random, wanted: int) -> dict[str, int]:
    """Plans of random texts that pass the forecast, at the simulated rig with its noise and disturbances: how many
    there were, and how many left a limit of an input or the travel of an output.
    """
    rig, vocabulary, simulator = interpreter.vocabulary.rig, interpreter.vocabulary, interpreter.simulator
    counts = {"simulated": 0, "refused in simulation": 0, "beyond": 0}
    while counts["simulated"] < wanted:
        plan = texts.planned(interpreter, texts.text(random, vocabulary), np.zeros(len(vocabulary.outputs)))
        if plan is None or not 0.0 < plan.duration <= SECONDS:
            continue
        try:
            interpreter.forecast(plan, simulator.rest)
        except UserError:
            counts["refused in simulation"] += 1
            continue
        plant = Plant(rig, seed=counts["simulated"], bias=rig.bias)
        controller = simulator.made.controller
        loop = simulated_loop(rig, simulator.model, controller, plan, duration=plan.duration + 1.0, plant=plant)
        low, high = rig.limits
        inside = (loop.inputs >= low).all() and (loop.inputs <= high).all() and np.isfinite(loop.outputs).all()
        counts["simulated"] += 1
        counts["beyond"] += not inside or plant.stopped > 0
    return counts


def stopping(arguments: argparse.Namespace) -> Found:
    """Stops of the default rig, in processes in real time."""
    rig = rigs.load(rigs.default())
    found = stops.measured(rig, DOMAIN, times=arguments.stops, seed=arguments.seed)
    every = [one for ways in found.values() for each in ways.values() for one in each]
    passed = [count for _, count in every]
    return {
        "stops": len(every),
        "period_ms": 1e3 / defaults(rig, "plant")["rate"],
        "ms": milliseconds(every),
        "commands_meanwhile": {str(count): passed.count(count) for count in sorted(set(passed))},
        "states": {state: {way: milliseconds(each) for way, each in ways.items()} for state, ways in found.items()},
    }


def milliseconds(found: Sequence[tuple[float, int]]) -> dict[str, float]:
    """What stops took."""
    return result.percentiles([1e3 * taken for taken, _ in found])


PARTS: Mapping[str, Callable[[argparse.Namespace], Found]] = {
    "reading": reading,
    "preview": preview,
    "texts": random_texts,
    "stops": stopping,
}


def flat(found: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, str]]:
    """Rows of a table of nested results."""
    for key, value in found.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{where}{key} ")
        else:
            yield f"{where}{key}", f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> int:
    """Run the parts and write their results."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.commander", description=__doc__)
    parser.add_argument("parts", nargs="*", default=list(PARTS), help=", ".join(PARTS))
    parser.add_argument("--texts", type=int, default=100_000)
    parser.add_argument("--simulated", type=int, default=40, help="plans of random texts at each simulated rig")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--stops", type=int, default=3, help="in each state and way")
    asked = parser.parse_args()
    for name in asked.parts:
        if name not in PARTS:
            raise UserError(f"no part {name}: known are {', '.join(PARTS)}")
        machine = result.machine()
        found = PARTS[name](asked)
        table = Table("what", "value", title=name)
        for key, value in flat(found):
            table.add_row(key, value)
        print_table(table)
        print(result.write(f"commander_{name}", found, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
