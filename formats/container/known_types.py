"""Definitions of message types for bags without them (rosbag2 .db3 files before ROS 2 Iron)."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

DIVIDER = "=" * 80
NESTED_TYPE = re.compile(r"^\s*(\w+/\w+)", re.MULTILINE)  # the type of a field that is a message itself
ALIGNMENT_BYTES = 4  # a message may be padded at its end
RELEASES = ("LATEST", "ROS2_HUMBLE", "ROS2_FOXY")  # definitions of a type may differ between them
MAX_SAMPLE = 1 << 16  # bytes: definitions of types with larger messages never changed


def definition(msgtype: str, sample: bytes = b"") -> str | None:
    """Return the ros2msg text of a standard or common robot message type; None for an unknown type.

    Some types gained fields between ROS releases (sensor_msgs/Range its variance). So the newest definition is
    returned that gives the message `sample` of the bag its actual length. If no definition does, the result is the
    newest one for a standard type, and None for another type.
    """
    if texts := _texts(msgtype.replace("/msg/", "/")):
        return next((text for text in texts if not sample or _fits(_store(msgtype, text), msgtype, sample)), None)
    known = _definitions(msgtype)
    if len(known) < 2 or not sample or len(sample) > MAX_SAMPLE:
        return next(iter(known), None)
    return next((text for text, store in known.items() if _fits(store, msgtype, sample)), next(iter(known)))


@cache
def _fields() -> dict[str, list[str]]:
    """Return the field definitions of every type in known_types.toml, one field per line, newest first."""
    table = tomllib.loads((files(__package__) / "known_types.toml").read_text(encoding="utf-8"))
    return {name: [re.sub(r",\s+", "\n", text) + "\n" for text in texts] for name, texts in table.items()}


def _texts(name: str) -> list[str]:
    """Return the ros2msg texts of a type in known_types.toml, with all types that it uses, newest first."""
    table = _fields()
    used = [name] if name in table else []
    for one in used:
        used += [other for text in table[one] for other in NESTED_TYPE.findall(text) if other not in used]
    versions = max((len(table[one]) for one in used), default=0)
    chosen = [[table[one][min(i, len(table[one]) - 1)] for one in used] for i in range(versions)]
    return [f"\n{DIVIDER}\n".join([own, *map("MSG: {}\n{}".format, used[1:], rest)]) for own, *rest in chosen]


def _store(msgtype: str, text: str) -> Any:
    """Return a `rosbags` type store with the message type of a ros2msg text."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, msgtype))
    return store


def _definitions(msgtype: str) -> dict[str, Any]:
    """Return the different definitions of a type in RELEASES, newest first: ros2msg text -> type store."""
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, Any] = {}
    for release in RELEASES:
        store = get_typestore(Stores[release])
        if msgtype in store.types:
            found.setdefault(str(store.generate_msgdef(msgtype, ros_version=2)[0]), store)
    return found


def _fits(store: Any, msgtype: str, sample: bytes) -> bool:
    """Return whether `sample` (CDR), decoded and encoded again as `msgtype`, has the same length up to padding."""
    try:
        message = store.deserialize_cdr(sample, msgtype)
        written = len(store.serialize_cdr(message, msgtype, little_endian=sample[1:2] == b"\x01"))
    except Exception:
        return False
    return abs(len(sample) - written) < ALIGNMENT_BYTES
