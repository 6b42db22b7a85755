"""The public sets with every kind of structure: options chosen by the training data, errors on the official tests."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

import hybrid_sysid_ros
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from hybrid_sysid_ros.extensions.search.cross_validation import cross_validate
from hybrid_sysid_ros.identification.identify import evaluate, identify
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.models.structure import structure_of
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file, written_file
from studies.public.loader import loader_of
from studies.public.sets import HERE, SETS, PublicSet, read

DATA = "HYBRID_SYSID_DATA"
FOLDS = 3
NEAR = 0.01
"""A candidate that comes first is kept unless a later one is better by so many hundredths of R2's distance from 1."""
Candidates = Sequence[Mapping[str, float]]
TANH: Candidates = [{}, *({"units": n, "ridge": ridge} for n in (2, 4, 8) for ridge in (1e-3, 1e-4, 1e-5))]
"""For short records."""
CURVES: Candidates = [{"highest": 4, **item} for item in (
    {}, {"units": 1, "power": 3}, {"units": 2, "power": 3}, {"units": 2}, {"units": 4},
)]  # fmt: skip
"""For a long one."""
EVERYWHERE: Candidates = [{"everywhere": 1, "units": n} for n in (2, 4, 8)]
KINDS: Mapping[str, Mapping[str, tuple[str, Candidates]]] = {
    "drives": {
        "gray": ("gray", [{}]),
        "hybrid": ("hybrid", EVERYWHERE),
        "black box": ("state_space", TANH),
    },
    "tanks": {
        "gray": ("gray", [{}]),
        "hybrid": ("hybrid", EVERYWHERE),
        "black box": ("state_space", TANH),
    },
    "silverbox": {
        "gray": ("gray", [{}]),
        "black box": ("state_space", CURVES),
    },
}
"""By set, kinds of structures with their options to choose from, the simplest first."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """What one kind of structure reached on a set."""

    structure: str
    options: dict[str, float]
    """Chosen by the training data."""
    validation: list[float]
    """R2 in held-out blocks of the training data, by candidate."""
    training: list[list[float]]
    """RMSE of each seed on each training record, in the set's unit."""
    tests: list[list[float]]
    """RMSE of each seed on each test."""


def command(
    folder: Annotated[
        Path | None, typer.Argument(help=f"Folder with the sets' files; by default public/ in {DATA}.")
    ] = None,
    chosen: Annotated[
        list[str] | None, typer.Option("--set", help=f"Only this set, of {', '.join(SETS)}; may be repeated.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", help="Only this kind: gray, hybrid or black box; may be repeated.")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Seeds of each fit.", min=1, max=20)] = 3,
    source: Annotated[
        str, typer.Option(help="Where records come from: files, or the loader nonlinear-benchmarks.")
    ] = "files",
    out: Annotated[
        Path, typer.Option("--json", help="JSON file of the results; what it has already is not done again.")
    ] = Path("out/public.json"),
) -> None:
    """Fit every kind of structure to the public sets, and print its errors on the official tests.

    Each begins as the benchmark says: the first samples of a test give the start and are not scored. Options are chosen
    by held-out blocks of the training data alone. Errors are means over the seeds.
    """
    reader = loader_of(source)
    place = folder or Path(os.environ.get(DATA) or "") / "public"
    if reader is None and not place.is_dir():
        raise UserError(f"{place}: no such folder; give the folder of the sets, or set {DATA} (docs/results/public.md)")
    for name in chosen or []:
        if name not in SETS:
            raise UserError(f"there is no public set {name}; known are {', '.join(SETS)}")
    known = {item for kinds in KINDS.values() for item in kinds}
    for name in kind or []:
        if name not in known:
            raise UserError(f"there is no kind {name}; known are {', '.join(sorted(known))}")
    out.parent.mkdir(parents=True, exist_ok=True)
    check_file(out, suffix=".json")
    found = _kept(out)
    for name in chosen or SETS:
        public = read(name, place, None if reader is None else reader(name))
        for title, (structure, candidates) in KINDS[name].items():
            if kind and title not in kind:
                continue
            key = _key(public, structure, candidates, seeds)
            row = found.setdefault(name, {}).get(title)
            if row is None or row["key"] != key:
                status.print(f"{name}, {title}")
                found[name][title] = {**vars(_row(public, structure, candidates, seeds)), "key": key}
                with written_file(out) as partial:
                    partial.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        print_table(table(public, found[name]))
    console.print(str(out))


def _row(public: PublicSet, structure: str, candidates: Candidates, seeds: int) -> Row:
    """The candidate that its training data prefer, fitted with each seed and then scored on the tests."""
    given: dict[str, Any] = {"sampling": public.sampling}
    validation: list[float] = []
    if len(candidates) > 1:
        for options in candidates:
            try:
                held = cross_validate(
                    public.train, public.rig, structure, options=options, folds=FOLDS, alike=True, **given
                )
                validation.append(held.value)
            except UserError as error:
                status.print(f"  {structure} {dict(options)}: {error}")
                validation.append(-1.0)
    options = candidates[preferred(validation)]
    seeded = structure_of(structure, public.rig.system).seeded
    models = [
        identify(public.train, public.rig, structure, options=options, seed=seed, **given)
        for seed in range(seeds if seeded else 1)
    ]
    return Row(
        structure=structure,
        options=dict(options),
        validation=validation,
        training=[[scores["rmse"] / public.scale for scores in model.scores.values()] for model in models],
        tests=[[evaluate(model, record).rmse / public.scale for record in public.tests] for model in models],
    )


def preferred(validation: Sequence[float]) -> int:
    """Index of the choice: the first whose R2 is hardly further from 1 than that of the best."""
    if not validation:
        return 0
    missing = 1.0 - np.array(validation)
    return int(np.flatnonzero(missing <= (1.0 + NEAR) * missing.min())[0])


def table(public: PublicSet, rows: Mapping[str, Mapping[str, Any]]) -> Table:
    """Errors on the tests by kind, beside what is asked for and what others published."""
    shown = Table(
        "", *(record.name for record in public.tests), "options",
        title=f"{public.name}: RMSE [{public.unit}] of the simulation, mean and range over seeds",
    )  # fmt: skip
    for kind, row in rows.items():
        errors = np.array(row["tests"])
        cells = [
            f"{column.mean():.3g} ({column.min():.3g} to {column.max():.3g})" if np.ptp(column) else f"{column[0]:.3g}"
            for column in errors.T
        ]
        chosen = ", ".join(f"{name}={value:g}" for name, value in row["options"].items())
        shown.add_row(f"{kind} ({row['structure']})", *cells, chosen)
    for title, others in (("goal", public.goals), ("published", public.published)):
        for name, values in others.items():
            cells = [f"{value:g}" for value in values] + [""] * (len(public.tests) - len(values))
            shown.add_row(f"{title}: {name}", *cells, "")
    return shown


def _key(public: PublicSet, structure: str, candidates: Candidates, seeds: int) -> str:
    """Digest of all that a row depends on."""
    files = [(HERE / public.name / file).read_text(encoding="utf-8") for file in ("system.py", "rig.yaml")]
    records = [record.fingerprint for record in (*public.train, *public.tests)]
    chosen = [structure, [dict(item) for item in candidates], seeds, FOLDS, NEAR, astuple(public.sampling)]
    content = [chosen, files, records, package_digest()]
    return hashlib.sha256(json.dumps([content, versions()], default=str).encode()).hexdigest()[:16]


@cache
def package_digest() -> str:
    """Digest of the package's sources: a fit of earlier ones is another one."""
    found = hashlib.sha256()
    for path in sorted(Path(hybrid_sysid_ros.__file__).parent.rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def _kept(path: Path) -> dict[str, dict[str, Any]]:
    if not path.exists():
        return {}
    try:
        found: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
        return {name: dict(rows) for name, rows in found.items() if all("key" in row for row in rows.values())}
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise UserError(f"{path}: holds no results of this study ({error}); give another file") from error
