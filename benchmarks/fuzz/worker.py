"""Worker: a process that reads one mutated case after another and says what came of each."""

from __future__ import annotations

import ctypes
import logging
import random
import shutil
import tempfile
import traceback
import warnings
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from time import process_time
from typing import Any

from benchmarks.fuzz import mutations
from benchmarks.fuzz.subjects import Files, Subject, reported, subjects
from hybrid_sysid_ros.support.errors import UserError

MEMORY = 500.0
"""MB that the process may have at its highest."""
SECONDS = 10.0
"""Of the processor, for one case."""
FAILURES = ("traceback", "hang", "crash", "memory", "silent")
OUTCOMES = ("refused", "same", "said", "own truth", *FAILURES)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a case."""

    case: int
    subject: str
    target: str
    mutation: str
    outcome: str
    seconds: float = 0.0
    megabytes: float = 0.0
    detail: str = ""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case by its number: which files, what is done to them, and whether they are read with recovery."""

    number: int
    subject: Subject
    target: str
    mutation: mutations.Mutation
    recover: bool
    rng: random.Random

    @classmethod
    def of(cls, seed: int, number: int, known: list[Subject]) -> Case:
        rng = random.Random(f"{seed}:{number}")
        subject = rng.choice(known)
        target = rng.choice(subject.targets)
        mutation = rng.choice(mutations.of(target))
        recover = subject.name.startswith("bag.") and rng.random() < 0.25
        return cls(number=number, subject=subject, target=target, mutation=mutation, recover=recover, rng=rng)

    def files(self) -> Files:
        return self.mutation(self.rng, self.subject.files, self.target)


class _Said(logging.Handler):
    """Whether something was said."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.anything = False

    def emit(self, record: logging.LogRecord) -> None:
        self.anything = True


class Reader:
    """Reads cases in a folder of its own."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.seed = seed
        self.folder = folder
        self.known = subjects()
        self.said = _Said()
        root = logging.getLogger()
        root.handlers = [self.said]
        warnings.simplefilter("ignore")
        self.good = {subject.name: self._good(subject) for subject in self.known}

    def run(self, number: int) -> Outcome:
        """Make a case's files and read them."""
        case = Case.of(self.seed, number, self.known)
        self._put(case.files())
        self.said.anything = False
        _forget()
        start = process_time()
        outcome, detail = self._read(case)
        seconds, megabytes = process_time() - start, _highest()
        if outcome not in FAILURES:
            outcome = "hang" if seconds > SECONDS else "memory" if megabytes > MEMORY else outcome
        return Outcome(
            case=number,
            subject=case.subject.name,
            target=Path(case.target).name,
            mutation=case.mutation.__name__,
            outcome=outcome,
            seconds=round(seconds, 3),
            megabytes=round(megabytes, 1),
            detail=detail,
        )

    def _read(self, case: Case) -> tuple[str, str]:
        try:
            found = reported(case.subject.read(self.folder, case.recover))
        except UserError as error:
            line = str(error)
            return ("refused", line) if line.isprintable() else ("traceback", f"not one line: {line!r}")
        except BaseException:  # whatever it is, it is what is looked for
            return "traceback", traceback.format_exc(limit=-6)
        good = self.good[case.subject.name]
        if found == good:
            return "same", ""
        if self.said.anything:
            return "said", ""
        noticed = found[0] == good[0] and not case.subject.sealed
        if noticed or case.mutation in mutations.OWN or not case.subject.name.startswith(("bag.", "model.", "policy.")):
            return "own truth", ""
        return "silent", f"{good[0]} samples became {found[0]}" if good[0] else "other numbers"

    def _good(self, subject: Subject) -> Any:
        self._put(subject.files)
        return reported(subject.read(self.folder, False))

    def _put(self, files: Files) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        for name, content in files.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def serve(seed: int, connection: Connection) -> None:
    """Answer numbers of cases with their outcomes, until None comes."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
        reader = Reader(seed, Path(place) / "case")
        connection.send(None)
        while (number := connection.recv()) is not None:
            connection.send(asdict(reader.run(number)))


def _forget() -> None:
    """Give back what earlier cases left, and begin anew with the highest memory."""
    if hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")


def _highest() -> float:
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024e-6
    raise UserError("fuzz: /proc/self/status has no VmHWM: memory is measured on Linux only")
