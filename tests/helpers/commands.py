"""Run the command line in this process: exit code, stdout, stderr, as a user would see them."""

from __future__ import annotations

import contextlib
import io
import signal
from dataclasses import dataclass
from typing import Any

from locfuse.cli.main import main


@dataclass(frozen=True)
class Done:
    exit_code: int
    stdout: str
    stderr: str


def locfuse(*words: Any) -> Done:
    out, err = io.StringIO(), io.StringIO()
    handler = signal.getsignal(signal.SIGTERM)
    code = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main([str(w) for w in words])
    except SystemExit as e:
        code = int(e.code or 0)
    finally:
        signal.signal(signal.SIGTERM, handler)
    return Done(code, out.getvalue(), err.getvalue())


def ok(*words: Any) -> Done:
    """Run what must succeed."""
    done = locfuse(*words)
    assert done.exit_code == 0, done.stderr
    return done
