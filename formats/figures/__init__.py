"""Figures of a report: what each panel shows, as values, and how it is drawn: SVG for a page, PDF for print."""
