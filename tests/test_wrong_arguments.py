"""What the front door, ``import hybrid_sysid_ros as hs``, says to wrong arguments: one line with its name."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.control import MpcSolution, Status
from tests.shared import Frame

ROOT = Path(__file__).parents[1]
BAGS, TRAINED = ROOT / "bags", ROOT / "trained"
TIME = np.arange(400) * 0.005
WAVE = np.sin(TIME)


def made(**changes: Any) -> Record:
    """A record of a beam, but for what is changed."""
    given: dict[str, Any] = {"time": TIME, "inputs": WAVE, "outputs": 0.1 * WAVE, "rig": "cam_beam"}
    return hs.record(**{**given, **changes})


def beam() -> Record:
    return hs.read_bag(BAGS / "beam_multisine", "cam_beam")


def turning(value: float) -> Callable[[Any], Any]:
    """A reference that is wrong from 1.5 s on."""
    return lambda times: np.where(times > 1.5, value, 0.0)[:, None]


def own(control: Callable[..., Any], **changes: Any) -> Any:
    """A controller as a user writes one."""
    methods = {"control": control, "prepare": lambda elapsed: None, "reset": lambda: None}
    return SimpleNamespace(**{"horizon": 5, "period": 0.05, **methods, **changes})


def gives(value: Any) -> Any:
    """A controller that answers everything with this input."""
    return own(lambda *instance: MpcSolution(value, value, value, Status.FEEDBACK))


@pytest.fixture(scope="module")
def things() -> SimpleNamespace:
    """What arguments are made of."""
    model = hs.load_model(TRAINED / "cam_beam" / "model")
    mpc = hs.mpc("cam_beam", model)
    mpc.control(np.zeros(2), np.zeros(1), np.zeros(1), np.zeros((mpc.horizon, 1)))  # later calls are no less checked
    return SimpleNamespace(
        mpc=mpc,
        record=made(),
        two_columns=hs.record(time=TIME, inputs=np.zeros((400, 2)), outputs=WAVE),
        volts=hs.record(time=TIME, inputs=WAVE, outputs=4.0 * WAVE),
        wheel=hs.record(time=TIME, inputs=WAVE, outputs=np.stack([WAVE, WAVE], axis=1)[:, :1], rig=None),
        model=model,
        other=hs.load_model(TRAINED / "wheel_motor" / "model"),
        policy=hs.load_policy(TRAINED / "cam_beam" / "policy"),
        rig=hs.load_rig("cam_beam"),
    )


Case = tuple[str, Callable[[SimpleNamespace], object]]
WRONG: list[Case] = [
    # rigs and bags
    ("rig", lambda t: hs.load_rig("cam_beem")),
    ("rig", lambda t: hs.load_rig("")),
    ("rig", lambda t: hs.load_rig(7)),  # type: ignore[arg-type]
    ("rig", lambda t: hs.load_rig("./nowhere")),
    ("rig", lambda t: hs.load_rig(BAGS / "beam_multisine")),
    ("rig", lambda t: hs.load_rig(t.model)),
    ("rig", lambda t: hs.load_rig("./a\0b")),
    ("rig", lambda t: hs.load_rig("./" + "a" * 5000)),
    ("rig", lambda t: hs.load_rig("~nosuchuser/x")),
    ("rig", lambda t: hs.read_bag(BAGS / "beam_multisine", t.record)),
    ("path", lambda t: hs.read_bag(t.record, "cam_beam")),
    ("path", lambda t: hs.read_bag("nowhere", "cam_beam")),
    ("signals", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", signals="nowhere.yaml")),
    ("signals", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", signals=BAGS)),
    ("period", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", period=1e300)),
    ("topic", lambda t: hs.read_bag(BAGS / "wheel_motor_multisine", "cam_beam")),
    ("period", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", period=-1.0)),
    ("period", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", period="1")),  # type: ignore[arg-type]
    ("signals", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", signals=3)),  # type: ignore[arg-type]
    ("recover", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", recover="no")),  # type: ignore[arg-type]
    ("period", lambda t: hs.read_bag(BAGS / "beam_multisine", "cam_beam", period=10**400)),
    ("path", lambda t: hs.read_bag("~nosuchuser/x", "cam_beam")),
    ("path", lambda t: hs.read_bag("./a\0b", "cam_beam")),
    ("path", lambda t: hs.read_bag("./" + "a" * 5000, "cam_beam")),
    # arrays
    ("time", lambda t: made(time=TIME[:, None])),
    ("time", lambda t: made(time="now")),
    ("time", lambda t: made(time=TIME**2)),
    ("time", lambda t: made(time=-TIME)),
    ("backwards", lambda t: made(time=TIME[::-1])),
    ("time", lambda t: made(time=[0.0])),
    ("inputs", lambda t: made(inputs=WAVE[:-1])),
    ("inputs", lambda t: made(inputs=np.stack([WAVE, WAVE]).T)),
    ("inputs", lambda t: made(inputs=WAVE[None])),
    ("inputs", lambda t: made(inputs=np.where(TIME < 1.0, WAVE, np.nan))),
    ("inputs", lambda t: made(inputs=["a"] * 400)),
    ("inputs", lambda t: made(inputs={"force": WAVE})),
    ("inputs['drive']", lambda t: made(inputs={"drive": np.stack([WAVE, WAVE]).T})),
    ("masked", lambda t: made(inputs=np.ma.masked_greater(WAVE, 0.5))),
    ("inputs has the names", lambda t: made(inputs=Frame(force=WAVE))),
    ("outputs has the names", lambda t: made(outputs=Frame(position=WAVE, speed=WAVE))),
    ("dtype bool", lambda t: made(inputs=WAVE > 0)),
    ("precision float32", lambda t: made(time=(TIME + 1.7e9).astype(np.float32))),
    ("timedelta64", lambda t: made(time=TIME.astype("datetime64[s]"))),
    ("dtype object", lambda t: made(inputs=[Decimal(1)] * 400)),
    ("differ in length", lambda t: made(inputs=[[1.0], [1.0, 2.0]])),
    ("input drive", lambda t: made(inputs=100.0 * WAVE)),
    ("outputs", lambda t: made(outputs=3.0)),
    ("dtype complex128", lambda t: made(outputs=WAVE.astype(complex))),
    ("output position", lambda t: made(outputs=5.0 * WAVE)),
    ("units", lambda t: made(units={"position": "bar"})),
    ("units", lambda t: made(units={"speed": "V"})),
    ("units", lambda t: made(units="V")),
    ("units", lambda t: made(units={"position": "V"}, rig=None)),
    ("channels", lambda t: made(channels={"reference": WAVE[:3]})),
    ("channels", lambda t: made(channels={"a": [[1], [1, 2]]})),  # type: ignore[dict-item]
    ("channels", lambda t: made(channels={"a": np.full(400, np.nan)})),
    ("channels", lambda t: made(channels={3: WAVE})),  # type: ignore[dict-item]
    ("units of position", lambda t: made(units={"position": np.array(["V", "V"])})),
    ("name", lambda t: made(name="a\nb")),
    ("name", lambda t: made(name="../../x")),
    ("name", lambda t: made(name="")),
    ("time", lambda t: Record(name="a", time="now", input=WAVE[:, None], output=WAVE[:, None])),  # type: ignore[arg-type]
    ("input", lambda t: Record(name="a", time=TIME, input=[[1], [1, 2]], output=WAVE[:, None])),  # type: ignore[arg-type]
    ("channels", lambda t: Record(name="a", time=TIME, input=WAVE[:, None], output=WAVE[:, None], channels=WAVE)),  # type: ignore[arg-type]
    ("a part", lambda t: t.record.part("0", 1)),  # type: ignore[arg-type]
    ("a part", lambda t: t.record.part(0, np.nan)),
    ("every", lambda t: t.record.part(0, 1, every=0)),
    # identify
    ("records", lambda t: hs.identify([], "cam_beam")),
    ("records", lambda t: hs.identify(None, "cam_beam")),  # type: ignore[arg-type]
    ("records", lambda t: hs.identify("bags/beam_multisine", "cam_beam")),  # type: ignore[arg-type]
    ("records", lambda t: hs.identify(WAVE, "cam_beam")),  # type: ignore[arg-type]
    ("records[0]", lambda t: hs.identify([WAVE], "cam_beam")),  # type: ignore[list-item]
    ("records[1]", lambda t: hs.identify([t.record, "bags/beam_multisine"], "cam_beam")),  # type: ignore[list-item]
    ("records[0]", lambda t: hs.identify(t.two_columns, "cam_beam")),
    ("records[0]", lambda t: hs.identify(t.record, "wheel_motor")),
    ("output position", lambda t: hs.identify(t.volts, "cam_beam")),
    ("records", lambda t: hs.identify([t.record, t.record], "cam_beam")),
    ("rig", lambda t: hs.identify(t.record, t.model)),
    ("structure", lambda t: hs.identify(t.record, "cam_beam", "hybird")),
    ("structure", lambda t: hs.identify(t.record, "cam_beam", 5)),  # type: ignore[arg-type]
    ("option", lambda t: hs.identify(t.record, "cam_beam", "gray", options={"neurons": 3})),
    ("options", lambda t: hs.identify(t.record, "cam_beam", options={"units": "8"})),  # type: ignore[dict-item]
    ("options", lambda t: hs.identify(t.record, "cam_beam", options=8)),  # type: ignore[arg-type]
    ("options", lambda t: hs.identify(t.record, "cam_beam", options={"units": 10**400})),
    ("options", lambda t: hs.identify(t.record, "cam_beam", options={"units": np.complex128(8)})),
    ("part", lambda t: hs.identify(t.record, "cam_beam", part=(0.5, 0.2))),
    ("part", lambda t: hs.identify(t.record, "cam_beam", part=(0, 50))),
    ("part", lambda t: hs.identify(t.record, "cam_beam", part=0.5)),  # type: ignore[arg-type]
    ("part", lambda t: hs.identify(t.record, "cam_beam", part=np.array(0.5))),
    ("part", lambda t: hs.identify(t.record, "cam_beam", part=[(0, 0.5), (0.5, 1)])),
    ("sampling", lambda t: hs.identify(t.record, "cam_beam", sampling=0.05)),  # type: ignore[arg-type]
    ("sampling", lambda t: hs.identify(t.record, "cam_beam", sampling={"rate": 20})),
    ("sampling", lambda t: hs.identify(t.record, "cam_beam", sampling={"step": "fast"})),
    ("seed", lambda t: hs.identify(t.record, "cam_beam", seed=-1)),
    ("seed", lambda t: hs.identify(t.record, "cam_beam", seed=0.5)),  # type: ignore[arg-type]
    ("progress", lambda t: hs.identify(t.record, "cam_beam", progress=True)),  # type: ignore[arg-type]
    ("progress", lambda t: hs.identify(beam(), "cam_beam", "gray", part=(0, 0.1), progress=lambda a: None)),  # type: ignore[arg-type,misc]
    ("seconds", lambda t: hs.identify(made(time=1e3 * TIME), "cam_beam")),
    # models
    ("folder", lambda t: hs.load_model(t.model)),
    ("folder", lambda t: t.model.save(None)),
    ("folder", lambda t: t.model.save(5)),
    ("folder", lambda t: t.policy.save(None)),
    ("folder", lambda t: t.policy.certificate.save(None)),
    ("is a file", lambda t: t.model.save(__file__)),
    ("model", lambda t: hs.load_model(TRAINED / "cam_beam")),
    ("rig", lambda t: hs.load_model(TRAINED / "cam_beam" / "model", rig=WAVE)),  # type: ignore[arg-type]
    ("rig", lambda t: hs.load_policy(TRAINED / "cam_beam" / "policy", rig=[])),  # type: ignore[arg-type]
    ("record", lambda t: t.model.score("bags/beam_multisine")),
    ("record", lambda t: t.model.score([t.record])),
    ("record", lambda t: t.other.free_run(t.record)),
    ("part", lambda t: t.model.plot(t.record, part=(0.0, np.nan))),
    ("of at least 0 and at most 1", lambda t: t.model.score(t.record, part=(0, np.nan))),
    # loops
    ("model", lambda t: hs.simulate("cam_beam", t.other)),
    ("model", lambda t: hs.simulate("cam_beam", TRAINED / "cam_beam" / "model")),  # type: ignore[arg-type]
    ("plant", lambda t: hs.simulate("cam_beam", t.model, plant=t.other, seconds=1)),
    ("controller", lambda t: hs.simulate("cam_beam", t.model, controller="pid")),
    ("controller", lambda t: hs.simulate("cam_beam", t.model, controller=object())),  # type: ignore[arg-type]
    (
        "controller.control fails: ZeroDivisionError",
        lambda t: hs.simulate("cam_beam", t.model, controller=own(lambda *_: 1 / 0)),
    ),
    ("controller.control gives 3", lambda t: hs.simulate("cam_beam", t.model, controller=own(lambda *_: 3))),
    ("shape (1,)", lambda t: hs.simulate("cam_beam", t.model, controller=gives(np.zeros(2)))),
    ("controller.control is nan", lambda t: hs.simulate("cam_beam", t.model, controller=gives(np.array([np.nan])))),
    ("controller.horizon", lambda t: hs.simulate("cam_beam", t.model, controller=own(len, horizon="a"))),
    ("controller.period", lambda t: hs.simulate("cam_beam", t.model, controller=own(len, period=0.0))),
    ("policy", lambda t: hs.simulate("wheel_motor", t.other, controller=t.policy)),
    ("policy", lambda t: hs.simulate("cam_beam", t.model, policy=t.policy)),
    ("of another rig", lambda t: hs.simulate("wheel_motor", t.other, controller=hs.mpc("cam_beam", t.model))),
    ("'horizon'", lambda t: hs.mpc("cam_beam", t.model, parameters={"controller.horizon": 10})),
    ("riccati_at", lambda t: hs.mpc("cam_beam", t.model, riccati_at=99.0)),
    (
        "term a is not finite",
        lambda t: hs.mpc("cam_beam", t.model, terms={"a": {"value": "log(velocity)", "price": 1}}),
    ),
    ("stage_parameters names 'wall'", lambda t: hs.mpc("cam_beam", t.model, stage_parameters={"wall": 0.03})),
    ("nothing to track", lambda t: hs.mpc("cam_beam", t.model, parameters={"output_weight": [0.0]})),
    (
        "state has shape (3,)",
        lambda t: t.mpc.control(np.zeros(3), np.zeros(1), np.zeros(1), np.zeros((t.mpc.horizon, 1))),
    ),
    ("preview has shape ()", lambda t: t.mpc.control(np.zeros(2), np.zeros(1), np.zeros(1), 0.02)),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference="stairs")),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=[1.0, 2.0])),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=99.0)),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=np.sin)),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=lambda t: 0.1 if t > 1 else 0.0)),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=lambda t: 1 / 0)),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=lambda: 0.0)),  # type: ignore[arg-type,misc]
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=turning(np.nan), seconds=2)),
    ("reference", lambda t: hs.simulate("cam_beam", t.model, reference=turning(1e9), seconds=2)),
    ("give finite numbers", lambda t: hs.simulate("cam_beam", t.model, reference=np.nan)),
    ("seconds", lambda t: hs.simulate("cam_beam", t.model, seconds=0)),
    ("seconds", lambda t: hs.simulate("cam_beam", t.model, seconds=10**400)),
    ("seed", lambda t: hs.simulate("cam_beam", t.model, seed=10**5000, seconds=1)),
    ("seconds", lambda t: hs.simulate("cam_beam", t.model, seconds="ten")),  # type: ignore[arg-type]
    ("seed", lambda t: hs.simulate("cam_beam", t.model, seed="1", seconds=1)),  # type: ignore[arg-type]
    ("parameters", lambda t: hs.simulate("cam_beam", t.model, parameters={"horizon": 10})),
    ("parameters", lambda t: hs.simulate("cam_beam", t.model, parameters={"controller.horizons": 10})),
    ("parameters", lambda t: hs.simulate("cam_beam", t.model, parameters={"controller.horizon": -3})),
    ("argument controller", lambda t: hs.simulate("cam_beam", t.model, parameters={"controller.policy": "exact"})),
    ("argument model", lambda t: hs.simulate("cam_beam", t.model, parameters={"controller.model": "model"})),
    ("input_rate", lambda t: hs.simulate("cam_beam", t.model, parameters={"controller.rate_limit": [1.0]})),
    # policies and what leaves
    ("model", lambda t: hs.train_policy("wheel_motor", t.model)),
    ("episodes", lambda t: hs.train_policy("cam_beam", t.model, episodes=1)),
    ("hidden", lambda t: hs.train_policy("cam_beam", t.model, hidden=64)),  # type: ignore[arg-type]
    ("hidden", lambda t: hs.train_policy("cam_beam", t.model, hidden=())),
    ("hidden", lambda t: hs.train_policy("cam_beam", t.model, hidden=np.array(64.5))),  # type: ignore[arg-type]
    ("follow", lambda t: hs.train_policy("cam_beam", t.model, follow="coulomb")),  # type: ignore[arg-type]
    ("folder", lambda t: hs.load_policy(None)),  # type: ignore[arg-type]
    ("policy", lambda t: hs.load_policy(TRAINED / "cam_beam" / "model")),
    ("model", lambda t: hs.load_policy(TRAINED / "cam_beam" / "policy", t.other)),
    ("policy", lambda t: hs.certify(TRAINED / "cam_beam" / "policy")),  # type: ignore[arg-type]
    ("loops", lambda t: hs.certify(t.policy, loops=0)),
    ("delta", lambda t: hs.certify(t.policy, loops=10, delta="1 %")),  # type: ignore[arg-type]
    ("at most 0.999", lambda t: hs.certify(t.policy, loops=10, delta=1)),
    ("seconds", lambda t: hs.certify(t.policy, seconds=99.0)),
    ("seconds", lambda t: hs.certify(t.policy, loops=1, seconds=0.05, workers=1)),
    ("model", lambda t: hs.export("trained/cam_beam/model", "out")),  # type: ignore[arg-type]
    ("out", lambda t: hs.export(t.model, 3)),  # type: ignore[arg-type]
    ("format", lambda t: hs.export(t.policy, "out", format="matlab")),
    ("format", lambda t: hs.export(t.model, "out", format="banana")),
    ("format", lambda t: hs.export(t.model, "out", format="c")),
    ("step", lambda t: hs.export(t.policy, "out", step=-3)),
    ("step", lambda t: hs.export(t.policy, "out", step=0.1)),
    ("overwrite", lambda t: hs.export(t.policy, "out", overwrite="no")),  # type: ignore[arg-type]
    ("state", lambda t: t.policy.control(0.0, np.zeros(1), np.zeros(1), np.zeros((20, 1)))),
    ("preview", lambda t: t.policy.control(np.zeros(2), np.zeros(1), np.zeros(1), np.zeros(20))),
    ("disturbance", lambda t: t.policy.control(np.zeros(2), ["a"], np.zeros(1), np.zeros((20, 1)))),
]


@pytest.mark.filterwarnings("ignore:.* are its times in ms")  # a doubt of the record, which stands below
@pytest.mark.parametrize(("argument", "call"), WRONG, ids=[f"{k}-{name}" for k, (name, _) in enumerate(WRONG)])
def test_a_wrong_argument_is_reported_in_one_line(
    things: SimpleNamespace, argument: str, call: Callable[[SimpleNamespace], object]
) -> None:
    with pytest.raises(hs.UserError) as caught:
        call(things)
    line = str(caught.value)
    assert argument in line
    assert "\n" not in line
    assert "array([" not in line
    assert len(line) < 500


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"outputs": np.where(np.arange(400) == 200, -0.15, 0.1 * WAVE)}, "spike"),
        (
            {"time": 1e3 * TIME},
            "samples are 5 s apart, 5e+03 times the step of cam_beam, 0.001 s: are its times in ms?",
        ),
    ],
)
def test_doubtful_values_are_warned_of(changes: dict[str, Any], words: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made(**changes)
    assert words in str(caught[0].message)
    assert caught[0].filename == __file__
