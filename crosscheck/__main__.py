"""`python -m crosscheck`."""

import os
import sys

# Python puts the current folder first. Modules there that are called like others must not be imported.
if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(os.path.abspath(__file__))):
    del sys.path[0]

from crosscheck.cli import main

main()
