"""`crosscheck explain`: its counts are those of the code that runs, and its words are true of it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from command_line import run

from crosscheck.scenes import load
from crosscheck.studies.explain import left_out, operations_by_output, operations_by_term, structure
from newton_euler.integrators.compiled import FORMULATIONS, Code
from newton_euler.model.scene import OUTPUTS

SCENES = {"tracker": {}, "four_bar": {"N": 2}, "chain": {"N": 3}}


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", SCENES)
def test_terms_add_up_to_the_code(name, formulation):
    code = Code(load(name, **SCENES[name]), formulation)
    terms = operations_by_term(code)
    assert terms["all"] == code.program("derivative").operations
    assert sum(terms.values()) == 2 * terms["all"]
    assert (terms["actuation"] > 0) == (name == "tracker")
    assert (terms.get("constraints", 0) > 0) == (name != "chain" or formulation == "cartesian")


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_outputs_cost_what_their_own_code_does(tracker, formulation):
    counts = operations_by_output(replace(tracker, outputs=frozenset(["energy"])), formulation)
    for output, wanted in [("nothing", []), *((output, [output]) for output in OUTPUTS)]:
        alone = Code(replace(tracker, outputs=frozenset(wanted)), formulation)
        assert counts[output] == alone.program("output").operations
    assert counts["all of this scene's"] == counts["energy"]


def test_structure_of_the_tracker(tracker):
    """7 bodies with the ground, 8 joints, two loops cut at balls, 2 degrees of freedom."""
    found = structure(Code(tracker))
    assert (found["bodies that move"], found["joints"], found["joints that carry coordinates"]) == (
        "6",
        "8",
        "6",
    )
    assert (found["velocities"], found["constraint rows"], found["degrees of freedom"]) == ("8", "6", "2")
    cartesian = structure(Code(tracker, "cartesian"))
    assert cartesian["velocities"] == "42"
    assert cartesian["constraint rows"] == "40"  # 34 of the joints and 6 norms
    assert cartesian["degrees of freedom"] == "2"


@pytest.mark.parametrize(("formulation", "unmoved", "following"), [("relative", 3, 0), ("cartesian", 0, 3)])
def test_structure_of_windows(formulation, unmoved, following):
    """A ball's row along z: in joint coordinates nothing can move it, in Cartesian ones hinges imply it."""
    found = structure(Code(load("four_bar", N=3), formulation))
    assert found["  that nothing can move"] == str(unmoved)
    assert found["  that follow from others"] == str(following)
    assert found["degrees of freedom"] == "1"


def test_what_was_left_out(tracker):
    lines = list(left_out(Code(tracker)))
    assert "gravity: zero" in lines
    assert "rotation matrices of 2 of 6 bodies: constant" in lines  # the sliders
    assert not any("loops" in line or "control" in line or "outputs" in line for line in lines)
    chain = replace(load("chain", N=3), outputs=frozenset(["velocities"]))
    lines = list(left_out(Code(chain)))
    assert "constraints and their projection: no loops" in lines
    assert "actuation: no control law" in lines
    assert "outputs: reactions, actuation, violation, energy not asked for" in lines
    assert "mass matrix: 0 of 9 entries are zero" in lines
    assert not any("gravity" in line or "rotation" in line for line in lines)
    windows = list(left_out(Code(load("four_bar", N=2))))
    assert "constraint rows: 2 of 6 say nothing that others do not" in windows


def test_the_command(capsys):
    status, out, err = run(capsys, "explain", "four_bar", "--set", "N=1")
    assert (status, err) == (0, "")
    for heading in (
        "four_bar: N four-bar windows",
        "operations of a right-hand side, by term",
        "operations of an output, by what is asked for beside poses",
        "native code",
        "left out, at no cost",
    ):
        assert f"{heading}" in out
    assert max(map(len, out.splitlines())) <= 100
    status, out, err = run(capsys, "explain", "four_bar", "--set", "N=0")
    assert (status, out) == (2, "")
    assert "choose a whole number from 1 to 1000" in err
