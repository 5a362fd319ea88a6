"""Caps: the largest input that is read. A real log stays far below each; a file built to do harm does not.

Bytes alone do not bound work: 24 kB of zstd hold millions of empty records, and 3 kB of text define a message of
10^8 fields. So what is counted, nested or repeated is bounded too. Whatever exceeds a cap is refused in one line
that names the cap, or counted as lost where the rest of the log can still be read.
"""

from __future__ import annotations

# bytes
MAX_CHUNK = 256 * 1024 * 1024  # of one chunk, compressed or not; writers use 1 to 8 MiB
MAX_MESSAGE = 64 * 1024 * 1024  # of one message
MAX_LONG = 64 * 1024 * 1024  # of all messages of a topic that are held as columns and longer than 64 KiB each
MAX_TEXT = 4 * 1024 * 1024  # of one string in a message; a robot's description has some hundred thousand
MAX_ATTACHMENT = 16 * 1024 * 1024  # larger attachments stay in the file
MAX_ROBOT_TOML = 128 * 1024  # `locfuse init` writes 5 kB
MAX_TEXT_FILE = 256 * 1024 * 1024  # a trajectory or detections: an hour at 100 Hz is 40 MB
MAX_METADATA = 4 * 1024 * 1024  # metadata.yaml of a rosbag2 folder; a bag of 10 000 files has 1 MB
MAX_MAP_FILE = 64 * 1024 * 1024  # a line map: 150 bytes a wall
MAX_MAP_PICTURE = 129 * 1024 * 1024  # of a map as an image: 2 bytes for each of MAX_MAP_PIXELS, and the header
MAX_WALLS = 3000  # of a given map: its states hold 0.7 GiB, with the square of their number
MAX_REPORT = 64 * 1024 * 1024  # report.json; over an hour's drive it has 100 kB

# structure of a file
FREE_RECORDS = 4096  # records in any chunk; a larger number needs as many bytes, compressed
MAX_TOPICS = 10_000  # topics of a log; a busy robot has 500
MAX_DATABASE_SECONDS = 20.0  # CPU of one step of sqlite: a row is a matter of microseconds

# structure of a message definition
MAX_DEFINITION = 256 * 1024  # bytes; the longest of ROS (a planning scene) has 70 kB
MAX_DEFINITION_LINES = 4096  # that say something; a planning scene has 1000
MAX_EXPRESSIONS = 1024  # of IDL: lengths of arrays, constants, what annotations say; each takes 2 to 5 ms to parse
MAX_DEPTH = 32  # structures in structures
MAX_FIELDS = 10_000  # of a message, those of its parts counted at every mention

# structure of a message
MAX_ITEMS = 100_000  # strings, arrays and structures walked one by one

# structure of a robot's description
MAX_KEYS = 4096  # of a robot.toml
MAX_KEY_DEPTH = 16  # tables in tables of a robot.toml
MAX_DOTS = 500  # in a line of a robot.toml: TOML's dotted keys cost the square of their parts
MAX_JOINTS = 10_000  # of a URDF
MAX_TRANSFORMS = 10_000  # child frames of /tf_static


def names_its_cap(what: str, found: float, cap: float, unit: str = "") -> str:
    """Return the error line for an input above its cap: "what: 12 units, more than the cap of 10 units"."""
    units = f" {unit}" if unit else ""
    return f"{what}: {_grouped(found)}{units}, more than the cap of {_grouped(cap)}"


def _grouped(number: float) -> str:
    return f"{number:,.0f}".replace(",", " ")
