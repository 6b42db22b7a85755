"""Comparison: a model's frequency response and its bands beside that of a record, both from the same inputs.

The model's response is that of its free run over the record's inputs, by the same estimate, so that what segments and
friction do to one they do to the other. Its bands come from free runs of models whose parameters are drawn from their
covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.extensions.frequency_response.spectral_estimate import FrequencyResponse, frequency_response
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.identification.validation.bands import Uncertainty, drawn_systems
from hybrid_sysid_ros.identification.validation.unstable import check_free_run
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

DRAWS = 40
"""Models with drawn parameters, an even number."""
WIDTHS: Mapping[float, float] = {0.5: 0.6745, 0.9: 1.6449}
"""Deviations to each side that hold so large a share of a normal distribution."""
COHERENT = 0.5
"""Coherence from which a band of the record is compared with the model."""
DECIBEL = 20.0 / np.log(10.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseComparison:
    """The responses of a record and of a model to the record's inputs."""

    name: str
    """Of the record."""
    measured: FrequencyResponse
    simulated: FrequencyResponse
    """Of the model's free run, in the same bands."""
    difference: FrequencyResponse
    """Of what was measured less the free run: its deviations lack what segments and curvature do to both alike."""
    gain_deviations: Array
    """Standard deviations of the model's gain, by its parameters [dB], (bands, outputs, inputs)."""
    phase_deviations: Array
    """Of its phase [rad]."""

    @property
    def ratio(self) -> Array:
        """Measured response over the model's: complex, (bands, outputs, inputs)."""
        return np.asarray(self.measured.values / self.simulated.values)

    @property
    def gain_errors(self) -> Array:
        """Measured gain over the model's [dB]."""
        return np.asarray(DECIBEL * np.log(np.abs(self.ratio)))

    @property
    def gain_limits(self) -> Array:
        """What 90 % of the gain errors keep where the model is right [dB]: by its parameters, and by the record."""
        of_record = DECIBEL * self.difference.deviations / np.abs(self.measured.values)
        return np.asarray(WIDTHS[0.9] * np.hypot(self.gain_deviations, of_record))

    def compared(self, output: int) -> NDArray[np.bool_]:
        """Which bands are coherent enough for a comparison, (bands,)."""
        return np.asarray(self.measured.coherence[:, output] >= COHERENT)


def compared(model: Model, experiment: PreparedRecord, *, draws: int = DRAWS) -> ResponseComparison:
    """The comparison of a model with a record that is prepared for it.

    Raises UserError where a free run is meaningless or diverges, and where the record is too short or its inputs show
    no band.
    """
    check_free_run(model.system, experiment)
    samples, sampling = experiment.samples, experiment.sampling
    inputs = experiment.inputs.reshape(samples - 1, sampling.every, -1).mean(axis=1)

    def response(outputs: Array) -> FrequencyResponse:
        try:
            return frequency_response(inputs, outputs[: samples - 1], sampling.period)
        except UserError as error:
            raise UserError(f"{experiment.name}: {error}") from None

    nominal = _run(model.system, experiment)
    if not np.isfinite(nominal).all():
        raise UserError(f"{experiment.name}: the model's free run diverges, so it has no frequency response")
    measured, simulated = response(experiment.outputs), response(nominal)
    difference = response(experiment.outputs - nominal)
    ranges = [model.training_range[item.name] for item in model.system.inputs]
    spans = np.array([high - low for low, high in ranges])
    known = Uncertainty(names=model.names, covariance=model.covariance, spans=spans)
    changed = [_run(system, experiment) for system in drawn_systems(model.system, known, draws)]
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = [np.log(response(run).values / simulated.values) for run in changed if np.isfinite(run).all()]
    squares = [np.mean(np.square(part), axis=0) for part in (np.real(moved), np.imag(moved))] if moved else None
    gains, phases = squares or (np.zeros(simulated.values.shape), np.zeros(simulated.values.shape))
    if len(moved) < len(changed):  # some of the models that the parameters leave open diverge: nothing is known
        gains, phases = np.full_like(gains, np.inf), np.full_like(phases, np.inf)
    return ResponseComparison(
        name=experiment.name,
        measured=measured,
        simulated=simulated,
        difference=difference,
        gain_deviations=DECIBEL * np.sqrt(gains),
        phase_deviations=np.sqrt(phases),
    )


def response_sentence(found: ResponseComparison, system: System, output: int, channel: int) -> str:
    """A sentence on one output's response to one input."""
    name = f"{found.name}: {system.outputs[output].name} by {system.inputs[channel].name}"
    use = found.compared(output)
    if not use.any():
        return f"{name}: the record's response is not coherent anywhere (below {COHERENT:g}), so nothing is compared"
    errors, limits = found.gain_errors[use, output, channel], found.gain_limits[use, output, channel]
    frequencies = found.measured.frequencies[use]
    inside, worst = int(np.sum(np.abs(errors) <= limits)), int(np.argmax(np.abs(errors)))
    side = "above" if errors[worst] > 0.0 else "below"
    return (
        f"{name}: gain inside the 90 % band at {inside} of {len(errors)} frequencies, "
        f"{frequencies[0]:.3g} to {frequencies[-1]:.3g} Hz; farthest at {frequencies[worst]:.3g} Hz, "
        f"{abs(errors[worst]):.2g} dB {side} the model"
    )


def response_content(found: ResponseComparison, system: System) -> dict[str, Any]:
    """The comparison as plain data, by output and input: gains [dB], phases [deg], and the model's 90 % bands."""
    made: dict[str, Any] = {"frequencies": found.measured.frequencies.tolist()}
    width = WIDTHS[0.9]
    for k, output in enumerate(system.outputs):
        made[output.name] = {"coherence": found.measured.coherence[:, k].tolist()}
        for j, item in enumerate(system.inputs):
            made[output.name][item.name] = {
                **{
                    name: {"gain": gain(part)[:, k, j].tolist(), "phase": phase(part)[:, k, j].tolist()}
                    for name, part in (("measured", found.measured), ("model", found.simulated))
                },
                "gain_band": (width * found.gain_deviations[:, k, j]).tolist(),
                "phase_band": np.degrees(width * found.phase_deviations[:, k, j]).tolist(),
                "sentence": response_sentence(found, system, k, j),
            }
    return made


def gain(response: FrequencyResponse) -> Array:
    """Gains [dB] of SI units, (bands, outputs, inputs)."""
    return np.asarray(DECIBEL * np.log(np.maximum(np.abs(response.values), 1e-300)))


def phase(response: FrequencyResponse) -> Array:
    """Phases [deg], without jumps from band to band, (bands, outputs, inputs)."""
    return np.degrees(np.unwrap(np.angle(response.values), axis=0))


def _run(system: System, experiment: PreparedRecord) -> Array:
    """Outputs of the free run, (samples, outputs), each from its own initial state."""
    sampling, starts = experiment.sampling, np.array([[0, 0, experiment.samples, 0]])
    first = initial_state(system, experiment)[None]
    return rollouts(system, starts, first, experiment.inputs, step=sampling.step, every=sampling.every)[1]
