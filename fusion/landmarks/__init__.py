"""Landmarks with ids: what detectors say, range and bearing to a point, and where points are seen to stand."""
