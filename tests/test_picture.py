"""The pictures of benchmarks: what is drawn is where it is said to be."""

from xml.etree import ElementTree

import numpy as np

from benchmarks.picture import Panel, draw

SVG = "{http://www.w3.org/2000/svg}"


def test_a_line_runs_from_corner_to_corner_and_a_held_one_in_steps(tmp_path):
    time = np.array([0.0, 1.0, 2.0])
    panels = [
        Panel(
            label="q [V] <1>", height=100, lines={"a & b": np.array([0.0, 1.0, 2.0]), "c": np.array([2.0, 2.0, 0.0])}
        ),
        Panel(label="u [V]", height=50, lines={"c": np.array([5.0, -5.0, -5.0])}, held=True),
    ]
    picture = ElementTree.parse(draw(tmp_path / "new" / "picture.svg", time, panels, title="a & b")).getroot()
    texts = [item.text for item in picture.iter(f"{SVG}text")]
    assert {"a & b", "c", "q [V] <1>", "u [V]", "time [s]", "0", "2"} <= set(texts)
    assert "-0" not in texts
    rising, falling, held = (
        np.array([[float(number) for number in point.split(",")] for point in item.attrib["points"].split()])
        for item in picture.iter(f"{SVG}polyline")
    )
    assert np.ptp(np.diff(rising, axis=0), axis=0).max() < 0.11  # straight, to the rounding
    assert rising[0, 1] - rising[-1, 1] == falling[-1, 1] - falling[0, 1] > 80.0
    np.testing.assert_array_equal(rising[:, 0], falling[:, 0])
    assert np.all((np.diff(held, axis=0) == 0.0).any(axis=1))  # along an axis each
    styles = {item.attrib["stroke"] for item in picture.iter(f"{SVG}polyline")}
    assert len(styles) == 2  # one name, one colour
