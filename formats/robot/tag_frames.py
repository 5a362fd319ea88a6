"""Tags that /tf publishes as one transform camera -> tag per detection: names, ids, axes of the camera."""

from __future__ import annotations

import re

import numpy as np

from locfuse.fusion.data import Array

from .transforms import StaticTransforms

TAGS = "locfuse/msg/TagFrames"  # id, x, y, z [m] in the camera's optical axes (REP 103: x right, y down, z ahead)
OF_CAMERA = "tags"  # the last part of "/tf:camera_optical:tags"
NUMBERED = re.compile(r"^(.*?)(\d+)$", re.DOTALL)
MAX_ID = 2**62
TAG_NAME = re.compile(
    r"tags?(?![a-z])|marker|aruco|april|fiducial|landmark|beacon|\d+h\d+"
)  # does not match "stage"
MIN_UPRIGHT_SHARE = 0.7  # vertical component of a frame's z axis, above which its z axis is up as in a body frame


def number_of(frame: str) -> int | None:
    """Return the number at the end of a frame's name ("tag_3", "tag36h11:5"); None without one."""
    match = NUMBERED.match(frame)
    return int(match[2][-18:]) % MAX_ID if match else None


def named_as_tag(frame: str) -> bool:
    """Return whether a frame's name is that of a tag with a number."""
    name = frame.rpartition("/")[2].lower()
    return number_of(name) is not None and TAG_NAME.search(name) is not None


def ancestors(transforms: StaticTransforms, frame: str) -> list[tuple[str, Array]]:
    """Return (ancestor, pose (4, 4) of the frame in this ancestor) for all ancestors of a frame, nearest first."""
    above = {edge.child: edge for edge in transforms.edges}
    found: list[tuple[str, Array]] = []
    T = np.eye(4)
    while frame in above and len(found) < len(above):  # also ends in a loop of frames
        edge = above[frame]
        T, frame = edge.T_parent_child @ T, edge.parent
        found.append((frame, T))
    return found


def in_optical_axes(p: Array, frame: str, transforms: StaticTransforms) -> Array:
    """Return positions (n, 3) [m] in a camera's frame as positions in optical axes (x right, y down, z ahead).

    The frame counts as optical if its name has "optical", else if its z axis is not upright in its root frame.
    Without a root: if more positions are ahead along z than along x.
    """
    above = ancestors(transforms, frame)
    if "optical" in frame.lower():
        optical = True
    elif above:
        optical = abs(float(above[-1][1][2, 2])) < MIN_UPRIGHT_SHARE
    else:
        optical = bool((p[:, 2] > 0.0).mean() > (p[:, 0] > 0.0).mean()) if len(p) else True
    return p if optical else np.stack((-p[:, 1], -p[:, 2], p[:, 0]), axis=-1)
