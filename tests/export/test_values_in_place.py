"""New values in a YAML that people wrote: every other byte stays, and what cannot be changed is refused."""

from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from ruamel.yaml import YAML

from locfuse.cli.ros.export import section_of
from locfuse.formats.robot.ros_yaml import Setting, changed, in_yaml, parsed, render
from locfuse.fusion.data import LocfuseError

FILE = Path("nav2.yaml")
KEYS = ("alpha1", "alpha2", "alpha3", "sigma_hit", "z_hit", "z_rand", "update_min_d")
numbers = st.floats(min_value=-1e6, max_value=1e6).map(lambda x: f"{x:.3f}")
gaps = st.sampled_from([" ", "   "])
comments = st.sampled_from(["", "  # how noisy: 0.2", " # é: [a, b]", "   "])
ends = st.sampled_from(["\n", "\r\n"])
quotes = st.sampled_from(["", "'", '"'])


@st.composite
def files(draw: st.DrawFn) -> tuple[list[str], list[str], list[str], list[str]]:
    """Return keys, and the text as pieces before each value, the values, and what follows the last of them."""
    keys = draw(st.permutations(KEYS))
    end = draw(ends)
    bom = draw(st.sampled_from(["", "\ufeff"]))
    before, values = (
        f"{bom}# mine{end}other:{end}  ros__parameters: {{alpha9: 1}}{end}amcl:{end}  ros__parameters:{end}",
        [],
    )
    pieces = []
    for key in keys:
        quote = draw(quotes)
        pieces.append(f"{before}    {key}:{draw(gaps)}{quote}")
        values.append(draw(numbers))
        before = f"{quote}{draw(comments)}{end}{draw(st.sampled_from(['', f'    # between{end}', end]))}"
    return keys, pieces, values, [f"{before}last:{end}  - &a 1{end}  - *a{end}"]


@given(files(), st.dictionaries(st.sampled_from(KEYS), st.floats(min_value=1e-9, max_value=1e9), min_size=1))
def test_only_the_bytes_of_the_named_values_change(
    made: tuple[list[str], list[str], list[str], list[str]], new: dict[str, float]
) -> None:
    keys, pieces, values, rest = made
    text = "".join(piece + value for piece, value in zip(pieces, values, strict=True)) + rest[0]
    file = parsed(FILE, text)
    settings = [Setting(key=key, value=value, words="") for key, value in new.items()]
    got, absent = changed(file, section_of(file, "amcl"), settings)
    replaced = [in_yaml(new[key]) if key in new else value for key, value in zip(keys, values, strict=True)]
    quoted = {key for key, piece in zip(keys, pieces, strict=True) if piece[-1] in "'\""}
    same = [  # a number that has these four digits already stays as it is written
        old if key not in quoted and float(old) == float(now) else now
        for key, old, now in zip(keys, values, replaced, strict=True)
    ]
    expected = "".join(piece + value for piece, value in zip(pieces, same, strict=True)) + rest[0]
    assert got == expected
    assert not absent


OLD = """amcl:  # amcl
  ros__parameters:
    alpha1: 0.2  # found: turn by turn; of another log
    alpha2: 0.2 # found it at a fair: do not touch
    alpha3: '0.2'    # carried over: way by way{end}    # found: not beside a value
    poses: [1.0, 2.0,  # found: x: of another log
      3.0, 4.0]  # found: y: of another log
    z_hit: "# found: 0.5"  # mine: # found: 0.2
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_comment_of_an_earlier_export_is_replaced_and_one_of_the_users_stays(end: str) -> None:
    file = parsed(FILE, OLD.replace("{end}", "\n").replace("\n", end))
    settings = [
        Setting(key="alpha1", value=0.3, words="by this log"),
        Setting(key="alpha2", value=0.3, words="by this log"),
        Setting(key="alpha3", value=0.3, words="by this log", origin="set"),
        Setting(key="poses", value=[5.0, 2.0, 3.0, 4.0], words="", places=(0,), row=2, row_words=("x: new", "y")),
        Setting(key="z_hit", value="near", words="by this log"),
    ]
    got, _ = changed(file, file.sections[0], settings)
    assert got.split(end)[2:] == [
        "    alpha1: 0.3  # found: by this log",
        "    alpha2: 0.3 # found it at a fair: do not touch",
        "    alpha3: '0.3'    # carried over: by this log",
        "    # found: not beside a value",
        "    poses: [5.0, 2.0,  # found: x: new",
        "      3.0, 4.0]  # found: y: of another log",
        '    z_hit: "near"  # mine: # found: 0.2',
        "",
    ]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[1, 2, 3, 4]  # found: x: old", "[5.0, 2, 3, 6.0]  # found: x, y"),  # the words of the whole list
        ("[1, [2], 3, 4]", "[5.0, [2], 3, 6.0]"),
        ("[1, 2, # x\n        3,    4]", "[5.0, 2, # x\n        3,    6.0]"),
    ],
)
def test_a_list_keeps_its_layout_and_the_numbers_that_are_not_meant(old: str, new: str) -> None:
    file = parsed(FILE, f"n:\n  ros__parameters:\n    odom0: odom\n    Q: {old}\n")
    setting = Setting(key="Q", value=[5.0, 9.0, 9.0, 6], words="x, y", places=(0, 3), row=2, row_words=("a", "b"))
    assert changed(file, file.sections[0], [setting])[0] == file.text.replace(old, new)


def test_comments_of_an_earlier_export_on_what_cannot_be_mapped_are_replaced_in_this_section_alone() -> None:
    text = (
        "# imu0 covariance: cannot be mapped: above\nekf:\n  ros__parameters:\n    odom0: odom\n"
        "    # imu0 covariance: cannot be mapped: yaw 1\n    # imu0 covariance: cannot be mapped: z 2\n"
        "    # lrf: mine\n    x: 1  # lrf: cannot be mapped: beside\n"
        "amcl:\n  ros__parameters:\n    alpha1: 1\n    # lrf: cannot be mapped: of amcl\n"
    )
    file = parsed(FILE, text)
    notes = [
        ("imu0 covariance", "yaw 5"),
        ("imu0 covariance", "z 6"),
        ("imu0 covariance", "w 7"),
        ("lrf", "no laser"),
    ]
    settings = [Setting(key=key, value=None, words=words) for key, words in notes]
    assert changed(file, file.sections[0], settings)[0] == text.replace("yaw 1", "yaw 5").replace("z 2", "z 6")


REFUSED = {
    "amcl:\n\tros__parameters:\n\t\talpha1: 1\n": "line 2 begins with a tab; indent YAML with spaces",
    "amcl:\n  ros__parameters:\n    alpha1: &a 0.2\n    alpha2: *a\n": "line 3: alpha1 has an anchor or an alias",
    "amcl:\n  ros__parameters: &p\n    alpha1: 0.2\nb: *p\n": "line 3: alpha1 has an anchor or an alias",
    "amcl:\n  ros__parameters:\n    alpha2: 1\n    sigma_hit: 1\n    <<: {alpha1: 1}\n": "takes keys by <<",
    "amcl:\n  ros__parameters:\n    alpha1: 0.2\n    alhpa2: 0.2\n": "amcl has no key alhpa2: correct it",
    "amcl:\n  ros__parameters:\n    alpha1: 0.2\n    alpha1: 0.3\n": "alpha1 stands twice",
    "amcl:\n  ros__parameters:\n    alpha1: !!float 0.2\n": "alpha1 has no plain value",
    "amcl:\n  ros__parameters:\n    alpha1:\n    alpha2: 1\n": "alpha1 has no plain value",
    "amcl:\n  ros__parameters:\n    alpha1: [0.2]\n": "alpha1 is not a single value",
    "ekf:\n  ros__parameters:\n    odom0: odom\n": "has no section of amcl",
    "a:\n  ros__parameters: {alpha1: 1}\nb:\n  ros__parameters: {alpha1: 1}\n": "several sections of amcl (a, b)",
    "- 1\n": "its top level is not a mapping",
    "a: [\n": "is no YAML",
    "\0\1": "is no YAML",
}


CONTROLLER = """controller_manager:
  ros__parameters:
    front:
      type: ackermann_steering_controller/AckermannSteeringController
front:
  ros__parameters:
    wheel_separation: 0.4
"""
STEERED = "front is a ackermann_steering_controller/AckermannSteeringController, not a diff_drive_controller"


@pytest.mark.parametrize(
    ("text", "target", "says"),
    [*((text, "amcl", says) for text, says in REFUSED.items()), (CONTROLLER, "diff_drive", STEERED)],
)
def test_what_cannot_be_changed_is_said_in_one_line(text: str, target: str, says: str) -> None:
    def change() -> None:
        file = parsed(FILE, text)
        changed(file, section_of(file, target), [Setting(key="alpha1", value=1.5, words="")])

    with pytest.raises(LocfuseError) as problem:
        change()
    assert says in str(problem.value)
    assert "\n" not in str(problem.value)


def test_a_node_is_chosen_by_its_name_and_nested_keys_are_found() -> None:
    text = (
        "robot1:\n  fc:\n    ros__parameters:\n      imu:\n        gyro_noise: 0.01 # mine\n"
        "fc2:\n  ros__parameters:\n    imu.gyro_noise: 1\n"
    )
    file = parsed(FILE, text)
    setting = Setting(key="imu.gyro_noise", value=0.5, words="")
    assert changed(file, section_of(file, "fusioncore", "fc"), [setting])[0] == text.replace("0.01", "0.5")
    assert changed(file, section_of(file, "fusioncore", "fc2"), [setting])[0] == text.replace(": 1\n", ": 0.5\n")


@given(st.floats(min_value=-1e300, max_value=1e300), st.text(max_size=12))
def test_a_new_file_is_read_as_it_was_meant(number: float, text: str) -> None:
    settings = [Setting(key="number", value=number, words=text), Setting(key="word", value=text, words="x")]
    yaml = YAML(typ="safe", pure=True)
    yaml.version = (1, 1)  # as libyaml reads it for ROS
    found = yaml.load(render(text, [("node", text, settings)]))["node"]["ros__parameters"]
    assert isinstance(found["number"], float)
    assert found["number"] == pytest.approx(number, rel=1e-3)
    assert found["word"] == text
