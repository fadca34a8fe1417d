"""Methods of integration as plain Python, where an element beyond the end of an array is an error."""

from dataclasses import fields, replace

import numpy as np
import pytest

from crosscheck.library import load
from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.native import Record
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled.run import METHODS, Integrator
from newton_euler.integrators.options import FIXED, STABILIZATIONS, Options
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import Count
from newton_euler.runs.simulate import CompiledScene

OPTIONS = {name: {"step": 0.01} if name in FIXED else {"rtol": 1e-4} for name in METHODS}


def plain(argument, pause):
    """Convert an argument of native code for Python: vectors, native functions, no wish to stop."""
    if isinstance(argument, Record):
        values = {field.name: plain(getattr(argument, field.name), pause) for field in fields(argument)}
        return type(argument)(**values)
    if isinstance(argument, np.ndarray):
        return argument.reshape(-1)
    if argument is pause:
        return lambda counts, wish: None
    if not isinstance(argument, NativeFunction):
        return argument

    def call(x, y):
        size = argument.inputs * argument.lanes
        assert len(x) >= size
        given = x[:size].reshape(-1, argument.lanes)
        y[: argument.outputs * argument.lanes] = argument(given).ravel()

    return call


@pytest.mark.parametrize("stabilization", STABILIZATIONS)
@pytest.mark.parametrize(
    ("scene", "formulation"),
    [
        ("four_bar", "relative"),
        ("heavy_top", "relative"),
        ("pendulum", "cartesian"),
        ("heavy_top", "cartesian"),
    ],
)
@pytest.mark.parametrize("integrator", METHODS)
def test_methods_stay_within_their_arrays(monkeypatch, integrator, scene, formulation, stabilization):
    """Ten outputs of a scene of hinges and of one with Euler parameters, the same as in native code."""
    scene = load(scene)
    code = CompiledScene(replace(scene, duration=10.0 * scene.output_period), formulation, stabilization)
    options = Options(integrator, **OPTIONS[integrator])
    taken = []
    bind = NativeFunctions.bind

    def taking(self, function, *arguments):
        taken.append((function, arguments))
        return bind(self, function, *arguments)

    monkeypatch.setattr(NativeFunctions, "bind", taking)
    native, interpreted = (Integrator(code, code.scene.times, options) for _ in range(2))
    arguments = [each for function, each in taken if function is METHODS[integrator]][1]
    interpreted.x[:] = code.start
    METHODS[integrator](*(plain(each, interpreted._python.pause) for each in arguments))
    assert interpreted.counts[Count.STATUS] == Status.DONE
    native(code.start)
    # the same operations, but for sums and products that are rounded once in native code: what that changes
    # grows by less than a thousand in ten outputs; adaptive steps are then others, good to the tolerance
    close = 1e-12 if options.step else options.rtol
    assert interpreted.table == pytest.approx(native.table, rel=0.0, abs=close * np.abs(native.table).max())
