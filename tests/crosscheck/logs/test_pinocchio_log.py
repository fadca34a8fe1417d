"""The log of a user's loop with plain Pinocchio, written by `examples/pinocchio_log.py`."""

from __future__ import annotations

import runpy

import pytest

from crosscheck.library import load
from crosscheck.loading.load import load_scene
from crosscheck.logs.judge import Log, judge_log
from crosscheck.own_run.errors import Band
from urdf.write import to_loops, to_urdf

pytestmark = pytest.mark.slow

ROTOR = 1e-4
"""Gear ratio^2 times rotor inertia, kg m^2: as large as the inertia of the crank."""


@pytest.mark.parametrize(("rotors", "band"), [({"motor": ROTOR}, Band.ACCURATE), ({}, Band.WRONG)])
def test_a_loop_needs_the_rotors_of_the_urdf(tmp_path, rotors, band):
    """RK4 with small steps is accurate only if the loop sets the rotor that Pinocchio's reader drops."""
    scene = load("examples/linkage.xml", key="go")
    urdf, loops, path = (tmp_path / name for name in ("linkage.urdf", "loops.yaml", "log.csv"))
    text, rotor = to_urdf(scene), f'armature="{ROTOR}" damping'
    urdf.write_text(text.replace("damping", rotor, 1))
    loops.write_text(to_loops(scene))
    script = runpy.run_path("examples/pinocchio_log.py")
    script["ROTORS"].update(rotors)
    script["main"](str(urdf), str(path))
    model, report = load_scene(str(urdf), {"loops": str(loops)})
    assert report is not None
    found = judge_log(model, report.names, "log", Log(str(path)))
    assert found.band is band
    if band is Band.ACCURATE:
        assert found.error.relative < 1e-6
