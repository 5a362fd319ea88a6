"""The report: its tables, notes and words, as JSON, Markdown, HTML, CSV and LaTeX; summaries over logs."""
