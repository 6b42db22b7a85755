"""Information: what an experiment tells of a model's parameters, by the sensitivities of its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Sensitivities, System, rollouts
from hybrid_sysid_ros.identification.problem import CORRELATION_SECONDS
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LEAST_KNOWN = 1e3
"""Sizes of a number within which it counts as known beforehand where nothing else is."""
LONGEST = 0.3
"""Most of half the length of a secant, in a number's size."""
MOST = 300
"""Free numbers of a model whose experiments are designed: more are weights without a meaning."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Knowledge:
    """What is known of a model's free numbers."""

    names: tuple[str, ...]
    sizes: Array
    """By which deviations are counted: the larger one of a parameter's value and its declared scale, (free,)."""
    information: Array
    """In numbers that are counted in their sizes, (free, free)."""

    @classmethod
    def of(cls, model: Model) -> Knowledge:
        """That of a fitted model: the inverse of its covariance; where that says nothing, a declared prior, or next to
        nothing. Raises UserError for a model without free numbers, or with too many.
        """
        if not 0 < len(model.names) <= MOST:
            raise UserError(
                f"{model.structure} of {model.rig} has {len(model.names)} free numbers; an experiment is designed for "
                f"1 to {MOST}: identify a gray box (--structure gray)"
            )
        declared, values = {item.name: item for item in model.system.parameters}, model.system.named
        sizes, spreads = np.ones(len(model.names)), np.full(len(model.names), np.inf)
        for k, name in enumerate(model.names):
            if name in declared:
                sizes[k] = max(abs(values[name]), declared[name].scale)
                spreads[k] = declared[name].spread or np.inf
        covariance = model.covariance / np.outer(sizes, sizes)
        known = np.diag(covariance) > 0.0
        information = np.diag(LEAST_KNOWN**-2 + np.where(known, 0.0, (sizes / spreads) ** 2))
        block = np.ix_(known, known)
        information[block] += np.linalg.pinv(covariance[block], rcond=1e-12, hermitian=True)
        return cls(names=model.names, sizes=sizes, information=information)

    def deviations(self, more: Array | None = None, pull: Array | None = None) -> Array:
        """Standard deviations of the numbers in their units, also after further information, (free,). pull: by which
        a known error moves them, see :meth:`Fisher.shown`.
        """
        covariance = np.linalg.inv(self.information if more is None else self.information + more)
        moved = np.zeros(len(covariance)) if pull is None else covariance @ pull
        return np.asarray(np.sqrt(np.diag(covariance) + moved**2) * self.sizes)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fisher:
    """The Fisher information of experiments about a system's numbers.

        M = sum_k S_k' R^-1 S_k,   S_k = d y_k / d theta,

    with R the noise of outputs: Goodwin & Payne (1977), Dynamic System Identification, chapter 6. Where a fit has more
    to find, as the beginning of a record, M is the inverse of the covariance of what it finds.
    """

    sensitivities: Sensitivities
    sampling: Sampling
    sizes: Array
    weight: Array
    """1 / (variance of an independent reading) of each output at the scored samples, (outputs,)."""
    steps: Array | None = None
    """Half of the lengths of secants in the parameters' units, (parameters,), for a law with corners; None: exact
    derivatives.
    """
    columns: Sequence[int] = ()
    """Those of the sensitivities that are numbers of the model; by default all."""
    begins: Array | None = None
    """Deviations within which a fit knows the states at the beginning of a record, (states,); None: it knows them."""

    @classmethod
    def of(cls, model: Model, rig: Rig, sizes: Array) -> Fisher:
        """That of a model on a rig, whose sensors and training errors give the noise."""
        places = {item.name: i for i, item in enumerate(model.system.parameters)}
        free = [places[name] for name in model.names if name in places]
        weights = [name.removeprefix("weight_") for name in model.names if name not in places]
        known = np.sqrt(np.clip(np.diag(model.covariance)[: len(free)], 0.0, None))
        most = LONGEST * sizes[: len(free)]
        return cls(
            sensitivities=Sensitivities(model.system, parameters=free),
            begins=begins_of(rig, model.sampling.period),
            sampling=model.sampling,
            sizes=sizes,
            weight=1.0 / noise_of(model, rig) ** 2,
            steps=np.where(known > 0.0, np.minimum(known, most), most) if by_secants(model.system, rig) else None,
            columns=[*range(len(free)), *(len(free) + int(number) for number in weights)],
        )

    def information(self, system: System, inputs: Array, first: Array | None = None) -> Array:
        """M of a run from rest, or from a first state (states,), in numbers that are counted in their sizes, (free,
        free). inputs (steps, inputs).
        """
        return self.shown(system, inputs, first)[0]

    def shown(self, system: System, inputs: Array, first: Array | None = None) -> tuple[Array, Array]:
        """M, and a pull g (free,): errors d of the integration step move a fit by M^-1 g, g = sum_k S_k' R^-1 d_k."""
        tangents = self.tangents(system, inputs, first)
        states = 0 if self.begins is None else len(self.begins)
        chosen = [
            *(self.columns or range(tangents.shape[2] - states)),
            *range(tangents.shape[2] - states, tangents.shape[2]),
        ]
        sizes = self.sizes if self.begins is None else np.concatenate([self.sizes, self.begins])
        scaled = tangents[:, :, chosen] * np.sqrt(self.weight)[:, None] * sizes
        rows = scaled.reshape(-1, scaled.shape[2])
        whole = np.asarray(rows.T @ rows)
        pull = rows.T @ (self._step_error(system, inputs, first) * np.sqrt(self.weight)).ravel()
        count = whole.shape[0] - states
        if not states:
            return whole, pull
        begins = whole[:count, count:] @ np.linalg.inv(whole[count:, count:] + np.eye(states))
        return (
            whole[:count, :count] + np.eye(count) / LEAST_KNOWN**2 - begins @ whole[count:, :count],
            pull[:count] - begins @ pull[count:],
        )

    def _step_error(self, system: System, inputs: Array, first: Array | None) -> Array:
        """Errors of the outputs by the integration step, by half of it, (samples, outputs), as a fit knows them."""
        samples, sampling = len(inputs) // self.sampling.every + 1, self.sampling
        starts, rest = run_of(system, samples)
        begin = rest if first is None else np.ascontiguousarray(first[None])
        if system.sampling_time is not None or system.stepper.is_map:
            return np.zeros((samples, len(system.outputs)))
        with np.errstate(all="ignore"):
            coarse, fine = (
                rollouts(
                    system, starts, begin, np.repeat(inputs, parts, axis=0),
                    step=sampling.step / parts, every=parts * sampling.every,
                )[1]
                for parts in (1, 2)
            )  # fmt: skip
            return np.asarray(np.nan_to_num(2.0 * (fine - coarse), posinf=0.0, neginf=0.0))

    def tangents(self, system: System, inputs: Array, first: Array | None = None) -> Array:
        """Derivatives of the outputs by the numbers, (samples, outputs, free); 0 where a run diverges."""
        samples = len(inputs) // self.sampling.every + 1
        out = np.empty((samples, len(system.outputs), self.sensitivities.count))
        starts, rest = run_of(system, samples)
        begin = rest if first is None else np.ascontiguousarray(first[None])
        with np.errstate(all="ignore"):
            self.sensitivities.rollouts(
                system, starts, begin, inputs, step=self.sampling.step, every=self.sampling.every, out=out
            )
        if self.steps is not None:
            for column, (place, step) in enumerate(zip(self.sensitivities.parameters, self.steps, strict=True)):
                out[:, :, column] = self._secant(system, place, float(step), inputs, begin)
        return out if np.isfinite(out).all() else np.zeros_like(out)

    def _secant(self, system: System, place: int, step: float, inputs: Array, begin: Array) -> Array:
        """Change of the outputs by a parameter, over a length within its bounds, (samples, outputs)."""
        item, values = system.parameters[place], system.values
        ends, found = np.clip([values[place] - step, values[place] + step], item.low, item.high), []
        starts, _ = run_of(system, len(inputs) // self.sampling.every + 1)
        for end in ends.tolist():
            values[place] = end
            with np.errstate(all="ignore"):
                found.append(
                    rollouts(
                        system.with_values(values), starts, begin, inputs,
                        step=self.sampling.step, every=self.sampling.every,
                    )[1]
                )  # fmt: skip
        return np.asarray((found[1] - found[0]) / max(float(ends[1] - ends[0]), 1e-300))


def begins_of(rig: Rig, period: float) -> Array:
    """Deviations of the states at the beginning of a record: what a sensor shows within its noise, its rate within that
    of a difference, and others within their size.
    """
    found = np.ones(len(rig.system.states))
    places = {item.name: i for i, item in enumerate(rig.system.states)}
    noise = np.array([abs(sensor.scale) * sensor.floor for sensor in rig.sensors])
    for item, size in zip(rig.system.outputs, noise.tolist(), strict=True):
        if item.name in places:
            found[places[item.name]] = size
            if (rate := rig.system.kinematics.get(places[item.name])) is not None:
                found[rate] = size / period
    return found


def by_secants(system: System, rig: Rig) -> bool:
    """Whether the information is that of secants over what is not known, as a fit's standard errors are: where a law
    has corners of dry friction, at which a derivative misses what a fit finds. In a loop the inputs of a plan are those
    of one model alone, and a search finds secants that no record bears out; derivatives for several models hold.
    """
    return has_corners(system) and not rig.experiments.loops


def has_corners(system: System) -> bool:
    """Whether a law has corners of dry friction, where it is decided that a motion ends."""
    return any(not contact.hidden for contact in system.contacts)


def run_of(system: System, samples: int) -> tuple[NDArray[np.int64], Array]:
    """Starts and first states of one rollout from rest."""
    return np.array([[0, 0, samples, 0]], dtype=np.int64), np.zeros((1, len(system.states)))


def noise_of(model: Model, rig: Rig) -> Array:
    """Noise of each output at scored samples, as a standard deviation of independent ones, (outputs,) in SI: that of a
    model's training errors, of which a correlation time is one observation, and at least what the sensor has.

    Where a model does not have the correlation time, what its errors have beyond the sensor's noise counts as slow, a
    stretch of CORRELATION_SECONDS as one observation.
    """
    found, bands = [], (model.note("bands") or {}).get("outputs", {})
    for item, sensor in zip(model.system.outputs, rig.sensors, strict=True):
        errors = [scores.get("outputs", {item.name: scores})[item.name]["rmse"] for scores in model.scores.values()]
        whole = float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0
        white = abs(sensor.scale) * sensor.floor
        if samples := bands.get(item.name, {}).get("correlation"):
            found.append(max(white, whole * np.sqrt(float(samples))))
            continue
        slow = max(whole**2 - white**2, 0.0) * max(CORRELATION_SECONDS / model.sampling.period, 1.0)
        found.append(np.sqrt(white**2 + slow))
    if not np.all(np.array(found) > 0.0):
        raise UserError(f"{rig.file}: neither sensors nor training errors say how noisy an output is; declare sensors")
    return np.array(found)
