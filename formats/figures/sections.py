"""The list of a report's figures in reading order."""

from __future__ import annotations

from msgspec.structs import replace

from .panels import TIME, Scene, Section


def sections(scene: Scene) -> list[Section]:
    """Return the figures of a report in reading order, without empty sections."""
    from .deviation import bands, credit, deviations, spread, uncertainty
    from .filter import consistency, gates, innovations, learnt
    from .where import trajectories, where

    found = [trajectories(scene), where(scene)]
    found += [deviations(scene), spread(scene), bands(scene)] if scene.has_truth else [uncertainty(scene)]
    found += [consistency(scene), innovations(scene), gates(scene), learnt(scene), credit(scene)]
    events = tuple(scene.events)  # on every time axis
    panels = ([replace(p, events=events) if p.x_label == TIME else p for p in s.panels] for s in found)
    return [replace(s, panels=tuple(own)) for s, own in zip(found, panels, strict=True) if own]
