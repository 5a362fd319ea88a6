"""Message types that are read as another type: scans out of clouds, joints out of what others call them."""
