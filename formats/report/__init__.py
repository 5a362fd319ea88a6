"""Reports of results as JSON, Markdown, HTML, CSV and LaTeX, of one log and of many."""
