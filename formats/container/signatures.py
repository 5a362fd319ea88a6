"""Name a file by its first bytes, so that a refusal can say what the file is instead of what it is not."""

from __future__ import annotations

SIGNATURES = (
    (b"\x89MCAP0\r\n", "an MCAP file"),
    (b"SQLite format 3\x00", "a sqlite3 database (a rosbag2 .db3 is one)"),
    (b"#ROSBAG V2.0", "a ROS 1 bag"),
    (b"#ROSBAG", "a ROS 1 bag of an old version"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed data"),
    (b"\x04\x22\x4d\x18", "lz4-compressed data"),
    (b"\x1f\x8b", "gzip-compressed data"),
    (b"BZh", "bzip2-compressed data"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x89PNG", "a PNG image"),
    (b"%PDF", "a PDF document"),
    (b"RRF", "a Rerun recording"),
    (b"rosbag2_bagfile_information", "a rosbag2 metadata.yaml"),
    (b"{", "JSON text"),
)


def describe(head: bytes) -> str:
    """Return what a file that starts with `head` (the first 64 bytes or more) is, in words."""
    if not head:
        return "empty (0 bytes)"
    for signature, words in SIGNATURES:
        if head.startswith(signature):
            return words
    if not head.strip(b"\x00"):
        return "filled with zeros"
    try:
        text = head[:60].decode()
    except UnicodeDecodeError:
        return "of an unknown kind"
    return "a text file" if text.isprintable() or "\n" in text else "of an unknown kind"
