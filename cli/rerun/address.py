"""Where a viewer listens: apart from the viewer, since the options of every `run` name it."""

from __future__ import annotations

import re

ADDRESS = re.compile(r"rerun(?:\+https?)?://(?P<host>\[[^\]/]+\]|[^/:@]+)(?::(?P<port>\d{1,5}))?/proxy")
HOST, PORT = "127.0.0.1", 9876
LOCAL_VIEWER = f"rerun+http://{HOST}:{PORT}/proxy"
