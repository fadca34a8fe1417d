"""Compares engines on closed-loop mechanisms: scenes, comparison, recordings, figures."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crosscheck.report.outcome import Outcome
    from crosscheck.support.errors import CrosscheckError
    from crosscheck.sweeps.sweep import Sweep, sweep
    from crosscheck.verdict import Verdict, check
else:

    def __getattr__(name: str) -> Any:
        """Import what is exported when it is asked for.

        The command line sets the threads of BLAS before it imports NumPy.
        """
        if name not in __all__:
            raise AttributeError(f"module 'crosscheck' has no attribute {name!r}")
        if name in ("Sweep", "sweep"):
            from crosscheck.sweeps import sweep as module
        elif name == "CrosscheckError":
            from crosscheck.support import errors as module
        elif name == "Outcome":
            from crosscheck.report import outcome as module
        else:
            from crosscheck import verdict as module

        return getattr(module, name)


__all__ = ["CrosscheckError", "Outcome", "Sweep", "Verdict", "check", "sweep"]
