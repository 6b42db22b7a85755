"""How far records and models are to be trusted: python -m benchmarks.trust [PART...].

Parts that are named are measured anew, the others are those of the last results. Asked rows that fall short are counted
in the key ``short``, and named; parts that were never measured are among them.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.trust import adapting, bands, designs, foreign, importing, intervals, records, state_spaces
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from studies.beam_lecture.lecture import DATA

NAME = "trust"
PARTS: Mapping[str, Callable[[], dict[str, Any]]] = {
    "import": importing.measured,
    "check": records.measured,
    "intervals": intervals.measured,
    "bands": bands.measured,
    "foreign": foreign.measured,
    "adapt": adapting.measured,
    "design": designs.measured,
    "state_space": state_spaces.measured,
}


def rows(found: Mapping[str, Any]) -> list[tuple[str, float, str, bool]]:
    """Each asked row: name, value, what is asked, and whether it is reached."""
    made = list[tuple[str, float, str, bool]]()
    if part := found.get("import"):
        made.append(("import of ten minutes [s]", part["seconds"], "< 5", part["seconds"] < 5.0))
    if part := found.get("check"):
        made.append(("kinds of faults named first", part["kinds_named"], ">= 27 of 30", part["kinds_named"] >= 27))
        made.append(("good records accused", len(part["accused"]), f"0 of {part['good']}", not part["accused"]))
        made.append(("check [s]", part["check_seconds"], "< 10", part["check_seconds"] < 10.0))
    for name, case in (found.get("intervals") or {}).items():
        low, high = intervals.WITHIN
        held, asked = case["all"], f"{low:g} to {high:g}, of {case['repetitions']}"
        enough = case["repetitions"] >= intervals.REPETITIONS
        made.append((f"90 % intervals of {name} that hold", held, asked, enough and low <= held <= high))
        least = min(case["held"].values(), default=0.0)
        made.append(("the same of its worst parameter", least, f">= {low:g}", enough and least >= low))
    if part := found.get("bands"):
        low, high = bands.WITHIN
        made.append(("samples in 90 % bands", part["held_90"], f"{low:g} to {high:g}", low <= part["held_90"] <= high))
        made.append(("of the worst record", part["least"], f">= {bands.LEAST:g}", part["least"] >= bands.LEAST))
        made.append(("width of the narrowest", part["width"], f"<= {bands.WIDEST:g}", part["width"] <= bands.WIDEST))
        held = part["ahead_90"]
        made.append(("predictions ahead in 90 % bands", held, f"{low:g} to {high:g}", low <= held <= high))
        held = part["loop_90"]
        made.append(("forecast loops in 90 % bands", held, f"{low:g} to {high:g}", low <= held <= high))
        least = part["loop_least"]
        made.append(("of the worst loop", least, f">= {bands.LEAST:g}", least >= bands.LEAST))
        wide = part["loop_width"]
        made.append(("width of the narrowest, loops", wide, f"<= {bands.WIDEST:g}", wide <= bands.WIDEST))
        limit = bands.SLOWEST
        made.append(("time of bands [free runs]", part["free_runs"], f"<= {limit:g}", part["free_runs"] <= limit))
    elif "bands" in found:
        made.append(("samples in 90 % bands", math.nan, f"needs {DATA}", False))
    for name, held in found.get("foreign", {}).get("held_90", {}).items():
        low, high = foreign.WITHIN
        made.append((f"foreign samples in bands, {name}", held, f"{low:g} to {high:g}", low <= held <= high))
        least = found["foreign"]["least"][name]
        made.append((f"of the worst foreign record, {name}", least, f">= {foreign.LEAST:g}", least >= foreign.LEAST))
    if part := found.get("adapt"):
        most, near = adapting.MOST_LOST, adapting.NEAR
        made.append(("R2 lost by --adapt", part["lost"], f"<= {most:g}", part["lost"] <= most))
        missed = part["missed"]
        made.append(("R2 missed where it holds a bias", missed, f"<= {near:g}", missed <= near))
        half = 0.5 * len(part["rows"]) / len(adapting.SECONDS)
        made.append(("records near the best constant bias", part["near"], f">= {half:g}", part["near"] >= half))
    for name in designs.RIGS if "design" in found else ():
        case = found["design"].get(name, {"ratio": math.nan, "noises": 0, "seconds": math.nan})
        enough, asked = case["noises"] >= designs.NOISES, f"<= {designs.MOST:g}, {case['noises']} noises"
        made.append(
            (f"variance of a designed minute, {name}", case["ratio"], asked, enough and case["ratio"] <= designs.MOST)
        )
        made.append((f"its design [s], {name}", case["seconds"], "< 60", case["seconds"] < 60.0))
    if part := found.get("state_space"):
        made.append(("state space of order 30, 1e5 samples [s]", part["seconds"], "< 300", part["seconds"] < 300.0))
        least = 1.5 * part["noise"]
        made.append(("its error in the outputs' deviation", part["error"], f"<= {least:g}", part["error"] <= least))
    made += [(f"part {name}", math.nan, "measured", False) for name in PARTS if name not in found]
    return made


def last() -> dict[str, Any]:
    """The parts of the last results; empty where there are none."""
    try:
        content = json.loads((result.RESULTS / f"{NAME}.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return {name: part for name, part in content["results"].items() if name in PARTS}


def main() -> int:
    """Measure the parts that are named, or all; print the table and write the JSON."""
    chosen, found = sys.argv[1:] or list(PARTS), last()
    if unknown := [name for name in chosen if name not in PARTS]:
        print(f"error: no part {unknown[0]}: known are {', '.join(PARTS)}", file=sys.stderr)
        return 2
    for name in chosen:
        status.print(name)
        found[name] = PARTS[name]()
    table = Table("asked", "measured", "goal", "reached", title="trust")
    made = rows(found)
    for name, value, goal, reached in made:
        table.add_row(name, f"{value:.3g}", goal, "yes" if reached else "NO")
    print_table(table)
    for kind, case in found.get("check", {}).get("kinds", {}).items():
        if case["right"] < records.ENOUGH:
            console.print(f"{kind}: {case['right']} of 9, {case['first']}")
    for name, case in found.get("intervals", {}).items():
        console.print(f"{name}: " + ", ".join(f"{key} {share:.2f}" for key, share in case["held"].items()))
    for name, case in found.get("design", {}).items():
        shown = (f"{kind} {row['variance']:.3g} ({row['parameter']})" for kind, row in case["worst"].items())
        console.print(f"worst relative variance of {name}: {', '.join(shown)}")
    for name, rows_of in found.get("bands", {}).get("records", {}).items():
        shown = (f"{key} {row['held_90']:.2f} ({1e3 * row['mean_error']:.1f} mm)" for key, row in rows_of.items())
        console.print(f"held of {name}, and mean error: {', '.join(shown)}")
    for name, rows_of in found.get("foreign", {}).get("records", {}).items():
        shown = (f"{key} {row['held_90']:.2f} (R2 {row['r2']:.2f}, {row['width']:.2f})" for key, row in rows_of.items())
        console.print(f"held of foreign records, {name}, and width in the narrowest: {', '.join(shown)}")
    for name, words in found.get("check", {}).get("accused", {}).items():
        console.print(f"accused: {name}: {words}")
    short = [name for name, *_, reached in made if not reached]
    print(result.write(NAME, {**found, "short": len(short), "short_rows": short}))
    console.print(f"short: {len(short)}{': ' if short else ''}{', '.join(short)}")
    return 0


if __name__ == "__main__":
    result.run(main)
