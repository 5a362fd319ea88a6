"""Addresses of remote logs: an object in a bucket, or a file on a web server."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote

import msgspec

from locfuse.fusion.data import UsageError

SCHEMES = ("s3", "s3a", "gs", "az", "adl", "azure", "abfs", "abfss", "http", "https")
ADDRESS = re.compile(r"(?P<scheme>[a-z][a-z0-9+.-]*)://(?P<place>[^/?#]*)(?P<key>.*)", re.DOTALL)
WEB = ("http", "https")


class Url(msgspec.Struct, frozen=True, order=True):
    """Address of one remote object; an address that ends in "/" is that of a folder of objects."""

    text: str

    def __post_init__(self) -> None:
        """Raise UsageError for an unknown scheme, a password, a query or a missing host."""
        if self.scheme not in SCHEMES:
            raise UsageError(f"{self.scheme}://: unknown; logs are read from {', '.join(SCHEMES)}")
        if "@" in self.host and self.scheme in WEB:
            raise UsageError(f"{self.scheme}://...@{self.host.rpartition('@')[2]}: no passwords in addresses")
        if self.scheme in WEB and re.search(r"[?#]", self.text):
            raise UsageError(
                f"{self.text.partition('?')[0]}: an address with ? or # is not read; give a plain one"
            )
        if not self.host:
            raise UsageError(f"{self.text}: which bucket or server? Write it like s3://bucket/drive.mcap")

    @property
    def scheme(self) -> str:
        """The scheme: "s3", "https", ..."""
        return self.text.partition("://")[0]

    @property
    def root(self) -> str:
        """The address of the bucket or server: "s3://bucket"."""
        return f"{self.scheme}://{self.host}"

    @property
    def host(self) -> str:
        """The name of the bucket or server."""
        return re.split(r"[/?#]", self.text.partition("://")[2])[0]

    @property
    def key(self) -> str:
        """The path of the object in its bucket or server, without a leading "/"."""
        key = self.text.removeprefix(self.root).lstrip("/")
        return unquote(key) if self.scheme in WEB else key

    @property
    def name(self) -> str:
        """The last part of the key."""
        return self.key.rstrip("/").rpartition("/")[2]

    @property
    def parent(self) -> Url:
        """The folder of this object."""
        return Url(self.text.rstrip("/").rpartition("/")[0] + "/")

    @property
    def is_folder(self) -> bool:
        """Whether this is the address of a folder."""
        return self.text.endswith("/") or not self.key

    def at(self, key: str) -> Url:
        """Return the object with another key in the same bucket or server."""
        return Url(f"{self.root}/{key}")

    def __str__(self) -> str:
        """Return the address as given."""
        return self.text


Place = Path | Url  # a local file or a remote object


def is_url(word: str) -> bool:
    """Return whether a command-line argument is an address (scheme://...)."""
    return ADDRESS.fullmatch(word) is not None


def place(word: str) -> Place:
    """Return a command-line argument as a local path or an address. Raises UsageError for an invalid address."""
    return Url(word) if is_url(word) else Path(word)
