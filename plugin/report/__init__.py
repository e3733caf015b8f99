"""The report that people look at: its assembly, the HTML page and the terminal's lines."""
