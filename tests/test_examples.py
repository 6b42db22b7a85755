"""What the examples and the page on Python say can be run as it stands."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hybrid_sysid_ros as hs

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
PAGE = ROOT / "docs" / "python.md"
NEEDS_TORCH = "skip-execution"
"""Tag of the cells that the documentation shows without running them."""


def _run(code: str, folder: Path) -> str:
    """What a script prints, run in a folder beside the bags that the project ships."""
    (folder / "bags").symlink_to(ROOT / "bags")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=folder, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_outputs(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore")  # those of the notebooks' own libraries
def test_a_notebook_runs_from_its_first_cell_to_its_last(path: Path) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if NEEDS_TORCH in cell.metadata.get("tags", ()):
            pytest.importorskip("torch")
            cell.metadata["tags"].remove(NEEDS_TORCH)
    client = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(path.parent)}})
    client.execute()
    kinds = {kind for cell in notebook.cells for output in cell.get("outputs", ()) for kind in output.get("data", ())}
    assert "application/vnd.plotly.v1+json" in kinds


@pytest.mark.slow
def test_the_page_runs_block_by_block(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    first, *others = re.findall(r"```python\n(.*?)```", text, re.S)
    assert len(list(filter(None, first.splitlines()))) == 5, "from a bag to a score"
    printed = _run("\n".join([first, *others]), tmp_path)
    assert float(re.findall(r"R2 ([\d.]+)", printed)[0]) > 0.9


SCRIPT = """
import hybrid_sysid_ros as hs
bags, record = ["bags/beam_multisine", "bags/beam_random_steps"], hs.read_bag("bags/beam_swept_sine", "cam_beam")

rig = hs.load_rig("cam_beam")
records = [hs.read_bag(path, rig) for path in bags]
model = hs.identify(records, rig, "hybrid", part=(0, 0.5))
print(model)
model.score(record); model.free_run(record); model.plot(record)
loop = hs.simulate(rig, model, controller="exact", reference="steps", seconds=10)
policy = hs.train_policy(rig, model{training}); certificate = hs.certify(policy{loops})
hs.export(model, "out")
"""


@pytest.mark.slow
def test_the_whole_way_is_ten_lines(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("plotly")
    training = ", episodes=2, rounds=1, epochs=1, hidden=(4,), workers=1"
    printed = _run(SCRIPT.format(training=training, loops=", loops=4, delta=0.5, workers=1"), tmp_path)
    assert len(printed.strip().splitlines()) <= 10
    assert "array" not in printed
    assert (tmp_path / "out" / "step.casadi").is_file()


def test_every_public_name_is_used_in_an_example_or_told_on_the_page() -> None:
    reported = "".join(path.read_text(encoding="utf-8") for path in (*NOTEBOOKS, PAGE))
    assert [name for name in hs.__all__ if f"hs.{name}" not in reported and f"`{name}`" not in reported] == []
