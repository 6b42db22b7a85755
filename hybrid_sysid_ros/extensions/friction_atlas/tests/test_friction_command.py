"""hybrid-sysid friction."""

from tests.command_line import refused


def test_laws_of_friction_are_listed_and_drawn(command, tmp_path):
    status, out, _ = command("friction")
    assert status == 0
    assert all(name in out for name in ("stribeck", "lugre", "maxwell", "ageing"))
    status, out, error = command("friction", "stribeck", "--set", "static=3", "--out", tmp_path)
    assert status == 0, error
    picture = (tmp_path / "stribeck.svg").read_text(encoding="utf-8")
    assert picture.count("<polyline") == 5  # a plot each, and the spring's end
    refused(command("friction", "stribeck", "--set", "static=0.5"), "below Coulomb")
    refused(command("friction", "stribeck", "--set", "static"), "NAME=VALUE")
    refused(command("friction", "stribeck", "--set", "static=2", "--set", "static=3"), "static is given 2 times")
    refused(command("friction", "sticky"), "sticky")
    refused(command("friction", "sticky", "--set"), "--set", "argument")
