"""The whole drive at once: smoothing backward, the graph of key poses with its loops, and references."""
