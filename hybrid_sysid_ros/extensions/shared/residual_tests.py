"""Residual tests: whether residuals contain anything that a model could explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

CONFIDENCE = 0.99
LAGS = 25
SPAN = 4  # lags of the residuals' autocovariance that are used, in numbers of tested lags
NO_POWER = 1e-2  # share of the largest eigenvalue below which a combination of lags was not excited
DESCRIPTIONS = {
    "phi_ee": "residual with itself",
    "phi_ue": "residual with input",
    "phi_e(eu)": "residual with residual times input",
    "phi_(u^2)'e": "residual with input squared",
    "phi_(u^2)'e^2": "residual squared with input squared",
}
"""The signals that each of the five correlation tests compares."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualTest:
    """Correlation coefficients of residuals, and their probability if nothing is left to explain."""

    lags: NDArray[np.int64]
    """Lags in samples, (lags,)."""
    values: Array
    """Coefficients, -1 to 1, (lags,)."""
    bound: float
    """A single coefficient is within +-bound with probability CONFIDENCE."""
    statistic: float
    """Statistic of all tested lags, chi-squared with ``degrees`` of freedom."""
    degrees: int
    p_value: float
    """Probability of a statistic at least as large."""

    @classmethod
    def of(
        cls, lags: NDArray[np.int64], values: Array, variance: float, statistic: float, degrees: int
    ) -> ResidualTest:
        """A test from the variance of a coefficient where nothing is left, and the statistic of all."""
        bound = float(scipy.stats.norm.ppf(0.5 + 0.5 * CONFIDENCE) * np.sqrt(variance))
        p_value = float(scipy.stats.chi2.sf(statistic, degrees))
        return cls(lags=lags, values=values, bound=bound, statistic=float(statistic), degrees=degrees, p_value=p_value)

    @property
    def passed(self) -> bool:
        """Whether the statistic is within the range that it has with probability CONFIDENCE where nothing is left."""
        return self.p_value >= 1.0 - CONFIDENCE

    @property
    def outside(self) -> int:
        """Number of coefficients beyond the bound."""
        return int(np.sum(np.abs(self.values) > self.bound))


def whiteness(residuals: Array, *, lags: int = LAGS) -> ResidualTest:
    """Autocorrelation of residuals (samples,) at lags 1 to `lags`, after their mean is removed.

    r(k) = R(k) / R(0), R(k) = 1/N sum e(t) e(t - k); bound N_a / sqrt N; Ljung (1999), System Identification, 2nd ed.,
    section 16.6. The statistic is that of Ljung and Box (1978), Biometrika 65(2): N (N + 2) sum r(k)^2 / (N - k).
    A free run of an output-error model need not pass: its residuals hold the process noise as the rig filters it.

    Raises UserError for too few samples, or residuals that are constant or not finite.
    """
    centred = _centred(residuals, "residuals", lags)
    samples = len(centred)
    covariance = _covariances(centred, centred)
    positive = np.arange(1, lags + 1)
    values = covariance[samples - 1 + positive] / covariance[samples - 1]
    statistic = samples * (samples + 2) * np.sum(values**2 / (samples - positive))
    return ResidualTest.of(positive, values, 1.0 / samples, statistic, lags)


def independence(residuals: Array, signal: Array, *, lags: int = LAGS) -> ResidualTest:
    """Cross-correlation of residuals with an input or reference, both (samples,), at lags -`lags` to `lags`.

    r(k) = 1/N sum e(t) u(t - k) / (deviation of e, of u). Positive lags show what past inputs still explain, negative
    ones the effect of residuals on later inputs, as feedback causes it. The residuals need not be white: with
    R the autocovariances, sqrt(N) R_eu(k) has variance P = sum_j R_e(j) R_u(j), and two lags i, j the covariance
    sum_l R_e(l) R_u(l + i - j); Ljung (1999), section 16.6. R_e goes through a Parzen window over SPAN * `lags`: a line
    that the input leaves in the residuals must stand out from their spectrum, not raise it. The statistic N r' P^-1 r
    covers lags 0 to `lags`, without combinations in which the signals have no power. If the input was made from past
    residuals (feedback) and these are not white, only a test against the reference has these probabilities.

    Raises UserError for too few samples, or a signal that is constant or not finite.
    """
    error, cause = _centred(residuals, "residuals", lags), _centred(signal, "signal", lags)
    if len(error) != len(cause):
        raise UserError(f"residual test: {len(error)} residuals, but {len(cause)} samples of the signal")
    samples = len(error)
    error, cause = error / np.std(error), cause / np.std(cause)
    all_lags = np.arange(-lags, lags + 1)
    values = _covariances(error, cause)[samples - 1 + all_lags]
    own = _covariances(error, error) * _parzen(np.arange(1 - samples, samples) / (SPAN * lags))
    products = scipy.signal.correlate(own, _covariances(cause, cause), mode="full", method="fft")
    middle = len(products) // 2
    variances, directions = np.linalg.eigh(scipy.linalg.toeplitz(products[middle : middle + lags + 1]))
    excited = variances > NO_POWER * variances[-1]
    amounts = directions.T[excited] @ values[lags:]
    statistic = samples * np.sum(amounts**2 / variances[excited])
    return ResidualTest.of(all_lags, values, products[middle] / samples, statistic, int(np.sum(excited)))


def correlation_tests(residuals: Array, signal: Array, *, lags: int = LAGS) -> dict[str, ResidualTest]:
    """The five tests that together see linear and nonlinear terms left in residuals e; e, u (samples,) without means.

        phi_ee(k) = E e(t) e(t - k)                 as from white noise: :func:`whiteness`
        phi_ue(k) = E e(t) u(t - k)                 0 at every lag
        phi_e(eu)(k) = E e(t) e(t - k) u(t - k)     0 for k > 0
        phi_(u^2)'e(k) = E e(t) (u^2)'(t - k)       0 at every lag; x' is x without its mean
        phi_(u^2)'e^2(k) = E (e^2)'(t) (u^2)'(t - k)    0 at every lag

    Billings and Voon (1986), Correlation based model validity tests for non-linear models, Int. J. Control 44(1), where
    phi_e(eu) at k + 1 is theirs at k. The last four are :func:`independence` of these signals, so their bounds hold for
    residuals of any colour; with coloured ones those of phi_e(eu) are too tight where the residuals are correlated with
    themselves (5 % instead of 1 % of such lags are outside for first-order residuals with a pole at .9). Which fail
    tells what is missing: phi_ue sees a linear or odd term of the input, phi_(u^2)'e an even one, phi_(u^2)'e^2 either
    and odd ones that have no linear part, phi_e(eu) products of input and noise.

    Returns: the tests by the names in DESCRIPTIONS. A binary input has no (u^2)', so its two tests are left out.

    Raises UserError for too few samples, different numbers of them, or a signal that is constant or not finite.
    """
    e, u = _centred(residuals, "residuals", lags), _centred(signal, "signal", lags)
    if len(e) != len(u):
        raise UserError(f"residual test: {len(e)} residuals, but {len(u)} samples of the signal")
    pairs = {"phi_ue": (e, u), "phi_e(eu)": (e, e * u)}
    if np.ptp(u**2) > 1e-9 * np.max(u**2):
        pairs |= {"phi_(u^2)'e": (e, u**2), "phi_(u^2)'e^2": (e**2, u**2)}
    tests = {name: independence(*pair, lags=lags) for name, pair in pairs.items()}
    return {"phi_ee": whiteness(residuals, lags=lags), **tests}


def _covariances(first: Array, second: Array) -> Array:
    """1/N sum first(t) second(t - k) at k = -(N - 1) ... N - 1, shape (2 N - 1,)."""
    return np.asarray(scipy.signal.correlate(first, second, mode="full", method="fft") / len(first))


def _parzen(share: Array) -> Array:
    """Parzen's window over shares of its half width: a lag window whose spectrum is nowhere negative."""
    a = np.abs(share)
    return np.where(a <= 0.5, 1 - 6 * a**2 + 6 * a**3, 2 * np.clip(1 - a, 0, None) ** 3)


def _centred(values: Array, name: str, lags: int) -> Array:
    values = np.asarray(values, dtype=float)
    if lags < 1 or len(values) < 2 * lags:
        raise UserError(f"residual test: {len(values)} samples are too few for {lags} lags: use twice as many or more")
    if not np.isfinite(values).all():
        raise UserError(f"residual test: the {name} are not finite at sample {int(np.argmax(~np.isfinite(values)))}")
    centred = values - values.mean()
    if np.std(centred) <= 1e-12 * float(np.max(np.abs(values))):
        raise UserError(f"residual test: the {name} are constant: there is nothing to correlate")
    return centred
