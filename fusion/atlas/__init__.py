"""A building as many small line maps: each begins at an anchor, and a graph of anchors holds them together."""
