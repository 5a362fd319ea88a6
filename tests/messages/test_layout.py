"""Where fields lie in a message: sizes by a naive walk, bytes by rosbags, messages a byte too short or long."""

import struct
from typing import Any

import numpy as np
import pytest
from bags import build
from invented import decode, invented, walks, written
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.field_paths import paths
from locfuse.formats.messages import cdr
from locfuse.formats.messages.cdr import ROS1, Decoder
from locfuse.formats.messages.schema import parse
from locfuse.fusion.data import Ragged

RULE = "=" * 80 + "\nMSG: t/Inner\n"


TYPES = {
    "a text": "uint8 a\nstring b\nuint16 c",
    "texts": "string[] b\nuint8 c",
    "numbers at the end": "uint8 a\nfloat64[] b",
    "numbers amid": "uint16[] b\nuint8 c",
    "fixed numbers": "uint8 a\nfloat32[3] b\nuint8 c",
    "structures": f"Inner[] b\nuint8 c\n{RULE}uint8 x\nfloat64 y\n",
    "a fixed number of structures": f"uint8 a\nInner[2] b\nuint8 c\n{RULE}uint16 x\nuint8 y\n",
    "structures of 12 bytes that begin at 8": f"uint8 a\nInner[5] b\nuint8 c\n{RULE}float64 x\nfloat32 y\n",
    "structures of texts": f"Inner[] b\n{RULE}string x\n",
    "arrays in structures": f"Inner[] b\nuint8 c\n{RULE}float32[] x\n",
    "nothing": "",
    "structures of nothing": f"Inner[] b\nuint8 c\n{RULE}",
}
VALUES: dict[str, dict[str, Any]] = {
    "a text": {"b": "laser"},
    "texts": {"b": ["a", "", "bcd"]},
    "numbers at the end": {"b": [1.0, 2.0]},
    "numbers amid": {"b": [1, 2, 3]},
    "structures": {"b": [{"x": 1}, {"x": 2}, {"x": 3}]},
    "structures of texts": {"b": [{"x": "one"}, {"x": "three"}]},
    "arrays in structures": {"b": [{"x": [1, 2]}, {"x": []}, {"x": [3]}]},
}


def example(name: str, kind: str) -> tuple[Decoder, bytes]:
    """The decoder of one of the types, and a message by rosbags."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(TYPES[name], "t/msg/Top"))
    message = build("t/msg/Top", store, **VALUES.get(name, {}))
    if kind == "ros1":
        return Decoder(parse("t/Top", "ros1msg", TYPES[name], filler=False), ROS1), written(store, message, kind)
    return Decoder(parse("t/Top", "ros2msg", TYPES[name])), written(store, message, "little")


@pytest.mark.parametrize("kind", ["cdr", "ros1"])
@pytest.mark.parametrize("name", [n for n in TYPES if "nothing" not in n])
@pytest.mark.parametrize("wanted", [True, False])
def test_a_message_fills_its_bytes_but_for_padding(name: str, kind: str, wanted: bool) -> None:
    """Each message alone, so that it is walked and not compared with another."""
    decoder, whole = example(name, kind)
    fields = paths(decoder.message) if wanted else []

    def reasons(message: bytes) -> list[str]:
        return list(decode(Decoder(decoder.message, decoder.rules), [message], fields).bad)

    shortest = len(whole)
    while kind == "cdr" and not reasons(whole[: shortest - 1]):
        shortest -= 1  # rosbags pads the end
    assert shortest > len(whole) - 4
    spare = 3 if kind == "cdr" else 0
    for n in range(shortest):
        assert reasons(whole[:n]) == ["shorter than its type"], n
    for n in range(spare + 1):
        assert reasons(whole[:shortest] + bytes(n)) == []
    assert reasons(whole[:shortest] + bytes(spare + 1)) == ["longer than its type"]


@pytest.mark.parametrize("n", range(6))
def test_padding_behind_a_message_may_differ_from_message_to_message(n: int) -> None:
    decoder, whole = example("a text", "cdr")
    decoded = decode(decoder, [whole, whole + bytes(n), whole], ["b", "c"])
    assert decoded.columns["b"] == ["laser"] * int(decoded.good.sum())
    assert decoded.good.tolist() == [True, n <= 3, True]


def test_an_empty_message_takes_a_byte_in_ros_2_and_none_in_ros_1() -> None:
    """OMG DDS does without empty structures, so that ROS 2 puts a byte there."""
    for kind, message in (("cdr", b"\0\1\0\0\0"), ("ros1", b"")):
        decoder, _ = example("nothing", kind)
        assert decode(decoder, [message], []).good.all()
    decoder, _ = example("structures of nothing", "cdr")
    found = decode(decoder, [b"\0\1\0\0" + struct.pack("<I", 3) + bytes(3) + b"\x07"], ["c"])
    assert np.asarray(found.columns["c"]).tolist() == [7]
    assert paths(decoder.message) == ["c"]


@pytest.mark.parametrize(("length", "good"), [(4, True), (5, False)])
def test_a_text_has_a_cap(length: int, good: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the byte that ends it; whether it is wanted or not."""
    monkeypatch.setattr(cdr, "MAX_TEXT", 5)
    decoder = Decoder(parse("t/Top", "ros2msg", "string b"))
    message = b"\0\1\0\0" + struct.pack("<I", length + 1) + b"x" * length + b"\0"
    for fields in (["b"], []):
        found = decode(decoder, [message], fields)
        assert found.good.tolist() == [good]
        assert good or next(iter(found.bad)).startswith("a text longer than")


@pytest.mark.parametrize(("n", "good"), [(5, True), (6, False)])
def test_texts_and_structures_of_their_own_length_have_a_cap_together(
    n: int, good: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cdr, "MAX_ITEMS", 10)
    decoder = Decoder(parse("t/Top", "ros2msg", "string[] a\nstring[] b"))
    strings = struct.pack("<I", n) + struct.pack("<I", 0) * n
    few = struct.pack("<I", 5) + struct.pack("<I", 0) * 5
    for fields in (["a"], []):
        assert decode(decoder, [b"\0\1\0\0" + strings + few], fields).good.tolist() == [good]


def test_structures_of_a_fixed_size_have_no_cap_and_absurd_arrays_are_refused_unwalked() -> None:
    decoder = Decoder(parse("t/Top", "ros2msg", f"Inner[] b\n{RULE}uint8 x\n"))
    n = 200_000
    message = b"\0\1\0\0" + struct.pack("<I", n) + bytes(n)
    assert decode(decoder, [message], []).good.all()
    decoder = Decoder(parse("t/Top", "ros2msg", f"Inner[] b\n{RULE}float64[1000] x\n"))
    message = b"\0\1\0\0" + struct.pack("<I", 3) + bytes(4 + 2 * 8000)
    for fields in (["b.x.length"], []):
        assert list(decode(decoder, [message], fields).bad) == ["shorter than its type"]


@pytest.mark.parametrize("kind", [b"\0\2", b"\1\1", b"\0\3", b"\1\0"])
def test_only_plain_cdr_is_read(kind: bytes) -> None:
    decoder = Decoder(parse("t/Top", "ros2msg", "uint8 b"))
    assert list(decode(decoder, [kind + b"\0\0\7"], ["b"]).bad) == ["not plain CDR"]
    for short in (b"", b"\0", b"\0\1\0"):
        assert list(decode(decoder, [short], ["b"]).bad) == ["shorter than its type"]


def texts(*lengths: int) -> list[bytes]:
    """Messages of one text of each length, and a number behind it."""
    found = []
    for n in lengths:
        text = struct.pack("<I", n + 1) + b"x" * n + b"\0"
        found.append(b"\0\1\0\0" + text + bytes(-len(text) % 4) + struct.pack("<I", n))
    return found


def test_however_many_layouts_there_are_every_message_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to a number of them a layout is tried on all messages that are left, and kept for the next chunk."""
    walked = walks(monkeypatch)
    monkeypatch.setattr(cdr, "MAX_GROUPS", 3)
    monkeypatch.setattr(cdr, "MAX_LAYOUTS", 2)
    lengths = [4, 9, 14, 19, 24, 4, 9, 14, 19, 24]
    decoder = Decoder(parse("t/Top", "ros2msg", "string a\nuint32 b"))
    for chunk, count in enumerate((7, 3)):
        walked.clear()
        found = decode(decoder, texts(*lengths), ["a", "b"])
        assert found.columns["a"] == ["x" * n for n in lengths]
        assert np.asarray(found.columns["b"]).tolist() == lengths
        assert len(walked) == count, chunk


def test_length_words_are_compared_in_pieces_of_a_bounded_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texts of swapped lengths take the same bytes: every single message must be compared."""
    monkeypatch.setattr(cdr, "MAX_GATHERED_WORDS", 6)
    decoder = Decoder(parse("t/Top", "ros2msg", "string a\nstring b"))
    pairs = [("xxx", "yyyyyyy"), ("xxxxxxx", "yyy")]
    said = [pairs[i % 3 == 2] for i in range(17)]
    raw = [
        b"\0\1\0\0" + b"".join(struct.pack("<I", len(one) + 1) + one.encode() + b"\0" for one in pair)
        for pair in said
    ]
    found = decode(decoder, raw, ["a", "b"])
    assert list(zip(*found.columns.values(), strict=True)) == said


@pytest.mark.parametrize("seed", range(20))
def test_columns_of_no_message_are_of_the_kind_that_those_of_messages_are(seed: int) -> None:
    text, store, (message,) = invented(1000 + seed, 1)
    raw = written(store, message, "little")
    decoder = Decoder(parse("t/Top", "ros2msg", text))
    names = paths(decoder.message)
    one, none = (decode(decoder, some, names).columns for some in ([raw], []))
    for name in names:
        full, empty = one[name], none[name]
        assert type(full) is type(empty), name
        assert len(empty) == 0
        if isinstance(full, np.ndarray) and isinstance(empty, np.ndarray):
            assert (full.dtype, full.shape[1:]) == (empty.dtype, empty.shape[1:])
        if isinstance(full, Ragged) and isinstance(empty, Ragged):
            assert full.values.dtype == empty.values.dtype
