"""New values in a robot.toml that people have written: what they wrote stays."""

from __future__ import annotations

import tomllib

import pytest

from locfuse.formats.robot import robot_toml
from locfuse.formats.robot.commented_toml import updated
from locfuse.fusion.data import LocfuseError

MINE = """# Anna's robot
order = "stamp"

[wheels]  # new tyres
radius = 0.05  # by ruler, "worn" # twice
# track = 0.6  # not yet measured
left = 'a # b'

# [compass]
# sigma_deg = 3.0

[lrf]
topic = "/scan"
"""


def test_values_change_and_every_other_character_stays() -> None:
    text = updated(MINE, {"wheels": {"radius": 0.0498}}, "x")
    assert text == MINE.replace("0.05 ", "0.0498 ")


def test_a_key_behind_a_hash_is_filled_in_where_it_stands() -> None:
    text = updated(MINE, {"wheels": {"track": 0.61}}, "x")
    assert "\ntrack = 0.61  # not yet measured\n" in text


def test_a_table_behind_a_hash_comes_into_effect() -> None:
    text = updated(MINE, {"compass": {"sigma_deg": 1.5}}, "x")
    assert "\n[compass]\nsigma_deg = 1.5\n\n[lrf]" in text


def test_new_keys_and_tables_are_added_and_say_who_did() -> None:
    changes = {"wheels": {"noise": 1e-4}, "gps": {"origin": [48.1, 11.5]}, "preset": "paper", "order": "auto"}
    text = updated(MINE, changes, "locfuse tune")
    assert tomllib.loads(text) == robot_toml.merge(tomllib.loads(MINE), changes)
    assert "noise = 0.0001  # locfuse tune\n" in text
    assert text.index("left = ") < text.index("noise = ") < text.index("# [compass]")
    assert text.rstrip().endswith("[gps]\norigin = [48.1, 11.5]  # locfuse tune")


def test_a_value_that_holds_a_hash_is_replaced_whole() -> None:
    assert tomllib.loads(updated(MINE, {"wheels": {"left": "c"}}, "x"))["wheels"]["left"] == "c"


def test_an_empty_file_is_filled() -> None:
    assert tomllib.loads(updated("", {"lrf": {"x": 0.2}}, "x")) == {"lrf": {"x": 0.2}}


@pytest.mark.parametrize(
    "text", ["wheels.radius = 0.05\n", "[wheels]\nradius = [\n 1,\n 2]\n", "wheels = {radius = 1}\n"]
)
def test_what_cannot_be_changed_line_by_line_is_refused_not_broken(text: str) -> None:
    with pytest.raises(LocfuseError, match=r"line by line|not valid TOML"):
        updated(text, {"wheels": {"radius": 0.04}}, "x")
