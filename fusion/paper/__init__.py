"""The paper's filter as printed: its equations, its measurement vector, its loop with a fixed period."""
