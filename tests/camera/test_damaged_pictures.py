"""What libjpeg says of damage reaches us and not the terminal."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse
from hostile import Put, write

from locfuse.fusion.camera import images
from locfuse.fusion.camera.decoder_words import listened, tells_of_damage
from locfuse.fusion.camera.opencv import cv2

GREEN = np.full((200, 300, 3), (40, 160, 60), np.uint8)


def jpeg(seed: int = 0) -> bytes:
    noise = np.random.default_rng(seed).integers(0, 40, GREEN.shape, np.uint8)
    return bytes(cv2.imencode(".jpg", GREEN + noise)[1])


def dented(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + data[middle + 40 :]


def cut(data: bytes) -> bytes:
    return data[: len(data) // 2] + b"\xff\xd9"


@pytest.mark.parametrize("damage", [dented, cut])
def test_a_damaged_picture_is_not_whole_and_the_terminal_stays_quiet(
    damage: Callable[[bytes], bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    assert images.compressed(damage(jpeg()), "jpeg") == images.NOT_WHOLE
    assert capfd.readouterr().err == ""


def test_bytes_behind_the_picture_are_no_damage(capfd: pytest.CaptureFixture[str]) -> None:
    """Some cameras pad the data in front of the end mark."""
    whole = jpeg()
    padded = whole[:-2] + b"\x00\x01\x02" + whole[-2:]
    found = images.compressed(padded, "jpeg")
    assert not isinstance(found, str)
    np.testing.assert_array_equal(found, images.compressed(whole, "jpeg"))
    assert capfd.readouterr().err == ""


def test_in_many_threads_the_damaged_one_is_found_and_no_other() -> None:
    """Cut in two, so that libjpeg hears of each; some dents it steps over in silence."""
    pictures = [cut(jpeg(i)) if i % 7 == 3 else jpeg(i) for i in range(60)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda data: images.compressed(data, "jpeg"), pictures))
    bad = [i for i, one in enumerate(found) if isinstance(one, str)]
    assert bad == [i for i in range(60) if i % 7 == 3]


def test_stderr_is_where_it_was_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    def fails() -> None:
        os.write(2, b"a library's words\n")
        raise ValueError("no picture")

    with pytest.raises(ValueError, match="no picture"):
        listened(fails)
    os.write(2, b"ours\n")
    assert capfd.readouterr().err == "ours\n"


def test_only_words_about_the_picture_count() -> None:
    assert tells_of_damage(b"Corrupt JPEG data: premature end of data segment\n")
    assert not tells_of_damage(b"Corrupt JPEG data: 3 extraneous bytes before marker 0xd9\n")
    assert tells_of_damage(b"Corrupt JPEG data: 900 extraneous bytes before marker 0xd9\n")
    assert not tells_of_damage(b"some other thread's words\n")


def test_a_log_with_damaged_pictures_counts_them(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def dent(put: Put) -> Put:
        if "image" not in put.topic:
            return put
        return put._replace(data=put.data[:-900] + bytes(20) + put.data[-880:])

    log = write(tmp_path / "f.mcap", dent, seconds=4.0)
    done = locfuse("run", log, "-o", tmp_path / "o")
    assert done.exit_code == 3
    assert "not whole" in done.stderr
    assert "JPEG" not in capfd.readouterr().err
