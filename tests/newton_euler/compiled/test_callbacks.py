"""Errors in Python that native code calls end the run and reach the caller."""

from __future__ import annotations

import numpy as np
import pytest
from overconstrained import linkage

from newton_euler import simulate, simulate_batch
from newton_euler.compiled import records
from newton_euler.compiled.callbacks import Callbacks
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.run import Integrator
from newton_euler.integrators.options import Options
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, STOP_ALL_RUNS, Count
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state


def raising(error):
    def function(*arguments):
        raise error

    return function


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
def test_an_exchange_of_rows_that_fails_ends_the_run(monkeypatch, capfd, integrator):
    monkeypatch.setattr(records, "exchanged", raising(np.linalg.LinAlgError("SVD did not converge")))
    scene = linkage("bennett")
    with pytest.raises(IntegrationError, match="SVD did not converge") as caught:
        simulate(scene, integrator=integrator, rtol=1e-6, atol=1e-8)
    assert 0.0 <= caught.value.time < scene.duration
    assert capfd.readouterr() == ("", "")


def test_an_exchange_of_rows_that_fails_in_a_lane_ends_its_run(monkeypatch, capfd):
    monkeypatch.setattr(records, "exchanged", raising(np.linalg.LinAlgError("SVD did not converge")))
    scene = linkage("bennett")
    errors = simulate_batch(scene, [scene.initial_state] * 5).errors
    assert list(errors) == [0, 1, 2, 3, 4]
    assert all(isinstance(error, IntegrationError) for error in errors.values())
    assert all("SVD did not converge" in str(error) for error in errors.values())
    assert capfd.readouterr() == ("", "")


def test_a_mistake_of_the_program_is_raised_as_it_is(monkeypatch):
    mistake = ZeroDivisionError("division by zero")
    monkeypatch.setattr(records, "exchanged", raising(mistake))
    with pytest.raises(ZeroDivisionError) as caught:
        simulate(linkage("bennett"))
    assert caught.value is mistake


@pytest.mark.parametrize(
    ("status", "quoted"), [(Status.SINGULAR, True), (Status.OPEN, False), (Status.STEP_TOO_SMALL, False)]
)
def test_an_error_that_a_run_recovered_from_is_not_its_reason(monkeypatch, status, quoted):
    """Projection that fails long after the dense form did has a reason of its own."""
    scene = linkage("bennett")
    code = CompiledEquations(scene, "relative")
    integrator = Integrator(code, scene.times, Options())

    def ended():
        integrator.counts[Count.STATUS] = status
        integrator._python.error = np.linalg.LinAlgError("of a state before")

    monkeypatch.setattr(integrator, "_run", ended)
    with pytest.raises(IntegrationError) as caught:
        integrator(code.packed(*code.system.coordinates(initial_state(scene))))
    assert ("of a state before" in caught.value.reason) == quoted


def test_an_error_of_a_state_is_forgotten_at_the_next_one_that_has_an_answer():
    """The method has avoided it; what ends the run stays."""
    callbacks, errors, marked = Callbacks(np.zeros(COUNTS)), [np.linalg.LinAlgError("a")], []

    def function(x, y, on):
        if errors:
            raise errors.pop()

    callback = callbacks.guarded(function, lambda y, on: marked.append((y, on))).function
    callback(1, 2, 3)
    assert (str(callbacks.error), callbacks.fatal, marked) == ("a", None, [(2, 3)])
    assert callbacks.counts[Count.STOP_REQUEST] == 0.0
    callback(1, 2, 3)
    assert callbacks.error is None
    errors.append(MemoryError("b"))
    callback(1, 2, 3)
    callback(1, 2, 3)
    assert (str(callbacks.fatal), len(marked)) == ("b", 2)
    assert callbacks.counts[Count.STOP_REQUEST] == STOP_ALL_RUNS
