"""Panels drawn: as SVG for a page that can be hovered and zoomed, or by matplotlib for print."""
