"""What the pages say is run."""

import re
from pathlib import Path

GUIDES = Path(__file__).parents[2] / "docs" / "guides"
PROGRAM = "".join((GUIDES / name).read_text(encoding="utf-8") for name in ("systems.md", "dynamics.md"))


def test_the_snippets_about_systems_are_one_program_that_runs(tmp_path, monkeypatch):
    """As a file: descriptions of parameters are read from the source of their class."""
    (tmp_path / "snippets_of_systems.py").write_text("\n".join(re.findall(r"```python\n(.*?)```", PROGRAM, re.DOTALL)))
    monkeypatch.syspath_prepend(tmp_path)
    import snippets_of_systems as program  # type: ignore[import-not-found]

    reported = {item.name: item.description for item in program.Watched().parameters}
    assert reported["length"] == "From axis to tip."
    assert reported["weight"] == "m g l."
