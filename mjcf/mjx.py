"""MJX, MuJoCo's time stepping in JAX, as another way to take the steps of `mjcf.simulate`.

MJX compiles the steps of a model before the first one, which takes from ten seconds to a minute. It calls no
Python during steps, and lacks an integrator and a constraint solver of MuJoCo. Scenes that need more are
refused.

Open trees have the steps of MuJoCo to round-off. Loops do not: at moving states, the reference accelerations
of loop constraints in MJX 3.17 are not those of MuJoCo 4.0, so that accelerations of the moving tracker
differ by up to 3 %, and its coordinates by 8e-6 m after 100 steps of 1 ms.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from mjcf.errors import MjcfError
from mjcf.forces import wind_loads
from mjcf.soft import SoftMuJoCo
from newton_euler.errors import (
    DISTRIBUTION,
    MissingPackageError,
    OptionError,
    UnusablePackageError,
    one_line,
)
from newton_euler.optional_packages import version_of

EXTRA = "mjx"
"""Name of the optional dependencies (`pip install crosscheck-dynamics[mjx]`)."""

REQUIREMENTS = ("jax>=0.10", "mujoco-mjx>=3.17")
"""Requirements of the packages that `EXTRA` installs."""


class MjxSteps:
    """Steps of a compiled scene by MJX, in 64-bit numbers."""

    def __init__(self, system: SoftMuJoCo) -> None:
        """Prepare the steps.

        Raises:
            MissingPackageError: if MJX is not installed.
            UnusablePackageError: if MJX is too old, or cannot be imported.
            MjcfError: for a scene that needs Python at every step, or an element that MJX lacks.
        """
        _refuse_python(system)
        self._system = system
        self._jax, self._mjx = _imported()

    def advance(self, number: int) -> None:
        """Take steps from the state in the system's `data`, and write the new state and time there.

        64-bit numbers are enabled during the call only, as other users of JAX in the process may not want
        them.

        Raises:
            MjcfError: for an element that MJX lacks.
            UnusablePackageError: if the versions of MJX and MuJoCo do not match.
        """
        model, data = self._system.model, self._system.data
        with self._jax.enable_x64(True):
            try:
                on_device = self._mjx.put_model(model), self._mjx.put_data(model, data)
            except NotImplementedError as error:
                raise MjcfError(
                    f"scene {self._system.scene.name!r}: MJX lacks an element: {error}"
                ) from error
            except (AttributeError, TypeError) as error:  # of models with other attributes
                raise _unusable("cannot take a model of MuJoCo", error) from error
            end = _compiled_steps()(*on_device, number)
            for name in ("qpos", "qvel", "qacc_warmstart"):
                getattr(data, name)[:] = getattr(end, name)
            data.time = float(end.time)


def _imported() -> tuple[Any, Any]:
    """Import JAX and MJX; for the errors see `MjxSteps`."""
    try:
        for requirement in REQUIREMENTS:
            version_of(requirement)
    except PackageNotFoundError as error:
        raise MissingPackageError(error.name, EXTRA) from error
    try:
        import jax
        from mujoco import mjx
    except Exception as error:  # jax raises a RuntimeError for another version of jaxlib
        raise _unusable("cannot be imported", error) from error
    return jax, mjx


def _unusable(problem: str, error: Exception) -> UnusablePackageError:
    """Return the error for MJX in versions that do not match, with all versions that were found."""
    found = list[str]()
    for package in ("jax", "jaxlib", "mujoco-mjx", "mujoco"):
        with suppress(PackageNotFoundError):
            found.append(f"{package} {version(package)}")
    reason = one_line(str(error)).rstrip(".") or type(error).__name__
    problem = f"{problem}: {reason} (found: {', '.join(found)})"
    return UnusablePackageError("MJX", problem, f"{DISTRIBUTION}[{EXTRA}]")


@cache
def _compiled_steps() -> Any:
    """Return a function of MJX's model, data and a number of steps; JAX compiles it once for each model."""
    jax, mjx = _imported()

    def steps(model: Any, data: Any, number: Any) -> Any:
        """Take a number of steps."""
        return jax.lax.fori_loop(0, number, lambda _, each: mjx.step(model, each), data)

    return jax.jit(steps)


def check_options(integrator: str, solver: str) -> None:
    """Raise `OptionError` for an integrator or a constraint solver that MJX does not have."""
    if integrator == "implicit":
        raise OptionError("integrator", integrator, "RK4, Euler or implicitfast with MJX")
    if solver == "PGS":
        raise OptionError("solver", solver, "Newton or CG with MJX")


def _refuse_python(system: SoftMuJoCo) -> None:
    """Raise `MjcfError` for the first element of a scene that Python evaluates at every step."""
    scene = system.scene
    elements = [f"motion of joint {motion.joint!r}" for motion in scene.motions]
    elements += [scene.control[k].element for k in system.driven.law_indices]
    evaluated = (*system.evaluated.values(), *wind_loads(scene), *scene.switched_forces)
    elements += [each.element for each in evaluated]
    if scene.tracks_work:
        raise MjcfError(
            f"scene {scene.name!r}: MJX does not integrate the work of forces, which the output 'energy' of "
            "this scene needs; leave it out of the outputs"
        )
    for element in elements:
        raise MjcfError(f"{element}: MJX has no such element, and calls no Python at its steps")
