"""Runs whose steps MJX takes, against those of MuJoCo in C; what MJX cannot simulate."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mjcf
from crosscheck.library import load
from mjcf import mjx
from mjcf.errors import MjcfError
from newton_euler.errors import MissingPackageError, OptionError, UnknownNameError, UnusablePackageError


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


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A function that installs packages before all others: versions, and the code of the module jax."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(code: str = "", **versions: str) -> None:
        for name, found in versions.items():
            folder = tmp_path / f"{name}-{found}.dist-info"
            folder.mkdir()
            folder.joinpath("METADATA").write_text(
                f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: {found}\n"
            )
        tmp_path.joinpath("jax.py").write_text(code)
        monkeypatch.delitem(sys.modules, "jax", raising=False)

    return install


def test_requirements_are_those_of_the_extra() -> None:
    project = tomllib.loads(Path(__file__).parents[2].joinpath("pyproject.toml").read_text())["project"]
    assert project["optional-dependencies"][mjx.EXTRA] == list(mjx.REQUIREMENTS)


def test_missing_mjx(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjx, "REQUIREMENTS", ("numpy>=1", "absent-package>=2"))
    with pytest.raises(MissingPackageError) as caught:
        mjcf.simulate(load("pendulum"), backend="MJX")
    assert (caught.value.package, caught.value.extra) == ("absent-package", "mjx")


def test_old_jax(environment: Callable[..., None]) -> None:
    environment(jax="0.4.30", mujoco_mjx="3.17.0")
    with pytest.raises(UnusablePackageError) as caught:
        mjcf.simulate(load("pendulum"), backend="MJX")
    assert caught.value.problem == "has version 0.4.30"
    assert caught.value.needed == mjx.REQUIREMENTS[0]


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise RuntimeError('jaxlib is newer\\nthan jax')", "jaxlib is newer than jax"),
        ("raise ImportError('libcuda.so: cannot open')", "libcuda.so"),
        ("raise AttributeError('no attribute')", "no attribute"),
    ],
)
def test_jax_that_cannot_be_imported(environment: Callable[..., None], code: str, reason: str) -> None:
    environment(code, jax="0.10.2", jaxlib="0.9.0", mujoco_mjx="3.17.0")
    with pytest.raises(UnusablePackageError) as caught:
        mjcf.simulate(load("pendulum"), backend="MJX")
    for word in (reason, "jax 0.10.2, jaxlib 0.9.0, mujoco-mjx 3.17.0, mujoco ", "[mjx]'"):
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


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
