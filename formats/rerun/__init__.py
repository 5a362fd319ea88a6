"""Rerun recordings: their content as values, drawing, layout and saving."""
