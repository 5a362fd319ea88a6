"""Many messages of one type at once: the bytes of one, repeated, with columns of numbers laid over them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.container.mcap_write import Messages, nested
from locfuse.formats.messages.cdr import CDR, read_layout
from locfuse.formats.messages.fields import resolve
from locfuse.formats.messages.schema import Many, Node, Scalar, parse
from locfuse.fusion.data import Ints

MESSAGES = Messages()
Columns = Mapping[str, NDArray[Any]]  # dotted path of a field -> numbers (n,), or (n, k) for an array of k


def stamps(path: str, t_ns: Ints) -> dict[str, Ints]:
    """Return the columns of a builtin_interfaces/Time."""
    return {f"{path}.sec": t_ns // 1_000_000_000, f"{path}.nanosec": t_ns % 1_000_000_000}


class Template:
    """A message whose texts and lengths are settled; some of its numbers are columns, all others are zero."""

    def __init__(self, msgtype: str, constant: Mapping[str, Any], columns: Collection[str]) -> None:
        one = MESSAGES.cdr(msgtype, nested(constant))
        message = parse(msgtype, "ros2msg", MESSAGES.schema(msgtype))
        layout = read_layout(message, nested({path: path for path in columns}), memoryview(one), CDR)
        self._bytes = np.frombuffer(one, np.uint8)
        self._at = {path: layout.leaves[path].offsets[0] for path in columns}
        self._dtype = {path: _number(resolve(message, path)[0].node) for path in columns}

    def filled(self, columns: Columns) -> NDArray[np.uint8]:
        """Return n messages as CDR bytes, (n, size)."""
        n = len(next(iter(columns.values())))
        out = np.tile(self._bytes, (n, 1))
        for path, values in columns.items():
            data = np.ascontiguousarray(values, self._dtype[path]).view(np.uint8).reshape(n, -1)
            out[:, self._at[path] : self._at[path] + data.shape[1]] = data
        return out


def _number(node: Node) -> np.dtype[Any]:
    scalar = cast("Scalar", node.element if isinstance(node, Many) else node)
    return np.dtype(scalar.dtype).newbyteorder("<")
