"""The omni-directional camera: from pictures to bearings of a red vertical landmark, with OpenCV."""
