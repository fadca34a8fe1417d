"""Reports of results for the terminal, for files (JSON, Markdown, JUnit XML) and as HTML pages."""
