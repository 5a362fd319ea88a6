"""A building as data: spaces hollowed out of a solid block, doorways, glass, furniture, people who walk.

The block is `room.size` and its outer walls. Every space is given on the centre lines of its walls, so neighbours
share a number; all walls have the same thickness. `office.toml` and `hall.toml` are examples.
"""

from __future__ import annotations

from typing import Literal

from .table import Point, Positive, Segment, Share, Table

Side = Literal["south", "east", "north", "west"]


class Opening(Table, frozen=True, kw_only=True):
    """A hole in one wall of a space, as deep as the wall."""

    side: Side
    at: float  # m, of its middle: x in a south or north wall, y in an east or west wall
    width: Positive = 1.0  # m
    kind: Literal["door", "closed", "glass"] = "door"  # closed: a niche that is seen from outside the space
    leaf_deg: float = 0.0  # how far the door's leaf stands open, into the space; 0: there is no leaf


class Box(Table, frozen=True, tag_field="kind", tag="box"):
    """A cabinet, a sofa, a pillar with corners: a solid box on the floor."""

    at: Point  # m, its middle
    size: Point  # m, along x and y before it is turned
    turn_deg: float = 0.0
    height: Positive = 1.8  # m


class LeggedTable(Table, frozen=True, tag_field="kind", tag="table"):
    """A table or a chair: four thin round legs under a top above the laser."""

    at: Point
    size: Point
    turn_deg: float = 0.0
    height: Positive = 0.72
    leg: Positive = 0.025  # m, radius of a leg


class SwivelChair(Table, frozen=True, tag_field="kind", tag="chair"):
    """An office chair: at the height of the laser it is one thin column."""

    at: Point
    radius: Positive = 0.035
    height: Positive = 0.45


Furniture = Box | LeggedTable | SwivelChair


class Space(Table, frozen=True, kw_only=True):
    """A corridor or a room. Spaces that overlap are one space with no wall between."""

    name: str
    area: Segment  # m: west, south, east, north, on the centre lines of the walls
    openings: tuple[Opening, ...] = ()
    furniture: tuple[Furniture, ...] = ()


class Glass(Table, frozen=True, kw_only=True):
    """The reflection of a laser beam at a pane: it returns near normal incidence, else it passes through."""

    within_deg: float = 8.0  # from the normal
    returns: Share = 0.8  # probability of an echo there
    post_every: Positive = 1.5  # m, at most, between the posts that hold the panes
    post: Positive = 0.06  # m, thickness of a post


class Walker(Table, frozen=True, kw_only=True):
    """A person who walks along a path and back for the whole drive, and steps aside for the robot."""

    path: tuple[Point, ...]
    speed: Positive = 1.1  # m/s; the seed changes it by up to 20 %
    pause: float = 20.0  # s at both ends; the seed changes it by up to 50 %

    def __post_init__(self) -> None:
        if len(self.path) < 2:
            raise ValueError("a walker needs at least two points in its `path`")


class Building(Table, frozen=True, kw_only=True):
    """A whole building, instead of the walls and plates of a `room`."""

    spaces: tuple[Space, ...]
    wall: Positive = 0.15  # m, thickness of every wall
    bow: float = 0.02  # m: walls deviate from straight lines by up to this
    screens: tuple[Segment, ...] = ()  # thin straight walls, in any direction
    glass: Glass = Glass()
    people: tuple[Walker, ...] = ()
    seed: int | None = None  # of the walls' shapes and of the walks; None: the seed of the drive
