"""A recording read back: what it holds is what the filter estimated, at the log's own times."""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recordings import Entity, read, read_blueprint

from locfuse import sample_logs
from locfuse.cli.analysis import results
from locfuse.cli.analysis.compare import Compared
from locfuse.cli.analysis.configurations import for_comparison
from locfuse.cli.analysis.load import Loaded, load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.rerun.scene import make_scene
from locfuse.cli.session.result import Result
from locfuse.formats.rerun.recording import save_recording
from locfuse.fusion.data import VERDICTS, Estimates, Evaluation
from locfuse.fusion.judge.evaluate import evaluate

LOG = "rounded_triangle"
EVERY = 20  # pictures


class Made(NamedTuple):
    loaded: Loaded
    estimates: dict[str, Estimates]
    evaluations: dict[str, Evaluation]
    entities: dict[str, Entity]
    layout: dict[str, Entity]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    path = tmp_path_factory.mktemp("rerun") / "drive.rrd"
    how = LogOptions(sets=("lrf.deskew=false",), quiet=True)
    loaded = load([sample_logs.path(LOG)], how)
    words = ["odometry", "compass", "lrf", "camera", "all", "lrf@2Hz"]
    configurations = for_comparison(words, loaded.drive)
    estimates = {c.name: c.fuse(loaded.drive, loaded.robot)[0] for c in configurations}
    judged = {c.name: evaluate(estimates[c.name], c.drive(loaded.drive)) for c in configurations}
    compared = Compared(loaded, configurations, list(estimates.values()), list(judged.values()), [])
    report = results.build(loaded, compared.evaluations)
    save_recording(path, make_scene(Result(compared, report), images=EVERY))
    return Made(loaded, estimates, judged, read(path), read_blueprint(path))


def name_of(configuration: str) -> str:
    return configuration.replace("@", "\\@").replace("+", "\\+")


def test_times_are_the_logs_and_the_viewer_opens_on_seconds_since_the_start(made: Made) -> None:
    drive = made.loaded.drive
    pose = made.entities["world/all/pose"]
    np.testing.assert_array_equal(pose.ns, drive.epoch_ns + np.rint(drive.t * 1e9).astype(np.int64))
    np.testing.assert_array_equal(pose.steps, np.arange(len(drive.t)))
    assert drive.epoch_ns == 1_700_000_000_000_000_000
    columns = {name for e in made.entities.values() for part in e.parts for name in part.schema.names}
    timelines = {name for name in columns if ":" not in name}
    assert timelines - {"rerun.controls.RowId"} == {"drive", "log time", "step"}
    pose = made.entities["world/all/pose"]
    seconds = [t.total_seconds() for t in pose.column("drive")]
    np.testing.assert_allclose(seconds, made.loaded.drive.t, atol=1e-6)  # read back in microseconds
    panel = made.layout["time_panel"].static
    assert [value for name, value in panel.items() if name.endswith(":timeline")] == [[["drive"]]]


def test_the_legend_names_every_configuration_and_every_panel_opens_on_something(made: Made) -> None:
    names = {p.removeprefix("legend/") for p in made.entities if p.startswith("legend/")}
    assert {name_of(n) for n in made.estimates} <= names
    assert {"truth", "matched", "rejected", "landmark"} <= names
    for name in made.estimates:
        sample = made.entities[f"legend/{name_of(name)}"].static["Points2D:colors"]
        assert sample == made.entities[f"world/{name_of(name)}/path"].static["LineStrips2D:colors"]
    views = {key: e.static for key, e in made.layout.items() if "ViewBlueprint:class_identifier" in e.static}
    names = {first(v["ViewBlueprint:display_name"]) for v in views.values()}
    assert {"Map", "Scan", "Omni image", "Panorama", "x [m]", "heading [deg]", "Gates", "Result"} <= names
    assert {"NIS compass", "NIS lrf", "NIS camera", "lrf r [m]", "camera bearing [deg]", "/joint_states"} <= names
    for view in views.values():
        origin = first(view["ViewBlueprint:space_origin"]).strip("/")
        assert any(path == origin or path.startswith(f"{origin}/") or not origin for path in made.entities), origin


@pytest.mark.parametrize("configuration", ["odometry", "compass", "lrf", "camera", "all", "lrf@2Hz"])
def test_every_configuration_has_its_pose_path_and_ellipse(made: Made, configuration: str) -> None:
    e, root = made.estimates[configuration], f"world/{name_of(configuration)}"
    pose = made.entities[f"{root}/pose"]
    np.testing.assert_allclose(
        pose.array("Transform3D:translation")[:, 0, :2], e.pose[:, :2], atol=1e-6 + 1e-6 * abs(e.pose[:, :2]).max()
    )
    q = pose.array("Transform3D:quaternion")[:, 0]
    turned = 2.0 * np.arctan2(q[:, 2], q[:, 3])
    np.testing.assert_allclose(np.cos(turned - e.pose[:, 2]), 1.0, atol=1e-10)
    steps = made.entities[f"{root}/path"].array("LineStrips2D:strips")[:, 0]
    np.testing.assert_array_equal(steps[1:, 0], steps[:-1, 1])  # a growing path without holes
    np.testing.assert_allclose(steps[[0, -1], [0, 1]], e.pose[[0, -1], :2], atol=1e-5)
    axes = made.entities[f"{root}/sigma"].array("Ellipses2D:half_sizes")[:, 0]
    largest = np.sqrt(np.linalg.eigvalsh(e.P[:, :2, :2])[:, 1].clip(0))
    np.testing.assert_allclose(axes[:, 0], 3.0 * largest, atol=1e-7, rtol=1e-5)


def test_y_is_up_the_truth_lies_below_the_estimates_and_the_result_table_is_there(made: Made) -> None:
    (matrix,) = made.entities["world"].static["Transform3D:mat3x3"]
    assert np.array(matrix).reshape(3, 3).tolist() == [[1, 0, 0], [0, -1, 0], [0, 0, 1]]
    (truth,) = made.entities["world/truth/path"].static["LineStrips2D:draw_order"]
    (lowest,) = made.entities["world/odometry/path"].static["LineStrips2D:draw_order"]
    assert truth < lowest
    (((text,), *_),) = [made.entities["result"].static["TextDocument:text"]]
    assert "| odometry |" in text
    assert "<" not in text  # the viewer shows tags as text


def test_deviations_are_those_of_the_report(made: Made) -> None:
    judged = made.evaluations["camera"]
    assert judged.heading is not None
    for name, values in (
        ("x", judged.deviation[:, 0]),
        ("y", judged.deviation[:, 1]),
        ("heading", np.degrees(judged.heading)),
    ):
        entity = made.entities[f"deviation/{name}/camera"]
        np.testing.assert_allclose(entity.array("Scalars:scalars")[:, 0], values, atol=1e-12)
        np.testing.assert_array_equal(
            entity.ns, made.loaded.drive.epoch_ns + np.rint(judged.t * 1e9).astype(np.int64)
        )
    bounds = made.entities["deviation/heading/camera/three_sigma"].array("Scalars:scalars")
    np.testing.assert_allclose(bounds[:, 0], np.degrees(3.0 * judged.sigma[:, 2]), atol=1e-12)
    np.testing.assert_array_equal(bounds[:, 0], -bounds[:, 1])


@pytest.mark.parametrize("configuration", ["lrf", "all", "lrf@2Hz"])
def test_segments_stand_where_the_pose_puts_them_in_their_verdict_s_colour(made: Made, configuration: str) -> None:
    e, m = made.estimates[configuration], made.loaded.drive.measurements["lrf"]
    audit = e.audits["lrf"]
    if "@" in configuration:
        m = m.take(np.flatnonzero(np.diff(np.floor(m.t * 2.0), prepend=-1.0) > 0))
    seen = {
        group: made.entities[f"world/{name_of(configuration)}/seen/lrf/{group}"].column("LineStrips2D:strips")
        for group in ("matched", "rejected", "new")
        if f"world/{name_of(configuration)}/seen/lrf/{group}" in made.entities
    }
    matched = np.isin(audit.verdict, (0, VERDICTS.index("repeated")))
    assert sum(map(len, seen["matched"])) == int(matched.sum())
    assert len(seen["matched"]) == len(m.t)  # one row a scan: what is no longer seen goes away
    assert sum(map(len, seen["new"])) == int((audit.verdict == VERDICTS.index("new")).sum())
    scan = len(m.t) // 2
    rows = [(k, r) for k, r, v in zip(audit.instant, audit.row, audit.verdict, strict=True) if v == 0]
    inside = [(k, r) for k, r in rows if m.first[scan] <= r < m.first[scan + 1]]
    for (instant, row), strip in zip(inside, seen["matched"][scan], strict=True):
        (r, psi), (lo, hi) = m.z[row], m.extra["ends"][row]
        x, y, theta = e.pose[instant]
        beta = psi + theta
        for point, along in zip(strip, (lo, hi), strict=True):
            assert point[0] == pytest.approx(x + r * math.cos(beta) - along * math.sin(beta), abs=1e-5)
            assert point[1] == pytest.approx(y + r * math.sin(beta) + along * math.cos(beta), abs=1e-5)


def test_the_bearing_ray_starts_at_the_camera_and_ends_near_the_landmark(made: Made) -> None:
    settings: Any = made.loaded.robot.settings("camera")
    e = made.estimates["all"]
    rays = made.entities["world/all/seen/camera/matched"].column("LineStrips2D:strips")
    landmark = np.array(settings.landmark)
    instants = made.loaded.drive.instant["camera"]
    for k, row in zip(instants, rays, strict=True):
        for start, end in row:
            x, y, theta = e.pose[k]
            assert start[0] == pytest.approx(x + settings.x * math.cos(theta), abs=1e-5)
            assert start[1] == pytest.approx(y + settings.x * math.sin(theta), abs=1e-5)
            assert np.hypot(*(np.array(end) - landmark)) < 0.3  # 2 degrees at 7 m


def test_nis_innovations_and_gates_are_the_audits(made: Made) -> None:
    e = made.estimates["all"]
    audit = e.audits["compass"]
    nis = made.entities["nis/compass/all"].array("Scalars:scalars")[:, 0]
    np.testing.assert_allclose(np.sort(nis), np.sort(audit.nis), rtol=1e-12)
    y = made.entities["innovation/compass/heading/all"].array("Scalars:scalars")[:, 0]
    np.testing.assert_allclose(y, np.degrees(audit.y[:, 0]), atol=1e-9)
    bound = made.entities["innovation/compass/heading/all/two_sigma"].array("Scalars:scalars")[:, 0]
    np.testing.assert_allclose(bound, np.degrees(2.0 * audit.sigma[:, 0]), atol=1e-9)
    (level,) = {v for (v,) in made.entities["nis/compass/limits/gate"].column("Scalars:scalars")}
    assert level == pytest.approx(float(audit.threshold[0]))
    (high,) = {v for (v,) in made.entities["nis/compass/limits/high"].column("Scalars:scalars")}
    assert high == pytest.approx(5.024, abs=1e-3)  # chi-square, 97.5 %, 1 degree of freedom
    states = [s for (s,) in made.entities["gate/compass/all"].column("StateChange:state")]
    assert all(a != b for a, b in itertools.pairwise(states))  # only changes
    worst = "accepted" if (audit.verdict == 0).all() else "rejected"
    assert worst in states


def test_walls_appear_when_they_are_first_matched_and_end_where_the_map_ends_them(made: Made) -> None:
    e = made.estimates["all"]
    refined = made.entities["world/all/walls/refined"]
    strips = {tuple(np.round(np.ravel(s), 4)) for (s,) in refined.column("LineStrips2D:strips")}
    assert len(strips) == len(e.final_map)
    for line in e.final_map:
        c, s = math.cos(line.beta), math.sin(line.beta)
        ends = [(line.rho * c - t * s, line.rho * s + t * c) for t in line.ends]
        assert any(np.allclose(np.ravel(ends), strip, atol=2e-4) for strip in strips)
    (first,) = made.entities["world/all/walls/first_scan"].column("LineStrips2D:strips")
    assert len(first) == len(e.first_map)
    assert refined.ns[0] < refined.ns[-1]  # the map grew


def test_pictures_pass_through_byte_for_byte_and_the_landmark_is_marked(made: Made) -> None:
    topic = made.loaded.choice.topics["camera"]
    with sample_logs.path(LOG).open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages([topic])
        messages = [bytes(message.data) for _, _, _, message in decoded]
    shown = made.entities["camera/omni"].column("EncodedImage:blob")
    assert [bytes(blob) for (blob,) in shown] == messages[::EVERY]
    assert {kind for (kind,) in made.entities["camera/omni"].column("EncodedImage:media_type")} == {"image/jpeg"}
    panoramas = made.entities["camera/panorama"].column("EncodedImage:blob")
    assert len(panoramas) == len(shown)
    settings: Any = made.loaded.robot.settings("camera")
    m = made.loaded.drive.measurements["camera"]
    rays = made.entities["camera/omni/found/matched"].column("LineStrips2D:strips")
    assert sum(map(len, rays)) > 0
    for i, found in enumerate(rays):
        for (x0, y0), (x1, y1) in found:
            angle = math.atan2(x1 - x0, y1 - y0)  # from straight down, counter-clockwise on the screen
            bearings = m.z[m.first[EVERY * i] : m.first[EVERY * i + 1], 0] - math.radians(settings.zero_deg)
            sign = -1.0 if settings.clockwise else 1.0
            assert np.abs(np.angle(np.exp(1j * (sign * bearings - angle)))).min() < 1e-4
            from_centre = math.hypot(x0 - settings.centre[0], y0 - settings.centre[1])
            assert from_centre == pytest.approx(settings.inner, abs=1e-3)


def test_scans_are_the_logs_ranges_in_the_frame_of_the_robot(made: Made) -> None:
    topic = made.loaded.choice.topics["lrf"]
    with sample_logs.path(LOG).open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages([topic])
        scans = [message for _, _, _, message in decoded]
    settings: Any = made.loaded.robot.settings("lrf")
    assert settings.yaw_deg == 0.0
    shown = made.entities["world/all/scan/points"].column("Points2D:positions")
    inside = made.loaded.drive.measurements["lrf"].t
    assert len(shown) == len(inside)
    scan, points = scans[len(scans) - len(shown)], np.array(shown[0])  # scans before the wheels are left out
    ranges = np.array(scan.ranges)
    seen = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    assert len(points) == int(seen.sum())
    offset = points - (settings.x, settings.y)
    np.testing.assert_allclose(np.hypot(*offset.T), ranges[seen], atol=1e-5)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(seen)
    np.testing.assert_allclose(np.arctan2(offset[:, 1], offset[:, 0]), angles, atol=1e-5)


def test_raw_topics_are_the_logs_numbers(made: Made) -> None:
    topic = made.loaded.choice.topics["compass"]
    with sample_logs.path(LOG).open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages([topic])
        field = [message.magnetic_field.x for _, _, _, message in decoded]
    shown = made.entities[f"raw{topic}/magnetic_field.x"].array("Scalars:scalars")[:, 0]
    np.testing.assert_array_equal(shown, field)
    assert "raw/joint_states/position.left_wheel_joint" in made.entities


def test_paths_grow_and_each_configuration_has_one_switch(made: Made) -> None:
    ranges = [p for p, e in made.layout.items() if "VisibleTimeRanges:ranges" in e.static]
    for configuration in made.estimates:
        assert any(f"/world/{name_of(configuration)}/path/" in p for p in ranges), configuration
    hidden = [
        p for p, e in made.layout.items() if [False] in e.static.get("EntityBehavior:visible", []) and "walls" in p
    ]
    assert not any("world/all/walls" in p for p in hidden)  # only the fullest configuration shows its map
    assert any("world/lrf/walls" in p for p in hidden)


def first(column: list[list[str]]) -> str:
    return column[0][0]
