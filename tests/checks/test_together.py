"""Numbers of several logs pooled: who agrees, who disagrees, which clock is off, and what helps all of them."""

import math

import numpy as np
import pytest
from msgspec.structs import replace
from small_drive import TRACK, drive, robot as robot_of

from locfuse.fusion.checks.together import LogEstimates, Look, Number, asked, clocks_of, common, commons, shown
from locfuse.fusion.checks.tried import Fixes, Marks
from locfuse.fusion.robot import WheelSettings

LOGS = ("a", "b", "c", "d", "e", "f")


def numbers(values: list[float], sigma: float, now: float = 0.0) -> dict[str, Number]:
    return {log: Number(value, sigma, now) for log, value in zip(LOGS, values, strict=False)}


def test_logs_that_agree_within_their_sigmas_give_the_weighted_mean_and_its_sigma() -> None:
    found = common("wheels.track", {"a": Number(0.60, 0.001, 0.6), "b": Number(0.601, 0.002, 0.6)})
    # inverse variances: 1e6 and 0.25e6
    assert found.value == pytest.approx((0.60 * 4 + 0.601) / 5)
    assert found.sigma == pytest.approx(1.25e6**-0.5)
    assert not found.apart
    assert not found.off


def test_the_sigma_of_the_mean_holds_what_logs_scatter_beyond_their_own_sigmas() -> None:
    """200 robots with six logs each, whose lags scatter by 8 ms at claimed sigmas of 1 ms."""
    rng = np.random.default_rng(1)
    z = []
    for _ in range(200):
        each = (0.17 + 0.008 * rng.standard_normal(6) + 0.001 * rng.standard_normal(6)).tolist()
        found = common("gyro.time_offset", numbers(each, 0.001))
        assert found.value is not None
        z.append((found.value - 0.17) / found.sigma)
    assert 0.8 < math.sqrt(float(np.square(z).mean())) < 1.4


def test_one_log_of_six_that_disagrees_is_named_with_its_sigmas_and_does_not_move_the_value() -> None:
    found = common("lrf.time_offset", numbers([0.17, 0.16, 0.19, 0.17, 0.18, 0.31], 0.004))
    assert found.value == pytest.approx(0.174, abs=0.005)
    assert list(found.apart) == ["f"]
    assert found.apart["f"] > 5.0
    assert found.words.startswith("lrf.time_offset = 0.174 s in 5 logs (0.160 to 0.190;")
    assert "f disagrees: 0.310 s" in found.words


@pytest.mark.parametrize("values", [[0.10, 0.13], [0.10, 0.10, 0.10, 0.13, 0.13, 0.13], [0.1, 0.13, 0.16]])
def test_logs_between_which_a_mount_moved_have_no_common_value(values: list[float]) -> None:
    found = common("lrf.x", numbers(values, 0.001))
    assert found.value is None
    assert not found.off
    assert "differs between the logs, so there is no common value: a 0.100 m, b " in found.words


def test_logs_that_are_configured_differently_are_not_of_one_robot() -> None:
    assert not commons({log: {"wheels.track": Number(0.3, 0.001, now)} for log, now in (("a", 0.3), ("b", 0.287))})


def test_a_small_lag_that_no_log_shows_alone_is_shown_by_nine_together() -> None:
    one = LogEstimates(lags={"lrf wheels.time_offset": Number(0.03, 0.01)}, clocks={"lrf": 0.0, "wheels": 0.0})
    logs = {str(i): one for i in range(9)}
    assert not clocks_of({"0": logs["0"], "1": LogEstimates()})
    ((clock,), (rival,)) = clocks_of(logs)
    assert (clock.key, rival.key) == ("lrf.time_offset", "wheels.time_offset")
    assert (clock.value, rival.value) == pytest.approx((0.03, -0.03))


def test_a_truth_that_is_late_by_another_time_in_each_log_does_not_hide_the_lag_of_a_sensor() -> None:
    """The skid-steer robot: gyro 0.18 s ahead of the wheels, truth 0.3 to 0.6 s behind the gyro."""
    logs = {}
    for log, truth in zip(LOGS, (0.30, 0.42, 0.51, 0.60, 0.37, 0.33), strict=True):
        lags = {
            "gyro wheels.time_offset": Number(0.18, 0.01),
            "gyro truth.time_offset": Number(truth, 0.01),
            "truth wheels.time_offset": Number(0.18 - truth, 0.01),
        }
        logs[log] = LogEstimates(lags=lags, clocks=dict.fromkeys(("gyro", "wheels", "truth"), 0.0))
    (first, second) = clocks_of(logs)
    assert [c.key for c in first] == ["gyro.time_offset"]
    assert first[0].value == pytest.approx(0.18)
    assert [c.key for c in second] == ["wheels.time_offset"]


# --- settings tried on all logs; a robot whose errors are known in closed form


def robot(tracks: dict[str, float], now: float = 0.6, broken: str = "") -> dict[str, object]:
    """Return first numbers of logs whose error [m] is 0.01 + |track - true| / 10, and how to look at them."""
    first = {log: LogEstimates({"wheels.track": Number(track, 0.001, now)}) for log, track in tracks.items()}

    def look(sets: object) -> dict[str, dict[Fixes, Look]]:
        found: dict[str, dict[Fixes, Look]] = {}
        for log, track in tracks.items():
            for fixes in sets:  # type: ignore[attr-defined]
                at = float(dict(f.split("=") for f in fixes).get("wheels.track", now))
                error = 0.01 + abs(at - track) / 10 + (0.02 if log == broken and fixes else 0.0)
                marks = {"odometry": Marks(5.0 * error, 1.0, (0.5, 2.0)), "all": Marks(error, 1.0, (0.5, 2.0))}
                shown = LogEstimates({"wheels.track": Number(track, 0.001, at)})
                found.setdefault(log, {})[fixes] = Look(shown, {"odometry": (), "all": ("lrf",)}, marks)
        return found

    return {"first": first, "look": look}


def test_a_common_setting_that_helps_every_log_is_one_fix_with_the_figures_of_each() -> None:
    found = asked(**robot({"a": 0.700, "b": 0.702, "c": 0.698}))  # type: ignore[arg-type]
    assert found.fix is not None
    assert found.fix.fixes == ("wheels.track=0.7",)
    assert list(found.fix.pairs) == ["a", "b", "c"]
    assert [marks.position for marks in found.fix.pairs["a"]] == pytest.approx([0.1, 0.05])


def test_a_log_that_loses_is_named_and_one_that_disagrees_has_no_vote() -> None:
    found = asked(**robot({"a": 0.700, "b": 0.702, "c": 0.698}, broken="c"))  # type: ignore[arg-type]
    assert found.fix is None
    assert [step.losers for step in found.refused] == [("c",)]
    found = asked(**robot({"a": 0.70, "b": 0.70, "c": 0.70, "d": 0.50}))  # type: ignore[arg-type]
    assert found.fix is not None
    assert found.fix.fixes == ("wheels.track=0.7",)
    assert found.fix.pairs["d"][1].position > found.fix.pairs["d"][0].position  # type: ignore[operator]


def test_two_robots_and_logs_without_a_number_get_no_common_setting() -> None:
    found = asked(**robot({"a": 0.7, "b": 0.5}))  # type: ignore[arg-type]
    assert found.fix is None
    assert not found.refused
    assert "no common value" in found.common[0].words
    found = asked({"a": LogEstimates(), "b": LogEstimates()}, lambda sets: pytest.fail("nothing to try"))
    assert found.common == ()
    assert found.fix is None


def test_the_factors_of_an_odometry_are_estimated_by_a_truth() -> None:
    one = drive(5, robot_of(), ("compass",), laps=2.0)
    longer = replace(one, wheels=one.wheels.rerolled(1.1 * one.wheels.rolled, 1.1 * 1.05 * TRACK))
    found = shown(longer, replace(robot_of(), wheels=WheelSettings())).settings
    assert found["wheels.scale"].value == pytest.approx(1.0 / 1.1, rel=0.01)
    assert found["wheels.turn_scale"].value == pytest.approx(1.05, rel=0.02)
    assert {"wheels.radius", "wheels.track"}.isdisjoint(found)
