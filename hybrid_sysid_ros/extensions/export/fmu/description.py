"""The variables of an FMU, in its modelDescription.xml and in the table of its C code."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

from hybrid_sysid_ros.extensions.export.c_source import number
from hybrid_sysid_ros.rigs import units

BASE_UNITS = {
    "rad": {"rad": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "J": {"kg": 1, "m": 2, "s": -2},
    "N m": {"kg": 1, "m": 2, "s": -2},
    "1": {},
}
"""Exponents of the SI's base units."""


@dataclass(frozen=True, kw_only=True)
class FmuVariable:
    """A variable of an FMU."""

    name: str
    causality: Literal["independent", "input", "output", "parameter", "local"]
    place: str
    """Its member in the C structure of values."""
    variability: Literal["continuous", "discrete", "tunable", "fixed"] = "discrete"
    kind: Literal["Float64", "Boolean", "Enumeration"] = "Float64"
    unit: str = ""
    start: float | None = None
    low: float = -math.inf
    high: float = math.inf
    checked: bool = False
    """Whether values that are set must be finite and within the bounds; inputs are bounded by the model."""
    size: int = 1
    """Of an array."""
    description: str = ""

    @property
    def access(self) -> str:
        """When it may be set."""
        if self.causality == "input" or self.variability == "tunable":
            return "ALWAYS"
        return "BEFORE" if self.causality == "parameter" or self.causality == "local" else "READ"

    def row(self, reference: int) -> str:
        """Its row in the table of the C code."""
        parts = [str(reference), self.kind.upper(), self.access, str(int(self.checked))]
        parts += [f"offsetof(fmu_values, {self.place})", str(self.size), number(self.low), number(self.high)]
        return f"    {{{', '.join(parts)}, {json.dumps(self.name)}}}"


TIME = FmuVariable(
    name="time", causality="independent", place="time", variability="continuous", unit="s", description="Time"
)


def structured(*parts: str) -> str:
    """A name in the structured convention."""
    return ".".join(part if re.fullmatch(r"[A-Za-z_]\w*", part) else f"'{part}'" for part in parts)


def model_description(
    variables: Sequence[FmuVariable],
    *,
    name: str,
    identifier: str,
    about: str,
    token: str,
    tool: str,
    period: float,
    duration: float,
    statuses: Sequence[tuple[str, str]] = (),
) -> str:
    """The text of modelDescription.xml. statuses: names and descriptions of an enumeration that begins with 0."""
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0", modelName=name, instantiationToken=token, description=about, generationTool=tool,
        variableNamingConvention="structured",
    )  # fmt: skip
    ElementTree.SubElement(
        root, "CoSimulation", modelIdentifier=identifier, canGetAndSetFMUState="true",
        canHandleVariableCommunicationStepSize="true", fixedInternalStepSize=repr(period),
    )  # fmt: skip
    _units(root, sorted({item.unit for item in variables if item.unit}))
    if statuses:
        types = ElementTree.SubElement(root, "TypeDefinitions")
        kind = ElementTree.SubElement(types, "EnumerationType", name="status")
        for value, (status, text) in enumerate(statuses):
            ElementTree.SubElement(kind, "Item", name=status, value=str(value), description=text)
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError", description="Why a call was refused")
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(duration), stepSize=repr(period))
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, item in enumerate(variables):
        _variable(listed, reference, item)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for element in ("Output", "InitialUnknown"):
        for reference, item in enumerate(variables):
            if item.causality == "output":
                ElementTree.SubElement(structure, element, valueReference=str(reference))
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _units(root: ElementTree.Element, names: Sequence[str]) -> None:
    listed = ElementTree.SubElement(root, "UnitDefinitions")
    for name in names:
        unit, found = ElementTree.SubElement(listed, "Unit", name=name), units.named(name)
        if found is not None and found.base in BASE_UNITS:
            powers = dict(BASE_UNITS[found.base])
            powers["s"] = powers.get("s", 0) - found.per
            given = {key: str(power) for key, power in powers.items() if power}
            given |= {} if found.factor == 1.0 else {"factor": repr(found.factor)}
            ElementTree.SubElement(unit, "BaseUnit", given)


def _variable(listed: ElementTree.Element, reference: int, item: FmuVariable) -> None:
    given = {"name": item.name, "valueReference": str(reference), "causality": item.causality}
    given["variability"] = item.variability
    if item.description:
        given["description"] = " ".join(item.description.split())
    if item.causality == "local":
        given["initial"] = "exact"
    if item.unit:
        given["unit"] = item.unit
    for key, value in (("min", item.low), ("max", item.high)):
        if math.isfinite(value):
            given[key] = repr(value)
    if item.kind == "Enumeration":
        given["declaredType"] = "status"
    if item.start is not None:
        start = str(bool(item.start)).lower() if item.kind == "Boolean" else repr(float(item.start))
        given["start"] = " ".join([start] * item.size)
    element = ElementTree.SubElement(listed, item.kind, given)
    if item.size > 1:
        ElementTree.SubElement(element, "Dimension", start=str(item.size))


def build_description(identifier: str, sources: Sequence[str]) -> str:
    """The text of sources/buildDescription.xml."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    for source in sources:
        ElementTree.SubElement(files, "SourceFile", name=source)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
