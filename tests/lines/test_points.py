"""Points of chosen scans: read from the log again, but not again for scans that lie beside the last ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scan_streams import SCAN, scan_stream

from locfuse.formats.columns import take
from locfuse.fusion.data import ArrayStream, Block
from locfuse.fusion.lines.points import ScanPoints
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings, laser_of
from locfuse.fusion.wheels.scan_clouds import STANDING

SCANS, PER_BLOCK, BEAMS = 12, 4, 8
RANGES = np.repeat(1.0 + np.arange(SCANS)[:, None] / 2.0, BEAMS, axis=1)  # m: another one in each scan


class Blocks:
    """A stream of scans, a few in each block; it counts the blocks that were read."""

    def __init__(self, whole: ArrayStream) -> None:
        self.whole, self.read = whole, 0

    def blocks(self, *fields: str, rows: int) -> Iterator[Block]:
        for at in np.split(np.arange(SCANS), range(PER_BLOCK, SCANS, PER_BLOCK)):
            self.read += 1
            yield at, {name: take(column, at) for name, column in self.whole.columns(*fields).items()}


def test_scans_beside_the_last_ones_are_not_read_again() -> None:
    stream = Blocks(scan_stream(range(SCANS), RANGES))
    points = ScanPoints(
        stream,  # type: ignore[arg-type]  # only its blocks are read
        Lrf.reads[SCAN],
        np.zeros(SCANS),
        laser_of(LrfSettings()),
        STANDING,
        np.arange(SCANS),
    )
    # readings, and how many blocks are read by then: beside the last ones, over the end of a block, before it
    for readings, read in (([9, 10], 3), ([10, 11], 3), ([8, 9], 3), ([7, 8], 5), ([1, 0], 6), ([2, 3], 6)):
        found = points.read(np.array(readings))
        for reading, seen in zip(readings, found, strict=True):
            assert len(seen) == BEAMS
            np.testing.assert_allclose(np.hypot(*seen.T), RANGES[reading], rtol=1e-12)
        assert stream.read == read, readings
    assert points.take(np.array([3])).read(np.array([0]))[0].shape == (BEAMS, 2)
    assert stream.read == 6
