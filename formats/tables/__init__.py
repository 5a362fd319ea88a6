"""The tables of a report, its notes and its words, for every medium: terminal, Markdown, HTML, CSV, LaTeX."""
