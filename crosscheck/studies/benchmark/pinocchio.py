"""Pinocchio in its cheapest ways, for benchmarks; see `urdf.tight`.

The time of a run is the march, forward kinematics at every output and a copy of where all joints are then:
translations and rotation matrices, as Pinocchio has them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from crosscheck.studies.benchmark.work_precision import Ladder, Model, Models, Run, Setting, intervals
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from urdf.tight import Equations

ALPHAS = (0.0, 3.0, 10.0)
"""1/s, of Baumgarte's gains. On the tracker 30 is no better than 10, and 100 is stiff."""

LCABA = ((1e-6, 1), (1e-6, 2))
"""Regularisations of `lcaba`, which always needs one and knows no Baumgarte gains. A third iteration gains
nothing on the tracker."""

LCABA_RTOL = 1e-9
"""Its accelerations are no smoother than this, and methods with error control stall on the noise."""

TIGHTEST = 3e-14
"""Tightest rtol: scipy's own limit is 2.2e-14."""

STEPS = (1, 2, 5, 10, 20)
"""Fixed steps from one output to the next."""

March = Callable[[], tuple[Array, int]]
"""Coordinates at all outputs, and how many evaluations it took."""


def models(scene: Scene) -> Models:
    """Pinocchio's models of a scene: one for each Baumgarte gain and algorithm."""
    found: dict[str, Callable[[], Model]] = {}
    for alpha in ALPHAS:
        found[f"constraintDynamics, alpha {alpha:g}"] = partial(_load, scene, alpha, None)
    for mu, iterations in LCABA:
        found[f"lcaba, mu {mu:g} x {iterations}"] = partial(_load, scene, 0.0, (mu, iterations))
    return found


def _load(scene: Scene, alpha: float, lcaba: tuple[float, int] | None) -> Model:
    from urdf.tight import equations_of

    equations = equations_of(scene, alpha, lcaba)
    if lcaba:
        prefix = f"lcaba, mu {lcaba[0]:g} x {lcaba[1]}"
        ladders = [
            _lsoda(equations, prefix, 1.0, LCABA_RTOL),
            _scipy(equations, prefix, "DOP853", range(2, 9)),
        ]
    else:
        prefix = f"constraintDynamics, alpha {alpha:g}"
        ladders = [_lsoda(equations, prefix, 1.0, TIGHTEST), _lsoda(equations, prefix, 1e-2, TIGHTEST)]
        if alpha != ALPHAS[1]:
            ladders.append(_scipy(equations, prefix, "DOP853", range(2, 14)))
        if alpha == 0.0:
            ladders.append(_scipy(equations, prefix, "Radau", range(2, 7)))
        if alpha == ALPHAS[-1]:
            ladders.append(_scipy(equations, prefix, "RK45", range(2, 10)))
            ladders.append(_fixed(equations, prefix, "RK4"))
            ladders.append(_fixed(equations, prefix, "Euler"))
    return Model(tuple(ladders), "URDF written and read, model built")


def _lsoda(equations: Equations, prefix: str, share: float, tightest: float) -> Ladder:
    """LSODA with atol = share rtol."""
    from urdf.tight import lsoda

    settings = []
    for rtol in (base * 10.0**-power for power in range(1, 14) for base in (1.0, 0.3)):
        if rtol >= tightest:
            march = partial(lsoda, equations, rtol, share * rtol)
            settings.append(Setting(f"rtol {rtol:.0e}", _runner(equations, march)))
    return Ladder(f"{prefix}, LSODA, atol = {share:g} rtol", tuple(settings))


def _scipy(equations: Equations, prefix: str, name: str, powers: range) -> Ladder:
    from urdf.tight import scipy_solver

    settings = []
    for power in powers:
        rtol = 10.0**-power
        march = partial(scipy_solver, equations, name, rtol, 0.01 * rtol)
        settings.append(Setting(f"rtol {rtol:.0e}", _runner(equations, march)))
    return Ladder(f"{prefix}, {name}, atol = 0.01 rtol", tuple(settings))


def _fixed(equations: Equations, prefix: str, name: str) -> Ladder:
    from urdf.tight import fixed

    settings = []
    times = equations.system.scene.times
    for number in STEPS:
        march = partial(fixed, equations, name, intervals(times), number)
        step = float(times[1] - times[0]) / number
        settings.append(Setting(f"step {step:.3g} s", _runner(equations, march)))
    return Ladder(f"{prefix}, {name}", tuple(settings))


def _runner(equations: Equations, march: March) -> Callable[[], Run]:
    from urdf.tight import Kinematics

    kinematics = Kinematics(equations)

    def run() -> Run:
        start = time.perf_counter()
        rows, evaluations = march()
        placements = kinematics(rows)
        seconds = time.perf_counter() - start
        return Run(seconds, evaluations, partial(kinematics.poses, placements))

    return run
