"""Preview pictures as PNG files: `locfuse info LOG --preview DIR`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import LocfuseError


def write_pictures(folder: Path, pictures: Mapping[str, NDArray[np.uint8]]) -> list[Path]:
    """Write pictures (h, w) or BGR (h, w, 3) as `folder/<name>.png`, each whole or not at all.

    A file of that name is replaced, other files stay. Raises LocfuseError where it cannot be written.
    """
    import cv2

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise LocfuseError(f"cannot write to {folder}: {problem.strerror or problem}") from None
    written = []
    for name, picture in pictures.items():
        path = folder / f"{name}.png"
        _, png = cv2.imencode(".png", picture)
        with whole_file(path) as temporary:
            temporary.write_bytes(png.tobytes())
        written.append(path)
    return written
