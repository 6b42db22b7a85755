"""hybrid-sysid export ros2_control: a controller that compiles against declarations of what it uses, and commands."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.ros2_control.export import export_ros2_control
from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped

HEADERS = Path(__file__).parent / "ros2_control_headers"
PARAMETERS = """
#include <memory>
#include <string>
#include <vector>
namespace {name}_controller {{
struct Params {{ std::vector<std::string> state_interfaces = {{"s"}}, command_interfaces = {{"c"}}; }};
struct ParamListener {{
  template <typename Node> explicit ParamListener(Node) {{}}
  Params get_params() const {{ return {{}}; }}
}};
}}
"""


@pytest.mark.slow
@pytest.mark.skipif(not (compiler.found() and shutil.which("g++")), reason="needs a C and a C++ compiler: gcc and g++")
def test_the_package_compiles_against_declared_headers_and_commands_as_in_python(tmp_path):
    """It is not linked against ros2_control, which no package index has."""
    rig, model = load_rig("wheel_motor"), hs.load_model(shipped("wheel_motor", "model"))
    package = tmp_path / "package"
    done = export_ros2_control(rig, model, package, settings={"real_time": True}, seal="s")
    declared = yaml.safe_load((package / "src" / f"{done.name}_controller_parameters.yaml").read_text())
    assert declared[f"{done.name}_controller"]["state_interfaces"]["default_value"] == ["wheel/velocity"]
    assert declared[f"{done.name}_controller"]["command_interfaces"]["default_value"] == ["wheel/effort"]
    (tmp_path / f"{done.name}_controller_parameters.hpp").write_text(PARAMETERS.format(name=done.name))
    unit = package / "unit"
    places = [package / "include", unit, tmp_path, HEADERS]
    include = [part for place in places for part in ("-I", str(place))]
    renamed = [f"-Dmalloc={done.name}_allocate", f"-Dcalloc={done.name}_allocate_zeros", f"-Dfree={done.name}_release"]
    sources = [unit / f"{done.name}.c", *sorted((unit / "daqp").glob("*.c"))]
    for path in sources:
        more = renamed if path.parent.name == "daqp" else []
        subprocess.run(["gcc", "-O1", "-w", *more, *include, "-c", str(path)], cwd=tmp_path, check=True)
    objects = [str(tmp_path / f"{path.stem}.o") for path in sources]
    warnings = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    own = [str(package / "src" / "controller.cpp"), str(HEADERS / "main.cpp")]
    subprocess.run(["g++", *warnings, *include, *own, *objects, "-lm", "-o", "driven"], cwd=tmp_path, check=True)

    loop = loop_in_python(rig, model, {"real_time": True})
    period, horizon, rest = loop.estimator.period, loop.mpc.horizon, loop.command.copy()
    loop.reset()
    random, applied, lines, expected = np.random.default_rng(0), rest, [], []
    for k in range(60):
        time, reference, reading = k * period, float(random.uniform(-5.0, 5.0)), float(random.uniform(-1.0, 1.0))
        lines.append(f"{time!r} {reference!r} {reading!r}")
        answer = loop.step(time, np.array([reading]), applied, np.full((horizon, 1), reference))
        loop.prepare(period)
        applied = answer.inputs
        expected.append(applied[0])
    rate = str(round(1.0 / period))
    ran = subprocess.run(
        [str(tmp_path / "driven"), "1", "1", rate], input="\n".join(lines), capture_output=True, text=True, check=True
    )
    found = np.array(ran.stdout.split(), dtype=float)
    np.testing.assert_allclose(found[:-1], expected, atol=1e-9 * rig.actuators[0].high)
    assert found[-1] == rig.actuators[0].rest
    slow = subprocess.run([str(tmp_path / "driven"), "1", "1", "7"], capture_output=True, text=True, check=False)
    assert slow.returncode == 1
    assert "update_rate is 7 Hz, but the loop was exported for" in slow.stderr
