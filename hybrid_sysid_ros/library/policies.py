"""Policies: networks that imitate the exact MPC, their certificates, and exports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.controller import MpcSolution
from hybrid_sysid_ros.control.mpc.horizon import PARTS
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.control.safety.certificate import DELTA, LOOPS, Certificate
from hybrid_sysid_ros.library import arguments
from hybrid_sysid_ros.library.arguments import RigLike
from hybrid_sysid_ros.library.models import Model, load_model, sealed
from hybrid_sysid_ros.models import Model as AnyModel
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError, shown
from hybrid_sysid_ros.support.files import path_of
from hybrid_sysid_ros.support.progress import StageProgress
from hybrid_sysid_ros.support.text_table import text_table

DEFAULT = Settings()
MOST = 10**9
OF_MODELS = {"loop": True, "fmu": True, "page": True, "ros2_control": True, "urdf": False, "mjcf": False}
"""Formats of a whole model beside CasADi's, and whether a policy may go with it."""
FORMATS = ("onnx", "c", "both", *OF_MODELS)
SECONDS = 0.02, 8.0
"""Shortest and longest loop of a certificate [s]."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Policy(policies.Policy):
    """A network that replaces an MPC, and the model of this MPC.

    ``policy.control(state, disturbance, previous_input, preview)`` answers; ``policy.save(folder)`` keeps it.
    """

    imitates: Model
    """The model of the exact MPC that it imitates."""

    @classmethod
    def of(cls, policy: policies.Policy, model: Model) -> Policy:
        """A policy with its model."""
        given = {item.name: getattr(policy, item.name) for item in fields(policies.Policy) if item.init}
        return cls(**given, imitates=model)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """Answer one instance: state (n,), disturbance (m,) and previous_input (m,), preview (horizon, p).

        See :class:`hybrid_sysid_ros.control.Controller`. Raises UserError for a part of another shape.
        """
        shapes = (self.states,), (self.inputs,), (self.inputs,), (self.horizon, self.outputs)
        parts = state, disturbance, previous_input, preview
        for name, part, shape in zip(PARTS, parts, shapes, strict=True):
            if not (isinstance(part, np.ndarray) and part.dtype.kind in "iuf"):
                arguments.array_of(part, f"control: {name}")
            if np.shape(part) != shape:
                raise UserError(f"control: {name} has shape {np.shape(part)}; it needs {shape}")
        return super().control(*parts)

    def __repr__(self) -> str:
        widths = ", ".join(str(len(bias)) for _, bias in self.layers[:-1])
        return f"Policy({self.rig}: tanh layers of {widths}, a plan of {self.stages} of {self.horizon} intervals)"

    def __str__(self) -> str:
        rows = [
            (key.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value))
            for key, value in self.training.items()
        ]
        return text_table(f"policy for {self.rig}", ("quantity", "value"), rows, most=8, rest="policy.training")


def train_policy(
    rig: RigLike,
    model: AnyModel,
    *,
    episodes: int = DEFAULT.episodes[0],
    rounds: int = len(DEFAULT.episodes),
    epochs: int = DEFAULT.epochs,
    hidden: Sequence[int] = DEFAULT.hidden,
    plan: bool = DEFAULT.sequence,
    follow: Mapping[str, float] | None = None,
    margin: float = DEFAULT.margin,
    seed: int = 0,
    workers: int = 0,
    cluster: str = "",
    samples: str | Path | None = None,
    progress: StageProgress | None = None,
) -> Policy:
    """Train a network that imitates the exact MPC of a rig on a model (extra ``train``).

    episodes: closed loops in each round. rounds: number of rounds; from the second one on the policy drives (DAgger).
    epochs: those of the last round. hidden: widths of the tanh layers. plan: give the whole plan, which can be checked
    and certified. follow: parameters of the model to which the policy adapts, with their spreads. margin: share of a
    state's range by which the imitated MPC has tighter bounds. seed: random seed. workers: number of processes, 0 for
    one per core. cluster: address of a Dask scheduler in their place, or local. samples: folder of finished loops, with
    which an interrupted training continues. progress(stage, done, of): a function that is called during the work.

    The defaults take an hour on a few cores. Raises UserError where torch is missing, or a number is out of range.
    """
    used = sealed(model, arguments.rig_of(rig))
    settings = Settings(
        episodes=(arguments.whole_of(episodes, "episodes", low=2, high=MOST),)
        * arguments.whole_of(rounds, "rounds", low=1, high=100),
        epochs=arguments.whole_of(epochs, "epochs", low=1, high=MOST),
        hidden=_widths(hidden),
        workers=arguments.whole_of(workers, "workers", low=0, high=MOST),
        cluster=arguments.text_of(cluster, "cluster"),
        sequence=arguments.flag_of(plan, "plan"),
        followed=arguments.given_options(follow, "follow"),
        margin=arguments.number_of(margin, "margin", low=0.0, high=0.49),
    )
    given: dict[str, Any] = {
        "seed": arguments.seed_of(seed),
        "samples": None if samples is None else path_of(samples, "samples"),
        "progress": arguments.callable_of(progress, "progress", "stage, done, of"),
    }
    trained: policies.Policy = extensions.one("policies", "train", "hs.train_policy needs the extension policies")(
        used, settings, **given
    )
    return Policy.of(trained, used)


def load_policy(folder: str | Path, model: AnyModel | None = None, *, rig: str | Path = "") -> Policy:
    """Read a policy folder and run its self-check.

    model: the model that it was trained for, by default the one that comes with the package. rig: folder of its rig,
    where that is not known by name. Raises UserError for a missing or altered file, and another model.
    """
    place = path_of(folder, "folder")
    arguments.source_of(rig)
    own = policies.load(place, certified=False).rig
    used = load_model(shipped(own, "model")) if model is None else sealed(model, arguments.rig_of(own))
    return Policy.of(policies.load(place, model=used), used)


def certify(
    policy: policies.Policy,
    model: AnyModel | None = None,
    *,
    loops: int = LOOPS,
    seconds: float | None = None,
    delta: float = DELTA,
    seed: int = 0,
    workers: int = 0,
    cluster: str = "",
    store: str | Path | None = None,
    progress: StageProgress | None = None,
) -> Certificate:
    """Certify a policy: run random closed loops beside the exact MPC, and bound the rates at which it keeps criteria.

    model: the model that the policy imitates, by default its own. loops: number of independent loops. seconds: length
    of a loop, by default that of the rig's file. delta: probability with which one of the bounds may be wrong. seed:
    random seed. workers: number of processes, 0 for one per core. cluster: address of a Dask scheduler in their place,
    or local. store: folder of finished loops, with which an interrupted certification continues. progress(stage, done,
    of): a function that is called during the work.

    ``certificate.save(folder)`` writes it into its policy's folder. Raises UserError where policy and model don't fit.
    """
    if not isinstance(policy, policies.Policy):
        raise UserError(f"policy is {shown(policy)}; give a policy: train_policy makes one, load_policy reads one")
    if model is None and not isinstance(policy, Policy):
        raise UserError("model is missing; give the model that the policy imitates")
    used = (
        policy.imitates if isinstance(policy, Policy) and model is None else sealed(model, arguments.rig_of(policy.rig))
    )
    if used.seal != policy.model:
        raise UserError(f"model is another one than the policy's of {policy.rig}; give the one that it was trained for")
    low, high = SECONDS
    length = None if seconds is None else arguments.number_of(seconds, "seconds", low=low, high=high, unit="s")
    given: dict[str, Any] = {
        "seconds": length,
        "seed": arguments.seed_of(seed),
        "loops": arguments.whole_of(loops, "loops", low=1, high=MOST),
        "delta": arguments.number_of(delta, "delta", low=0.0, high=0.999, above=True),
        "workers": arguments.whole_of(workers, "workers", low=0, high=MOST),
        "cluster": arguments.text_of(cluster, "cluster"),
        "store": None if store is None else path_of(store, "store"),
        "progress": arguments.callable_of(progress, "progress", "stage, done, of"),
    }
    found: Certificate = extensions.one("policies", "certify", "hs.certify needs the extension policies")(
        policy, _seal(policy), used, **given
    )
    return found


def export(
    model: AnyModel | policies.Policy,
    out: str | Path,
    *,
    format: str = "both",
    step: float = 0.0,
    smoothing: float = 0.0,
    overwrite: bool = False,
    policy: policies.Policy | None = None,
) -> Path:
    """Write a model as CasADi functions, or a policy as ONNX and C99, or another body of a model; return its path.

    format: for a policy, "onnx" (extra ``export``), "c" or "both"; "loop" for a model's loop as C99, its estimator and
    exact MPC, with ``policy`` before it if one is given; "ros2_control" for a colcon package with it; "page" for an
    HTML file with it and the model (extra ``page``); "fmu" for an FMI 3.0 file (extra ``fmu``) of a model, or with
    ``policy`` of its supervised controller; "urdf" and "mjcf" for a model's joints. step: for a model, that of its step
    function [s], 0 for its own. smoothing: for a model, the velocity over which stick-slip is rounded, 0 for none.
    overwrite: replace what is there. Results are checked against the original. Raises UserError for a place that can't
    be written.
    """
    folder, replaced = path_of(out, "out"), arguments.flag_of(overwrite, "overwrite")
    form = arguments.choice_of(format, "format", FORMATS)
    needs = "hs.export needs the extension export"
    if policy is not None and (not OF_MODELS.get(form) or isinstance(model, policies.Policy)):
        raise UserError("policy is for a model's loop: give a model, and format='loop'")
    if isinstance(model, policies.Policy):
        if form in OF_MODELS:
            raise UserError(f"format is {form!r}; it is for a model: give the policy as policy=")
        for name, value in (("step", step), ("smoothing", smoothing)):
            if value != 0.0:
                raise UserError(f"{name} is {shown(value)}; it is for a model: leave it out for a policy")
        extensions.one("exporters", "policy", needs)(model, folder, seal=_seal(model), form=form, overwrite=replaced)
        return folder
    if not isinstance(model, AnyModel):
        raise UserError(f"model is {shown(model)}; give a model or a policy")
    if form in OF_MODELS:
        used, given = sealed(arguments.given_model(model)), dict[str, Any]()
        if OF_MODELS[form]:
            given["settings"] = {"real_time": True}
        if policy is not None:
            given["settings"] = {"real_time": True, "policy": "supervised"}
            given |= {"network": policy, "policy_seal": _seal(policy)}
        extensions.one("exporters", form, needs)(
            arguments.rig_of(used.rig), used, folder, seal=used.seal, **given, overwrite=replaced
        )
        return folder
    if form != "both":
        raise UserError(
            f"format is {form!r}; it is for a policy: leave it out for a model, which is written for CasADi"
        )
    given = {
        "step": arguments.number_of(step, "step", low=0.0, unit="s"),
        "smoothing": arguments.number_of(smoothing, "smoothing", low=0.0),
    }
    extensions.one("exporters", "model", needs)(
        sealed(arguments.given_model(model)), folder, **given, overwrite=replaced
    )
    return folder


def _seal(policy: policies.Policy) -> str:
    """The seal of a policy's folder, wherever it is saved."""
    with TemporaryDirectory() as scratch:
        policy.save(Path(scratch) / "policy")
        return storage.digest(Path(scratch) / "policy", kind="policy")


def _widths(value: object) -> tuple[int, ...]:
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str) or not np.size(value):
        raise UserError(f"hidden is {shown(value)}; give the widths of the layers, such as (64, 64)")
    widths = np.atleast_1d(value) if isinstance(value, np.ndarray) else value
    return tuple(arguments.whole_of(width, f"hidden[{index}]", low=1, high=MOST) for index, width in enumerate(widths))
