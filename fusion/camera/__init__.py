"""The omni-directional camera: from pictures to the bearing of a red vertical landmark. OpenCV lives here."""
