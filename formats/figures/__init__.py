"""Figures of a report: the content of each panel as values, and its renderers: SVG for a page, PDF for print."""
