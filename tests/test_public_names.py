"""Public names of the four packages."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

import newton_euler
from newton_euler.model.joint_kinds import JOINT_KINDS

PACKAGES = ("newton_euler", "mjcf", "urdf", "crosscheck")


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_are_typed_and_have_what_they_list(package):
    module = importlib.import_module(package)
    assert Path(str(module.__file__)).with_name("py.typed").exists()
    for name in module.__all__:
        assert getattr(module, name).__module__ != package
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = module.nothing_like_it


def test_all_joint_kinds_are_public():
    assert {kind.__name__ for kind in JOINT_KINDS.values()} <= set(newton_euler.__all__)
