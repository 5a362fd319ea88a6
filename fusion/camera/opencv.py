"""OpenCV, imported in one place, so that its limits are set before it reads its first byte.

Importing this module costs 60 ms and more: import it (or what imports it: images, panorama, radial, preview)
only inside functions that really look at a picture.
"""

from __future__ import annotations

import os

# A 5 kB JPEG can claim 20000 x 20000 pixels. An 8K frame (7680 x 4320) still fits: 100 MB decoded.
# images.py holds every header to the same cap, whoever imported OpenCV first.
MAX_PIXELS = 2**25
MAX_MAP_PIXELS = 2**26  # of a map: 400 m x 400 m in cells of 5 cm
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_MAP_PIXELS))  # the larger: it is of the whole process

import cv2  # noqa: E402

# One picture per core (camera.py) beats many cores per picture, and keeps results free of the core count.
cv2.setNumThreads(1)

__all__ = ["MAX_MAP_PIXELS", "MAX_PIXELS", "cv2"]
