"""Figures of the library's scenes, a file for each scene; `crosscheck regress` reads them."""
