"""Applied forces for engines, which do not call the methods of the elements, against these methods."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from elements import ELEMENTS

from crosscheck.engines.applied import body_loads, commands, coordinate_elements, coordinate_load
from crosscheck.library import load
from newton_euler.equations.applied_forces import applied_wrenches, power, surroundings
from newton_euler.model.control import commands as declared_commands
from newton_euler.reading.excitation import random_states

TIME = 0.37
"""Time, s, at which references, gusts and feedforward are not those of the start."""

SCENES = {
    **{name: scene for name, scene in ELEMENTS.items() if scene.forces or scene.control},
    **{name: load(name) for name in ("tracker_wind", "tracker_drive", "tracker_sun_day", "excavator")},
}
"""Scenes with forces of every kind."""


@pytest.mark.parametrize("name", SCENES)
def test_forces(name):
    scene = SCENES[name]
    for state in random_states(scene, 2):
        # frictions of loaded joints are added by the equations, which have the reactions
        at = surroundings(scene, state, TIME)._replace(friction=lambda: defaultdict(float))
        motions = {key: (float(x), float(rate)) for key, (x, rate) in at.measured.items()}
        loads = body_loads(scene, state, TIME)
        needed = np.array(applied_wrenches(scene, at))
        scale = 1e-12 * max(1.0, float(np.max(np.abs(needed))))
        np.testing.assert_allclose(loads.wrenches, needed, atol=scale, rtol=0.0)
        found_power, found_energy = loads.power, loads.energy
        for element in coordinate_elements(scene):
            given = dict.fromkeys(element.keys, 0.0)  # of laws that use a model; none in `at`
            found = coordinate_load(element, motions, TIME, given)
            forces = [float(force) for force in element.along_coordinates(at)]
            np.testing.assert_allclose(found.forces, forces, rtol=1e-12, atol=1e-12)
            rates = [motions[key][1] for key in element.keys]
            found_power += float(np.subtract(found.forces, found.elastic) @ rates)
            found_energy += found.energy
        needed_power = float(power(scene, at))
        np.testing.assert_allclose(found_power, needed_power, rtol=1e-11, atol=1e-10)
        energy = sum(float(force.energy(at)) for force in scene.forces)
        np.testing.assert_allclose(found_energy, energy, rtol=1e-12, atol=1e-12)


def test_springs_of_an_engine_are_left_out_of_the_wrenches_but_not_of_the_power():
    scene = ELEMENTS["forces, slider_tree"]
    (state,) = random_states(scene, 1)
    springs = [force for force in scene.body_forces if force.kind == "point_spring"]
    assert springs
    every, rest = body_loads(scene, state, TIME), body_loads(scene, state, TIME, springs)
    assert np.max(np.abs(every.wrenches - rest.wrenches)) > 0.1
    assert rest.power == every.power
    assert rest.energy + rest.native_energy == pytest.approx(every.energy, rel=1e-14)
    assert rest.native_energy > 0.0


def test_commands_of_computed_torque():
    scene = load("tracker_computed_torque")
    for state in random_states(scene, 2):
        at = surroundings(scene, state, TIME)
        motions = {key: (float(x), float(rate)) for key, (x, rate) in at.measured.items()}
        needed = declared_commands(scene.control, motions, TIME)
        np.testing.assert_allclose(list(commands(scene.control, motions, TIME)), needed, rtol=1e-13)
