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
BRAKE = {"coulomb": 20.0}
"""Seven times the friction of the beam."""
CHANGED = {"gain": 4.0, "damping": 50.0}
"""Instead of 5.8 and 34."""
FAULTS: dict[str, Fault] = {
    **{f"kill {name}": killed(name) for name in LOOP},
    "kill recorder": killed_recorder,
    "kill run": killed_run,
    **{f"stop {name} 2 s": stopped(name) for name in NODES},
    "30 % lost": measurements(lost(0.3)),
    "all lost": measurements(lost(1.0)),
    "late by 1": measurements(late(1)),
    "late by 2": measurements(late(2)),
    "twice": measurements(lambda: lambda message: [message, message]),
    "reordered": measurements(reordered),
    ".9 s ahead at 2 Hz": measurements(stamped(0.9, every=100)),
    "all .9 s ahead": measurements(stamped(0.9, every=1)),
    "5 s old at 2 Hz": measurements(stamped(-5.0, every=100)),
    "all 5 s old": measurements(stamped(-5.0, every=1)),
    "a year ahead": measurements(stamped(3e7, every=100)),
    **{f"reading {name}": measurements(reading(same(value))) for name, value in HUGE.items()},
    **{f"input {name}": measurements(reading(same(value), "effort")) for name, value in HUGE.items()},
    "velocity nan": measurements(shaped(with_velocity)),
    "frozen": measurements(frozen),
    "biased": measurements(reading(lambda value, k: value + 0.05)),
    "spiking": measurements(reading(lambda value, k: value + (0.2 if k % 20 == 0 else 0.0))),
    "clipped": measurements(reading(lambda value, k: min(value, 0.02))),
    "a list too short": measurements(shaped(cut)),
    "a list too long": measurements(shaped(longer)),
    "no numbers": measurements(shaped(without_numbers)),
    "other names": measurements(shaped(renamed)),
    "a name twice": measurements(shaped(twice_named)),
    "thousands of names": measurements(shaped(with_thousands_of_names)),
    "a million names": crowd,
    "best-effort driver": best_effort,
    "race of commands": command(10.0, newest),
    "driver, stamp now": command(10.0, now),
    "driver, best effort": command(10.0, now, reliable=False),
    "person, no stamp": command(10.0, lambda stage: 0),
    **{f"commands {name}": command(value, newest) for name, value in HUGE.items()},
    **{f"estimates {name}": estimate(value) for name, value in HUGE.items()},
    "reference 44 V": reference(1.0),
    "reference 1e9": reference(1e9),
    "reference 1e100": reference(1e100),
    "reference nan": reference(math.nan),
    "reference old": reference(0.02, offset=-60.0),
    "reference ahead": reference(0.02, offset=60.0),
    "reference back in time": reference(0.02, spacing=-1_000_000),
    "reference of 100 000 points": reference(0.02, points=100_000),
    "no reference": no_reference,
    **{f"second {name}": second(name) for name in LOOP},
    "parameter storm": storm,
    "empty diagnostics": empty_diagnostics,
    **{f"disk {trouble}": failing_disk(trouble) for trouble in ("full", "read-only", "slow")},
    "model gone": gone_model,
    "model altered": altered_model,
    "model swapped": swapped_model,
    "half the rate": replaced(rate=100.0),
    "twice the rate": replaced(rate=500.0),
    "brake": altered(lambda system, rig: (parameters(system, **BRAKE), rig)),
    "changed plant": altered(lambda system, rig: (parameters(system, **CHANGED), rig)),
    "a stop in the way": altered(lambda system, rig: (system, narrower(rig))),
    "ten busy processes": crowded,
    "use_sim_time without /clock": without_clock,
}
"""By name."""
CLOCKED: dict[str, Fault] = {
    "clock 10 s ahead": set_clock(10.0),
    "clock 10 s back": set_clock(-10.0),
    "clock .5 s back": set_clock(-0.5),
    "clock a year ahead": set_clock(3e7),
    "clock stands": standing_clock,
}
"""Those of a loop whose time is that of /clock."""
UNHEARD = {"kill recorder", "kill run", "stop recorder 2 s"}
"""Those of which no other node knows: no diagnostics come any more, which an aggregator shows as stale."""
QUIET = {
    "twice",
    "late by 1",
    "reordered",
    "velocity nan",
    "empty diagnostics",
    "parameter storm",
    "best-effort driver",
    "ten busy processes",
}
"""Those that a loop may bear without a word: nothing is lost by them."""
