"""Identity of a log's content without reading all of it: sizes, and a hash of what each file says of itself.

The summary section of an MCAP lists every chunk with its place, size and times, so two recordings with equal
summaries are copies. A file without one is known by its size and both ends. Bytes that are changed in place and
leave these as they were are not seen; a later change of the file's time is (`locfuse compare` over many logs), and
so is every byte by `--hash`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from locfuse.formats.container.file_bytes import FileBytes
from locfuse.formats.container.losses import Losses
from locfuse.formats.mcap.summary import summary_section

from .files import log_files

END_BYTES = 1 << 16  # of a file without a summary: hashed at its beginning and at its end


class Identity(NamedTuple):
    """What a log's content is known by."""

    size: int  # bytes of all files
    digest: str  # hexadecimal


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return the files of a log in their order: by name, wherever they lie."""
    return sorted({file for path in paths for file in log_files(path)}, key=lambda file: (file.name, str(file)))


def identity_of(files: Sequence[Path]) -> Identity:
    """Return the identity of a log of these files. Raises LocfuseError where one cannot be read."""
    state, total = hashlib.sha256(), 0
    for file in files:
        data = FileBytes(file, Losses())
        section = summary_section(data)
        kind, content = ("ends", _ends(data)) if section is None else ("summary", section)
        state.update(f"{kind} {data.size} {len(content)}\n".encode() + content)
        total += data.size
    return Identity(total, state.hexdigest())


def _ends(data: FileBytes) -> bytes:
    return data.read(0, END_BYTES) + data.read(max(data.size - END_BYTES, 0), END_BYTES)
