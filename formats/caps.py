"""Upper limits on the size and complexity of inputs, far above those of real logs, against malicious files.

The number of bytes alone does not limit the work: 24 kB of zstd hold millions of empty records, and 3 kB of text
define a message of 10^8 fields. So counts, nesting and repetition have caps too. An input above a cap raises an
error of one line that names the cap. If the rest of the log is readable, a loss is recorded instead.
"""

from __future__ import annotations

from locfuse.fusion.data import LocfuseError

# bytes
MAX_CHUNK = 256 * 1024 * 1024  # of one chunk, compressed or not; writers use 1 to 8 MiB
MAX_MESSAGE = 64 * 1024 * 1024  # of one message
MAX_LONG = 64 * 1024 * 1024  # of all messages of a topic that are longer than 64 KiB and read into columns
MAX_TEXT = 4 * 1024 * 1024  # of one string in a message; a robot's description has some hundred thousand
MAX_ATTACHMENT = 16 * 1024 * 1024  # larger attachments stay in the file
MAX_ROBOT_TOML = 128 * 1024  # `locfuse init` writes 5 kB
MAX_TEXT_FILE = 256 * 1024 * 1024  # a trajectory or detections: an hour at 100 Hz is 40 MB
MAX_METADATA = 4 * 1024 * 1024  # metadata.yaml of a rosbag2 folder; a bag of 10 000 files has 1 MB
MAX_MAP_FILE = 64 * 1024 * 1024  # a line map: 150 bytes a wall
MAX_MAP_PICTURE = 129 * 1024 * 1024  # a map image: 2 bytes for each of MAX_MAP_PIXELS, and the header
MAX_WALLS = 3000  # of a line map: their covariance takes 0.7 GiB and grows with the square of the number
MAX_REPORT = 64 * 1024 * 1024  # report.json; over an hour's drive it has 100 kB

# structure of a file
FREE_RECORDS = 4096  # records accepted in any chunk; each further one needs a compressed byte
MAX_TOPICS = 10_000  # topics of a log; a busy robot has 500
MAX_DATABASE_SECONDS = 20.0  # CPU time of one sqlite step; a row takes microseconds

# structure of a message definition
MAX_DEFINITION = 256 * 1024  # bytes; the longest of ROS (a planning scene) has 70 kB
MAX_DEFINITION_LINES = 4096  # without blank and comment lines; a planning scene has 1000
MAX_EXPRESSIONS = 1024  # of IDL (array lengths, constants, annotations); each takes 2 to 5 ms to parse
MAX_DEPTH = 32  # of nested structures
MAX_FIELDS = 10_000  # of a message, with those of nested messages at every use

# structure of a message
MAX_ITEMS = 100_000  # strings, arrays and structures decoded one by one

# structure of a robot's description
MAX_KEYS = 4096  # of a robot.toml
MAX_KEY_DEPTH = 16  # of nested tables in a robot.toml
MAX_DOTS = 500  # in a line of a robot.toml: the time to parse a dotted key grows with the square of its parts
MAX_JOINTS = 10_000  # of a URDF
MAX_TRANSFORMS = 10_000  # child frames of /tf_static


def names_its_cap(what: str, found: float, cap: float, unit: str = "") -> str:
    """Return the error text for an input above its cap: "what: 12 units, more than the cap of 10 units"."""
    units = f" {unit}" if unit else ""
    return f"{what}: {_grouped(found)}{units}, more than the cap of {_grouped(cap)}"


def refuse_above(
    what: str, found: float, cap: float, unit: str = "", error: type[Exception] = LocfuseError
) -> None:
    """Raise `error` with the text of `names_its_cap` if the input `found` is above its `cap`."""
    if found > cap:
        raise error(names_its_cap(what, found, cap, unit))


def _grouped(number: float) -> str:
    return f"{number:,.0f}".replace(",", " ")
