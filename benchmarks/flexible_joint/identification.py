"""Gray boxes of the flexible joint and their hybrids, free-run over records that no fit saw.

What is learnt from, and what is scored, says the section demo of the rig's file. Options of the hybrids are those of
the largest score of blocked cross-validation within the training data, with seed 0: of hybrid_lugre for all hybrids,
and of each hybrid by residual for itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.search.cross_validation import cross_validate
from hybrid_sysid_ros.identification import Part, Scores, identify
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.validation.scores import score_free_run
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

OUTPUT = "link_speed"
BOXES = ("linear", "stribeck", "dahl", "lugre")
SEEDS = (0, 1, 2)
SAMPLING = Sampling(period=0.01)
TRAINING = Part(stop=0.5)
LEARNT = ("multisine", "random_steps")
UNSEEN: Mapping[str, Part] = {"multisine": Part(start=0.5), "random_steps": Part(start=0.5), "swept_sine": Part()}

DEVIATION = 5.73
"""Of the source's output: MSE / (1 - R2) is its square in every row of its Table 5."""

CANDIDATES: tuple[dict[str, float], ...] = (
    {"everywhere": 0},
    {"everywhere": 1},
    {"everywhere": 1, "scale": 0.3},
    {"everywhere": 1, "scale": 1.0},
    {"everywhere": 1, "scale": 1.0, "ridge": 1.0},
)

RESIDUAL_CANDIDATES: tuple[dict[str, float], ...] = (
    {"units": 8},
    {"units": 16},
    {"units": 8, "ridge": 3.0},
)
"""Of the hybrids by residual: one for each gray box, for each leaves another residual."""

PUBLISHED = {  # Table 5: MSE and R2 of the gray box and of its hybrid, on the identification set
    "linear": (3.3253, 0.8989, 0.5018, 0.9847),
    "stribeck": (4.5041, 0.8630, 0.4765, 0.9855),
    "dahl": (4.1782, 0.8729, 2.2018, 0.9330),
    "lugre": (1.7023, 0.9482, 0.6648, 0.9798),
}


def measured(rig: Rig) -> dict[str, Any]:
    """Fit everything and score it."""
    folder = Path(__file__).parents[2] / "bags"
    records = {name: bags.read(folder / f"{rig.name}_{name}", rig.signals) for name in UNSEEN}
    learnt = [records[name] for name in LEARNT]
    choice = _choice(learnt, rig, "hybrid_lugre", CANDIDATES)
    residual_choice = {box: _choice(learnt, rig, f"residual_{box}", RESIDUAL_CANDIDATES) for box in BOXES}
    chosen = _best(choice)
    residual = {box: _best(found) for box, found in residual_choice.items()}
    rows = {}
    for box in BOXES:
        for structure, seeds, options in (
            (box, SEEDS[:1], {}),
            (f"hybrid_{box}", SEEDS, chosen),
            (f"residual_{box}", SEEDS, residual[box]),
        ):
            runs = []
            for seed in seeds:
                model = identify(learnt, rig, structure, sampling=SAMPLING, part=TRAINING, options=options, seed=seed)
                scores = {name: free_run_scores(model, records[name], part) for name, part in UNSEEN.items()}
                r2 = {name: score.outputs[OUTPUT].r2 for name, score in scores.items()}
                training = [score["outputs"][OUTPUT]["r2"] for score in model.scores.values()]
                runs.append({"unseen": r2, "training": training, "seconds": model.fit["seconds"]})
            rows[structure] = {
                **{name: result.spread([run["unseen"][name] for run in runs]) for name in UNSEEN},
                "unseen": result.spread([np.mean(list(run["unseen"].values())) for run in runs]),
                "scaled_mse": result.spread([scaled(run["unseen"]) for run in runs]),
                "scaled_training_mse": result.spread([DEVIATION**2 * (1.0 - np.mean(run["training"])) for run in runs]),
                "training": result.spread([np.mean(run["training"]) for run in runs]),
                "seconds": result.spread([run["seconds"] for run in runs]),
            }
    return {
        "choice": choice,
        "chosen": chosen,
        "residual_choice": residual_choice,
        "residual_chosen": residual,
        "structures": rows,
    }


def free_run_scores(model: Model, record: Record, part: Part) -> Scores:
    """Of the strict free run, also where the angle, which nothing holds, has drifted off: the speed is scored."""
    return score_free_run(model.system, experiment_of(model, record, part=part))


def _choice(
    learnt: Sequence[Record], rig: Rig, structure: str, candidates: Sequence[Mapping[str, float]]
) -> list[dict[str, Any]]:
    """Scores of blocked cross-validation within the training data."""
    choice: list[dict[str, Any]] = []
    for options in candidates:
        try:
            found = cross_validate(learnt, rig, structure, sampling=SAMPLING, part=TRAINING, options=options)
        except UserError as error:
            choice.append({"options": dict(options), "refused": str(error)})
            continue
        choice.append({"options": dict(options), "r2": found.value, "standard_error": found.standard_error})
    return choice


def _best(choice: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    scored = [item for item in choice if "r2" in item]
    return dict(max(scored, key=lambda item: float(item["r2"]))["options"])


def scaled(r2: Mapping[str, float]) -> float:
    """Mean squared error of records whose outputs are all scaled to the published deviation."""
    return DEVIATION**2 * float(1.0 - np.mean(list(r2.values())))


def tables(found: Mapping[str, Any]) -> list[Table]:
    """R2 of each record and scaled errors beside the published ones."""
    r2 = Table("structure", "training", *UNSEEN, "unseen", "fit [s]", title=f"free-run R2 of {OUTPUT}: mean (range)")
    for name, row in found["structures"].items():
        r2.add_row(
            name, *(_shown(row[key]) for key in ("training", *UNSEEN, "unseen")), f"{row['seconds']['mean']:.1f}"
        )
    errors = Table("gray box", "MSE", "hybrid", "less by [%]", "published MSE", "hybrid", "less by [%]", title="scaled")
    for box, (gray, _, hybrid, _) in PUBLISHED.items():
        here, there = (found["structures"][name]["scaled_mse"] for name in (box, f"hybrid_{box}"))
        errors.add_row(
            box,
            f"{here['mean']:.3f}",
            f"{there['mean']:.3f} ({there['min']:.3f}-{there['max']:.3f})",
            f"{100 * (1 - there['mean'] / here['mean']):.1f}",
            f"{gray:.3f}",
            f"{hybrid:.3f}",
            f"{100 * (1 - hybrid / gray):.1f}",
        )
    cuts = Table("gray box", "training", "unseen", "published", title="error cut by the hybrid by residual [%]")
    for box, (gray, _, hybrid, _) in PUBLISHED.items():
        rows = (found["structures"][name] for name in (box, f"residual_{box}"))
        cuts.add_row(box, *_cuts(*rows), f"{100 * (1 - hybrid / gray):.1f}")
    return [r2, errors, cuts]


def _cuts(gray: Mapping[str, Any], hybrid: Mapping[str, Any]) -> list[str]:
    """By how much a hybrid lowers the mean squared error of its gray box, on training data and unseen, over seeds."""
    found = []
    for name in ("scaled_training_mse", "scaled_mse"):
        mean, low, high = (100.0 * (1.0 - hybrid[name][key] / gray[name]["mean"]) for key in ("mean", "max", "min"))
        found.append(f"{mean:.1f} ({low:.1f}-{high:.1f})")
    return found


def _shown(values: Mapping[str, float]) -> str:
    if values["min"] == values["max"]:
        return f"{values['mean']:.4f}"
    return f"{values['mean']:.4f} ({values['min']:.4f}-{values['max']:.4f})"
