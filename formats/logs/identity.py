"""Identity of a log's content without reading all of it: sizes, and a hash of what each file says of itself.

The summary section of an MCAP lists every chunk with its place, size and times, so two recordings with equal
summaries are copies. A file without one is known by its size and both ends. Bytes that are changed in place and
leave these as they were are not seen; a later change of the file's time is (`locfuse compare` over many logs), and
so is every byte by `--hash`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

from locfuse.formats.container.file_bytes import FileBytes
from locfuse.formats.container.losses import Losses
from locfuse.formats.container.mcap_summary import summary_section
from locfuse.formats.container.url import Place, Url

from .files import log_files

END_BYTES = 1 << 16  # of a file without a summary: hashed at its beginning and at its end


class Identity(NamedTuple):
    """What a log's content is known by."""

    size: int  # bytes of all files
    digest: str  # hexadecimal


class Seen(NamedTuple):
    """What one file is known by."""

    kind: str  # of the content: "summary", "ends" or "etag"
    size: int  # bytes of the file
    content: bytes


def files_of(paths: Sequence[Place]) -> list[Place]:
    """Return the files of a log in their order: by name, wherever they lie."""
    return sorted({file for path in paths for file in log_files(path)}, key=lambda file: (file.name, str(file)))


def identity_of(files: Sequence[Place]) -> Identity:
    """Return the identity of a log of these files. Raises LocfuseError where one cannot be read."""
    return identity([seen_of(file) for file in files])


def identity(seen: Sequence[Seen]) -> Identity:
    """Return the identity of a log by what was seen of each of its files."""
    state, total = hashlib.sha256(), 0
    for kind, size, content in seen:
        state.update(f"{kind} {size} {len(content)}\n".encode() + content)
        total += size
    return Identity(total, state.hexdigest())


def seen_of(file: Place) -> Seen:
    """Return what a file is known by."""
    if isinstance(file, Url):
        from locfuse.formats.container.remote_objects import Object

        return seen_of_object(*Object(file).state)
    data = FileBytes(file, Losses())
    section = summary_section(data)
    kind, content = ("ends", _ends(data)) if section is None else ("summary", section)
    return Seen(kind, data.size, content)


def seen_of_object(size: int, tag: str) -> Seen:
    """Return what is known of an object in a store: its ETag changes with its content."""
    return Seen("etag", size, tag.encode())


def _ends(data: FileBytes) -> bytes:
    return data.read(0, END_BYTES) + data.read(max(data.size - END_BYTES, 0), END_BYTES)
