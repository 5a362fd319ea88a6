"""Reading .rrd files back, without any of our code."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader


class Entity:
    """All rows of one entity, and what holds at all times."""

    def __init__(self) -> None:
        self.parts: list[Any] = []
        self.static: dict[str, Any] = {}

    def column(self, name: str) -> list[Any]:
        """One value or list per row, in the order of the log's time."""
        values = [v for part in self.parts if name in part.schema.names for v in part.column(name).to_pylist()]
        times = [t for part in self.parts if name in part.schema.names for t in _ns(part.column("log time"))]
        return [values[i] for i in np.argsort(times, kind="stable")]

    def array(self, name: str) -> NDArray[np.float64]:
        """The values of all rows as one array."""
        return np.array(self.column(name), dtype=np.float64)

    @property
    def ns(self) -> NDArray[np.int64]:
        """The log's time of every row."""
        return np.sort(np.concatenate([_ns(part.column("log time")) for part in self.parts]))

    @property
    def steps(self) -> NDArray[np.int64]:
        """The step of every row, in the order of the log's time."""
        return np.array(self.column("step"), dtype=np.int64)


def _ns(column: Any) -> NDArray[np.int64]:
    return np.asarray(column.cast("int64"), dtype=np.int64)


def read(path: Path) -> dict[str, Entity]:
    """The entities of the drive by path, without the leading slash."""
    return _entities(RrdReader(path).stream())


def read_blueprint(path: Path) -> dict[str, Entity]:
    """The entities of the layout."""
    reader = RrdReader(path)
    (store,) = reader.blueprints()
    return _entities(reader.stream(store=store))


def _entities(stream: Any) -> dict[str, Entity]:
    found: dict[str, Entity] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for chunk in stream.to_chunks():
            entity = found.setdefault(chunk.entity_path.strip("/"), Entity())
            batch = chunk.to_record_batch()
            if chunk.is_static or "log time" not in batch.schema.names:
                # a time to the nanosecond is no Python value without pandas
                names = [n for n in batch.schema.names if "time" not in n or n.endswith(":timeline")]
                entity.static |= {n: batch.column(n).to_pylist() for n in names}
            else:
                entity.parts.append(batch)
    return found
