"""Readers under mutated files: bags, models, policies, certificates, rigs and signals, each case made from its number.

A file must be refused in one line, or read as it was, or, where it can be recovered, read as far as it is whole, which
is said. A failure is a traceback, a hang (10 s of the processor), a lost process, more than 500 MB, and a silent
difference: other data than were written without a word. Where a file carries no checksums (loose messages, SQLite, a
rig's own YAML) and where a mutation makes a file that is whole in itself, seals and checksums included, what is read is
that file's own truth. A run that was ended goes on where it was, as long as neither seed nor code change.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from rich.progress import track
from rich.table import Table

from benchmarks import result
from benchmarks.fuzz.worker import FAILURES, MEMORY, OUTCOMES, SECONDS, Case, Reader, serve
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.shared.workers import count
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256, written_file
from hybrid_sysid_ros.support.threads import alone

NAME = "fuzz"
ROOT = Path(__file__).parents[2]
SHEET = ROOT / "build" / "fuzz.jsonl"
BLOCK = 250  # cases that are written down together
PATIENCE = 6 * SECONDS  # of the clock, for a case; then its process is ended
START = 300.0  # s that a process may need before its first case
KEPT = 100  # failures in the results

Row = dict[str, Any]


class Process:
    """A worker process, replaced when it is lost."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._process: SpawnProcess | None = None

    def run(self, number: int) -> Row:
        """Outcome of a case."""
        if self._process is None:
            self._start()
        self._pipe.send(number)
        try:
            if self._pipe.poll(PATIENCE):
                row: Row = self._pipe.recv()
                return row
            outcome = "hang"
        except (EOFError, OSError):
            outcome = "crash"
        self.close()
        nothing = dict.fromkeys(("subject", "target", "mutation"), "")
        return {"case": number, **nothing, "outcome": outcome, "detail": "its process was lost"}

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(self.seed, theirs), daemon=True)
        with alone():
            self._process.start()
        theirs.close()
        try:
            if self._pipe.poll(START):
                self._pipe.recv()
                return
        except EOFError:
            pass
        raise UserError("fuzz: a worker process did not start; run one case with --case to see why")

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None


class Sheet:
    """Finished blocks of cases, one a line; another seed or other code begins a new one."""

    def __init__(self, path: Path, seed: int) -> None:
        self.path = path
        digest = hashlib.sha256("".join(sha256(ROOT / name) for name in _sources()).encode()).hexdigest()
        self.head = json.dumps({"seed": seed, "code": digest[:16], "block": BLOCK})
        self.blocks: dict[int, list[Row]] = {}
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        if lines[:1] == [self.head]:
            for line in lines[1:]:
                try:
                    block = json.loads(line)
                except ValueError:  # the last one, of a run that was killed
                    continue
                self.blocks[block["block"]] = block["rows"]
            return
        with written_file(path) as partial:
            partial.write_text(f"{self.head}\n", encoding="utf-8")

    def add(self, block: int, rows: list[Row]) -> None:
        """Write a block down: failures in full, of others what the table needs."""
        self.blocks[block] = [row if row["outcome"] in FAILURES else {**row, "detail": ""} for row in rows]
        with self.path.open("a", encoding="utf-8") as file:
            file.write("\n" + json.dumps({"block": block, "rows": self.blocks[block]}))


def _sources() -> list[str]:
    files = [*ROOT.glob("hybrid_sysid_ros/**/*.py"), *(ROOT / "benchmarks" / NAME).glob("*.py")]
    return sorted(str(file.relative_to(ROOT)) for file in files)


def outcomes(sheet: Sheet, seed: int, cases: int, jobs: int) -> None:
    """Run the blocks that the sheet has not got yet."""
    left = [block for block in range(-(-cases // BLOCK)) if block not in sheet.blocks]

    def some(mine: list[int]) -> Iterator[tuple[int, list[Row]]]:
        process = Process(seed)
        try:
            for block in mine:
                yield block, [process.run(BLOCK * block + k) for k in range(BLOCK)]
        finally:
            process.close()

    def work(mine: list[int], shown: bool) -> None:
        steps = some(mine)
        for block, rows in track(steps, total=len(mine), description="cases", transient=True) if shown else steps:
            sheet.add(block, rows)

    with ThreadPoolExecutor(jobs) as threads:
        for done in [threads.submit(work, left[k::jobs], k == 0) for k in range(jobs)]:
            done.result()


def table(rows: list[Row]) -> Table:
    """A row for each kind of file and mutation."""
    shown = Table("files", "mutation", "cases", *OUTCOMES, "slowest", "memory", title="readers under mutated files")
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        kind = row["subject"].partition(".")[0] if not row["subject"].startswith("bag") else row["subject"]
        groups.setdefault((kind or "lost", row["mutation"]), []).append(row)
    for (kind, mutation), some in [*sorted(groups.items()), (("all", ""), rows)]:
        found = Counter(row["outcome"] for row in some)
        slowest, highest = (max(row.get(key, 0.0) for row in some) for key in ("seconds", "megabytes"))
        numbers = [str(found[outcome] or "") for outcome in OUTCOMES]
        shown.add_row(kind, mutation, str(len(some)), *numbers, f"{slowest:.2f} s", f"{highest:.0f} MB")
    return shown


def summary(rows: list[Row], seed: int) -> dict[str, Any]:
    """What is written: numbers by kind and mutation, failures with their cases, and how many there are."""
    counts: dict[str, dict[str, dict[str, int]]] = {}
    for row in rows:
        found = counts.setdefault(row["subject"] or "lost", {}).setdefault(row["mutation"], {})
        found[row["outcome"]] = found.get(row["outcome"], 0) + 1
    failures = [row for row in rows if row["outcome"] in FAILURES]
    return {
        "short": len(failures),
        "cases": len(rows),
        "seed": seed,
        "reading_s": round(sum(row.get("seconds", 0.0) for row in rows), 1),
        "outcomes": dict(Counter(row["outcome"] for row in rows)),
        "slowest_s": max(row.get("seconds", 0.0) for row in rows),
        "highest_mb": max(row.get("megabytes", 0.0) for row in rows),
        "limits": {"seconds": SECONDS, "megabytes": MEMORY},
        "failures": failures[:KEPT],
        "counts": counts,
    }


def main() -> int:
    """Run, print the table and write the results; 1 where there are failures."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{NAME}", description=__doc__)
    parser.add_argument("--cases", type=int, default=100_000, help="how many")
    parser.add_argument("--seed", type=int, default=1, help="of the cases")
    parser.add_argument("--jobs", type=int, default=0, help="worker processes; 0 for one on each processor")
    parser.add_argument("--case", type=int, help="run this one here, and keep its files in --out")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "fuzz_case", help="where --case puts its files")
    parser.add_argument("--sheet", type=Path, default=SHEET, help="finished cases, by which a run goes on")
    options = parser.parse_args()
    if options.case is not None:
        reader = Reader(options.seed, options.out)
        case = Case.of(options.seed, options.case, reader.known)
        print(f"{case.subject.name}: {case.target}, {case.mutation.__name__}{', recover' if case.recover else ''}")
        found = reader.run(options.case)
        print(f"{found.outcome}, {found.seconds} s, {found.megabytes} MB, files in {options.out}\n{found.detail}")
        return int(found.outcome in FAILURES)
    on = result.machine()
    options.sheet.parent.mkdir(parents=True, exist_ok=True)
    sheet = Sheet(options.sheet, options.seed)
    outcomes(sheet, options.seed, options.cases, count(options.jobs))
    rows = [row for block in sorted(sheet.blocks) for row in sheet.blocks[block] if row["case"] < options.cases]
    print_table(table(rows))
    found_all = summary(rows, options.seed)
    for row in found_all["failures"][:20]:
        print(f"--seed {options.seed} --case {row['case']}: {row['subject']} {row['mutation']}: {row['outcome']}")
    print(f"written to {result.write(NAME, found_all, on=on)}")
    if found_all["short"]:
        print(f"error: {found_all['short']} of {len(rows)} cases fall short", file=sys.stderr)
    return int(bool(found_all["short"]))


if __name__ == "__main__":
    result.run(main)
