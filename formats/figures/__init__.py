"""Figures of a report as values: what each panel shows, in which role and colour."""
