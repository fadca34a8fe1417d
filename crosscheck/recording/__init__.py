"""Recordings for the Rerun viewer, and pictures of them."""

import os
import sys

import pyarrow  # type: ignore[import-untyped]

# what goes wrong in Rerun is raised; its log on standard error would be a second voice
os.environ.setdefault("RUST_LOG", "off")


class _NoPandas:
    """Finder of modules that does not find pandas."""

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        if name == "pandas":
            raise ModuleNotFoundError(name)


# PyArrow, in which Rerun keeps what is logged, imports pandas with its first array, in case that is a table.
# A recording has none, and the import takes 0.2 s. PyArrow looks again for pandas where it needs it.
sys.meta_path.insert(0, _NoPandas)
pyarrow.array([0.0])
sys.meta_path.remove(_NoPandas)
