"""crosscheck: simulate a closed-loop mechanism in several dynamics engines, and compare the results.

The public names are `check` with its `Verdict` and `Outcome`, and `Log`, a run of another simulator. `tune`
with its `Tuning` finds the cheapest settings of an engine for an error. `diff` with its `Diff` compares two
model files, `importers` with its `Importers` compares what the importers of the engines read in one. `sweep`
with its `Sweep` makes Monte Carlo and design-of-experiments studies. `CrosscheckError` is the base class of
errors.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crosscheck.compare.outcome import Outcome
    from crosscheck.logs.judge import Log
    from crosscheck.one_file import Importers, importers
    from crosscheck.support.errors import CrosscheckError
    from crosscheck.sweeps.sweep import Sweep, sweep
    from crosscheck.tuning import Tuning, tune
    from crosscheck.two_files import Diff, diff
    from crosscheck.verdict import Verdict, check
else:

    def __getattr__(name: str) -> Any:
        """Import a public name when it is first used.

        The command line has to set the number of BLAS threads before NumPy is imported, so importing this
        package must not import NumPy.
        """
        if name not in __all__:
            raise AttributeError(f"module 'crosscheck' has no attribute {name!r}")
        if name in ("Sweep", "sweep"):
            from crosscheck.sweeps import sweep as module
        elif name in ("Tuning", "tune"):
            from crosscheck import tuning as module
        elif name in ("Diff", "diff"):
            from crosscheck import two_files as module
        elif name in ("Importers", "importers"):
            from crosscheck import one_file as module
        elif name == "CrosscheckError":
            from crosscheck.support import errors as module
        elif name == "Log":
            from crosscheck.logs import judge as module
        elif name == "Outcome":
            from crosscheck.compare import outcome as module
        else:
            from crosscheck import verdict as module

        return getattr(module, name)


__all__ = [
    "CrosscheckError",
    "Diff",
    "Importers",
    "Log",
    "Outcome",
    "Sweep",
    "Tuning",
    "Verdict",
    "check",
    "diff",
    "importers",
    "sweep",
    "tune",
]
