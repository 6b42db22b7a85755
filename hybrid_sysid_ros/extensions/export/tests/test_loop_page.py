"""hybrid-sysid export page: a page's numbers are Python's, and nothing in it comes from elsewhere."""

import importlib.util
import re
import shutil
from typing import Any

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.page import export, node_check, web_assembly
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError


def test_without_ziglang_it_says_what_to_install(tmp_path, monkeypatch):
    rig, model = load_rig("wheel_motor"), hs.load_model(shipped("wheel_motor", "model"))
    monkeypatch.setattr(web_assembly, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"wheel ziglang, which is missing: pip install 'hybrid_sysid_ros\[page\]'"):
        export.export_page(rig, model, tmp_path / "page.html", seal="s")
    assert not (tmp_path / "page.html").exists()


def test_another_suffix_is_refused(tmp_path):
    rig, model = load_rig("wheel_motor"), hs.load_model(shipped("wheel_motor", "model"))
    with pytest.raises(UserError, match=r"does not end in \.html"):
        export.export_page(rig, model, tmp_path / "page.htm", seal="s")


@pytest.mark.slow
@pytest.mark.skipif(not compiler.found(), reason="needs a C compiler")
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs the extra [page]")
@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, which runs the page's code")
def test_the_page_s_numbers_are_python_s_it_needs_nothing_else_and_a_rig_that_sticks_is_held(tmp_path, monkeypatch):
    rig, model = load_rig("cam_beam"), hs.load_model(shipped("cam_beam", "model"))
    page, still = tmp_path / "page.html", list[Any]()

    def run_still_too(code, data, driver, references, biases, noises):
        still.append(run(code, data, driver, 0.0 * references, 0.0 * biases, noises))
        return run(code, data, driver, references, biases, noises)

    run = node_check.run
    monkeypatch.setattr(node_check, "run", run_still_too)
    done = export.export_page(rig, model, page, seal="s")
    assert np.all(still[0][100:, 0] != 0.0)  # its sensor is not taken for frozen, so that the drive would rest
    assert done.differences["exact"] <= export.TOLERANCE
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=|@import|url\(|fetch\(|import\s""", text.replace('xmlns="http', ""))
    assert "Simulated by the identified model" in text
    assert done.bytes < 1_000_000
