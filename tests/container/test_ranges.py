"""Ranges of bytes: what is fetched together, what is kept, and what an address names."""

from __future__ import annotations

import random

import pytest

from locfuse.formats.container.remote_objects import Ranges, cut, joined
from locfuse.formats.container.url import Url, is_url, place
from locfuse.fusion.data import UsageError


def test_ranges_that_lie_close_are_fetched_together_and_others_are_not() -> None:
    assert list(joined([(100, 110), (0, 10), (10, 20)], gap=10)) == [(0, 20), (100, 110)]
    assert list(joined([(0, 10), (20, 30), (41, 50)], gap=10)) == [(0, 30), (41, 50)]
    assert list(joined([(0, 100), (10, 20)])) == [(0, 100)]
    assert list(joined([])) == []
    assert list(cut([(0, 25)], size=10)) == [(0, 10), (10, 20), (20, 25)]


def test_joined_ranges_hold_all_that_is_wanted_and_little_more() -> None:
    rng = random.Random(4)
    for _ in range(50):
        spans = [(a, a + rng.randint(1, 50)) for a in rng.sample(range(5000), 40)]
        found = list(joined(spans, gap=7))
        wanted = {i for a, b in spans for i in range(a, b)}
        held = [i for a, b in found for i in range(a, b)]
        assert wanted <= set(held)
        assert len(held) == len(set(held))
        assert len(held) - len(wanted) <= 7 * len(spans)


def test_what_is_kept_is_given_back_over_the_seams_and_the_oldest_goes_first() -> None:
    data = bytes(range(100))
    kept = Ranges(capacity=50)
    kept.put(0, data[:20])
    kept.put(20, data[20:40])
    assert kept.get(15, 25) == data[15:25]
    assert kept.get(35, 45) is None
    assert kept.get(0, 5) == data[:5]  # used last
    kept.put(60, data[60:80])
    assert kept.get(20, 21) is None
    assert kept.get(0, 20) == data[:20]
    assert kept.get(61, 80) == data[61:80]


def test_an_address_has_a_store_a_key_and_a_name() -> None:
    url = Url("s3://bucket/day 1/drive.mcap")
    assert (url.root, url.key, url.name) == ("s3://bucket", "day 1/drive.mcap", "drive.mcap")
    assert str(url.parent) == "s3://bucket/day 1/"
    assert url.parent.is_folder
    assert Url("https://host:8080/a%20b.mcap").key == "a b.mcap"
    assert place("s3://bucket/a.mcap") == Url("s3://bucket/a.mcap")
    assert not is_url("C:/logs/a.mcap")
    assert not is_url("logs/s3/a.mcap")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("ftp://host/a.mcap", "logs are read from s3"),
        ("https://me:secret@host/a.mcap", "no passwords"),
        ("https://host/a.mcap?X-Amz-Signature=secret", "with ? or #"),
        ("s3:///a.mcap", "which bucket"),
    ],
)
def test_an_address_that_cannot_be_read_is_refused_without_its_secrets(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=r".") as refused:
        Url(text)
    assert said in str(refused.value)
    assert "secret" not in str(refused.value)
