"""hybrid-sysid policy train: where it writes, and what an interrupt keeps."""

from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.policies.commands import policy_train
from hybrid_sysid_ros.extensions.shared.parallel import Store
from tests.command_line import PLACES, refused, refused_place


@PLACES
def test_it_says_where_it_cannot_write_before_anything_else(command, tmp_path, monkeypatch, place):
    refused_place(command, tmp_path, place, ("policy", "train", "nowhere", "--out", "PLACE"), monkeypatch)


def test_an_interrupted_training_says_what_is_kept(command, linear_model, tmp_path, monkeypatch):
    def interrupt(*_, samples, **__):
        store: Store[dict[str, Any]] = Store(samples)
        store.keep("a loop", {"plans": np.zeros(3)})
        raise KeyboardInterrupt

    monkeypatch.setattr(policy_train, "train_policy", interrupt)
    status, out, error = command("policy", "train", linear_model, "--out", tmp_path / "policy")
    kept = f"1 closed loops are kept in {tmp_path / 'policy.samples'}; the same command goes on from there"
    assert (status, out, error) == (130, "", f"interrupted: {kept}\n")


def test_a_policy_needs_a_model(command, tmp_path):
    refused(command("policy", "train", tmp_path / "nowhere", "--out", tmp_path / "policy"), "nowhere")


def test_wrong_settings_of_a_policy_get_one_line(command, linear_model, tmp_path):
    train = ("policy", "train", linear_model, "--out", tmp_path / "policy")
    refused(command(*train, "--hidden", "64;64"), "--hidden", "64,64")
    refused(command(*train, "--follow", "coulomb"), "coulomb")
    for spread in ("-1", "0", "nan", "inf"):
        refused(command(*train, "--follow", f"gain={spread}"), "gain", spread)
    refused(command(*train, "--hidden", "10000000"), "10000000")
    refused(command(*train, "--hidden", ",".join(["8"] * 9)), "8")
    refused(command(*train, "--follow", "mass=1"), "mass")


def test_an_unknown_option_points_at_the_help(command):
    given = ("policy", "train", "model", "--out", "p", "--episodes", "1")
    refused(command(*given), "--episodes", "hybrid-sysid policy train --help")
