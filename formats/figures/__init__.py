"""Figures of a report: panels as values, drawn as SVG for the page or by matplotlib for a paper."""
