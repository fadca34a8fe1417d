"""Run the command line for `python -m crosscheck`."""

import os
import sys

# Python puts the current folder first in `sys.path`. Modules there must not hide installed modules of the
# same name. The folder stays if it contains this package.
if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(os.path.abspath(__file__))):
    del sys.path[0]

from crosscheck.cli import main

main()
