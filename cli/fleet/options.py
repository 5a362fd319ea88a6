"""What the user chose for many logs."""

from __future__ import annotations

import msgspec


class FleetOptions(msgspec.Struct, frozen=True):
    """What is asked of many logs beyond a single one."""

    jobs: int
    max_failures: int | None
    again: bool
    each: tuple[str, ...]
    robot_from: str | None
    sweep: tuple[str, ...]
    cluster: str | None = None

    @property
    def asked(self) -> bool:
        """Whether even a single log is treated as one of many."""
        return bool(self.each or self.robot_from or self.sweep or self.again or self.cluster)
