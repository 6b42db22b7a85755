"""Kernels as C: what is translated answers as Python does."""

import ctypes
import math
import subprocess

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.unit.layout import MemoryLayout
from hybrid_sysid_ros.extensions.export.unit.printing import Printer
from hybrid_sysid_ros.extensions.export.unit.translator import Translator
from hybrid_sysid_ros.extensions.export.unit.values import INT, REAL, ArrayView, KnownValue, NumberValue, Origin
from hybrid_sysid_ros.support.errors import UserError

COMPILER = compiler.found() or ""
pytestmark = pytest.mark.skipif(not COMPILER, reason="needs a C compiler: cc, gcc or clang")

PRELUDE = """#include <math.h>
#include <stdlib.h>
typedef double rig_real;
static inline double rig_min(double a, double b) { return b < a ? b : a; }
static inline double rig_max(double a, double b) { return b > a ? b : a; }
static inline int rig_max_int(int a, int b) { return b > a ? b : a; }
"""


def smallest(a, b):
    return min(a, b), max(a, b)


def fibonacci(x, out, count):
    before, last = 0, 1
    for _ in range(count):
        before, last = last, before + last
    size = x.shape[0]
    moved, other = np.zeros(size), np.empty(size)
    for i in range(size - 1, -1, -1):
        moved[i] = x[i] * last / 3
        other[size - 1 - i] = -(x[i] ** 2)
    if size > 100:
        out[0] = 1.0
    for turn in range(3):
        moved, other = other, moved
        for i in range(0, size, 2):
            if not math.isfinite(moved[i]) or (turn == 1 and i > 2):
                continue
            moved[i] += 1.0 if i % 2 == 0 else -1.0
    low, high = smallest(x[0], x[1])
    for i in range(size):
        out[i] = moved[i] - other[i] * (low - (high - 1.0)) + max(i, 2)
    return low < high <= 7.0 and not math.isnan(high)


def translated(function, arguments):
    """A function of vectors in C, as a callable."""
    translator = Translator(MemoryLayout([]), "rig", "", {})
    made = translator.call(function, arguments)
    printer = Printer(translator)
    return made, PRELUDE + printer.structures() + printer.tables() + printer.functions().replace(
        f"static int {made.name}(", f"int {made.name}("
    )


@pytest.mark.parametrize(
    "x", [[1.0, 2.0, 3.0, -4.5, 0.1], [math.nan, 1.0, 2.0, 3.0, 4.0], [8.0, math.inf, 0.0, -0.0, 1.0]]
)
def test_a_function_in_c_answers_as_in_python(tmp_path, x):
    vector = ArrayView(REAL, (5,), "", Origin("x"))
    made, text = translated(fibonacci, [vector, vector, KnownValue(7)])
    (tmp_path / "unit.c").write_text(text)
    flags = ["-std=c99", "-O1", "-shared", "-fPIC", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    command = [COMPILER, *flags, str(tmp_path / "unit.c"), "-o", str(tmp_path / "unit.so"), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not built.returncode, built.stderr + text
    found, expected, given = np.zeros(5), np.zeros(5), np.array(x)
    called = getattr(ctypes.CDLL(str(tmp_path / "unit.so")), made.name)
    answer = called(ctypes.c_void_p(given.ctypes.data), ctypes.c_void_p(found.ctypes.data))
    with np.errstate(invalid="ignore"):
        assert bool(answer) == fibonacci(given, expected, 7)
    np.testing.assert_array_equal(found, expected)


def chosen(x, more, out):
    for i in range(out.shape[0]):
        out[i] = x[i] if i < x.shape[0] else more[i - x.shape[0]]
    for i in range(more.shape[0]):
        more[i] = 1.0


def test_an_array_without_elements_is_never_read(tmp_path):
    vector, empty = ArrayView(REAL, (3,), "", Origin("x")), ArrayView(REAL, (0,), "0", Origin("nothing"))
    _, text = translated(chosen, [vector, empty, vector])
    (tmp_path / "unit.c").write_text(text)
    subprocess.run([COMPILER, "-Wall", "-Wno-unused-function", "-Werror", "-c", "unit.c"], cwd=tmp_path, check=True)
    assert "for (int i = 0; i < 3; i++) {\n        out[i] = i < 3 ? x[i] : 0;" in text


def test_an_array_that_a_function_encloses_is_a_constant_in_c():
    """As the exponents of a polynomial; it is no part of the loop's memory."""
    order = np.array([2, 0])

    def kernel(x, k):
        return x[order[k]]

    _, text = translated(kernel, [ArrayView(REAL, (3,), "", Origin("x")), NumberValue(INT, "k")])
    assert "static const int rig_constant_0[2] = {\n    2, 0\n};" in text
    assert "x[rig_constant_0[k]]" in text


def test_the_rest_of_a_row_is_a_part_of_its_array():
    def kernel(x, k):
        row = x[k, 1:]
        return row[2] * row.shape[0]

    _, text = translated(kernel, [ArrayView(REAL, (2, 5), "", Origin("x")), NumberValue(INT, "k")])
    assert "row = x + k * 5 + 1;" in text
    assert "row[2] * 4" in text


def test_what_can_t_be_translated_is_named():
    def kernel(x):
        return {item: item for item in x}

    with pytest.raises(
        UserError, match=r"export: \{item: item for item in x\} in test_unit.kernel can't be printed as C"
    ):
        translated(kernel, [NumberValue(REAL, "x")])
