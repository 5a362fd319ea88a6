"""Losses of a log: places that cannot be read, each with reason, number of bytes and, if known, of messages."""

from __future__ import annotations

import msgspec
from msgspec import field
from msgspec.structs import replace


class Loss(msgspec.Struct, frozen=True):
    """One unreadable place of one file."""

    path: str
    reason: str
    bytes: int  # unusable bytes of the file
    messages: int | None = None  # None where the number is unknown
    of_settings: bool = False  # only the settings in the log cannot be read; all messages can


class Losses(msgspec.Struct):
    """All losses of a log; a place counts once, even if it is read twice."""

    places: dict[tuple[str, str, int], Loss] = field(default_factory=dict)  # (path, reason, offset) -> loss

    def add(self, path: str, reason: str, offset: int, n_bytes: int, messages: int | None = None) -> None:
        """Record the loss of `n_bytes` from `offset` on."""
        self.places.setdefault((path, reason, offset), Loss(path, reason, n_bytes, messages))

    def add_settings(self, path: str, reason: str) -> None:
        """Record that the settings in the log cannot be read."""
        self.places.setdefault((path, reason, 0), Loss(path, reason, 0, 0, of_settings=True))

    def explain_settings(self, reason: str, words: str) -> None:
        """Replace the `reason` of losses of settings by better `words`."""
        for place, loss in self.places.items():
            if loss.reason == reason:
                self.places[place] = replace(loss, reason=words, of_settings=True)

    def __bool__(self) -> bool:
        return bool(self.places)

    @property
    def recoverable(self) -> bool:
        """Whether more than settings is lost (bytes, messages or an end mark), so that `locfuse recover` helps."""
        return any(not loss.of_settings for loss in self.places.values())

    @property
    def bytes(self) -> int:
        """Number of lost bytes."""
        return sum(loss.bytes for loss in self.places.values())

    @property
    def messages(self) -> int:
        """Number of lost messages, where known."""
        return sum(loss.messages or 0 for loss in self.places.values())

    def by_reason(self) -> dict[str, dict[str, int]]:
        """Return reason -> {places, bytes, messages}, for reports."""
        table: dict[str, dict[str, int]] = {}
        for loss in self.places.values():
            row = table.setdefault(loss.reason, {"places": 0, "bytes": 0, "messages": 0})
            row["places"] += 1
            row["bytes"] += loss.bytes
            row["messages"] += loss.messages or 0
        return table

    def lines(self) -> list[str]:
        """Return the losses as text, one line per file and reason."""
        groups: dict[tuple[str, str], list[Loss]] = {}
        for loss in self.places.values():
            groups.setdefault((loss.path, loss.reason), []).append(loss)
        return [_line(path, reason, losses) for (path, reason), losses in groups.items()]


def _line(path: str, reason: str, losses: list[Loss]) -> str:
    n_bytes = sum(loss.bytes for loss in losses)
    known = [loss.messages for loss in losses if loss.messages is not None]
    parts = [f"{len(losses)} places"] if len(losses) > 1 else []
    parts += [f"{n_bytes} bytes"] if n_bytes else []
    if known:
        parts.append(f"{sum(known)} message{'' if sum(known) == 1 else 's'}")
    return f"{path}: {reason}" + (f" ({', '.join(parts)})" if parts else "")
