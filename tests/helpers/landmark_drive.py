"""A drive among five landmarks by wheels that slip: what is seen of them, and the truth."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bags import T0, S, Said
from commands import reported
from pose_streams import reckoned
from wheel_bags import GEOMETRY, RADIUS, TRACK, angles, messages, turned

from locfuse.fusion import se2
from locfuse.fusion.data import Array

MAP = {6: (2.0, 1.5), 7: (-1.0, 2.0), 8: (1.0, -2.0), 9: (3.0, -1.0), 12: (-2.0, -1.0)}
TO_OPTICAL = np.array([-0.5, 0.5, -0.5, 0.5])  # x, y, z, w: z ahead, x right
TF = "tf2_msgs/msg/TFMessage"


def path_of(angle: Array) -> Array:
    """Poses (n, 3) of dead reckoning along chords: the truth of these logs."""
    rolled = np.diff(angle, axis=0) * RADIUS
    return reckoned(np.column_stack((rolled.mean(axis=1), rolled @ [-1, 1] / TRACK)))


def slipping(share: float = 0.05, seconds: float = 60.0) -> tuple[Array, Array, Array]:
    """Times (n,), angles (n, 2) of wheels that slip by a share of every turn, true poses (n, 3)."""
    t, angle = angles(seconds)
    slip = share * (angle[:, 1] - angle[:, 0]) / 2
    return t, angle + np.stack((-slip, slip), axis=-1), path_of(angle)


def truth_file(folder: Path, t: Array, true: Array) -> Path:
    rows = zip(t, true.tolist(), strict=True)
    text = "".join(f"{T0 // S + s:.9f},{x!r},{y!r},{th!r}\n" for s, (x, y, th) in rows)
    (folder / "truth.csv").write_text(f"t,x,y,theta\n{text}")
    return folder / "truth.csv"


def map_file(folder: Path, places: Any = MAP) -> Path:
    rows = "".join(f"{key},{x},{y}\n" for key, (x, y) in places.items())
    (folder / "landmarks.csv").write_text(f"id,x,y\n{rows}")
    return folder / "landmarks.csv"


def seen_by(
    true: Array, mount: Array, rng: np.random.Generator, noise: float
) -> Iterator[tuple[int, list[tuple[int, Array]]]]:
    """Every tenth instant, and (id, metres ahead, left and up) of the landmarks that a camera sees there."""
    for i in range(5, len(true), 10):
        eye, seen = se2.compose(true[i], mount), []
        for key, place in MAP.items():
            x, y, _ = se2.between(eye, np.array([*place, 0.0]))
            if x > 0.3 and abs(y) < 1.2 * x:
                seen.append((key, np.array([x, y, 0.2]) + noise * rng.standard_normal(3)))
        yield i, seen


def optical(frame: str, mount: Array) -> list[Said]:
    """/tf_static: an optical frame that looks along the yaw of its mount (x, y, yaw) on the base."""
    turn = turned(mount[2])
    z, w = turn["z"], turn["w"]
    a, b = TO_OPTICAL[:3], TO_OPTICAL[3]
    v = np.cross([0.0, 0.0, z], a) + w * a + b * np.array([0.0, 0.0, z])
    rotation = dict(zip("xyzw", [*v.tolist(), float(w * b - z * a[2])], strict=True))
    place = {"x": float(mount[0]), "y": float(mount[1]), "z": 0.3}
    edge = {"header": {"frame_id": "base_link"}, "child_frame_id": frame}
    edge |= {"transform": {"translation": place, "rotation": rotation}}
    return messages("/tf_static", TF, np.zeros(1), [{"transforms": [edge]}])


def sets(*pairs: str) -> tuple[str, ...]:
    return tuple(word for pair in pairs for word in ("--set", pair))


def compared(log: Path, truth: Path, *words: Any, code: int = 0) -> tuple[dict[str, Any], str]:
    """The configurations that `compare` reports, and what it says on the way."""
    given = ("--no-advice", "-v", "--write", "json,html", "--truth", truth)
    done = reported("compare", log, *GEOMETRY, *given, *words, code=code)
    return done.rows, " ".join(done.stderr.split())
