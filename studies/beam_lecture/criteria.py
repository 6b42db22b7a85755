"""Information criteria: whether a model's parameters are worth what they explain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.identification.validation.bands import correlation_time
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class InformationCriteria:
    """Criteria of a Gaussian output-error model with n parameters, from N residuals of mean square s2; less is better.

        aic  = N ln s2 + 2 K,  K = n + 1 (the variance is estimated too)            Akaike (1974)
        aicc = aic + 2 K (K + 1) / (N - K - 1), infinite for N <= K + 1             Hurvich and Tsai (1989)
        bic  = N ln s2 + K ln N; half of it is Rissanen's description length (MDL)  Schwarz (1978), Rissanen (1978)
        fpe  = s2 (1 + n/N) / (1 - n/N), infinite for N <= n                        Akaike (1969); Ljung (1999), 16.4

    without the constant N (1 + ln 2 pi) of aic and bic, which is the same for all models of the same N. s2 and fpe are
    in the square of the output's unit. samples: the N that was used, a count of samples or an effective number.
    """

    samples: float
    parameters: int
    mean_square: float
    aic: float
    aicc: float
    bic: float
    fpe: float


@dataclass(frozen=True, kw_only=True)
class ModelCriteria:
    """Criteria by the plain count of samples, and by the number of them that are worth an independent one."""

    plain: InformationCriteria
    effective: InformationCriteria


def criteria(mean_square: float, samples: float, parameters: int) -> InformationCriteria:
    """Criteria from the mean square of residuals, their number (or effective number) and that of the parameters.

    Raises:
        UserError: a mean square or a number that is not above 0.
    """
    if not (mean_square > 0 and samples > 0 and parameters >= 0):
        raise UserError(
            f"criteria: mean square {mean_square:g}, {samples:g} samples and {parameters} parameters: the first two "
            "must be above 0, the last not below"
        )
    count, fit = parameters + 1, samples * float(np.log(mean_square))
    aic = fit + 2 * count
    room = samples - count - 1
    loss = (1 + parameters / samples) / (1 - parameters / samples) if samples > parameters else np.inf
    return InformationCriteria(
        samples=samples,
        parameters=parameters,
        mean_square=mean_square,
        aic=aic,
        aicc=aic + 2 * count * (count + 1) / room if room > 0 else np.inf,
        bic=fit + count * float(np.log(samples)),
        fpe=mean_square * loss,
    )


def judge(models: Mapping[str, tuple[Sequence[Array], int]]) -> dict[str, ModelCriteria]:
    """Criteria of models that were fitted to the same data.

    models: by name the residuals of each record, each (samples,), and the number of parameters. Free-run residuals are
    slow, so N samples are worth N / tau independent ones, tau being :func:`autocorrelation_time`. All models get the
    tau of the one with the smallest residuals, for two models' criteria compare at one N only, and what that one
    leaves is nearest to what any model must leave. This is the quasi-likelihood of Burnham and Anderson (2002), Model
    Selection and Multimodel Inference, 2nd ed., section 2.5, whose inflation factor also comes from the fullest model.

    Raises:
        UserError: models of different numbers of samples, no model, or residuals that are constant or not finite.
    """
    if not models:
        raise UserError("criteria: no model to judge")
    counts = {name: sum(len(part) for part in residuals) for name, (residuals, _) in models.items()}
    if len(set(counts.values())) > 1:
        raise UserError(f"criteria: the models have {counts} residuals; only models of the same data compare")
    squares = {
        name: float(np.mean(np.concatenate([np.asarray(part) for part in residuals]) ** 2))
        for name, (residuals, _) in models.items()
    }
    best = min(squares, key=lambda name: squares[name])
    tau = autocorrelation_time(models[best][0])
    samples = counts[best]
    return {
        name: ModelCriteria(
            plain=criteria(squares[name], samples, parameters),
            effective=criteria(squares[name], samples / tau, parameters),
        )
        for name, (_, parameters) in models.items()
    }


def autocorrelation_time(residuals: Sequence[Array]) -> float:
    """Autocorrelation time tau [samples], at least 1, of the residuals of some records, each (samples,).

    For parameters the number N / tau is careful: their estimates average the residual times its gradient, which is
    correlated less.

    Raises:
        UserError: no residuals, or such as are constant or not finite.
    """
    parts = [np.asarray(part, dtype=float) for part in residuals if len(part)]
    if not parts or not all(np.isfinite(part).all() for part in parts):
        raise UserError("autocorrelation time: there are no residuals, or they are not finite: the simulation diverges")
    if all(np.ptp(part) <= 1e-12 * np.max(np.abs(part)) for part in parts):
        raise UserError("autocorrelation time: the residuals are constant")
    return correlation_time(parts)
