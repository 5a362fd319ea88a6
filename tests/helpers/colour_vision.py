"""Colours as people see them: colour blindness simulated, distances that the eye tells apart, contrast."""

from __future__ import annotations

import re
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Machado, Oliveira, Fernandes 2009: severity 1.0, on linear RGB
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]]
    ),
}
TO_LMS = np.array(  # Ottosson 2020
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
TO_LAB = np.array(
    [
        [0.2104542553, 0.793617785, -0.0040720468],
        [1.9779984951, -2.428592205, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.808675766],
    ]
)


def linear_rgb(colour: str) -> Array:
    c = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def page(theme: str) -> str:
    """The background that the report's style sheet gives a theme."""
    light, dark, *_ = re.findall(r"--bg:#(\w+)", (files("locfuse.formats.report") / "report.css").read_text())
    digits = {"light": light, "dark": dark}[theme]
    return "#" + "".join(c * (6 // len(digits)) for c in digits)


def oklab(rgb: Array) -> Array:
    """Distances here are about what the eye tells apart."""
    lab: Array = TO_LAB @ np.cbrt(TO_LMS @ np.clip(rgb, 0.0, 1.0))
    return lab


def contrast(a: str, b: str) -> float:
    """WCAG 2.1."""
    light, dark = sorted((float(np.dot([0.2126, 0.7152, 0.0722], linear_rgb(c))) for c in (a, b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)
