"""Long drives stay light, `full` leaves nothing out, and no scene is too poor to be drawn."""

import math
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from recordings import read, read_blueprint
from small_drive import drive as small_drive, robot as small_robot

from locfuse.cli.rerun.scene import palette as shades
from locfuse.formats.figures import palette
from locfuse.formats.figures.palette import Trace
from locfuse.formats.geometry import ellipses, extremes, segments, wall_band, walls
from locfuse.formats.rerun import drawing as style
from locfuse.formats.rerun.blueprint import ticked
from locfuse.formats.rerun.drawing import STATES, reading_states, thinned_states
from locfuse.formats.rerun.recording import save_recording
from locfuse.formats.rerun.scene import REJECTED, RawTopic, RerunScene, SensorLook
from locfuse.fusion.data import (
    VERDICTS,
    Array,
    Audit,
    Component,
    Drive,
    Estimates,
    MapLine,
    Measurements,
    Motions,
    evenly,
    upper_triangles,
)
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.sensors.registry import colours

N = 30_000
SIGHTS: Mapping[str, SensorLook] = {
    "compass": SensorLook((Component("heading", "deg", 57.3),), (0.001, 5.02), "heading"),
    "lrf": SensorLook((Component("r", "m"), Component("psi", "deg", 57.3)), (0.05, 7.38), "segments"),
}


def long_scene(epoch_ns: int = 1_700_000_000_000_000_000) -> RerunScene:
    """A compass that speaks 30 000 times on a long spiral."""
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 0.1 * (N - 1), N)
    turn = t * 0.01
    pose = np.column_stack((turn * np.cos(turn), turn * np.sin(turn), turn))
    heading = Measurements(t, np.arange(N + 1), pose[:, 2:], np.ones((N, 1, 1)), 0.02, np.zeros((1, 1)))
    still = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    drive = Drive(epoch_ns, t, still, {"compass": heading}, {"compass": np.arange(N)}, {})
    y = rng.normal(size=(N, 1))
    rows = np.arange(N)
    verdict = np.zeros(N, np.int8)
    audit = Audit(rows, rows, verdict, np.full(N, -1), y[:, 0] ** 2, np.full(N, 10.8), y, np.ones((N, 1)))
    triangles = np.broadcast_to(upper_triangles(np.diag([1e-4, 4e-4, 1e-4])), (N, 6))
    estimates = Estimates("compass", ("compass",), t, pose, triangles, {"compass": audit})
    raw = [RawTopic("/imu/heading", t, {"data": pose[:, 2]})]
    return RerunScene("long", drive, [estimates], {}, SIGHTS, raw=raw)


def test_a_long_drive_is_thinned_and_full_keeps_everything(tmp_path: Path) -> None:
    scene = long_scene()
    save_recording(tmp_path / "light.rrd", scene)
    light = read(tmp_path / "light.rrd")
    rows = {path: len(e.ns) for path, e in light.items() if e.parts}
    assert max(rows.values()) <= 4000
    assert rows["world/compass/pose"] == 4000
    assert rows["world/compass/seen/compass/matched"] == 2000
    assert rows["nis/compass/compass"] > 3500
    save_recording(tmp_path / "full.rrd", replace(scene, full=True))
    full = read(tmp_path / "full.rrd")
    for path in ("world/compass/pose", "nis/compass/compass", "raw/imu/heading/data"):
        assert len(full[path].ns) == N
    assert len(full["world/compass/seen/compass/matched"].ns) == N
    assert (tmp_path / "light.rrd").stat().st_size < 0.25 * (tmp_path / "full.rrd").stat().st_size
    high = max(light["nis/compass/compass"].array("Scalars:scalars"))
    assert high == max(full["nis/compass/compass"].array("Scalars:scalars"))  # the worst one survives


def test_a_clock_that_counts_from_the_robots_start_is_shown_as_a_duration(tmp_path: Path) -> None:
    save_recording(tmp_path / "boot.rrd", long_scene(epoch_ns=5_000_000_000))
    pose = read(tmp_path / "boot.rrd")["world/compass/pose"]
    assert str(pose.parts[0].column("log time").type) == "duration[ns]"
    assert pose.ns[0] == 5_000_000_000


def test_a_drive_without_truth_and_without_sensors_is_drawn(tmp_path: Path) -> None:
    robot = small_robot()
    drive = small_drive(1, robot, sensors=(), laps=0.1, truth=False)
    estimates = fuse(drive, robot, [])
    save_recording(
        tmp_path / "poor.rrd", RerunScene("poor", drive, [estimates], {"odometry": evaluate(estimates, drive)})
    )
    entities = read(tmp_path / "poor.rrd")
    assert {"world/odometry/pose", "world/odometry/path", "world/odometry/sigma"} <= set(entities)
    assert not any(path.startswith(("deviation", "nis", "gate", "camera")) for path in entities)
    views = [e for e in read_blueprint(tmp_path / "poor.rrd").values() if "ViewBlueprint:display_name" in e.static]
    assert [e.static["ViewBlueprint:display_name"] for e in views] == [[["Map"]]]


def test_names_that_are_grammar_to_rerun_are_drawn(tmp_path: Path) -> None:
    robot = small_robot()
    drive = small_drive(1, robot, laps=0.1)
    estimates = [fuse(drive, robot, ["compass", "lrf"], name) for name in ("compass+lrf", "lrf@2Hz", "ä b")]
    raw = [RawTopic("/a b/[x]", drive.t, {"field.0": drive.t})]
    save_recording(tmp_path / "odd.rrd", RerunScene("a/b: c", drive, estimates, {}, SIGHTS, raw=raw))
    entities = read(tmp_path / "odd.rrd")
    assert {"world/compass\\+lrf/path", "world/lrf\\@2Hz/path", "world/ä\\ b/path"} <= set(entities)
    assert "raw/a\\ b/\\[x\\]/field.0" in entities


def audit_of(rows: list[int], verdicts: list[str]) -> Audit:
    k = len(rows)
    codes = np.array([VERDICTS.index(v) for v in verdicts], np.int8)
    nothing = np.full(k, np.nan)
    return Audit(
        np.zeros(k, int),
        np.array(rows),
        codes,
        np.zeros(k, int),
        nothing,
        nothing,
        np.zeros((k, 2)),
        np.zeros((k, 2)),
    )


def test_a_reading_is_as_good_as_what_became_of_its_parts() -> None:
    m = Measurements(
        np.arange(5.0), np.array([0, 2, 4, 5, 5, 6]), np.zeros((6, 2)), np.zeros((6, 2, 2)), 1.0, np.eye(2)
    )
    audit = audit_of(range(6), ["accepted", "accepted", "accepted", "gate", "ambiguous", "new"])  # type: ignore[arg-type]
    names = list(STATES)
    assert [names[c] for c in reading_states(m, audit)] == ["accepted", "partly", "rejected", "unusable", "new"]


def test_a_stretch_of_states_that_is_drawn_as_one_shows_its_worst() -> None:
    names = list(STATES)
    code = np.tile([names.index("accepted"), names.index("new")], 5000)
    code[7321] = names.index("rejected")
    reading, codes = thinned_states(code, 100)
    assert len(codes) == 100
    assert [names[c] for c in codes].count("rejected") == 1
    at = int(np.flatnonzero(codes == names.index("rejected"))[0])
    assert reading[at] <= 7321 < reading[at + 1]
    assert len(thinned_states(np.zeros(10_000, int), 100)[1]) == 10_000  # no change, nothing to thin


# --- thinning keeps what one looks for; geometry is held to closed forms and to se2


def test_thinning_keeps_spikes_and_short_curves_and_no_gap_is_an_extreme() -> None:
    values = np.sin(np.arange(200_000) / 5000.0)
    values[123_457], values[77_771] = 50.0, -50.0
    picks = extremes(values, 4000)
    assert len(picks) <= 4000
    assert {0, 77_771, 123_457, 199_999} <= set(picks.tolist())
    assert (np.diff(picks) > 0).all()
    assert extremes(np.zeros(4000), 4000).tolist() == list(range(4000))
    assert extremes(np.zeros(0), 4000).tolist() == []
    values = np.arange(50_000, dtype=float)
    values[100:40_000] = np.nan
    picks = extremes(values, 1000)
    assert np.isnan(values[picks]).sum() <= 1000 * 0.9  # a bucket of nothing but gaps still says so
    assert {49_999, 99, 40_000} <= set(picks.tolist())


@pytest.mark.parametrize("n", [4001, 4003, 7999, 8001, 36_000])
@pytest.mark.parametrize("curves", [1, 2])
def test_thinning_never_exceeds_the_limit_and_brackets_every_curve(n: int, curves: int) -> None:
    values = np.random.default_rng(n).normal(size=(n, curves)).cumsum(axis=0)
    picks = extremes(values, 4000)
    assert len(picks) <= 4000
    for curve in values.T:
        assert {int(curve.argmin()), int(curve.argmax())} <= set(picks.tolist())


def test_scans_are_picked_evenly_with_both_ends() -> None:
    picks = evenly(36_000, 2000)
    assert len(picks) == 2000
    assert picks[0] == 0
    assert picks[-1] == 35_999
    assert np.diff(picks).max() <= 19
    assert evenly(7, 2000).tolist() == list(range(7))
    assert evenly(0, 2000).tolist() == []


def test_ellipses_are_three_sigma_of_the_covariance() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(50, 2, 2))
    P = np.zeros((50, 3, 3))
    P[:, :2, :2] = A @ A.transpose(0, 2, 1)
    axes, angle = ellipses(P)
    for p, (a, b), turn in zip(P[:, :2, :2], axes, angle, strict=True):
        ahead, left = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
        for length, direction in ((a, ahead), (b, left)):
            tip = length * direction
            assert tip @ np.linalg.solve(p, tip) == pytest.approx(9.0, rel=1e-6)


def test_a_certain_position_is_a_point_and_a_line_lies_where_its_normal_form_says() -> None:
    axes, _ = ellipses(np.zeros((1, 3, 3)))
    assert axes.tolist() == [[0.0, 0.0]]
    ((a, b),) = segments(np.array([[2.0, math.pi / 2]]), np.array([[-1.0, 3.0]]))
    np.testing.assert_allclose([a, b], [[1.0, 2.0], [-3.0, 2.0]], atol=1e-12)


def test_the_band_of_a_wall_is_three_sigma_of_its_offset_there() -> None:
    P = np.array([[4e-4, -3e-5], [-3e-5, 1e-5]])
    line = MapLine(0, 3.0, 0.4, (-2.0, 5.0), P)
    band = wall_band(line)
    assert band[0].tolist() == band[-1].tolist()
    ((start, end),), n = walls([line]), np.array([math.cos(0.4), math.sin(0.4)])
    draws = np.random.default_rng(2).multivariate_normal((3.0, 0.4), P, 200_000)
    for point, offset in ((start, band[0]), (end, band[8])):
        # where the drawn wall crosses the normal through the point
        rho, beta = draws.T
        off = (rho - point @ np.stack((np.cos(beta), np.sin(beta)))) / np.cos(beta - 0.4)
        assert (offset - point) @ n == pytest.approx(3.0 * off.std(), rel=0.01)


# --- a colour on the map means one thing


APART = 20.0  # in CIELAB, where 2.3 is just noticeable


def lab(rgb: tuple[int, ...]) -> Array:
    """CIE 1976 L*a*b* under D65."""
    c = np.array(rgb[:3]) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ linear / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def web(colour: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(colour.removeprefix("#")))


def test_nothing_on_the_map_shares_a_colour_with_anything_else() -> None:
    sensors = {name: web(c.dark) for name, c in colours().items()}
    runs = {"odometry": web(palette.ODOMETRY.dark), "all": web(palette.ALL.dark)}
    things = {
        "landmark": style.LANDMARK,
        "wall": style.WALL,
        "wall at first sight": style.FIRST_WALL,
        "scan": style.SCAN,
        "loop closed": style.LOOP,
        **style.GROUPS,
    }
    labs = {name: lab(rgb) for name, rgb in {**sensors, **runs, **things}.items()}
    near = [(a, b) for a, b in combinations(labs, 2) if np.linalg.norm(labs[a] - labs[b]) < APART]
    assert near == []


def test_a_smoothed_result_has_a_shade_of_its_own() -> None:
    for sensors in (("lrf",), ("compass", "lrf", "camera")):
        name = "lrf" if len(sensors) == 1 else "all"
        drawn = shades({name: Trace(name, sensors), f"{name}-smoothed": Trace(name, sensors, smoothed=True)})
        plain, smoothed = (lab(rgb) for rgb in drawn.values())
        assert np.linalg.norm(plain - smoothed) > 20.0
        assert smoothed[0] < plain[0], "darker"


def test_red_is_what_was_refused_and_nothing_else() -> None:
    refused = lab(style.GROUPS[REJECTED])
    others = [style.TRUTH, style.LANDMARK, style.LIMIT, style.LEVEL, *style.FIELD_COLOURS]
    assert all(np.linalg.norm(lab(rgb) - refused) > 2.0 * APART for rgb in others)


@pytest.mark.parametrize(
    ("low", "high"), [(-0.73, 0.12), (-0.05, 0.75), (0.0, 3.0), (-0.4, 0.4), (3.2, 3.9), (-12.0, 17.0), (5.0, 5.0)]
)
def test_a_plot_of_deviations_has_two_labelled_ticks_with_room(low: float, high: float) -> None:
    """The viewer labels multiples of a power of ten, where at most seven fit into the plot."""
    below, above = ticked(low, high)
    assert below <= low <= high <= above
    steps = [10.0**p for p in range(-12, 4) if (above - below) / 10.0**p <= 7.0]
    assert any(np.floor(above / s) - np.ceil(below / s) >= 1 for s in steps)
    assert above - below <= 20.0 * max(high - low, 1e-9)
