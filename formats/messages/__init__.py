"""Message definitions and decoding: bytes of many messages into columns."""
