"""One mechanism in two forms, such as a loop that is cut elsewhere, and one number of a file that differs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mechanisms import GRAVITY, bar, pendulum
from test_two_ways import written_mjcf, written_urdf

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.motion import Likeness
from crosscheck.studies.faults import injection
from crosscheck.two_files import Diff
from newton_euler import Body, Mechanism, Scene
from newton_euler.model.couplings import Gear
from newton_euler.model.joint_kinds import Fixed, Revolute, Spherical

LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"

FAULT = 1e-4
"""Relative, or m or rad."""

SAME_MOTION = 1e-12
"""Relative change of accelerations of one mechanism of condition 30; measured are 3e-15."""


def compared(folder: Path, first: str, second: str) -> Diff:
    """Compare two texts of MJCF files."""
    for name, text in (("one.xml", first), ("two.xml", second)):
        (folder / name).write_text(text)
    return crosscheck.diff(folder / "one.xml", folder / "two.xml")


def found(result: Diff) -> list[tuple[str, str]]:
    """Element and quantity of each difference."""
    return [(row.element, row.quantity.value) for row in result.differences]


@pytest.mark.parametrize(("one", "other"), [("a", "c"), ("b", "coupler")])
def test_one_mechanism_cut_in_two_ways_moves_alike(tmp_path: Path, one: str, other: str) -> None:
    text, loops = written_urdf(other)
    for name, content in (("m.xml", written_mjcf(one, sites=False)), ("m.urdf", text), ("m.yaml", loops)):
        (tmp_path / name).write_text(content)
    options = {"loops": str(tmp_path / "m.yaml")}
    result = crosscheck.diff(tmp_path / "m.xml", tmp_path / "m.urdf", second_options=options)
    assert result.motion.change < SAME_MOTION
    assert result.run is not None
    assert result.run.distance <= result.run.uncertainty
    assert crosscheck.diff(tmp_path / "m.urdf", tmp_path / "m.xml", first_options=options).run is not None


def edited(text: str, element: str, attribute: str, entry: int) -> str:
    """Change a number after a name by `FAULT`, of the largest of its attribute."""
    start = text.index(element)
    match = re.compile(rf'(?<= {attribute}=")[^"]*').search(text, start)
    assert match is not None
    values = np.array([float(x) for x in match[0].split()])
    values[entry] += FAULT * (np.abs(values).max() or 1.0)
    return text[: match.start()] + " ".join(f"{x:.17g}" for x in values) + text[match.end() :]


@pytest.mark.parametrize(
    ("element", "attribute", "entry", "row"),
    [
        ('body name="coupler"', "mass", 0, ("coupler", "mass")),
        ('joint name="d"', "fullinertia", 3, ("rocker", "inertia")),
        ('joint name="d"', "axis", 0, ("d", "joint axis")),
        ('body name="crank"', "pos", 0, ("a", "joint origin")),
        ('site name="s1"', "pos", 0, ("c", "loop point")),
        ('body name="rocker"', "pos", 2, ("d", "joint origin")),
    ],
)
def test_one_number_of_the_file_is_found(
    tmp_path: Path, element: str, attribute: str, entry: int, row
) -> None:
    text = written_mjcf("c", sites=True)
    result = compared(tmp_path, text, edited(text, element, attribute, entry))
    assert result.outcome is Outcome.DIFFERENT
    assert row in found(result)


@pytest.mark.parametrize(
    ("old", "new", "row"),
    [
        ('kp="2"', 'kp="2.001"', ("servo", "kp")),
        ('name="pivot"', 'name="pivot" frictionloss="0.3"', ("pivot", "dry friction")),
        ('stiffness="0.5"', 'stiffness="0.5001"', ("pivot", "stiffness")),
        ('stiffness="0.5"', "", ("pivot", "stiffness")),
    ],
)
def test_terms_are_found_at_their_joint(tmp_path: Path, old: str, new: str, row) -> None:
    text = LINKAGE.read_text()
    assert old in text
    result = compared(tmp_path, text, text.replace(old, new, 1))
    assert found(result) == [row]


def test_another_zero_and_another_sign_are_the_same_hinge(tmp_path: Path) -> None:
    text = LINKAGE.read_text()
    other = text
    for old, new in (("elbow", 'ref="0.5"'), ("pivot", 'axis="0 -1 0"')):
        other = other.replace(f'name="{old}"', f'name="{old}" {new}', 1)
    result = compared(tmp_path, text, other)
    assert result.same
    assert result.motion.change < SAME_MOTION


def test_the_point_of_a_hinge_may_be_anywhere_on_its_axis() -> None:
    moved = injection.joint_point("pivot", np.array([0.0, 0.3, 0.0]))(pendulum())
    assert crosscheck.diff(pendulum(), moved).outcome is Outcome.SAME


def test_joints_of_another_kind_are_one_difference() -> None:
    scene = pendulum()
    ball = injection.joint_kind(scene.mechanism.joints[0], "spherical")(scene)
    for pair, values in (((scene, ball), ("hinge", "ball")), ((ball, scene), ("ball", "hinge"))):
        (row,) = crosscheck.diff(*pair).differences
        assert (row.element, row.quantity, row.first, row.second) == ("pivot", "kind", *values)


def test_gears_are_compared_by_what_they_couple() -> None:
    def geared(ratio: float, sign: float = 1.0) -> Scene:
        bodies = [Body.ground(), bar("left", [0, 0, 0], [0, 0, 1]), bar("right", [1, 0, 0], [1, 0, 1])]
        joints = [
            Revolute("on_left", "ground", "left", [0, 0, 0], axis=[0, 1, 0]),
            Revolute("on_right", "ground", "right", [1, 0, 0], axis=[0, sign, 0]),
        ]
        gear = Gear("wheels", "on_left", "on_right", ratio)
        return Scene("geared", Mechanism(bodies, joints, [gear]), 0.2, 0.1, GRAVITY)

    assert crosscheck.diff(geared(-2.0), geared(2.0, -1.0)).same
    (row,) = crosscheck.diff(geared(-2.0), geared(-2.0 * (1.0 + FAULT))).differences
    assert (row.element, row.quantity) == ("wheels", "coupling")


def test_bodies_with_other_names_are_paired_by_structure() -> None:
    scene = pendulum()
    bodies = [
        replace(body, name={"ground": "ground", "rod": "stick"}[body.name]) for body in scene.mechanism.bodies
    ]
    joint = replace(scene.mechanism.joints[0], second="stick", name="axle")
    renamed = replace(scene, mechanism=Mechanism(bodies, [joint]), initial_state=None)
    result = crosscheck.diff(scene, renamed)
    assert result.same
    assert ("rod", "stick") in result.comparison.alignment.renamed


def test_bodies_fixed_to_each_other_are_one_rigid_body() -> None:
    """Two uniform bars end to end are a bar twice as long: m l^2 / 12 across it."""
    mass, length = 2.0, 0.5
    own = mass * length**2 / 12.0 * np.diag([1.0, 1.0, 1e-3])
    upper, lower = (Body(name, mass, [0.0, 0.0, z], own) for name, z in (("upper", -0.25), ("lower", -0.75)))
    top = Spherical("top", "ground", "upper", [0, 0, 0])
    two = Mechanism([Body.ground(), upper, lower], [top, Fixed("glue", "lower", "upper", [0, 0, -0.5])])
    across = 2.0 * mass * (2.0 * length) ** 2 / 12.0
    bar_of_both = Body("upper", 2.0 * mass, [0.0, 0.0, -0.5], np.diag([across, across, 2.0 * own[2, 2]]))
    one = Mechanism([Body.ground(), bar_of_both], [top])
    scenes = [Scene("bars", mechanism, 1.0, 0.1, GRAVITY) for mechanism in (two, one)]
    result = crosscheck.diff(*scenes)
    assert result.same
    assert result.motion.likeness is Likeness.EQUAL
    assert result.motion.change < SAME_MOTION
