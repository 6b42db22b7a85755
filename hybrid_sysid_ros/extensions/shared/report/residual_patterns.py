"""Residual patterns: each residual test of a section, judged in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.extensions.shared.report.sections import IdentificationSection

FAILED = {
    "phi_ee": "what is left can be foreseen from its own past: an offset that wanders, or noise that moves the rig. In "
    "a free run this alone is no fault of the model",
    "phi_ue": "past input explains part of what is left: an effect of the input is missing, or its delay is off",
    "phi_re": "the past reference explains part of what is left: an effect of the input is missing. Where the "
    "input came from feedback, this test counts and e · u does not",
    "phi_e(es)": "what is left goes on differently where s is large: noise acts through the input, or gain changes",
    "phi_(s^2)'e": "what is left goes with the size of s: an effect that does not turn its sign with the input is "
    "missing, such as friction or gain that differ by direction",
    "phi_(s^2)'e^2": "what is left is larger where s is larger: some nonlinear effect is missing",
}
"""What it means that a test fails, by its key."""


@dataclass(frozen=True)
class Pattern:
    """A test's title, a sentence on it, and whether it passed on every record."""

    title: str
    words: str
    passed: bool


def patterns(section: IdentificationSection) -> Iterator[Pattern]:
    """A judgement of each residual test over all runs of a section."""
    for key, title in section.tests.items():
        tests = {run.name: run.tests[key] for run in section.runs if key in run.tests}
        failed = {name: test for name, test in tests.items() if not test.passed}
        if not failed:
            yield Pattern(title, f"No pattern in {'any' if len(tests) > 1 else 'the'} run.", passed=True)
            continue
        name, test = max(failed.items(), key=lambda item: float(np.abs(item[1].values[item[1].lags >= 0]).max()))
        past = test.lags >= 0
        k = int(np.argmax(np.abs(test.values[past])))
        lag, value = section.model.sampling.period * float(test.lags[past][k]), float(test.values[past][k])
        shown = f"{value:.2f}".replace("-", "\N{MINUS SIGN}")
        words = (
            f"In {len(failed)} of {len(tests)} runs {FAILED.get(key, FAILED['phi_ue'])}. "
            f"Most in {name}: a correlation of {shown} after {lag:.2g} s."
        )
        yield Pattern(title, words, passed=False)
