"""What is on disk is old and whole, or new and whole."""

import errno
import hashlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import beside, check_file, check_folder, sha256, written_file, written_folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "new" / "summary.json"
    with written_file(path) as partial:
        partial.write_text("{}")
        assert partial.name == "summary.json"
        assert not path.exists()
    assert path.read_text() == "{}"
    assert names(tmp_path / "new") == ["summary.json"]


def test_a_failed_file_leaves_the_old_one(tmp_path):
    path = tmp_path / "summary.json"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), written_file(path) as partial:
        _ = partial.write_text("half") / 0
    assert path.read_text() == "old"
    assert names(tmp_path) == ["summary.json"]


def test_a_folder_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "model"
    for text in ("first", "second"):
        with written_folder(path, marker="model.yaml") as partial:
            (partial / "model.yaml").write_text(text)
            (partial / f"only_{text}").touch()
    assert names(path) == ["model.yaml", "only_second"]
    assert names(tmp_path) == ["model"]


def test_a_failed_folder_leaves_the_old_one(tmp_path):
    path = tmp_path / "model"
    path.mkdir()
    (path / "model.yaml").write_text("old")
    with pytest.raises(ZeroDivisionError), written_folder(path, marker="model.yaml") as partial:
        _ = (partial / "model.yaml").write_text("half") / 0
    assert (path / "model.yaml").read_text() == "old"
    assert names(tmp_path) == ["model"]


@pytest.mark.parametrize("stop", [ZeroDivisionError, KeyboardInterrupt])
def test_what_fails_leaves_no_folders_that_were_made_for_it(tmp_path, stop):
    (tmp_path / "old").mkdir()
    for write in (written_file(tmp_path / "old/new/x"), written_folder(tmp_path / "old/new/y/z", marker="m")):
        with pytest.raises(stop), write:
            raise stop
    assert names(tmp_path) == ["old"]
    assert not names(tmp_path / "old")


def test_the_old_folder_returns_when_the_new_one_cannot_take_its_place(tmp_path):
    path = tmp_path / "model"
    path.mkdir()
    (path / "model.yaml").write_text("old")
    with pytest.raises(UserError, match="cannot be written"), written_folder(path, marker="model.yaml") as partial:
        partial.rmdir()  # nothing is left to take the place
    assert (path / "model.yaml").read_text() == "old"
    assert names(tmp_path) == ["model"]


def test_a_disk_that_is_full_names_what_is_written(tmp_path):
    """A copy's error names the file that is read."""
    full = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "source"))
    with (
        pytest.raises(UserError, match=r"target: cannot be written \(No space"),
        written_folder(tmp_path / "target", marker="x"),
    ):
        raise full
    assert not list(tmp_path.iterdir())


def test_a_folder_of_another_kind_is_never_replaced_unasked(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(UserError, match=r"no model\.yaml"), written_folder(tmp_path, marker="model.yaml"):
        pytest.fail("the body must not run")
    with written_folder(tmp_path, marker="model.yaml", force=True) as partial:
        (partial / "model.yaml").touch()
    assert names(tmp_path) == ["model.yaml"]


def test_a_bag_is_kept_where_replacing_is_not_wanted(tmp_path):
    (tmp_path / "metadata.yaml").touch()
    with (
        pytest.raises(UserError, match="exists already"),
        written_folder(tmp_path, marker="metadata.yaml", replace=False),
    ):
        pytest.fail("the body must not run")


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    with written_folder(tmp_path / "link", marker="model.yaml") as partial:
        (partial / "model.yaml").touch()
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "real") == ["model.yaml"]


def test_a_place_below_a_file_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    for write in (written_file(tmp_path / "file" / "x"), written_folder(tmp_path / "file" / "x", marker="y")):
        with pytest.raises(UserError, match="cannot be written"), write:
            pytest.fail("the body must not run")


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[Path]:
    """A folder that nobody may enter, not even root, who is somebody else meanwhile."""
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o000)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    yield folder
    os.seteuid(user)


def test_where_nothing_can_be_written_is_reported_before_the_work_as_after_it(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "file" / "x", tmp_path / "file" / "x" / "y", Path("/proc/x"), Path("/proc/x/y")):
        for ask in (lambda place=place: check_file(place), lambda place=place: check_folder(place, marker="y")):
            with pytest.raises(UserError, match="cannot be written"):
                ask()


def test_a_folder_that_may_not_be_entered_cannot_be_written(locked):
    for ask in (lambda: check_file(locked / "x"), lambda: check_folder(locked / "x" / "y", marker="y")):
        with pytest.raises(UserError, match=r"cannot be written \(Permission denied\)"):
            ask()
    for write in (written_file(locked / "x"), written_folder(locked / "x", marker="y")):
        with pytest.raises(UserError, match=r"cannot be written \(Permission denied\)"), write:
            pytest.fail("the body must not run")


def test_asking_leaves_nothing_behind(tmp_path):
    check_file(tmp_path / "new" / "summary.json")
    check_folder(tmp_path / "new" / "model", marker="model.yaml")
    assert names(tmp_path) == []


def test_a_pipe_or_a_device_is_never_replaced_by_a_file(tmp_path):
    """A rename would: /dev/null itself, where the user may."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match="device or a pipe"):
        check_file(tmp_path / "pipe")
    with pytest.raises(UserError, match="device or a pipe"), written_file(tmp_path / "pipe"):
        pytest.fail("the body must not run")
    assert (tmp_path / "pipe").is_fifo()


def test_what_may_not_be_replaced_is_reported_before_the_work(tmp_path):
    (tmp_path / "metadata.yaml").touch()
    with pytest.raises(UserError, match="is a folder, not a file"):
        check_file(tmp_path)
    with pytest.raises(UserError, match="is a file, not a folder"):
        check_folder(tmp_path / "metadata.yaml", marker="model.yaml")
    with pytest.raises(UserError, match=r"no model\.yaml"):
        check_folder(tmp_path, marker="model.yaml")
    with pytest.raises(UserError, match="exists already"):
        check_folder(tmp_path, marker="metadata.yaml", replace=False)
    check_folder(tmp_path, marker="metadata.yaml")


@pytest.mark.parametrize("place", [".", "..", "../here"])
def test_nobody_s_current_folder_is_taken_away(tmp_path, monkeypatch, place):
    """A folder is replaced by renaming: a shell inside would be left in one that is gone."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(UserError, match="current folder"):
        check_folder(place, marker="here")
    with pytest.raises(UserError, match="current folder"), written_folder(place, marker="here"):
        pytest.fail("the body must not run")
    assert names(tmp_path) == ["here"]
    check_folder("below", marker="x")
    check_folder("../there", marker="x")


def test_what_is_beside_a_folder_is_beside_it_by_any_of_its_names(tmp_path, monkeypatch):
    folder = tmp_path / "v1.2"
    folder.mkdir()
    (tmp_path / "elsewhere").symlink_to(folder)
    monkeypatch.chdir(folder)
    for name in (".", folder, "../v1.2/", tmp_path / "elsewhere"):
        assert beside(name, ".part") == tmp_path / "v1.2.part"


def test_a_file_and_a_folder_do_not_replace_each_other(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="is a folder"), written_file(tmp_path):
        pytest.fail("the body must not run")
    with pytest.raises(UserError, match="is a file"), written_folder(tmp_path / "file", marker="y"):
        pytest.fail("the body must not run")


def test_an_error_about_another_file_stays_what_it_is(tmp_path):
    with pytest.raises(FileNotFoundError), written_file(tmp_path / "x"):
        (tmp_path / "missing").read_text()


def test_the_digest_of_a_folder_is_what_sha256sum_says(tmp_path):
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "a.bin").write_bytes(b"abc")
    (tmp_path / "a.txt").write_bytes(b"")
    assert sha256(tmp_path / "b" / "a.bin") == hashlib.sha256(b"abc").hexdigest()
    listing = subprocess.run(["sha256sum", "a.txt", "b/a.bin"], cwd=tmp_path, capture_output=True, check=True).stdout
    assert sha256(tmp_path) == hashlib.sha256(listing).hexdigest()
    with pytest.raises(UserError, match="cannot be read"):
        sha256(tmp_path / "missing")
