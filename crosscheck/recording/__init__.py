"""Recordings for the Rerun viewer, and pictures of them."""

import os

# what goes wrong in Rerun is raised; its log on standard error would be a second voice
os.environ.setdefault("RUST_LOG", "off")
