"""Reports of results as JSON, Markdown, HTML, CSV and LaTeX, and summaries over several logs."""
