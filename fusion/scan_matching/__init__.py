"""Scan matching: point clouds with surface normals, point-to-line matching, key scans, pose-graph solver."""
