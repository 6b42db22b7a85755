"""Trials of Optuna: how options are drawn, and what makes two studies different."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid_sysid_ros.models import Option

if TYPE_CHECKING:
    import optuna


def study_differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """What differs between two problems, in words."""
    found = []
    for key in sorted({*old, *new}):
        before, now = old.get(key), new.get(key)
        if isinstance(before, dict) and isinstance(now, dict):
            others = sorted(name for name in {*before, *now} if before.get(name) != now.get(name))
            if others:
                found.append(f"other {key} ({', '.join(others)})")
        elif before != now:
            found.append(f"{key} {before}, not {now}")
    return ", ".join(found)


def distribution_of(option: Option) -> optuna.distributions.BaseDistribution:
    """How an option is drawn."""
    from optuna.distributions import FloatDistribution, IntDistribution

    if option.kind == "int":
        return IntDistribution(int(option.low), int(option.high))
    return FloatDistribution(option.low, option.high, log=option.kind == "log")


def sampler_at(seed: int, drawn: int) -> optuna.samplers.BaseSampler:
    """The sampler of the trial after ``drawn`` others."""
    import optuna

    state = int(np.random.SeedSequence((seed, drawn)).generate_state(1)[0])
    with experimental():
        return optuna.samplers.TPESampler(seed=state, multivariate=True, constant_liar=True)


@contextmanager
def experimental() -> Iterator[None]:
    """Around what older versions of Optuna call experimental."""
    import optuna

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        yield
