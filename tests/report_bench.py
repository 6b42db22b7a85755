"""Records, a model and a loop of the beam for tests of reports, and a page that is taken apart."""

import html.parser

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.excitation import multisine
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

RIG = rigs.load("cam_beam")
RATE, PERIOD = 200, 0.005
VOID = {"meta", "link", "br", "hr", "img", "input", "source"}


class Page(html.parser.HTMLParser):
    """Tags of a page: whether all are closed, which addresses they name, what its text is."""

    def __init__(self, text):
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.words: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.feed(text)
        self.close()
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        found = dict(attributes)
        self.addresses += [found[key] for key in ("src", "href", "data", "action") if key in found]
        self.ids += [found["id"]] if "id" in found else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)


def record(name, seed, duration=12.0):
    """A simulated experiment of the beam with a little noise. The law makes its drive of its reference."""
    time = PERIOD * np.arange(round(duration * RATE) + 1)
    drive = 1.0 + multisine(seed, amplitude=4.0, low=0.1, high=2.0, lines=20, period=duration)(time)[:, None]
    states = simulate(RIG.system, np.zeros(2), drive[:-1], step=PERIOD)
    noise = 5e-4 * np.random.default_rng(seed).normal(size=len(time))
    return Record(
        name=name,
        time=time,
        input=drive,
        output=states[:, :1] + noise[:, None],
        channels={
            "reference": states[:, 0] + RIG.display[0].si(drive[:, 0] / RIG.experiments.loops[0].gain),
            "filtered": states[:, 0],
        },
        digest=f"{seed:064x}",
    )


def model_of(training, correlation=0.99):
    """The rig's own equation as a model; two of its parameters are correlated."""
    names = tuple(item.name for item in RIG.system.parameters if not item.fixed)
    covariance = np.diag(np.full(len(names), 0.01**2))
    covariance[np.ix_([0, 3], [0, 3])] = 0.5**2 * np.array([[1.0, correlation], [correlation, 1.0]])
    return Model(
        rig="cam_beam",
        structure="gray",
        system=RIG.system,
        sampling=Sampling(step=PERIOD, period=0.05),
        names=names,
        covariance=covariance,
        training_range={},
        records=({"name": training.name, "source": "", "sha256": training.digest, "part": [0.0, 0.5]},),
        fit={"seconds": 1.25},
        seal="5ea1" * 16,
    )


def loop_of(duration=51.0, delay=0.0015):
    """A loop that follows the hardware reference 0.1 V below, with one command too late."""
    time = PERIOD * np.arange(-10, round(duration * RATE))
    reference = RIG.display[0].si(np.where(time < 0, np.nan, RIG.schedule().of(0)(time)))
    delays = np.full(len(time), delay)
    delays[500] = 0.0063
    return LoopRecord(
        name="run",
        rig=RIG,
        stamps=(1e9 * (time + 10)).astype(np.int64),
        time=time,
        outputs=np.nan_to_num(reference)[:, None] - RIG.display[0].si(np.float64(0.1)),
        reference=reference[:, None],
        inputs=np.clip(3 * np.sin(time), -10, 10)[:, None],
        command=np.clip(3 * np.sin(time), -10, 10)[:, None],
        delay=delays,
        turnaround=delays,
        late=delays > PERIOD,
        source="run",
        digest="ab" * 32,
    )
