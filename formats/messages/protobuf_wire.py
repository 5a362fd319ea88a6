"""Protobuf's wire format: fields as (number, how they lie), whatever the message type."""

from __future__ import annotations

from collections.abc import Iterator

from .layout import MalformedError

VARINT, FIXED_64, BYTES, FIXED_32 = 0, 1, 2, 5  # how a value lies
FIXED_SIZE = {FIXED_64: 8, FIXED_32: 4}
MAX_VARINT = 10  # bytes
SHORT = "shorter than its type"


def varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    """Return the number that begins at a byte, seven bits a byte from the lowest, and where it ends."""
    value = shift = 0
    for i in range(at, min(end, at + MAX_VARINT)):
        byte = data[i]
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, i + 1
        shift += 7
    raise MalformedError(SHORT if at + MAX_VARINT > end else "a number longer than 10 bytes")


def walk(data: bytes, at: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield each field of a message that lies at data[at:end]: number, how it lies, first byte, end.

    Of a text, bytes or a message these are those of its content. Raises MalformedError.
    """
    while at < end:
        tag, at = (data[at], at + 1) if data[at] < 0x80 else varint(data, at, end)
        wire = tag & 7
        if wire == BYTES:
            n, at = (data[at], at + 1) if at < end and data[at] < 0x80 else varint(data, at, end)
            stop = at + n
        elif wire == VARINT:
            _, stop = varint(data, at, end)
        elif wire in FIXED_SIZE:
            stop = at + FIXED_SIZE[wire]
        else:
            raise MalformedError(f"a field of wire type {wire}, which is not supported")
        if stop > end:
            raise MalformedError(SHORT)
        if tag < 8:
            raise MalformedError("a field of number 0")
        yield tag >> 3, wire, at, stop
        at = stop


def contents(data: bytes, number: int) -> list[bytes]:
    """Return the texts, bytes or messages of one field of a message."""
    return [data[at:end] for n, how, at, end in walk(data, 0, len(data)) if n == number and how == BYTES]


def whole(data: bytes, number: int) -> int:
    """Return the whole number of one field of a message, zero where it is left out."""
    found = [at for n, how, at, _ in walk(data, 0, len(data)) if n == number and how == VARINT]
    return varint(data, found[-1], len(data))[0] if found else 0
