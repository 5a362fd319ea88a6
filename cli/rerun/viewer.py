"""The Rerun viewer: find a running one, start one, and send it a recording within a time limit.

The viewer is a process of its own on the loopback interface (Rerun's `spawn` listens on all interfaces). A
recording is sent by a child process (this file), which is stopped after a time limit. Rerun has no reliable time
limit: if a port accepts but never answers, `flush(timeout_sec=10)` takes 59 s.
"""

from __future__ import annotations

import importlib.util
import os
import re
import socket
import subprocess
import sys
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from locfuse.fusion.data import LocfuseError

ADDRESS = re.compile(r"rerun(?:\+https?)?://(?P<host>\[[^\]/]+\]|[^/:@]+)(?::(?P<port>\d{1,5}))?/proxy")
HOST, PORT = "127.0.0.1", 9876
LOCAL_VIEWER = f"rerun+http://{HOST}:{PORT}/proxy"
PORT_TIMEOUT_S = 1.0  # for a connection
SEND_TIMEOUT_S = 10.0  # for sending a recording, plus its size divided by ...
SEND_RATE_BPS = 5e6  # bytes per second
START_TIMEOUT_S = 2.0  # a viewer that cannot start ends within this time


def show(path: Path) -> subprocess.Popen[bytes] | None:
    """Show a recording in a running viewer, else start one and return its process. Raises LocfuseError."""
    if listening(HOST, PORT):
        try:
            send(path, LOCAL_VIEWER)
            return None
        except LocfuseError:
            if not has_display():
                raise
    if not has_display():
        raise LocfuseError(f"there is no display, and no viewer runs at {HOST}:{PORT}")
    viewer = start_rerun(["--port", str(free_port(PORT)), str(path)])
    with suppress(subprocess.TimeoutExpired):  # it runs
        if (code := viewer.wait(START_TIMEOUT_S)) != 0:
            raise LocfuseError(f"the viewer ended at once with code {code}")
    return viewer


def has_display() -> bool:
    """Return whether a window can be opened."""
    if sys.platform.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return True


def listening(host: str, port: int) -> bool:
    """Return whether a program accepts connections at this host and port."""
    try:
        with socket.create_connection((host, port), timeout=PORT_TIMEOUT_S):
            return True
    except OSError:
        return False


def send(path: Path, url: str) -> None:
    """Send a recording to the viewer at `url`. Raises LocfuseError if it is not accepted in time."""
    match = ADDRESS.fullmatch(url)
    assert match is not None, url
    host, port = match["host"].strip("[]"), int(match["port"] or PORT)
    if not listening(host, port):
        raise LocfuseError(f"no viewer answers at {host}:{port}")
    command = [sys.executable, "-m", "locfuse.cli.rerun.viewer", str(path), url]
    limit_s = SEND_TIMEOUT_S + path.stat().st_size / SEND_RATE_BPS
    try:
        done = subprocess.run(command, timeout=limit_s, capture_output=True, text=True, check=False)
    except subprocess.TimeoutExpired:
        raise LocfuseError(f"what listens at {host}:{port} does not take a recording") from None
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["it went away"])[-1]
        raise LocfuseError(f"the viewer at {host}:{port} did not take the recording: {reason[:160]}")


def require() -> None:
    """Raise LocfuseError if there is neither a display nor a running viewer."""
    if not has_display() and not listening(HOST, PORT):
        words = f"there is no display, and no viewer runs at {HOST}:{PORT}"
        raise LocfuseError(f"{words}. Save the recording with --save FILE.rrd, or show it in a browser with --web")


def show_and_wait(path: Path) -> None:
    """Show a recording; if this starts a viewer, wait until its window is closed."""
    viewer = show(path)
    if viewer is None:
        return
    try:
        code = viewer.wait()
    except BaseException:
        viewer.terminate()
        raise
    if code != 0:
        raise LocfuseError(f"the viewer ended with code {code}; in a browser it may work: --web")


def serve(path: Path, wanted: int, say: Callable[[str], None]) -> None:
    """Serve a recording to browsers on this machine until interrupted; `say` prints the URL.

    Raises LocfuseError if the server ends by itself.
    """
    port, data = free_port(wanted), free_port(PORT)
    server = start_rerun(["--port", str(data), "--serve-web", "--web-viewer-port", str(port), str(path)])
    try:
        address = f"http://{HOST}:{port}/?url=" + quote(f"rerun+http://{HOST}:{data}/proxy", safe="")
        say(address)
        say("Ctrl-C ends it")
        if has_display():
            webbrowser.open(address)
        code = server.wait()
    except BaseException:
        server.terminate()
        server.wait()
        raise
    raise LocfuseError(f"the web viewer ended with code {code}")


def start_rerun(words: list[str]) -> subprocess.Popen[bytes]:
    """Start Rerun on the loopback interface, without output, unaffected by the terminal's Ctrl-C.

    Runs Rerun's binary, not its console script, which forks a viewer that would not be terminated.
    """
    package = importlib.util.find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise LocfuseError("the viewer is not installed; try: pip install rerun-sdk")
    program = Path(package.origin).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")
    command = [str(program), "--bind", HOST, *words]
    environment = {**os.environ, "RERUN_APP_ONLY": "true", "RUST_LOG": os.environ.get("RUST_LOG", "off")}
    nowhere = subprocess.DEVNULL
    try:
        return subprocess.Popen(
            command, env=environment, stdin=nowhere, stdout=nowhere, stderr=nowhere, start_new_session=True
        )
    except OSError as problem:
        raise LocfuseError(f"the viewer cannot be started: {problem.strerror}") from None


def free_port(wanted: int) -> int:
    """Return this port if it is free, else a free one."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise LocfuseError(f"no free port on {HOST}")


def _send_file(path: str, url: str) -> None:
    """Send a recording file to the viewer at `url`, with its application and recording id."""
    from locfuse.formats.rerun.recording import quiet_rust

    quiet_rust()
    import rerun as rr
    from rerun.chunk import RrdReader

    (first, *_) = RrdReader(path).recordings()
    stream = rr.RecordingStream(first.application_id, recording_id=first.recording_id, send_properties=False)
    stream.connect_grpc(url)
    stream.log_file_from_path(path)
    stream.flush()
    stream.disconnect()


if __name__ == "__main__":  # FILE URL
    try:
        _send_file(*sys.argv[1:3])
    except (RuntimeError, ValueError, OSError) as reason:
        sys.exit(str(reason).strip().splitlines()[0])
