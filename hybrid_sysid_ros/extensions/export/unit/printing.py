"""The text of a unit: types, constants, functions in the order of their calls, and the memory."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.export.unit.layout import MemoryLayout, element, members
from hybrid_sysid_ros.extensions.export.unit.translation import TranslatedFunction, Translation
from hybrid_sysid_ros.extensions.export.unit.values import (
    LANE,
    REAL,
    ArrayView,
    LaneValues,
    NumberValue,
    RecordValue,
    StructureValue,
    literal,
)
from hybrid_sysid_ros.support.arrays import Array

WIDTH = 118


class Printer:
    """Prints what a translator has translated. several: names of arrays of which the unit has as many as estimates.
    count: of these.
    """

    def __init__(self, translator: Translation, several: Sequence[str] = (), count: int = 1) -> None:
        self.translator, self.several, self.count = translator, several if count > 1 else (), count
        self.rig, self.layout = translator.rig, translator.layout
        self._functions = {item.name: item for item in translator.functions.values()}
        self._remembering: dict[str, bool] = {"unit": True}

    @property
    def written(self) -> list[str]:
        """Names of the arrays that are written, in the order of the loop's objects."""
        return [name for name in self.layout.arrays if name in self.layout.used and self.layout.places[name].written]

    @property
    def constants(self) -> list[str]:
        """Names of the arrays that are not."""
        return [
            name for name in self.layout.arrays if name in self.layout.used and not self.layout.places[name].written
        ]

    # ------------------------------------------------------------------ types

    def records(self) -> str:
        """Types of the records that are in use."""
        used = [self.layout.arrays[name].dtype for name in self.layout.used]
        found = []
        for kind, name in self.layout.records:
            if kind in used:
                single = self.layout.mutable.get(name)
                own = {key: of for key, of in members(kind).items() if single is None or key in single}
                found.append(self._structure(f"{self.rig}_{name}", [*own.items()]))
        return "\n".join(found)

    def structures(self) -> str:
        """Types of what functions return."""
        return "\n".join(self._structure(name, [*own]) for name, own in self.translator.structures.items())

    def _structure(self, name: str, own: list[tuple[str, str]]) -> str:
        lines = [f"    {self.translator.type_of(REAL) if kind == REAL else 'int'} {key};" for key, kind in own]
        return "\n".join(["typedef struct {", *lines, f"}} {name};", ""])

    def memory(self) -> str:
        """Members of the unit's memory."""
        return "\n".join(self._member(name) for name in self.written if name not in self.several)

    def filter(self) -> str:
        """The type of what the unit has for each estimate."""
        lines = [self._member(name) for name in self.written if name in self.several]
        return "\n".join(["typedef struct {", *lines, f"}} {self.rig}_filter;", ""])

    def _member(self, name: str) -> str:
        array = self.layout.arrays[name]
        return f"    {self.translator.type_of(element(array.dtype))} {name}[{array.size}];"

    def place(self, name: str) -> str:
        """An array in C."""
        if not self.layout.places[name].written:
            return f"{self.rig}_{name}"
        return f"unit->filter->{name}" if name in self.several else f"unit->{name}"

    # ------------------------------------------------------------------ constants

    def tables(self) -> str:
        """Constants."""
        return "\n".join(self.table(f"{self.rig}_{name}", self.layout.arrays[name]) for name in self.constants)

    def beginnings(self) -> tuple[str, str]:
        """Constants with which arrays begin, and the lines that copy them."""
        tables, lines, several = list[str](), list[str](), list[str]()
        for name in self.written:
            table, own = self._beginning(name)
            tables += table
            (several if name in self.several else lines).extend(own)
        if self.several:
            lines += [f"    for (int k = 0; k < {self.count}; k++) {{", "        unit->filter = &unit->filters[k];"]
            lines += [textwrap.indent(line, "    ") for line in several] + ["    }"]
            lines += [f"    for (int k = 1; k < {self.count}; k++) {{"]
            lines += ["        unit->further[k - 1] = &unit->filters[k - 1];", "    }"]
        return "\n".join(tables), "\n".join(lines)

    def begun_again(self, prefix: str) -> str:
        """Lines that let the arrays of some names begin again."""
        lines = []
        for name in self.written:
            if name.startswith(prefix):
                table, own = self._beginning(name)
                lines += [] if table else [f"    memset({self.place(name)}, 0, sizeof {self.place(name)});"]
                lines += own
        return "\n".join(lines)

    def _beginning(self, name: str) -> tuple[list[str], list[str]]:
        """The constants with which an array begins, and the lines that copy them; neither where it begins as zero."""
        array, tables, lines = self.layout.arrays[name], [], []
        set_members = [key for key in array.dtype.names or () if np.any(array[key])]
        if set_members and all(np.array_equal(array[key], np.arange(array.size)) for key in set_members):
            lines += [f"    for (int i = 0; i < {array.size}; i++) {{"]
            lines += [f"        {self.place(name)}[i].{key} = i;" for key in set_members]
            lines += ["    }"]
        elif step := _step_of(array):
            first = np.flatnonzero(array)[0]
            value = literal(array.ravel()[first], self.translator.suffix)
            lines += [f"    for (int i = {first}; i < {array.size}; i += {step}) {{"]
            lines += [f"        {self.place(name)}[i] = {value};", "    }"]
        elif array.tobytes().strip(b"\0"):
            tables.append(self.table(f"{self.rig}_{name}_at_first", array))
            lines.append(f"    memcpy({self.place(name)}, {self.rig}_{name}_at_first, sizeof {self.place(name)});")
        return tables, lines

    def table(self, name: str, array: Array) -> str:
        """An array of constants."""
        kind, suffix = element(array.dtype), self.translator.suffix
        if isinstance(kind, np.dtype):
            single = self.layout.mutable.get(self.layout.record(kind))
            own = [key for key in members(kind) if single is None or key in single]
            rows: Any = array.ravel()
            parts = ["{" + ", ".join(literal(row[key], suffix) for key in own) + "}" for row in rows]
        else:
            parts = [literal(value, suffix) for value in array.ravel()]
        body = textwrap.fill(", ".join(parts), WIDTH, initial_indent="    ", subsequent_indent="    ")
        return f"static const {self.translator.type_of(kind)} {name}[{array.size}] = {{\n{body}\n}};\n"

    # ------------------------------------------------------------------ functions

    def entry(self, kernel: Callable[..., Any], argument: str) -> str:
        """A call of a translated entry point with at most one argument."""
        made = next(
            item for key, item in self.translator.functions.items() if key[0] is getattr(kernel, "__code__", None)
        )
        return self.final(
            f"{made.name}(${made.name}${', ' if made.parameters else ''}{argument if made.parameters else ''})"
        )

    def functions(self) -> str:
        """All functions, each behind those that it calls."""
        found, waiting = [], list(self._functions.values())
        done: set[str] = {"unit"}
        while waiting:
            ready = [item for item in waiting if item.calls <= done]
            for item in ready:
                found.append(self._function(item))
                done.add(item.name)
            waiting = [item for item in waiting if item.name not in done]
        return "\n".join(found)

    def remembers(self, name: str) -> bool:
        """Whether a function needs the unit's memory."""
        if name not in self._remembering:
            item = self._functions[name]
            own = any(self.layout.places[array].written for array in item.arrays)
            self._remembering[name] = own or any(self.remembers(other) for other in sorted(item.calls))
        return self._remembering[name]

    def _function(self, item: TranslatedFunction) -> str:
        given = ["PLACEHOLDER_memory *unit"] if self.remembers(item.name) else []
        given += [self._declared(name, value) for name, value in item.parameters]
        match item.result:
            case None | LaneValues():
                kind = f"{self.rig.upper()}_APART void " if item.result else "void "
                given += [f"{self.translator.type_of(REAL)} *result"] if item.result else []
            case NumberValue(kind=own):
                kind = f"{self.translator.type_of(own)} "
            case ArrayView(kind=own):
                kind = f"{self.translator.pointer(own, item.place)}"
            case StructureValue(type=own):
                kind = f"{own} "
        head = f"static {kind}{item.name}({', '.join(given) or 'void'})"
        lines = [f"/* {item.about}. */"] if item.about else []
        lines += textwrap.wrap(head, WIDTH, subsequent_indent="    ", break_long_words=False)
        lines.append("{")
        text = "\n".join(item.lines)
        for name, value in item.variables.items():
            first = value.text.replace(LANE, "0") if isinstance(value, LaneValues) else name
            if re.search(rf"\b{first}\b", text):
                lines.append(self._variable(name, value))
                lines += [f"    (void){name};"] if name in item.unused else []
        lines += [line for line in item.lines if line]
        return self.final("\n".join([*lines, "}", ""]))

    def _declared(self, name: str, value: Any) -> str:
        match value:
            case ArrayView(kind=kind, place=place) | RecordValue(kind=kind, place=place):
                return f"{self.translator.pointer(kind, place)}{name}"
            case StructureValue(type=kind):
                return f"{kind} {name}"
            case LaneValues():
                return f"const {self.translator.type_of(REAL)} *{name}"
        return f"{self.translator.type_of(value.kind)} {name}"

    def _variable(self, name: str, value: Any) -> str:
        match value:
            case ArrayView(kind=kind, shape=(size,), text=text) if (
                text == name and value.live is None and self._is_array(value)
            ):
                return f"    {self.translator.type_of(kind)} {name}[{size}];"
            case ArrayView(kind=kind, place=place) | RecordValue(kind=kind, place=place):
                return f"    {self.translator.pointer(kind, place)}{name} = 0;"
            case StructureValue(type=kind):
                return f"    {kind} {name};"
            case LaneValues(count=count):
                names = ", ".join(f"{name}{lane}" for lane in range(count))
                return f"    {self.translator.type_of(REAL)} {names};"
        return f"    {self.translator.type_of(value.kind)} {name} = 0;"

    @staticmethod
    def _is_array(view: ArrayView) -> bool:
        return not view.place.sources

    def final(self, text: str) -> str:
        """A text with memory, constants and const in place of their marks."""

        def memory(found: re.Match[str]) -> str:
            return f"unit{found[2]}" if self.remembers(found[1]) else found[2].removeprefix(", ")

        text = re.sub(r"@(\w+)@", lambda found: self.place(found[1]), text)
        text = re.sub(r"\$(\w+)\$(, |)", memory, text)
        text = re.sub(r"§(\d+)§", lambda found: "" if self.translator.places[int(found[1])].written else "const ", text)
        return text.replace("PLACEHOLDER", self.rig)


def _step_of(array: Array) -> int:
    """The step between the only numbers of an array that are not zero, where they are all the same, as in a unit
    matrix; else 0.
    """
    if array.dtype.names:
        return 0
    flat = array.ravel()
    places = np.flatnonzero(flat)
    step = int(places[1] - places[0]) if len(places) > 1 else flat.size
    same = len(places) > 0 and np.array_equal(places, np.arange(places[0], flat.size, step))
    return step if same and len({value.tobytes() for value in flat[places]}) == 1 else 0


def layout_of(records: list[tuple[np.dtype[Any], str]], mutable: dict[str, set[str]]) -> MemoryLayout:
    """An empty layout that knows which members of single records are written."""
    made = MemoryLayout(records)
    made.mutable = mutable
    return made
