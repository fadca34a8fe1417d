"""What the figures of the library's scenes were, a file for each scene; `crosscheck regress` reads them."""
