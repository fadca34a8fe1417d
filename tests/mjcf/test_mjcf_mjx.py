"""Runs whose steps MJX takes, against those of MuJoCo in C; what MJX cannot simulate."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mjcf
from crosscheck.library import load
from mjcf.errors import MjcfError
from newton_euler.errors import MissingPackageError, OptionError, UnknownNameError


@pytest.mark.parametrize(
    ("options", "kind", "word"),
    [
        ({"backend": "mjx"}, UnknownNameError, "C, MJX"),
        ({"backend": "MJX", "integrator": "implicit"}, OptionError, "RK4, Euler or implicitfast"),
        ({"backend": "MJX", "solver": "PGS"}, OptionError, "Newton or CG"),
    ],
)
def test_options_that_mjx_lacks(options: dict[str, Any], kind: type[Exception], word: str) -> None:
    with pytest.raises(kind, match=word):
        mjcf.simulate(load("pendulum"), **options)


@pytest.mark.parametrize(
    ("scene", "outputs", "word"),
    [
        ("tracker", {"energy"}, "leave it out of the outputs"),
        ("tracker_wind", set(), "calls no Python"),
        ("tracker_on_boat", set(), "motion of joint"),
    ],
)
def test_scenes_that_need_python(scene: str, outputs: set[str], word: str) -> None:
    with pytest.raises(MjcfError, match=word):
        mjcf.simulate(replace(load(scene), outputs=frozenset(outputs)), backend="MJX")


def test_missing_mjx(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(MissingPackageError) as caught:
        mjcf.simulate(load("pendulum"), backend="MJX")
    assert (caught.value.package, caught.value.extra) == ("mujoco.mjx", "mjx")


def test_mjx_takes_the_same_steps() -> None:
    """MJX in 64-bit numbers differs by round-off; JAX has its default of 32 bits afterwards."""
    pytest.importorskip("mujoco.mjx")
    import jax.numpy

    scene = replace(load("pendulum"), duration=0.2, output_period=0.1)
    in_c, in_mjx = (mjcf.simulate(scene, backend=name) for name in ("C", "MJX"))  # type: ignore[arg-type]
    assert [run.settings["backend"] for run in (in_c, in_mjx)] == ["C", "MJX"]
    assert np.max(np.abs(in_mjx.position - in_c.position)) < 1e-14
    assert np.max(np.abs(in_mjx.position - in_mjx.position[0])) > 0.01
    assert jax.numpy.zeros(1).dtype == np.float32
