"""Tables of results in the terminal, as files and as pages."""
