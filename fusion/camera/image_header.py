"""How large a JPEG or PNG says it is, read from its header: before anything is decoded.

What is truncated is found here too: OpenCV 4 and 5 differ there, and libjpeg writes to stderr about it.
"""

from __future__ import annotations

PNG = b"\x89PNG\r\n\x1a\n"
JPEG, EOI = b"\xff\xd8", b"\xff\xd9"
MIN_TAIL_BYTES = 8  # bytes: shorter than what follows a frame header
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # SOF markers: the frame's size follows
BARE = frozenset({0x01, *range(0xD0, 0xD8)})  # markers without a length
END = frozenset({0xD9, 0xDA})  # end of image, start of scan: the size should have come before
COLOURS = 3  # components of a colour picture: Y, Cb, Cr


def image_size(data: memoryview) -> tuple[int, int] | None:
    """Return (width, height) [px] from a picture's header; None if it is no JPEG or PNG, or is cut off."""
    if bytes(data[:8]) == PNG and bytes(data[12:16]) == b"IHDR" and b"IEND" in bytes(data[24:]):
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    return _jpeg_size(data, _frame(data)) if bytes(data[:2]) == JPEG else None


def coarse_size(data: memoryview) -> tuple[int, int] | None:
    """Return (width, height) [px] of a JPEG that keeps its colour at half the resolution; None of all else."""
    at = _frame(data) if bytes(data[:2]) == JPEG else None
    return _jpeg_size(data, at) if _is_coarse(data, at) else None


def _is_coarse(data: memoryview, at: int | None) -> bool:
    """Return whether a JPEG with this frame keeps its colour at half the brightness' resolution (4:2:0, 4:2:2)."""
    if at is None or len(data) < at + 10 + 3 * COLOURS or data[at + 9] != COLOURS:
        return False
    sampling = [data[at + 11 + 3 * k] for k in range(COLOURS)]  # horizontal in the high half of the byte
    return all(sampling[0] >> 4 >= 2 * (other >> 4) > 0 for other in sampling[1:])


def _jpeg_size(data: memoryview, at: int | None) -> tuple[int, int] | None:
    if at is None:
        return None
    # inside a scan 0xFF is always followed by 0; the end is nearly always the end
    whole = EOI in bytes(data[-MIN_TAIL_BYTES:]) or EOI in bytes(data[at + 9 :])
    height, width = (int.from_bytes(data[at + k : at + k + 2], "big") for k in (5, 7))
    return (width, height) if whole else None


def _frame(data: memoryview) -> int | None:
    """Return where a JPEG's frame header begins: walk its segments (ITU-T T.81, B.2.2)."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in FRAMES:
            return at
        if marker in END:
            return None
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker in BARE:
            at += 2
        else:
            at += 2 + max(2, int.from_bytes(data[at + 2 : at + 4], "big"))
    return None
