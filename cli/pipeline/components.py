"""How the numbers of a sensor are shown: what is drawn of it, and the name, unit and scale of each number."""

from __future__ import annotations

import math
from typing import Any

DEG = 180.0 / math.pi

LOOKS: dict[str, tuple[Any, tuple[str, ...], tuple[float, ...]]] = {
    "compass": ("heading", ("heading [deg]",), (DEG,)),
    "lrf": ("segments", ("r [m]", "psi [deg]"), (1.0, DEG)),
    "camera": ("bearing", ("bearing [deg]",), (DEG,)),
}
