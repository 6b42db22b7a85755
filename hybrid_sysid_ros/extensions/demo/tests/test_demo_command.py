"""hybrid-sysid demo: what it can't do it says before it begins."""

from tests.command_line import refused


def test_the_demo_says_at_once_where_it_cannot_write(command, tmp_path):
    (tmp_path / "file").write_text("")
    refused(command("demo", "--out", tmp_path / "file" / "demo"), "file/demo", "--out")


def test_the_results_of_a_demo_are_replaced_only_on_request(command, tmp_path):
    (tmp_path / "report.html").write_text("mine")
    refused(command("demo", "--out", tmp_path), tmp_path / "report.html", "--overwrite")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
