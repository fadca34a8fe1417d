"""Kinds of elements that a consumer of scenes does not know: every consumer raises."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from mechanisms import pendulum

import mjcf
from crosscheck.library.entries import ENTRIES
from crosscheck.library.size import _count_terms
from mjcf.rigid import RigidMuJoCo
from mjcf.write import add_geom
from newton_euler.model import scene as scene_module
from newton_euler.model.description import ArrayField, description
from newton_euler.model.digital_control import Digital, Law, Sampled
from newton_euler.model.elements import OnPoint, PointLoad
from newton_euler.model.forces import Force
from newton_euler.model.geometry import Shape
from newton_euler.model.initial_pose import described_at
from newton_euler.model.joint import Pose
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.motions import TimeFunction, shifted
from newton_euler.reading.plausibility import corners_of
from newton_euler.reading.wrenches import Wrenches
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate
from urdf.dynamics import PinocchioSystem
from urdf.write import add_visual


@description
class Lift(OnPoint):
    """A force of 1 N along z, which no consumer knows."""

    name: str
    body: str
    point: ArrayField

    noun = "lift"
    strengths = {}  # noqa: RUF012

    def load(self, at):
        k = at.mechanism.body_index(self.body)
        arm = at.frames[k].rotation @ at.poses[k].point_to_body(self.point)
        return PointLoad(k, np.array([0.0, 0.0, 1.0]), np.zeros(3), arm)


@pytest.fixture
def lifted(monkeypatch):
    monkeypatch.setitem(scene_module.ELEMENT_KINDS, "forces", (*scene_module.ELEMENT_KINDS["forces"], Lift))
    scene = pendulum()
    return replace(
        scene, forces=(*scene.forces, Lift("lift", scene.mechanism.body_names[1], [0.1, 0.0, 0.0]))
    )


def test_the_solver_simulates_a_force_from_its_class_alone(lifted):
    assert not np.array_equal(simulate(lifted).position, simulate(pendulum()).position)


@pytest.mark.parametrize(
    "consumer",
    [
        lambda scene: Wrenches(scene.mechanism, initial_state(scene)).add_forces(scene),
        mjcf.to_xml,
        RigidMuJoCo,
        PinocchioSystem,
    ],
    ids=["reading", "MJCF", "MuJoCo", "Pinocchio"],
)
def test_a_consumer_that_does_not_know_a_force_raises(lifted, consumer):
    with pytest.raises(AssertionError, match="Lift"):
        consumer(lifted)


def test_a_force_that_is_not_described_at_other_poses_raises(lifted):
    with pytest.raises(NotImplementedError):
        described_at(lifted, initial_state(lifted))


class Unknown:
    """A shape or a function of time that no consumer knows."""

    center, coefficients, quaternion = np.zeros(3), (0.0,), (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "consumer",
    [
        corners_of,
        lambda shape: add_geom(Element("body"), shape, "", Pose(np.zeros(3), np.eye(3)), np.eye(4)[0]),
        lambda shape: add_visual(Element("link"), shape, np.zeros(3), "gray"),
        lambda function: shifted(function, 1.0),
        _count_terms,
    ],
    ids=["plausibility", "MJCF", "URDF", "shift of a function", "size of a function"],
)
def test_a_consumer_that_does_not_know_a_shape_or_a_function_raises(consumer):
    with pytest.raises(AssertionError, match="Unknown"):
        consumer(Unknown())


def test_scene_files_have_all_kinds():
    kinds = {
        *get_args(Force),
        *get_args(Law),
        *get_args(Shape),
        *get_args(TimeFunction),
        *JOINT_KINDS.values(),
    }
    assert kinds - ENTRIES.keys() == {Sampled, Digital}  # Python, and an entry that is written by hand
