"""The paper's filter as printed: its equations, its measurement vector, its lock-step loop."""
