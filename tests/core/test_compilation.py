"""Compiled code: kept on disk by what it is made of, found again by the next process, and safe to share."""

import os
import shutil
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hybrid_sysid_ros.core import compilation
from hybrid_sysid_ros.core.code_cache import CheckedCacheFile
from hybrid_sysid_ros.core.compiled import _kept as printed_file
from hybrid_sysid_ros.support.versions import FALL_BACK, WARNED

PROGRAM = """
from dataclasses import dataclass
import numpy as np
from numba.core import event
from hybrid_sysid_ros.core import Dry, Sensitivities, Softsign, System, bounded, simulate
from hybrid_sysid_ros.core.mathematics import sin

@dataclass(frozen=True, kw_only=True)
class Block(System):
    states = ("q [rad]", "v [rad/s]")
    inputs = ("u [V]",)
    contacts = (Dry(on="v", level="grip"),)
    grip: float = bounded(1.0, 0.0, 2.0, unit="rad/s^2")

    @property
    def weights(self):
        return np.linspace(-1.0, 1.0, 8)

    def law(self, x, u):
        return x[1], u[0] - sin(x[0]) + Softsign(features=2, units=2)(x)[0]

with event.install_recorder("numba:run_pass") as passes:
    end = simulate(Block(), np.zeros(2), np.full((10, 1), 3.0), step=0.01)[-1]
    sensitivities, out = Sensitivities(Block()), np.empty((3, 1, 1 + 8 + 2))
    starts = np.array([[0, 0, 3, 0]])
    sensitivities.rollouts(Block(), starts, np.zeros((1, 2)), np.ones((3, 1)), step=0.01, every=1, out=out)
print(len(passes.buffer), *end, out.sum())
"""


SMALL = """
from numba.core import event
from hybrid_sysid_ros.core.compilation import kernel
from tests.compiling import twice

with event.install_recorder("numba:run_pass") as passes:
    found = kernel(twice)(1.5)
print(len(passes.buffer), found)
"""


def run(cache, home=None, *, program=PROGRAM, without="", damaged=0):
    """Passes of the compiler, and the numbers of the program, in a process of its own, without some private parts, and
    with a line for each file that is damaged.
    """
    environment = {
        **os.environ,
        "HYBRID_SYSID_CACHE": str(cache),
        "TMPDIR": str(home or cache),
        FALL_BACK: without,
        WARNED: "",
    }
    found = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    passes, *numbers = found.stdout.split()
    assert found.stderr.count("\n") == len(list(filter(None, without.split(",")))) + damaged  # a warning each
    assert found.stderr.count("made again") == damaged
    return int(passes), numbers


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def first(cache):
    """What the first process found that kept its code there."""
    return run(cache)


def test_a_second_process_compiles_nothing(cache, first):
    assert first[0] > 50
    assert run(cache) == (0, first[1])


@pytest.mark.slow
def test_numba_s_own_compiler_makes_the_same_digits(cache, first):
    passes, numbers = run(cache, without="numba.compiler")
    assert passes > 50  # what was compiled in the other way is not taken for it
    assert numbers == first[1]
    assert run(cache, without="numba.compiler") == (0, numbers)


def test_without_a_lock_nothing_is_kept(cache):
    first = run(cache, program=SMALL, without="numba.cache")
    assert first[0] > 10
    assert run(cache, program=SMALL, without="numba.cache") == first


@pytest.mark.slow
def test_where_nothing_can_be_kept_it_is_compiled_for_this_process(tmp_path):
    """The cache is a file, and so no folder; temporary files may be made."""
    (tmp_path / "cache").write_text("")
    (tmp_path / "temporary").mkdir()
    first = run(tmp_path / "cache", tmp_path / "temporary", program=SMALL)
    assert first[0] > 10
    assert run(tmp_path / "cache", tmp_path / "temporary", program=SMALL) == (0, first[1])  # with temporary files


def test_code_that_is_damaged_on_disk_is_made_again_with_a_line(tmp_path):
    first = run(tmp_path, program=SMALL)
    (index,) = tmp_path.rglob("*.nbi")
    (code,) = tmp_path.rglob("*.nbc")
    for path, at in ((index, 40), (code, 3000)):
        content = bytearray(path.read_bytes())
        content[at] ^= 4
        path.write_bytes(content)
        assert run(tmp_path, program=SMALL, damaged=1) == first
    assert run(tmp_path, program=SMALL) == (0, first[1])


def flipped(content, at):
    return bytes(one ^ 255 if k == at % len(content) else one for k, one in enumerate(content))


@pytest.mark.parametrize("damage", ["empty", "half", "longer", 0, 30, -17, -1])
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_what_is_damaged_is_not_unpacked(tmp_path, damage, ending):
    file = CheckedCacheFile(str(tmp_path), "twice", 1.0)
    file.save("key", list(range(100)))
    assert file.load("key") == list(range(100))
    (path,) = tmp_path.glob(f"*.{ending}")
    content = path.read_bytes()
    other = {"empty": b"", "half": content[: len(content) // 2], "longer": content + b"."}
    path.write_bytes(other[damage] if damage in other else flipped(content, damage))
    with pytest.warns(RuntimeWarning, match=r"is damaged: its compiled code is made again"):
        assert file.load("key") is None
    file.save("key", [1.0])
    assert file.load("key") == [1.0]


def test_code_in_another_function_s_place_is_not_taken(tmp_path):
    files = [CheckedCacheFile(str(tmp_path), name, 1.0) for name in ("one", "other")]
    for file in files:
        file.save("key", file._index_name)
    for path in tmp_path.glob("one*"):
        shutil.copy(path, tmp_path / path.name.replace("one", "other"))
    with pytest.warns(RuntimeWarning, match="damaged"):
        assert files[1].load("key") is None


def test_copies_of_a_source_share_its_code(tmp_path):
    """As a second clone, or an installed package beside its checkout."""
    with compilation.kept_in(tmp_path):
        one, other = (CheckedCacheFile(str(tmp_path / name), "twice", b"content") for name in ("one", "other"))
        altered = CheckedCacheFile(str(tmp_path / "one"), "twice", b"other content")
    one.save("key", 2.0)
    assert other.load("key") == 2.0
    assert altered.load("key") is None


def test_what_cannot_be_kept_is_reported(tmp_path):
    with pytest.warns(RuntimeWarning, match="the next process compiles anew"):
        CheckedCacheFile(str(tmp_path / "gone"), "twice", 1.0).save("key", 1.0)


def test_a_printed_source_that_is_damaged_is_printed_again(root):
    path = printed_file(compilation.folder("thing", "1"), "one = 1.0\n")
    path.write_bytes(b"one = \xff\n")
    with pytest.warns(RuntimeWarning, match=r"printed.py is damaged"):
        assert printed_file(path.parent, "one = 1.0\n").read_text() == "one = 1.0\n"


@pytest.mark.slow
def test_processes_that_start_at_once_agree(tmp_path):
    environment = {**os.environ, "HYBRID_SYSID_CACHE": str(tmp_path)}
    running = [
        subprocess.Popen([sys.executable, "-c", PROGRAM], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    found = [process.communicate()[0].split()[1:] for process in running]
    assert [process.returncode for process in running] == [0, 0]
    assert found[0] == found[1]
    assert run(tmp_path) == (0, found[0])


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A cache of this test's own."""
    monkeypatch.setenv("HYBRID_SYSID_CACHE", str(tmp_path))
    for function in (compilation._root, compilation._clear):
        function.cache_clear()
    yield tmp_path / "hybrid_sysid_ros"
    for function in (compilation._root, compilation._clear):
        function.cache_clear()


def test_a_cache_can_be_written_to_by_its_owner_only(root):
    root.mkdir(mode=0o775)
    root.chmod(0o775)
    assert compilation.folder("thing", "1") == root / "thing-1"
    for path in (root, root / "thing-1"):
        assert not stat.S_IMODE(path.stat().st_mode) & 0o022


def test_what_nobody_asked_for_in_a_month_is_cleared_away(root):
    old, used = compilation.folder("old", "1"), compilation.folder("used", "1")
    past = time.time() - 86400.0 * (compilation.UNUSED_DAYS + 1)
    for path in (old, used):
        os.utime(path, (past, past))
    compilation._clear.cache_clear()
    assert compilation.folder("used", "1") == used  # asked for before something new is kept
    compilation.folder("new", "1")
    assert sorted(path.name for path in root.iterdir()) == ["new-1", "used-1"]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of three modules; ``top`` imports ``middle``, and nobody ``apart``."""
    folder = tmp_path / "rooms"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "bottom.py").write_text("LIMIT = 1.0\n")
    (folder / "middle.py").write_text("from rooms.bottom import LIMIT\n")
    (folder / "top.py").write_text("import math\n\nfrom rooms import (\n    middle,\n)\n")
    (folder / "apart.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "rooms"]:
        del sys.modules[name]
    compilation._source.cache_clear()


def digest_of_top():
    for name in [name for name in sys.modules if name.partition(".")[0] == "rooms"]:
        del sys.modules[name]
    compilation._source.cache_clear()
    __import__("rooms.top")
    __import__("rooms.apart")
    return compilation.digest("rooms.top")


@pytest.mark.parametrize(("changed", "matters"), [("top", True), ("middle", True), ("bottom", True), ("apart", False)])
def test_compiled_code_is_made_again_where_something_it_reaches_has_changed(package: Path, changed, matters):
    before = digest_of_top()
    assert digest_of_top() == before
    path = package / f"{changed}.py"
    path.write_text(path.read_text() + "\nMORE = 1\n")
    os.utime(path, (0, 0))  # so that Python reads it again
    assert (digest_of_top() != before) == matters
