"""Make docs/images/rerun.png: python docs/images/make_rerun_picture.py [TAB] [PICTURE]

Records the sample log `disturbed`, opens the recording in Rerun's viewer without a window, and takes a picture at
34 s: a person stands before the laser, a red cabinet is not the landmark. Without a graphics card, Debian's
mesa-vulkan-drivers draw it.
"""

from __future__ import annotations

import io
import os
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

from PIL import Image

from locfuse.cli.main import main as locfuse
from locfuse.cli.rerun import viewer

LOG, TAB, SECONDS = "disturbed", "Deviation", 34.0
SIZE = (1600, 1000)
WIDTH = 1280  # px of the picture that is kept
TOP_BAR = 36  # px: the viewer's own buttons and what it says of this machine's graphics


def record(path: Path, tab: str) -> None:
    """Run `locfuse view LOG --save path`."""
    try:
        locfuse(["view", LOG, "--tab", tab, "--save", str(path)])
    except SystemExit as end:
        if end.code:
            raise


def screenshot(path: Path) -> bytes:
    """Return the viewer's picture of a recording as PNG."""
    port = viewer.free_port(0)
    options = ["--headless", "--port", str(port), "--window-size", f"{SIZE[0]}x{SIZE[1]}", "--hide-welcome-screen"]
    with tempfile.TemporaryDirectory() as runtime:
        os.environ.setdefault("XDG_RUNTIME_DIR", runtime)
        window = viewer.start_rerun([*options, str(path)])
        try:
            client = connected(f"rerun+http://127.0.0.1:{port}/proxy")
            client.set_time("drive", duration=SECONDS, play_state="paused")
            time.sleep(8.0)  # notices fade, pictures are decoded
            return bytes(client.take_screenshot())
        finally:
            window.terminate()
            window.wait(10)


def connected(url: str) -> Any:
    """Return a client of the viewer, once it has loaded the recording."""
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + 60.0
    while True:
        try:
            client = ViewerClient.connect(url)
            state = client.get_state()
            if state.recordings and state.views and not state.loading:
                return client
        except (ConnectionError, RuntimeError):
            if time.monotonic() > deadline:
                raise
        time.sleep(0.3)


def main(tab: str = TAB, target: str = str(Path(__file__).with_name("rerun.png"))) -> None:
    """Write the picture."""
    warnings.simplefilter("ignore")  # ViewerClient is experimental
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "drive.rrd"
        record(recording, tab)
        picture = Image.open(io.BytesIO(screenshot(recording))).convert("RGB")
    picture = picture.crop((0, TOP_BAR, *picture.size))
    size = (WIDTH, round(picture.height * WIDTH / picture.width))
    few = picture.resize(size, Image.Resampling.LANCZOS).quantize(
        255, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE
    )
    few.save(target, optimize=True)
    print(target)


if __name__ == "__main__":
    main(*sys.argv[1:])
