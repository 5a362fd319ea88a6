"""Description of a building: spaces cut out of a solid block, doorways, glass, furniture, walking people.

The block is `room.size` and its outer walls. Spaces are given by the centre lines of their walls; all walls have
the same thickness. `office.toml` and `hall.toml` are examples.
"""

from __future__ import annotations

from typing import Literal

from .table import Point, Positive, ScenarioTable, Segment, Share

Side = Literal["south", "east", "north", "west"]


class Opening(ScenarioTable, frozen=True, kw_only=True):
    """Opening in one wall of a space: a door, a niche, or glass."""

    side: Side
    at: float  # m, middle of the opening: x in a south or north wall, y in an east or west wall
    width: Positive = 1.0  # m
    kind: Literal["door", "closed", "glass"] = "door"  # closed: a niche in the outer half of the wall
    leaf_deg: float = 0.0  # opening angle of the door leaf, into the space; 0: no leaf


class Box(ScenarioTable, frozen=True, tag_field="kind", tag="box"):
    """Solid box on the floor, such as a cabinet, a sofa or a pillar."""

    at: Point  # m, its middle
    size: Point  # m, along x and y before it is turned
    turn_deg: float = 0.0
    height: Positive = 1.8  # m


class LeggedTable(ScenarioTable, frozen=True, tag_field="kind", tag="table"):
    """Table or chair with four thin round legs; its top is above the laser."""

    at: Point
    size: Point
    turn_deg: float = 0.0
    height: Positive = 0.72
    leg: Positive = 0.025  # m, radius of a leg


class SwivelChair(ScenarioTable, frozen=True, tag_field="kind", tag="chair"):
    """Office chair, one thin column at the height of the laser."""

    at: Point
    radius: Positive = 0.035
    height: Positive = 0.45


Furniture = Box | LeggedTable | SwivelChair


class Space(ScenarioTable, frozen=True, kw_only=True):
    """Corridor or room; overlapping spaces are one space without a wall between them."""

    name: str
    area: Segment  # m: west, south, east, north, on the centre lines of the walls
    openings: tuple[Opening, ...] = ()
    furniture: tuple[Furniture, ...] = ()


class Glass(ScenarioTable, frozen=True, kw_only=True):
    """Reflection of laser beams by panes: only near normal incidence, else the beam passes through."""

    within_deg: float = 8.0  # largest angle to the normal with an echo
    returns: Share = 0.8  # probability of an echo within this angle
    post_every: Positive = 1.5  # m, largest distance of the posts that hold the panes
    post: Positive = 0.06  # m, thickness of a post


class Walker(ScenarioTable, frozen=True, kw_only=True):
    """Person who walks along a path and back during the whole drive, and steps aside for the robot."""

    path: tuple[Point, ...]
    speed: Positive = 1.1  # m/s; the seed changes it by up to 20 %
    pause: float = 20.0  # s at both ends; the seed changes it by up to 50 %

    def __post_init__(self) -> None:
        if len(self.path) < 2:
            raise ValueError("a walker needs at least two points in its `path`")


class Building(ScenarioTable, frozen=True, kw_only=True):
    """Building that replaces the walls and plates of a `room`."""

    spaces: tuple[Space, ...]
    wall: Positive = 0.15  # m, thickness of every wall
    bow: float = 0.02  # m, largest deviation of a wall from its straight line
    screens: tuple[Segment, ...] = ()  # thin straight walls, in any direction
    glass: Glass = Glass()
    people: tuple[Walker, ...] = ()
    seed: int | None = None  # seed of the wall shapes and the walks; None: the seed of the drive
