"""What all tests share."""
# ruff: noqa: E402

import os

# Threads of linear algebra spin while they wait: with a busy neighbour the small problems here take ten times as long.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.control.policy.kernels import TrainingRange
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.core import System, simulate
from hybrid_sysid_ros.estimation import Estimator, estimator_class
from hybrid_sysid_ros.models import Model, Sampling, load
from hybrid_sysid_ros.rigs import outside
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.excitation import Reference, multisine, random_steps
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support import extensions
from studies.beam_lecture import records as bab
from tests.one_joint import Linear
from tests.small_systems import FlexibleJoint, Motor, Slider

if TYPE_CHECKING:
    from tests.node_bench import Bench

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # before the first import of a message: a wrong type fails, not corrupts


@contextmanager
def rigs_of_its_own() -> Iterator[None]:
    """Rigs that are given by their paths meanwhile are unknown afterwards, here and to processes that are started."""
    before = outside.chosen_paths()
    yield
    for folder in set(outside.chosen_paths()) - set(before):
        rigs._LOADED.pop(folder, None)
    os.environ[outside.VARIABLE] = "\n".join(map(str, before))


@pytest.fixture(scope="module", autouse=True)
def _rigs_of_a_module() -> Iterator[None]:
    """Before the module's own fixtures, which may give some."""
    with rigs_of_its_own():
        yield


@pytest.fixture(autouse=True)
def _rigs_of_a_test() -> Iterator[None]:
    with rigs_of_its_own():
        yield


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real records that HYBRID_SYSID_DATA names."""
    folder = os.environ.get("HYBRID_SYSID_DATA", "")
    if folder and not Path(folder).is_dir():
        pytest.fail(f"HYBRID_SYSID_DATA={folder} is not a folder: correct it, or unset it to skip the real records")
    if not folder or not any(Path(folder).iterdir()):
        pytest.skip("needs the real records: set HYBRID_SYSID_DATA to their folder (docs/results/cam-beam.md)")
    return Path(folder)


@pytest.fixture(scope="session")
def experiments(data: Path) -> dict[str, bab.Experiment]:
    """The author's experiments by the name of their file, as they are: 1 kHz, in volts."""
    return {path.stem: bab.load(path) for path in sorted((data / "bab").glob("*.mat"))}


@pytest.fixture(scope="session")
def rig() -> Rig:
    return rigs.load("cam_beam")


@pytest.fixture(scope="session")
def records(experiments: dict[str, bab.Experiment], rig: Rig) -> dict[str, Record]:
    """The author's experiments in SI units."""
    return {
        name: Record(
            name=name,
            time=np.arange(len(item.output), dtype=np.float64) * item.sampling_time,
            input=item.input[:, None],
            output=rig.display[0].si(item.output)[:, None],
        )
        for name, item in experiments.items()
    }


@pytest.fixture(scope="session")
def slider() -> Slider:
    return Slider()


@pytest.fixture(scope="session")
def motor() -> Motor:
    return Motor()


@pytest.fixture(scope="session")
def flexible_joint() -> FlexibleJoint:
    return FlexibleJoint()


@pytest.fixture(scope="module", params=extensions.targets("estimators"))
def kind(request: pytest.FixtureRequest) -> type[Estimator]:
    """Each method of estimation."""
    kind: type[Estimator] = estimator_class(request.param)
    return kind


@pytest.fixture(scope="session")
def linear_records() -> list[Record]:
    """Three experiments of 12 s on a linear beam, noise-free, the widest first: at most 6, 4 and 2 V about balance."""
    system = Linear(gain=5.0, centre=0.9, stiffness=24.0, damping=22.0, input_delay=0.005)
    found = []
    for seed, volts in enumerate((6.0, 4.0, 2.0)):
        levels = np.random.default_rng(seed).uniform(-volts, volts, 40) + system.centre
        drive = levels.repeat(60)[:, None]
        position = simulate(system, np.zeros(2), drive, step=0.005)[:-1, :1]
        time = np.arange(len(drive), dtype=np.float64) * 0.005
        found.append(Record(name=f"linear_{volts:g}V", time=time, input=drive, output=position))
    return found


def exact_model(rig: Rig, system: System | None = None) -> Model:
    """A model that is the rig itself, or another system of its signature: nothing was fitted."""
    return Model(
        rig=rig.name,
        structure="gray",
        system=system or rig.system,
        sampling=Sampling(),
        names=(),
        covariance=np.zeros((0, 0)),
        training_range={},
    )


@pytest.fixture(scope="session")
def model_folder(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model that is the rig itself."""
    folder = tmp_path_factory.mktemp("trained") / "model"
    exact_model(rig).save(folder)
    return folder


@pytest.fixture(scope="session")
def policy_folder(rig: Rig, model_folder: Path) -> Path:
    """The rig's own P controller as a policy: u = 1 + 3 (q_1 - y) V, through a tiny, so straight, hidden unit."""
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig)
    features = 2 + 2 + problem.horizon  # position and velocity, disturbance, previous input, preview
    small = 1e-5
    weights = np.zeros((1, features))
    weights[0, 4] = small * rig.experiments.loops[0].gain / rig.display[0].scale / rig.actuators[0].high
    examples = np.random.default_rng(0).normal(scale=0.01, size=(3, features))
    centre, scale = np.zeros(features), np.ones(features)
    policy = Policy(
        problem=problem,
        model=load(model_folder).seal,
        rig=rig.name,
        output_map=np.array([[1.0, 0.0]]),
        centre=centre,
        scale=scale,
        layers=((weights, np.zeros(1)), (np.array([[1.0 / small]]), np.array([1.0 / rig.actuators[0].high]))),
        training_range=TrainingRange.of(10.0 * examples, centre, scale),
    )
    folder = model_folder.with_name("policy")
    replace(policy, check=(examples, policy.evaluate(examples))).save(folder)
    return folder


@pytest.fixture(scope="session")
def domain() -> Iterator[int]:
    """A ROS domain of this process's own, on this machine only. Beyond 100 its ports may be taken by others.

    DDS speaks UDP: by listening on the domain's first port by TCP, this process has it until it ends.
    """
    pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
    with ExitStack() as stack:
        for number in (1 + (os.getpid() + k) % 100 for k in range(100)):
            with suppress(OSError):  # another run has it
                stack.enter_context(socket.create_server(("127.0.0.1", 7400 + 250 * number)))
                break
        monkeypatch = stack.enter_context(pytest.MonkeyPatch.context())
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        yield number


@pytest.fixture
def bench(domain: int) -> Iterator["Bench"]:
    """Where nodes are tested."""
    from tests.node_bench import Bench

    made = Bench(domain)
    yield made
    made.close()


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run a program's main() with its name and arguments; give status, standard output and standard error."""

    def run(main: Callable[[], None], *words: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", [str(word) for word in words])
        status = 0
        try:
            main()
        except SystemExit as end:
            status = int(end.code or 0)
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


@pytest.fixture
def command(call: Callable[..., tuple[int, str, str]]) -> Callable[..., tuple[int, str, str]]:
    """Run hybrid-sysid with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid")


@pytest.fixture(scope="session")
def linear_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A linear model of the shipped multisine."""
    folder = tmp_path_factory.mktemp("model") / "linear"
    bag = str(Path(__file__).parents[1] / "bags" / "beam_multisine")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["hybrid-sysid", "identify", bag, "--structure", "linear", "--out", str(folder)])
        with pytest.raises(SystemExit) as end:
            app.main()
    assert not end.value.code
    return folder


def simulated_record(rig: Rig, reference: Reference, *, seconds: float, name: str, seed: int, noisy: bool) -> Record:
    """The simulated rig driven as the author's: u = clip(3 (ref - yf), +-10), after a second of rest."""
    plant = Plant(rig, seed=seed, noisy=noisy)
    plant.reset(np.zeros(len(rig.system.states)))
    scale, samples = rig.display[0].scale, round(seconds / rig.step)
    time = np.arange(samples, dtype=np.float64) * rig.step
    wanted = np.where(time < 1.0, 0.0, reference(time))
    position, drive = np.empty((samples, 1)), np.empty((samples, 1))
    for k in range(samples):
        measured = plant.measure()
        position[k] = measured.outputs[0]
        command = rig.experiments.loops[0].gain * (wanted[k] - measured.filtered[0] / scale)
        drive[k] = np.clip(command, -rig.actuators[0].high, rig.actuators[0].high)
        plant.advance(float(drive[k, 0]))
    return Record(name=name, time=time, input=drive, output=position)


@pytest.fixture(scope="session")
def driven() -> Callable[..., Record]:
    """How a simulated rig is driven: :func:`simulated_record`."""
    return simulated_record


@pytest.fixture(scope="session", params=[False, True], ids=["noise-free", "noisy"])
def simulated_records(request: pytest.FixtureRequest, rig: Rig) -> list[Record]:
    """Two experiments of 40 s of the simulated rig, a multisine and random steps."""
    sines = multisine(1, amplitude=4.0, low=0.1, high=2.0, lines=20, period=10.0)
    steps = random_steps(2, amplitude=4.0, hold=1.0, duration=40.0)
    noisy = request.param
    return [
        simulated_record(rig, sines, seconds=40.0, name="sines", seed=0, noisy=noisy),
        simulated_record(rig, steps, seconds=40.0, name="steps", seed=1, noisy=noisy),
    ]


class Frame:
    """Columns by name that numpy takes for an array, as those of pandas and polars."""

    def __init__(self, **columns: Any) -> None:
        self.columns, self.by_name = list(columns), columns

    def __getitem__(self, name: str) -> Any:
        return self.by_name[name]

    def __array__(self, *_: object, **__: object) -> Any:
        return np.column_stack(list(self.by_name.values()))
