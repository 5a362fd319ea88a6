"""Make docs/images/report.png: python docs/images/make_report_picture.py [LOG] [PICTURE] [OPTION ...]

Compares a log, opens the report in Chromium without a window, and keeps what its first screen shows. The default
is the sample log `labyrinth`, a recorded drive.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from locfuse.cli.main import main as locfuse

LOG, PICTURE = "labyrinth", str(Path(__file__).with_name("report.png"))
SIZE = (1280, 900)  # px
COLOURS = 255  # of the picture


def compared(log: str, out: Path, *options: str) -> Path:
    """Run `locfuse compare LOG`, and return its page."""
    try:
        locfuse(["compare", log, "--write", "html,json", "-q", "-o", str(out), *options])
    except SystemExit as end:
        if end.code:
            raise
    return out / "report.html"


def small(picture: Path, target: str, height: int | None = None) -> None:
    """Write a picture in few colours, cut to a height [px]."""
    image = Image.open(picture).convert("RGB")
    image = image.crop((0, 0, image.width, min(height or image.height, image.height)))
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)
    print(f"{target}: {Path(target).stat().st_size / 1000:.0f} kB")


def main(log: str = LOG, target: str = PICTURE, *options: str) -> None:
    """Write the picture."""
    with tempfile.TemporaryDirectory() as folder:
        page, shot = compared(log, Path(folder) / "out", *options), Path(folder) / "page.png"
        window = f"--window-size={SIZE[0]},{SIZE[1]}"
        command = ["chromium", "--headless", "--no-sandbox", "--hide-scrollbars", window, f"--screenshot={shot}"]
        subprocess.run([*command, page.as_uri()], check=True, capture_output=True)
        small(shot, target)


if __name__ == "__main__":
    main(*sys.argv[1:])
