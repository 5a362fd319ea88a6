"""Message definitions, and decoding of serialised messages into columns."""
