"""Which figures a report has: trajectories, deviations, consistency, innovations, gates, what was learnt."""

from __future__ import annotations

from .panels import Section
from .scene import Scene


def sections(scene: Scene) -> list[Section]:
    """Return the figures of a report in reading order; a section that has nothing to show is left out."""
    from .deviation import bands, deviations, uncertainty
    from .filter import consistency, gates, innovations, learnt
    from .trajectories import trajectories

    found = [trajectories(scene)]
    found += [deviations(scene), bands(scene)] if scene.has_truth else [uncertainty(scene)]
    found += [consistency(scene), innovations(scene), gates(scene), learnt(scene)]
    return [s for s in found if s.panels]
