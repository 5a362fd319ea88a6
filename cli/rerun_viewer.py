"""Rerun's viewer: is one running, can one be started, and handing it a recording without ever hanging.

The viewer is started as its own process on the loopback interface (Rerun's own `spawn` listens on all), and a
recording is sent to a running one by a child process that is given up after a while: the library's own
connection waits for minutes where a port is open and nobody answers.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

from ..fusion.data import LocfuseError
from .rerun_options import ADDRESS, LOCAL_VIEWER

HOST, PORT = "127.0.0.1", 9876
PROBE = 1.0  # s to wait for a port
PATIENCE = 20.0  # s to wait for a viewer to take a recording, and
RATE = 5e6  # bytes per second on top of that
START = 2.0  # s in which a viewer that cannot start has said so


def show(path: Path) -> None:
    """Show a recording in a running viewer, else in a new one. Raises LocfuseError where there is neither."""
    if listening(HOST, PORT):
        try:
            send(path, LOCAL_VIEWER)
        except LocfuseError:
            if not has_display():
                raise
        else:
            return
    if not has_display():
        raise LocfuseError(f"there is no display, and no viewer runs at {HOST}:{PORT}")
    start(path)


def has_display() -> bool:
    """Return whether a window can open."""
    if sys.platform.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return True


def listening(host: str, port: int) -> bool:
    """Return whether something accepts connections there."""
    try:
        with socket.create_connection((host, port), timeout=PROBE):
            return True
    except OSError:
        return False


def send(path: Path, url: str) -> None:
    """Send a recording to the viewer at `url`.

    Raises LocfuseError where no viewer takes it in time.
    """
    match = ADDRESS.fullmatch(url)
    assert match is not None, url
    host, port = match["host"].strip("[]"), int(match["port"] or PORT)
    if not listening(host, port):
        raise LocfuseError(f"no viewer answers at {host}:{port}")
    command = [sys.executable, "-m", "locfuse.formats.rerun_send", str(path), url]
    try:
        done = subprocess.run(
            command, timeout=PATIENCE + path.stat().st_size / RATE, capture_output=True, text=True, check=False
        )
    except subprocess.TimeoutExpired:
        raise LocfuseError(f"what listens at {host}:{port} does not take a recording") from None
    if done.returncode != 0:
        said = (done.stderr.strip().splitlines() or ["it went away"])[-1]
        raise LocfuseError(f"the viewer at {host}:{port} did not take the recording: {said[:160]}")


def start(path: Path) -> None:
    """Open a viewer of our own on the loopback interface and leave it running.

    Raises LocfuseError where it ends at once (no graphics driver, no such program).
    """
    command = [program(), "--bind", HOST, "--port", str(free_port()), str(path)]
    environment = {**os.environ, "RERUN_APP_ONLY": "true", "RUST_LOG": "error"}
    try:
        viewer = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
    except OSError as problem:
        raise LocfuseError(f"the viewer cannot be started: {problem.strerror}") from None
    deadline = time.monotonic() + START
    while time.monotonic() < deadline:
        if viewer.poll() is not None and viewer.returncode != 0:
            raise LocfuseError(f"the viewer ended at once with code {viewer.returncode}")
        time.sleep(0.1)


def serve(path: Path, port: int) -> int:
    """Serve a recording to browsers on this machine until interrupted; return the server's exit code."""
    command = [program(), "--bind", HOST, "--port", str(free_port()), "--web-viewer"]
    command += ["--web-viewer-port", str(port), str(path)]
    environment = {**os.environ, "RUST_LOG": os.environ.get("RUST_LOG", "error")}
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as server:
        try:
            return server.wait()
        except BaseException:
            server.terminate()
            raise


def free_port() -> int:
    """Return Rerun's usual port if it is free, else one that is."""
    for wanted in (PORT, 0):
        with socket.socket() as probe:
            try:
                probe.bind((HOST, wanted))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise LocfuseError(f"no free port on {HOST}")


def program() -> str:
    """Return Rerun's own binary: its console script forks, so that ending it would leave the viewer behind."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise LocfuseError("the viewer is not installed; try: pip install rerun-sdk")
    return str(Path(found.origin).parent / ("rerun.exe" if sys.platform == "win32" else "rerun"))
