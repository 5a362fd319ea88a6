"""`python -m locfuse.cli.rerun.send FILE.rrd URL`: send a recording to a running viewer.

A process of its own, because Rerun's connection cannot be made to give up (benchmarks: a port that accepts
and never answers holds `flush(timeout_sec=10)` for 59 s); who runs it sets the limit.
"""

from __future__ import annotations

import sys


def main(path: str, url: str) -> None:
    """Send the recording and its blueprint under their own names."""
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


if __name__ == "__main__":
    try:
        main(*sys.argv[1:3])
    except (RuntimeError, ValueError, OSError) as problem:
        sys.exit(str(problem).strip().splitlines()[0])
