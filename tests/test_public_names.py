"""Public names of the four packages: what they are, and the examples in their docstrings."""

from __future__ import annotations

import doctest
import importlib
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import crosscheck
import newton_euler
from crosscheck.scenes import load
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


@pytest.mark.parametrize(
    ("package", "name"),
    [(package, name) for package in PACKAGES for name in importlib.import_module(package).__all__],
)
def test_docstrings_have_examples_that_run(package, name, tmp_path, monkeypatch):
    """Each in the namespace that a reader of it has: all public names, NumPy, `load` and `replace`."""
    shutil.copytree(Path(__file__).parents[1] / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    packages = {each: importlib.import_module(each) for each in PACKAGES}
    names = {each: getattr(newton_euler, each) for each in newton_euler.__all__}
    names |= packages | {"np": np, "load": load, "replace": replace, "check": crosscheck.check}
    own, *of_methods = doctest.DocTestFinder().find(getattr(packages[package], name), name, extraglobs=names)
    assert own.examples, "no example"
    said: list[str] = []
    with warnings.catch_warnings():
        failed = [doctest.DocTestRunner().run(each, out=said.append).failed for each in (own, *of_methods)]
    assert sum(failed) == 0, "".join(said)
