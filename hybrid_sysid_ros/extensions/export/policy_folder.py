"""The folder of an exported policy: written only if what is in it answers as the policy does."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.policy import SELF_CHECK_TOLERANCE, Policy
from hybrid_sysid_ros.control.safety.certificate import Certificate, rounded_down
from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.export import c_source, compiler, onnx_graph
from hybrid_sysid_ros.extensions.export.vectors import NAMES, Vectors, parts, vectors
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder, sha256, written_folder

MANIFEST = "export.json"
FORMAT = 2
EXAMPLES = 2
"""Instances with their answers in the manifest."""

ExportFormat = Literal["onnx", "c", "both"]


@dataclass(frozen=True, kw_only=True)
class Check:
    """by: what evaluated the exported form; empty where nothing did. largest_difference: of its inputs from the
    policy's over all vectors [unit of the input].
    """

    file: str
    by: str
    largest_difference: float | None


def export(folder: Path | str, out: Path | str, *, form: ExportFormat = "both", overwrite: bool = False) -> list[Check]:
    """Write a saved policy as ONNX, as C, or both, with a manifest; tell how each was checked.

    Numbers are doubles, as the policy's own: it answers its self-check vectors to 1e-9 of the inputs' units and what is
    exported is held to the same, which single precision could not tell from a mistake. What deviates by more than
    :data:`~hybrid_sysid_ros.control.policy.policy.SELF_CHECK_TOLERANCE` is not written.

    Raises UserError for a policy that can't be read, a place that can't be written, a missing extra or a deviation.
    """
    check_folder(out, marker=MANIFEST, replace=overwrite)
    loaded = policies.load(folder)
    name = identifier(Path(folder).resolve().name)
    return write_export(loaded, out, name=name, seal=storage.digest(folder, kind="policy"), form=form)


def export_loaded(policy: Policy, out: Path, *, seal: str, form: ExportFormat, overwrite: bool) -> None:
    """:func:`export` of a policy in memory, by the name of the folder. seal: of the policy's own folder."""
    check_folder(out, marker=MANIFEST, replace=overwrite)
    write_export(policy, out, name=identifier(out.resolve().name), seal=seal, form=form)


def write_export(policy: Policy, out: Path | str, *, name: str, seal: str, form: ExportFormat = "both") -> list[Check]:
    """:func:`export` of a policy in memory. name: of the C function and the files. seal: of the policy's folder."""
    properties, known = about(policy, seal), vectors(policy)
    with written_folder(out, marker=MANIFEST) as partial:
        checks = []
        if form != "c":
            checks.append(_write_onnx(policy, known, partial, name, properties))
        if form != "onnx":
            checks.append(_write_c(policy, known, partial, name, properties))
        content = {
            "format": FORMAT,
            "name": name,
            **properties,
            "vectors": {"number": len(known), "tolerance": SELF_CHECK_TOLERANCE, "examples": _examples(policy, known)},
            "checks": [asdict(check) for check in checks],
            "files": {path.name: sha256(path) for path in sorted(partial.iterdir())},
        }
        (partial / MANIFEST).write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return checks


def identifier(text: str) -> str:
    """A name for files and a C function out of a folder's: letters, digits, _; none that C or its library has."""
    name = re.sub(r"[^0-9a-z]+", "_", text.lower())[:48].strip("_")
    return name if "policy" in name and name[0].isalpha() else f"policy_{name}".strip("_")


def about(policy: Policy, seal: str) -> dict[str, str]:
    """What an exported policy tells of itself."""
    rig = load_rig(policy.rig)
    system, problem = rig.system, policy.problem
    fits = (len(system.states), len(system.inputs), len(system.outputs)) == (
        policy.states,
        policy.inputs,
        policy.outputs,
    )
    properties = {
        "made_by": f"hybrid_sysid_ros {version('hybrid_sysid_ros')}",
        "rig": policy.rig,
        "policy": seal,
        "model": policy.model,
        "certificate": _certified(policy.certificate),
        "period": f"{problem.period:g} s",
        "horizon": str(problem.horizon),
        "state": _listed(system.states) if fits else f"{policy.states} states of the model",
        "preview": _listed(system.outputs) if fits else f"{policy.outputs} outputs of the model",
        "inputs": f"{_listed(system.inputs)} over {policy.stages} periods; disturbance and previous input too",
        "input_bounds": ", ".join(
            f"{low:g} .. {high:g}" for low, high in zip(problem.input_low, problem.input_high, strict=True)
        ),
        "rate_limit": ", ".join(
            f"{rate:g} a period" if math.isfinite(rate) else "none" for rate in problem.rate_limits
        ),
    }
    if policy.correction is not None:
        units = {item.name: item.unit for item in rig.system.parameters}
        properties["parameters"] = ", ".join(f"{key} [{units.get(key, '')}]" for key in policy.correction.names)
    return properties


def _listed(variables: Sequence[Variable]) -> str:
    return ", ".join(f"{item.name} [{item.unit}]" for item in variables)


def _certified(certificate: Certificate | None) -> str:
    """What the certificate says of the network alone, for that is what is exported."""
    if certificate is None:
        return "none"
    stratum, bound = certificate.worst_stratum("network"), certificate.mu("network")
    return f"{certificate.loops} loops; rate at least {rounded_down(bound)} in {stratum} (delta {certificate.delta:g})"


def _write_onnx(policy: Policy, known: Vectors, folder: Path, name: str, properties: dict[str, str]) -> Check:
    graph = onnx_graph.model(policy, name=name, about=properties)
    path = folder / f"{name}.onnx"
    path.write_bytes(graph.SerializeToString())
    difference = onnx_graph.largest_difference(path, policy, known)
    if not difference <= SELF_CHECK_TOLERANCE:
        raise UserError(
            f"{path.name}: deviates by {difference:.3g} from the policy's self-check vectors, more than "
            f"{SELF_CHECK_TOLERANCE:g}; nothing is written: train the policy again"
        )
    return Check(file=path.name, by=onnx_graph.evaluator(), largest_difference=difference)


def _write_c(policy: Policy, known: Vectors, folder: Path, name: str, properties: dict[str, str]) -> Check:
    texts = c_source.sources(policy, known, name=name, about=properties, tolerance=SELF_CHECK_TOLERANCE)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    compiler_name = compiler.found()
    if compiler_name is None:
        return Check(file=f"{name}.c", by="", largest_difference=None)
    with TemporaryDirectory(dir=folder.parent) as scratch:
        difference = compiler.run_test(compiler_name, folder, name, Path(scratch))
    return Check(file=f"{name}.c", by=f"{compiler_name} {' '.join(compiler.FLAGS)}", largest_difference=difference)


def _examples(policy: Policy, known: Vectors) -> list[dict[str, Any]]:
    """The first self-check vectors, which are all numbers."""
    columns = [*zip(NAMES, parts(policy, known.instances), strict=True), ("inputs", known.inputs)]
    return [
        {key: values[index].tolist() for key, values in columns if values.size}
        for index in range(min(EXAMPLES, len(policy.check[1])))
    ]
