"""Versions by the names of folders are those of importlib.metadata, which is not imported for them."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from locfuse.formats import versions
from locfuse.formats.versions import installed, own


@pytest.mark.parametrize("name", ["locfuse", "numpy", "opencv-python-headless", "rerun-sdk", "Rosbags"])
def test_a_version_is_what_python_says(name: str) -> None:
    assert installed(name) == metadata.version(name)
    assert own() == metadata.version("locfuse")


def test_there_is_none_of_what_is_not_installed() -> None:
    assert installed("opencv-contrib-python-headless-of-nobody") is None


def test_of_two_the_first_counts_and_a_place_that_is_no_folder_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place, number in (("a", "1.0"), ("b", "2.0rc1")):
        (tmp_path / place / f"Some.Thing-{number}.dist-info").mkdir(parents=True)
    (tmp_path / "lib.zip").write_bytes(b"PK")
    monkeypatch.setattr(sys, "path", [str(tmp_path / name) for name in ("none", "lib.zip", "a", "b")])
    versions._by_folder.cache_clear()
    try:
        assert installed("some-thing") == "1.0"
    finally:
        versions._by_folder.cache_clear()


def test_nothing_slow_is_imported() -> None:
    code = "import sys, locfuse.formats.versions as v; v.own(); print('importlib.metadata' in sys.modules)"
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
