"""The faults by name: each begins when it is called and is over when it returns."""

from __future__ import annotations

import math

from benchmarks.faults.measurements import (
    best_effort,
    cut,
    frozen,
    late,
    longer,
    lost,
    measurements,
    reading,
    renamed,
    reordered,
    same,
    shaped,
    stamped,
    twice_named,
    with_thousands_of_names,
    with_velocity,
    without_numbers,
)
from benchmarks.faults.others import (
    command,
    crowd,
    empty_diagnostics,
    estimate,
    newest,
    no_reference,
    now,
    reference,
    second,
    storm,
)
from benchmarks.faults.processes import (
    altered,
    altered_model,
    crowded,
    failing_disk,
    gone_model,
    killed,
    killed_recorder,
    killed_run,
    narrower,
    parameters,
    replaced,
    set_clock,
    standing_clock,
    stopped,
    swapped_model,
    without_clock,
)
from benchmarks.faults.stage import LOOP, NODES, Fault

HUGE = {"nan": math.nan, "inf": math.inf, "1e300": 1e300, "1e6": 1e6}
WRONG = {"nan": "not a number", "inf": "out of range", "1e300": "out of range"}
"""What is said of such a number."""
BRAKE = {"coulomb": 20.0}
"""Seven times the friction of the beam."""
CHANGED = {"gain": 4.0, "damping": 50.0}
"""Instead of 5.8 and 34."""
UNBELIEVED, OTHER = "readings that the model does not believe|innovations", "from another publisher"
UNHEARD = ""
"""Of what the loop bears without a loss, and of nodes of which no other one knows: no diagnostics come any more, which
an aggregator shows as stale.
"""
ALONE = {
    "reference": "after the end of the reference",
    "estimator": "commands at rest|for want of commands|nothing on state_estimate",
    "controller": "for want of commands|nothing on joint_command",
    "plant": "commands at rest|measurements missing|nothing on joint_states",
    "recorder": UNHEARD,
}
"""What the others say without a node."""
FAULTS: dict[str, tuple[Fault, str]] = {
    **{f"kill {name}": (killed(name), ALONE[name]) for name in LOOP},
    "kill recorder": (killed_recorder, UNHEARD),
    "kill run": (killed_run, UNHEARD),
    **{f"stop {name} 2 s": (stopped(name), ALONE[name]) for name in NODES},
    "30 % lost": (measurements(lost(0.3)), "measurements missing"),
    "all lost": (measurements(lost(1.0)), "for want of commands|nothing on joint_states"),
    "late by 1": (measurements(late(1)), UNHEARD),
    "late by 2": (measurements(late(2)), "measurements without an answer"),
    "twice": (measurements(lambda: lambda message: [message, message]), UNHEARD),
    "reordered": (measurements(reordered), UNHEARD),
    ".9 s ahead at 2 Hz": (measurements(stamped(0.9, every=100)), "measurements stamp ahead of the clock"),
    "all .9 s ahead": (measurements(stamped(0.9, every=1)), "measurements stamp ahead of the clock"),
    "5 s old at 2 Hz": (measurements(stamped(-5.0, every=100)), "measurements stamp"),
    "all 5 s old": (measurements(stamped(-5.0, every=1)), "measurements stamp"),
    "a year ahead": (measurements(stamped(3e7, every=100)), "measurements stamp ahead of the clock"),
    **{f"reading {name}": (measurements(reading(same(HUGE[name]))), f"measurements {WRONG[name]}") for name in WRONG},
    "reading 1e6": (measurements(reading(same(1e6))), f"measurements out of range|{UNBELIEVED}"),
    **{
        f"input {name}": (
            measurements(reading(same(value), "effort")),
            UNHEARD if name == "nan" else f"measurements {WRONG.get(name, 'out of range')}",  # unknown is no fault
        )
        for name, value in HUGE.items()
    },
    "velocity nan": (measurements(shaped(with_velocity)), UNHEARD),
    "frozen": (measurements(frozen), "times the same reading"),
    "biased": (measurements(reading(lambda value, k: value + 0.05)), UNBELIEVED),
    "spiking": (measurements(reading(lambda value, k: value + (0.2 if k % 20 == 0 else 0.0))), UNBELIEVED),
    "clipped": (measurements(reading(lambda value, k: min(value, 0.02))), f"times the same reading|{UNBELIEVED}"),
    "a list too short": (measurements(shaped(cut)), UNHEARD),
    "a list too long": (measurements(shaped(longer)), "measurements lists of other lengths"),
    "no numbers": (measurements(shaped(without_numbers)), "measurements not a number"),
    "other names": (measurements(shaped(renamed)), "nothing on joint_states"),
    "a name twice": (measurements(shaped(twice_named)), "measurements lists of other lengths"),
    "thousands of names": (measurements(shaped(with_thousands_of_names)), "measurements too large|without an answer"),
    "a million names": (crowd, "too large"),
    "best-effort driver": (best_effort, UNHEARD),
    "race of commands": (command(10.0, newest), f"commands {OTHER}"),
    "driver, stamp now": (command(10.0, now), f"commands {OTHER}"),
    "driver, best effort": (command(10.0, now, reliable=False), f"commands {OTHER}"),
    "person, no stamp": (command(10.0, lambda stage: 0), f"commands {OTHER}"),
    **{f"commands {name}": (command(HUGE[name], newest), f"commands {WRONG[name]}") for name in WRONG},
    "commands 1e6": (command(1e6, newest), f"commands out of range|commands {OTHER}"),
    **{f"estimates {name}": (estimate(HUGE[name]), f"estimates {WRONG[name]}") for name in WRONG},
    "estimates 1e6": (estimate(1e6), f"estimates out of range|estimates {OTHER}"),
    "reference 44 V": (reference(1.0), "references beyond the travel"),
    "reference 1e9": (reference(1e9), "references beyond the travel|references out of range"),
    "reference 1e100": (reference(1e100), "references out of range"),
    "reference nan": (reference(math.nan), "references not a number"),
    "reference old": (reference(0.02, offset=-60.0), "references stamp long past"),
    "reference ahead": (reference(0.02, offset=60.0), "references stamp ahead of the clock"),
    "reference back in time": (reference(0.02, spacing=-1_000_000), "references times that do not rise"),
    "reference of 100 000 points": (reference(0.02, points=100_000), "references too large"),
    "no reference": (no_reference, ALONE["reference"]),
    "second reference": (second("reference"), f"references {OTHER}"),
    "second estimator": (second("estimator"), f"estimates {OTHER}"),
    "second controller": (second("controller"), f"commands {OTHER}"),
    "second plant": (second("plant"), f"measurements {OTHER}"),
    "parameter storm": (storm, UNHEARD),
    "empty diagnostics": (empty_diagnostics, UNHEARD),
    "disk full": (failing_disk("full"), "No space left"),
    "disk read-only": (failing_disk("read-only"), "Read-only"),
    "disk slow": (failing_disk("slow"), "the disk does not answer"),
    "model gone": (gone_model, "model is gone"),
    "model altered": (altered_model, "model has changed"),
    "model swapped": (swapped_model, "model has changed|model is gone"),
    "half the rate": (replaced(rate=100.0), "measurements missing"),
    "twice the rate": (replaced(rate=500.0), "sooner than the parameter rate says"),
    "brake": (altered(lambda system, rig: (parameters(system, **BRAKE), rig)), UNBELIEVED),
    "changed plant": (altered(lambda system, rig: (parameters(system, **CHANGED), rig)), UNBELIEVED),
    "a stop in the way": (altered(lambda system, rig: (system, narrower(rig))), "at the end of the travel"),
    "ten busy processes": (crowded, UNHEARD),
    "use_sim_time without /clock": (without_clock, "nothing has come on /clock"),
}
"""By name, with what the diagnostics are to say of it, a regular expression."""
CLOCKED: dict[str, tuple[Fault, str]] = {
    "clock 10 s ahead": (set_clock(10.0), "clock was set|stamp"),
    "clock 10 s back": (set_clock(-10.0), "clock was set|stamp"),
    "clock .5 s back": (set_clock(-0.5), "clock was set|too late|stamp"),
    "clock a year ahead": (set_clock(3e7), "clock was set|stamp"),
    "clock stands": (standing_clock, "clock was set|stands"),
}
"""Those of a loop whose time is that of /clock."""
