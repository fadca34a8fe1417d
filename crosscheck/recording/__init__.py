"""3-D recordings of runs for the Rerun viewer (https://rerun.io), and pictures of the recordings."""

import os

# Rerun raises its errors; its log on standard error would print them a second time
os.environ.setdefault("RUST_LOG", "off")
