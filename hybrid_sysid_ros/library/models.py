"""Models: identified from records, scored, simulated and drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_sysid_ros import models
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification import identify as identified
from hybrid_sysid_ros.identification.fitting import FitProgress
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.validation.bands import bands_of
from hybrid_sysid_ros.identification.validation.evaluation import ModelEvaluation, evaluation
from hybrid_sysid_ros.identification.validation.identifiability import doubts, unexplained
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run_states
from hybrid_sysid_ros.identification.validation.unstable import UnsureRunError, check_free_run, stabilised_run
from hybrid_sysid_ros.library import arguments
from hybrid_sysid_ros.library.arguments import PartLike, RigLike, SamplingLike
from hybrid_sysid_ros.models import Sampling, storage
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError, shown
from hybrid_sysid_ros.support.files import path_of
from hybrid_sysid_ros.support.text_table import text_table


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Model(models.Model):
    """An identified model; see :class:`hybrid_sysid_ros.models.Model` for its fields.

    ``print(model)`` shows its parameters with their standard errors. ``model.save(folder)`` keeps it.
    """

    @classmethod
    def of(cls, model: models.Model) -> Model:
        """The model with the methods of this class."""
        if isinstance(model, cls):
            return model
        return cls(**{item.name: getattr(model, item.name) for item in fields(models.Model)})

    @property
    def parameters(self) -> dict[str, float]:
        """Each physical parameter by its name, in its unit."""
        pairs = zip(self.system.parameters, self.system.values.tolist(), strict=True)
        return {item.name: value for item, value in pairs if not item.learned}

    @property
    def doubts(self) -> list[str]:
        """Parameters that the training data did not determine, and runs that do not explain it, a sentence each."""
        poor = [
            f"over {name}, which it was fitted to, R2 of its run is {r2:.2f} for {output}"
            for name, output, r2 in unexplained(self)
        ]
        return [*map(str, doubts(self)), *poor]

    def score(self, record: Record, *, part: PartLike = (0.0, 1.0)) -> Scores:
        """Score the free run over a part of a record: R2, RMSE [SI] and fit in percent of each output. The run begins
        as in the model's fit; ``model.started(initial="first", warm_up=50).score(record)`` begins otherwise.

        For a rig with a stabiliser the run is in closed loop. Raises UserError for a record of another rig, one that
        does not fit the model's sampling, and a free run of an unstable system, which would be meaningless.
        """
        found = self.free_run(record, part=part)
        names, warm_up = [item.name for item in self.system.outputs], self.sampling.warm_up
        return Scores.of(names, found.measured[warm_up:], found.outputs[warm_up:])

    def evaluate(self, record: Record, *, part: PartLike = (0.0, 1.0)) -> ModelEvaluation:
        """Judge the model on a part of a record, as ``hybrid-sysid evaluate`` does: the score of its free run with a
        verdict, whether the use was trained, what its bands hold, and the closed loop done again. Raises UserError as
        :meth:`score` does, but scores an unstable system by predictions if its rig declares a stabiliser.
        """
        rig = rigs.load(self.rig)
        return evaluation(self, arguments.record_of(record, rig), rig, part=arguments.part_of(part))

    def free_run(self, record: Record, *, part: PartLike = (0.0, 1.0)) -> FreeRun:
        """Simulate a part of a record from one initial state. Raises UserError as :meth:`score` does."""
        rig = rigs.load(self.rig)
        chosen = arguments.part_of(part)
        experiment = experiment_of(self, arguments.record_of(record, rig), part=chosen)
        if rig.experiments.stabiliser is None:
            # what is not known of its start is much beside the spread of a short part, which does not make it unsure
            with suppress(UnsureRunError) if chosen != Part() else nullcontext():
                check_free_run(self.system, experiment)
            states, outputs = free_run_states(self.system, experiment)
        else:
            states, outputs = stabilised_run(self.system, experiment, rig.experiments.stabiliser)
        return FreeRun(
            name=experiment.name,
            rig=rig,
            time=np.arange(experiment.samples, dtype=np.float64) * experiment.sampling.period,
            measured=experiment.outputs,
            outputs=outputs,
            states=states,
            bands={band.level: band.half for band in bands_of(self, experiment)},
        )

    def plot(self, record: Record, *, part: PartLike = (0.0, 1.0)) -> Any:
        """Draw the free run over a part of a record: a plotly figure (extra ``report``). Raises UserError as
        :meth:`score` does.
        """
        return self.free_run(record, part=part).plot()

    def sealed(self) -> Model:
        """The model with the seal of its folder, by which policies and certificates refer to it."""
        if self.seal:
            return self
        with TemporaryDirectory() as scratch:
            self.save(Path(scratch) / "model")
            return replace(self, seal=storage.digest(Path(scratch) / "model", kind="model"))


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeRun:
    """A free run over a record, at its scored samples; SI units. n states of the model, p outputs."""

    name: str
    """Name of the record."""
    rig: Rig
    time: Array
    """(samples,) [s]."""
    measured: Array
    """(samples, p)."""
    outputs: Array
    """(samples, p), simulated."""
    states: Array
    """(samples, n), simulated."""
    bands: Mapping[float, Array] = field(default_factory=dict)
    """Half of the width of the bands about the outputs, (samples, p), by level: .5 and .9; empty for models without."""

    def __repr__(self) -> str:
        return f"FreeRun({self.name}: {self.time[-1]:g} s, {len(self.time)} samples)"

    def __str__(self) -> str:
        rows = []
        for item, display, real, run in zip(
            self.rig.system.outputs, self.rig.display, self.measured.T, self.outputs.T, strict=True
        ):
            one = Scores.of([item.name], real[:, None], run[:, None])
            rmse = f"{float(display.shown(one.rmse)):.4g} {display.unit}"
            rows.append((item.name, f"{one.r2:.4f}", rmse, f"{one.fit_percent:.1f} %"))
        return text_table(
            f"free run over {self.name}", ("output", "R2", "RMSE", "fit"), rows, most=8, rest="free_run.outputs"
        )

    def plot(self) -> Any:
        """Draw measured and simulated outputs and their difference: a plotly figure (extra ``report``)."""
        figure = extensions.one("figures", "free_run", "plot needs the extension report")
        return figure(self.rig, self.time, self.measured, self.outputs, self.bands)


def identify(
    records: Record | Sequence[Record],
    rig: RigLike,
    structure: str = "hybrid",
    *,
    sampling: SamplingLike | None = None,
    part: PartLike | Sequence[PartLike] = (0.0, 1.0),
    options: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: FitProgress | None = None,
    refine: bool | None = None,
    criterion: str = "simulation",
) -> Model:
    """Fit a structure to parts of records.

    records: one or several. structure: "hybrid", "gray", "linear", "narx" and the others of ``hybrid-sysid identify
    --help``. sampling: ``step``, ``period``, ``input``, ``initial``, ``initial_samples`` and ``warm_up``, by default
    those of the rig's file, or near 5 and 50 ms as the records allow. part: a part of all records as fractions, or one
    for each record. options: numbers by name, such as {"units": 8}. seed: random seed. progress(stage, evaluations,
    error): a function that is called during the fit. refine: whether a gray box is fitted again at a finer step where
    the step moves its parameters too far; by default where the sampling gives no step. criterion: of physics,
    "simulation" for free runs, or "prediction" for a filter whose input offset walks.

    Raises UserError for records that don't fit the rig, its sampling or each other, or don't excite the rig, and for an
    unknown structure or option.
    """
    described = arguments.rig_of(rig)
    used = arguments.given_records(records, described)
    if not isinstance(structure, str) or not structure:
        raise UserError(f"structure is {shown(structure)}; give its name, such as 'hybrid'")
    names = [record.name for record in used]
    if twins := {name for name in names if names.count(name) > 1}:
        raise UserError(
            f"records: two are called {min(twins)}; results go by the name, so give them names of their own"
        )
    given = isinstance(sampling, Sampling) or (isinstance(sampling, Mapping) and "step" in sampling)
    return Model.of(
        identified(
            used,
            described,
            structure,
            sampling=arguments.given_sampling(sampling, described, used),
            part=arguments.given_parts(part, len(used)),
            options=arguments.given_options(options),
            seed=arguments.seed_of(seed),
            progress=arguments.callable_of(progress, "progress", "stage, evaluations, error"),
            refine=not given if refine is None else arguments.flag_of(refine, "refine"),
            criterion=arguments.choice_of(criterion, "criterion", ("simulation", *extensions.targets("criteria"))),
        )
    )


def load_model(folder: str | Path, *, rig: str | Path = "") -> Model:
    """Read a model folder. rig: folder of its rig, where that is not known by name. Raises UserError where a file
    is missing, altered or newer, or the model does not fit its rig.
    """
    return Model.of(models.load(path_of(folder, "folder"), rig=arguments.source_of(rig)))


def sealed(model: object, rig: Rig | None = None) -> Model:
    """The model of an argument, with its seal."""
    return Model.of(arguments.given_model(model, rig)).sealed()
