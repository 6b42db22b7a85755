"""hybrid-sysid policy export: where it writes."""

from tests.command_line import PLACES, refused_place


@PLACES
def test_it_says_where_it_cannot_write_before_anything_else(command, tmp_path, monkeypatch, place):
    refused_place(command, tmp_path, place, ("policy", "export", "nowhere", "PLACE"), monkeypatch)
