"""Figures of a report: panels as values, drawn as SVG for a page, and as SVG and PDF for print."""
