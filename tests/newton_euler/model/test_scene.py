"""Scenes, control laws, shapes: what they accept, and what they say of what they refuse."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from mechanisms import pendulum, spinning_top

from newton_euler import PD, State
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.geometry import Box, Capsule
from newton_euler.model.written_file import atomic_file
from newton_euler.runs.assemble import initial_state

START = State.initial(pendulum().mechanism)
MASKED = np.ma.array(START.position, mask=START.position > 0.4)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("name", "../../evil", "name is '../../evil'"),
        ("name", "..", "name is '..'"),
        ("name", "", "name is ''"),
        ("name", "a" * 101, "at most 100"),
        ("name", 3, "name is 3"),
        ("description", "two\nlines", "description is 'two"),
        ("description", None, "description is None"),
        ("mechanism", 3, "mechanism is 3"),
        ("gravity", "down", "gravity is 'down'"),
        ("gravity", (0.0, 1.0), "gravity is"),
        ("control", None, "control is None"),
        ("control", (3,), "control holds"),
        ("initial_state", 3, "is 3; needed: a State"),
        (
            "initial_state",
            replace(START, position=MASKED),
            "position has another shape, or holds what is",
        ),
        ("outputs", "energy", "outputs is 'energy'"),
        ("outputs", None, "outputs is None"),
        ("duration", True, "duration is True"),
        ("duration", "1", "duration is '1'"),
        ("duration", 1e308, "at most 1e+07"),
        ("duration", 10**400, "duration is 1000"),
        ("output_period", -1, "output_period is -1"),
        ("output_period", 1e-320, "more than 1000000 outputs"),
    ],
)
def test_fields_that_a_scene_refuses(field, value, message):
    with pytest.raises(MechanismError) as caught:
        replace(pendulum(), **{field: value})
    assert message in str(caught.value)


def test_an_unknown_output():
    with pytest.raises(UnknownNameError, match="unknown output 'heat'"):
        replace(pendulum(), outputs=["heat"])


@pytest.mark.parametrize("one", [1, np.float32(1.0), np.float64(1.0), np.int64(1), Fraction(1)])
def test_any_real_number_is_a_time(one):
    scene = replace(pendulum(), duration=one, output_period=one)
    assert (type(scene.duration), scene.times.tolist()) == (float, [0.0, 1.0])


def test_arrays_are_the_scenes_own_and_read_only():
    given = np.array([0.0, 0.0, -1.0])
    scene = replace(pendulum(), gravity=given)
    box, bar = Box(given + 2.0, given), Capsule(given, given + 1.0, 0.1)
    given[0] = 5.0
    for array in (scene.gravity, box.half_sizes, box.center, box.quaternion, bar.start, bar.end):
        assert array[0] != 5.0
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("shape", "arguments", "message"),
    [
        (Box, ([1.0, 1.0], [0.0] * 3), "box: half_sizes is"),
        (Box, ([1.0, 1.0, 0.0], [0.0] * 3), "three positive lengths"),
        (Box, ([1.0] * 3, [0.0] * 3, [0.0] * 4), "quaternion has norm 0"),
        (Box, ([1.0] * 3, ["a", 0.0, 0.0]), "box: center is"),
        (Capsule, ([0.0] * 3, [1.0, 0.0, np.nan], 0.1), "capsule: end is"),
        (Capsule, ([0.0] * 3, [1.0] * 3, -0.1), "capsule: radius is -0.1"),
    ],
)
def test_shapes_that_cannot_be(shape, arguments, message):
    with pytest.raises(MechanismError) as caught:
        shape(*arguments)
    assert message in str(caught.value)


@pytest.mark.parametrize("field", ["stiffness", "damping", "target", "coordinate"])
@pytest.mark.parametrize("value", [True, "1", float("nan"), None])
def test_numbers_that_a_control_law_refuses(field, value):
    with pytest.raises(MechanismError, match=rf"control of joint 'j': {field} is"):
        PD(**{"joint": "j", "stiffness": 1.0, "damping": 1.0, "target": 0.0, field: value})


def moved(state: State, quantity: str, body: int, change: list[float]) -> State:
    values = getattr(state, quantity).copy()
    values[body] += change
    return replace(state, **{quantity: values})


@pytest.mark.parametrize(
    ("quantity", "change", "problem"),
    [
        ("position", [0.0, 1e-6, 0.0], "is not at its own pose"),
        ("quaternion", [np.cos(0.1) - 1.0, np.sin(0.1), 0.0, 0.0], "is not at its own pose"),
        ("linear_velocity", [0.0, 0.0, 1e-6], "moves"),
        ("angular_velocity", [0.0, 0.0, 1e-6], "moves"),
    ],
)
def test_the_ground_stays_where_it_is(quantity, change, problem):
    scene = spinning_top()
    with pytest.raises(MechanismError, match=f"ground 'ground': {problem}"):
        replace(scene, initial_state=moved(initial_state(scene), quantity, 0, change))


def test_either_sign_of_the_grounds_quaternion():
    scene = spinning_top()
    turned = moved(initial_state(scene), "quaternion", 0, [-2.0, 0.0, 0.0, 0.0])
    assert initial_state(replace(scene, initial_state=turned)) is turned


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_a_file_appears_whole_or_not_at_all(tmp_path, error):
    path = tmp_path / "new" / "a.txt"

    def interrupted():
        with atomic_file(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        interrupted()
    assert list(path.parent.iterdir()) == []
    with atomic_file(path) as temporary:
        temporary.write_text("whole")
    assert [(p.name, p.read_text()) for p in path.parent.iterdir()] == [("a.txt", "whole")]
    with path.open() as reader:
        with atomic_file(path) as temporary:
            temporary.write_text("new")
        assert (reader.read(), path.read_text()) == ("whole", "new")  # who reads meanwhile has the old one


def test_folders_that_are_too_deep_are_not_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError, match="folders inside of each other"), atomic_file("x/" * 2000 + "y"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_take_its_place_leaves_nothing(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"), atomic_file(tmp_path / "taken"):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]
