"""The report: JSON, Markdown, HTML, CSV, LaTeX, and summaries over logs."""
