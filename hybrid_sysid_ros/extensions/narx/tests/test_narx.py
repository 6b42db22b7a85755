"""Polynomial NARX: published coefficients, SysIdentPy's own models and simulations, and known truths."""

import dataclasses
import sys
from itertools import pairwise

import numpy as np
import pytest
import yaml

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Variable, compiled, one_step, simulate
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.extensions.narx.narx import Narx
from hybrid_sysid_ros.extensions.narx.term_selection import select_terms
from hybrid_sysid_ros.extensions.shared.lagged import REACH
from hybrid_sysid_ros.identification import PreparedRecord, free_run, prepare, score
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import DRIVE, POSITION
from tests.one_joint import narx as narx_of

SAMPLING = Sampling(step=0.05, period=0.05)

PUBLISHED = {  # exponents of y(k), y(k-1), y(k-2), u(k), u(k-1), u(k-2), all in V: coefficient
    (1, 0, 0, 0, 0, 0): 1.1440,
    (0, 1, 0, 0, 0, 0): -0.0171,
    (0, 0, 1, 0, 0, 0): -0.1534,
    (0, 0, 0, 1, 0, 0): 0.2197,
    (0, 0, 0, 0, 0, 0): -0.1618,
    (0, 0, 0, 2, 1, 0): 0.0015,
    (0, 1, 0, 0, 1, 0): 0.0124,
    (1, 1, 1, 0, 0, 0): 0.0022,
    (0, 0, 0, 0, 0, 1): -0.0452,
    (0, 1, 0, 0, 2, 0): -0.0019,
}


def published(output_scale=1.0, input_scale=1.0):
    """The author's model; with scales, the same one in other coefficients."""
    return narx_of(
        exponents=tuple(PUBLISHED),
        coefficients=tuple(
            value * output_scale ** (sum(term[:3]) - 1) * input_scale ** sum(term[3:])
            for term, value in PUBLISHED.items()
        ),
        output_lags=3,
        input_lags=3,
        output_range=(-10.0, 10.0),
        input_range=(-10.0, 10.0),
        output_scale=output_scale,
        input_scale=input_scale,
    )


TRUTH = {  # of y(k), y(k-1), u(k), u(k-1)
    (1, 0, 0, 0): 0.7,
    (0, 0, 1, 0): 0.5,
    (0, 1, 0, 0): -0.2,
    (0, 0, 0, 2): 0.3,
    (1, 0, 1, 0): -0.15,
}


def polynomial(inputs, start):
    """Outputs of TRUTH, one more than inputs; y(-1) = y(0) = start and u(-1) = u(0)."""
    y = [start, start]
    for k, u in enumerate(inputs):
        past = (y[-1], y[-2], u, inputs[max(k - 1, 0)])
        y.append(sum(value * np.prod(np.power(past, term)) for term, value in TRUTH.items()))
    return np.array(y[1:])


def selected(experiments, **settings):
    return select_terms(experiments, outputs=POSITION, inputs=DRIVE, **settings)


def experiment(inputs, outputs, name="bench"):
    return PreparedRecord(
        name=name, sampling=SAMPLING, inputs=inputs[:, None], outputs=outputs[:, None], states=outputs[:, None]
    )


def benches(*, noise=0.0, lengths=(150, 90, 200), offsets=(3.0, -3.0, 2.0)):
    """Records of TRUTH about levels that are far apart, so that a row across a border would be far from true."""
    random = np.random.default_rng(0)
    found = []
    for number, (length, offset) in enumerate(zip(lengths, offsets, strict=True)):
        inputs = random.uniform(-1, 1, length)
        outputs = polynomial(inputs, offset)
        found.append(experiment(inputs, outputs + noise * random.normal(size=length + 1), name=f"bench_{number}"))
    return found


def physical(narx):
    """Coefficients by exponents, in the units of output and input."""
    (terms,), (output, drive) = narx.exponents, narx.scales
    return {
        term: value * output ** (1 - sum(term[: narx.output_lags])) / drive ** sum(term[narx.output_lags :])
        for term, value in zip(terms, narx.coefficients, strict=True)
    }


def started(narx, item):
    """An experiment that begins where the lags of an equation do."""
    inputs = np.concatenate([item.inputs, item.inputs[-1:]])
    return dataclasses.replace(
        item, states=narx.record_map().states_from_record(item.outputs, np.zeros_like(item.outputs), inputs)
    )


# The equation


def test_the_published_model_simulates_as_published(experiments):
    """RMSE .591 V on the record it was identified from, read every 50 ms.

    Its coefficients are printed to four decimals: rounding by so much moves the RMSE by .004 V (one deviation of 500).
    """
    record = experiments["05_multisine_01"]
    outputs, inputs = record.output[::50], record.input[::50]
    narx = published()
    states = narx.record_map().states_from_record(outputs[:, None], np.zeros((len(outputs), 1)), inputs[:, None])
    # It begins with three measured outputs, as SysIdentPy's predictions do.
    simulated = simulate(narx, states[2], inputs[2:-1, None], step=0.05)[:, 0]
    error = outputs - np.concatenate([outputs[:2], simulated])
    assert np.sqrt(np.mean(error**2)) == pytest.approx(0.591, abs=0.008)


def test_scales_change_the_coefficients_and_nothing_else():
    random = np.random.default_rng(0)
    inputs = random.uniform(-4, 4, (200, 1))
    start = random.uniform(-1, 1, 5)
    expected = simulate(published(), start, inputs, step=0.05)
    np.testing.assert_allclose(
        simulate(published(output_scale=2.5, input_scale=0.3), start, inputs, step=0.05), expected, atol=1e-10
    )


@pytest.mark.parametrize("reach", [1.0, 100.0])  # within the range, and mostly held at its ends
def test_the_compiled_and_the_casadi_form_agree(reach):
    narx = published(output_scale=2.0, input_scale=5.0)
    symbolic = symbolic_step(narx, step=0.05)
    random = np.random.default_rng(1)
    for _ in range(200):
        x, u = reach * random.uniform(-5, 5, 5), reach * random.uniform(-10, 10, 1)
        following = one_step(narx, x, u, step=0.05)
        np.testing.assert_allclose(following, np.array(symbolic(x, u)).ravel(), rtol=1e-11, atol=1e-12)


def test_polynomials_of_the_same_terms_share_their_compiled_form():
    assert compiled(published()) is compiled(published().with_weights(np.ones(len(PUBLISHED))))


def test_a_short_recurrence_by_hand():
    other = narx_of(
        exponents=((1, 0), (0, 1)),
        coefficients=(0.5, 2.0),
        output_lags=1,
        input_lags=1,
        output_range=(-9.0, 9.0),
        input_range=(-9.0, 9.0),
    )
    np.testing.assert_allclose(simulate(other, np.array([4.0]), np.ones((2, 1)), step=0.05)[:, 0], [4.0, 4.0, 4.0])
    simulated = simulate(other, np.array([0.0]), np.array([[1.0], [3.0]]), step=0.05)
    np.testing.assert_allclose(simulated[:, 0], [0.0, 2.0, 7.0])


def test_states_are_the_records_own_past_and_extrapolated_before_it():
    outputs, rates, inputs = np.array([[1.0], [4.0], [9.0], [16.0]]), np.full((4, 1), 20.0), np.arange(4.0)[:, None]
    states = published().record_map().states_from_record(outputs, rates, inputs)
    # y(k), y(k-1), y(k-2), u(k-1), u(k-2); at 20 a second the output rose by 1 a sample before.
    np.testing.assert_allclose(
        states, [[1, 0, -1, 0, 0], [4, 1, 0, 0, 0], [9, 4, 1, 1, 0], [16, 9, 4, 2, 1]], atol=1e-12
    )
    assert [state.name for state in published().states] == [
        *("position", "position_1", "position_2"),
        *("drive_1", "drive_2"),
    ]


def test_a_free_run_never_leaves_its_band():
    unstable = narx_of(
        exponents=((3, 0), (0, 3), (0, 0)),
        coefficients=(4.0, 1.0, 0.1),
        output_lags=1,
        input_lags=1,
        output_range=(1.0, 3.0),
        input_range=(-1.0, 1.0),
    )
    for level in (1.0, 1e9, 1e200, -1e200):
        outputs = simulate(unstable, np.array([2.0]), np.full((500, 1), level), step=0.05)[1:, 0]
        assert np.all(np.abs(outputs - 2.0) <= REACH)


def test_a_design_survives_a_file():
    narx = published(output_scale=2.0)
    again = Narx.of(yaml.safe_load(yaml.safe_dump(narx.design)), narx.weights)
    assert again == narx
    assert again.with_weights(2 * narx.weights).coefficients == tuple(2 * narx.weights)


@pytest.mark.parametrize(
    "change",
    [
        {"output_lags": 0},
        {"input_lags": 2},
        {"coefficients": (1.0,)},
        {"exponents": (((0, 0, 0, 0, 0, -1),),), "coefficients": (1.0,)},
        {"scales": (1.0,)},
        {"exponents": (tuple(PUBLISHED), ())},
    ],
)
def test_terms_that_do_not_fit_are_refused(change):
    with pytest.raises(UserError, match="NARX"):
        dataclasses.replace(published(), **change)


# Its terms


def test_the_terms_of_several_records_are_found_and_their_borders_do_not_matter():
    pytest.importorskip("sysidentpy")
    found = selected(benches(), output_lags=2, input_lags=2, degree=2)
    assert physical(found) == pytest.approx(TRUTH, abs=1e-9)
    reverse = selected(benches()[::-1], output_lags=2, input_lags=2, degree=2)
    assert physical(reverse) == pytest.approx(TRUTH, abs=1e-9)


def test_the_terms_are_found_under_noise():
    pytest.importorskip("sysidentpy")
    items = benches(noise=0.002, lengths=(800, 700), offsets=(1.0, -1.0))
    found = selected(items, output_lags=2, input_lags=2, degree=2, terms=5)
    assert physical(found) == pytest.approx(TRUTH, abs=0.02)


def test_a_record_that_begins_at_rest_hides_no_terms():
    """Rows of exact zeros, on which SysIdentPy's reflections divide by zero."""
    pytest.importorskip("sysidentpy")
    inputs = np.concatenate([np.zeros(40), np.random.default_rng(3).uniform(-1, 1, 200)])
    found = selected([experiment(inputs, polynomial(inputs, 0.0))], output_lags=2, input_lags=2, degree=2)
    assert physical(found) == pytest.approx(TRUTH, abs=1e-9)


def test_one_record_gives_the_model_and_the_simulation_of_sysidentpy():
    """Its own regressors, selection, estimate and free run; its x(k-1) is our u(k)."""
    pytest.importorskip("sysidentpy")
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    item = benches(noise=0.05, lengths=(300,), offsets=(1.0,))[0]
    found = selected([item], output_lags=3, input_lags=2, degree=3, terms=7)
    peer = FROLS(
        order_selection=False,
        n_terms=7,
        ylag=3,
        xlag=2,
        basis_function=Polynomial(degree=3),
        estimator=LeastSquares(),
    )
    scaled = item.outputs / found.scales[0]
    inputs = np.concatenate([item.inputs, item.inputs[-1:]]) / found.scales[1]
    peer.fit(X=inputs, y=scaled)
    columns = (1001, 1002, 1003, 2001, 2002)
    terms = [tuple(int(np.sum(code == column)) for column in columns) for code in peer.final_model]
    theirs = dict(zip(terms, peer.theta.ravel(), strict=True))
    assert dict(zip(found.exponents[0], found.coefficients, strict=True)) == pytest.approx(theirs, rel=1e-8)
    expected = peer.predict(X=inputs, y=scaled[:3])[2:, 0] * found.scales[0]
    assert np.ptp(expected) > 0.5
    start = started(found, item).states[2]
    np.testing.assert_allclose(simulate(found, start, item.inputs[2:], step=0.05)[:, 0], expected, atol=1e-9)


def test_each_output_of_several_has_its_own_terms_in_all_signals():
    """Two outputs that drive each other, and two inputs."""
    pytest.importorskip("sysidentpy")
    random = np.random.default_rng(4)
    u = random.uniform(-1, 1, (400, 2))
    y = np.zeros((401, 2))
    for k in range(400):
        y[k + 1, 0] = 0.6 * y[k, 0] + 0.2 * y[k, 1] + 0.5 * u[k, 0] - 0.1 * u[k, 1] ** 2
        y[k + 1, 1] = 0.3 * y[k, 1] - 0.4 * y[k, 0] * u[k, 1] + u[k, 1]
    item = PreparedRecord(name="pair", sampling=SAMPLING, inputs=u, outputs=y, states=y)
    names = [tuple(Variable(name=f"{kind}_{i}", unit="V") for i in "ab") for kind in ("y", "u")]
    found = select_terms([item], outputs=names[0], inputs=names[1], output_lags=1, input_lags=1, degree=2)
    assert set(found.exponents[0]) == {(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 2)}
    assert set(found.exponents[1]) == {(0, 1, 0, 0), (1, 0, 0, 1), (0, 0, 0, 1)}
    np.testing.assert_allclose(free_run(found, started(found, item)), y, atol=1e-8)
    symbolic = symbolic_step(found, step=0.05)
    x, drive = random.normal(size=len(found.states)), random.normal(size=2)
    np.testing.assert_allclose(one_step(found, x, drive, step=0.05), np.array(symbolic(x, drive)).ravel(), rtol=1e-12)


def test_refinement_lowers_the_error_of_the_simulation():
    """Noise on the outputs biases one-step estimates; those of the simulation are near the truth."""
    pytest.importorskip("sysidentpy")
    records = {"lengths": (800, 800), "offsets": (0.5, -0.5)}
    noisy, clean = benches(noise=0.05, **records), benches(**records)
    first = selected(noisy, output_lags=2, input_lags=2, degree=2, terms=5)
    refined = fit(first, [started(first, item) for item in noisy], ridge=1e-6).system

    def error(narx):
        return np.mean([score(item.outputs[:, 0], free_run(narx, started(narx, item))[:, 0]).rmse for item in clean])

    assert set(first.exponents[0]) == set(TRUTH)
    assert error(refined) < 0.5 * error(first)


def test_selection_is_silent(capfd):
    pytest.importorskip("sysidentpy")
    selected(benches(), output_lags=2, input_lags=2, degree=3, terms=30)
    assert capfd.readouterr() == ("", "")


def test_records_that_can_not_be_used_are_named():
    long, short = benches(lengths=(100, 4), offsets=(1.0, 1.0))
    with pytest.raises(UserError, match=r"bench_1: 5 samples are too short for 5 lags; 6 are needed"):
        selected([long, short], output_lags=2, input_lags=5, degree=1, terms=2)
    finer = dataclasses.replace(long, sampling=Sampling())
    with pytest.raises(UserError, match="bench_0: a NARX steps once a sample"):
        selected([finer], output_lags=1, input_lags=1, degree=1)
    with pytest.raises(UserError, match="4 terms of 3 candidates and 100 samples; ask for 3 or fewer"):
        selected([long], output_lags=1, input_lags=1, degree=1, terms=4)
    with pytest.raises(UserError, match="must be 1 or more"):
        selected([long], output_lags=1, input_lags=0, degree=1)


def test_a_missing_sysidentpy_is_named_with_its_extra(monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "sysidentpy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "sysidentpy", None)
    with pytest.raises(UserError, match=r"sysidentpy.* is missing; .*hybrid_sysid_ros\[narx\]"):
        selected(benches(), output_lags=1, input_lags=1, degree=1, terms=2)


def test_a_record_of_the_beam_is_simulated(records, rig):
    """From averaged inputs, on the half that was not seen."""
    pytest.importorskip("sysidentpy")
    record: Record = records["06_multisine_02"]
    halves = [record.part(start, stop) for start, stop in pairwise((0.0, 0.5, 1.0))]
    first = selected([prepare(halves[0], rig.system, SAMPLING)], output_lags=1, input_lags=2, degree=3, terms=4)
    seen, unseen = (prepare(half, first, SAMPLING) for half in halves)
    refined = fit(first, [seen], ridge=1e-6).system
    assert score(unseen.outputs[:, 0], free_run(refined, unseen)[:, 0]).r2 > 0.8
