"""junit.xml of `crosscheck run`: a test case fails exactly if the exit status is not 0, for any reason."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from command_line import run

from crosscheck.engines.registry import ENGINES
from crosscheck.studies.faults import injection
from crosscheck.support.errors import CrosscheckError

SWING = """<mujoco model="swing"><option timestep="{step}" integrator="RK4"/><worldbody>
  <body name="bar" euler="0 40 0"><joint name="hinge" axis="0 1 0" {limit}/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.4" contype="0"/></body>
  </worldbody></mujoco>"""

BOUNCE = """<mujoco model="bounce"><option timestep="0.001" integrator="RK4"/><worldbody>
  <geom type="plane" size="1 1 .1" solref="-1e15 -1e3"/><body name="ball" pos="0 0 .0999">
  <joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size=".1" solref="-1e15 -1e3" mass="1"/>
  </body></worldbody></mujoco>"""

LIMIT = 'range="-1 1" limited="true"'
"""A limit of the joint that acts at the start."""

ONE, TWO = "newton_euler", "newton_euler,mujoco"


@pytest.fixture
def cases(capsys, tmp_path):
    """Run a model; return the exit status, and the result and message of each test case by name."""

    def found(*arguments, text=SWING, step=0.1, limit="", engines=TWO):
        path, out = tmp_path / "swing.xml", tmp_path / "out"
        path.write_text(text.format(step=step, limit=limit))
        status, _, _ = run(capsys, "run", path, "--engines", engines, "--output", out, *arguments)
        suites = ElementTree.parse(out / "junit.xml").getroot()
        results = {}
        for suite in suites:
            elements = [[element for element in case if element.tag != "system-out"] for case in suite]
            for case, result in zip(suite, elements, strict=True):
                key = case.get("classname"), case.get("name")
                assert key not in results  # GitLab drops test cases with the same suite and name
                results[key] = (result[0].tag, result[0].get("message")) if result else ("passed", "")
            for attribute, tag in (("failures", "failure"), ("skipped", "skipped")):
                assert int(suite.get(attribute)) == sum(r[0].tag == tag for r in elements if r)
            assert int(suite.get("tests")) == len(suite)
        failed = any(tag == "failure" for tag, _ in results.values())
        assert failed == (status != 0) == (results["swing: verdict", "outcome"][0] == "failure")
        assert all("\n" not in message for _, message in results.values())
        return status, results

    return found


SETTINGS = "swing: verdict.your settings"


def test_checks_of_engines_and_the_judgement_without_a_limit(cases):
    status, results = cases()
    assert status == 0
    tag, message = results[SETTINGS, "accuracy"]
    assert tag == "skipped"  # it neither passes nor fails, as no error is limited
    assert message.startswith("your settings: accuracy: OFF BY ")
    assert message.endswith("no --max-error limits it")
    assert results["swing: engines compared.model", "mass, rel"] == ("passed", "")


def test_each_allowed_error_is_a_test_case(cases, tmp_path):
    status, results = cases("--max-error=0.01%", "--max-error=rotation=90deg")
    assert status == 5
    assert results[SETTINGS, "rotation error at most 90 deg"] == ("passed", "")
    tag, message = results[SETTINGS, "relative error at most 0.01 %"]
    assert tag == "failure"
    relative = json.loads((tmp_path / "out" / "summary.json").read_text())["own_run"]["relative"]
    number = re.search(r"at most 0\.01 %: (\S+) %; cause time step: ", message)[1]
    assert float(number) == pytest.approx(100.0 * relative, rel=5e-3)  # three digits
    assert cases("--max-error=50%")[0] == 0


def test_a_run_that_diverged_has_its_reason(cases):
    """The floor is far too stiff for the time step: MuJoCo resets the run."""
    motion = ("--set", "excitation=off", "--set", "duration=0.2")
    status, results = cases("--max-error=50%", *motion, text=BOUNCE)
    assert status == 5
    tag, message = results[SETTINGS, "relative error at most 50 %"]
    assert tag == "failure"
    assert message.startswith("your settings: relative error at most 50 %: diverged: Nan, Inf or huge value")
    assert "your settings diverged: Nan, Inf or huge value" in results["swing: verdict", "outcome"][1]


@pytest.mark.parametrize("limits", [(), ("--max-error=1%",)])
def test_what_acts_and_is_not_simulated(cases, limits):
    status, results = cases(*limits, step=0.002, limit=LIMIT)
    assert status == 4
    assert "limits of joint 'hinge'" in results["swing: verdict", "outcome"][1]
    assert cases(*limits, "--allow-reduced", step=0.002, limit=LIMIT)[0] == 0
    assert cases(*limits, step=0.002, limit=LIMIT, engines=ONE)[0] == 0  # one engine alone compares nothing


def test_engines_that_differ(cases, monkeypatch):
    real = ENGINES["newton_euler"].systems

    def heavier(scene):
        return real(injection.mass("bar", 1e-3)(scene))

    monkeypatch.setitem(ENGINES, "newton_euler", replace(ENGINES["newton_euler"], systems=heavier))
    status, results = cases("--max-error=50%")
    assert status == 1
    failed = [name for (_, name), (tag, _) in results.items() if tag == "failure"]
    assert {"outcome", "mass, rel"} <= set(failed)
    assert results[SETTINGS, "relative error at most 50 %"][0] == "passed"


def test_a_run_that_is_not_judged(cases, monkeypatch):
    def stops(*_):
        raise CrosscheckError("out of time")

    monkeypatch.setattr("crosscheck.compare.crosscheck.judge", stops)
    status, results = cases("--max-error=50%")
    assert status == 3
    assert results[SETTINGS, "relative error at most 50 %"] == (
        "skipped",
        "your settings: relative error at most 50 %: not judged",
    )
    assert "out of time" in results["swing: verdict", "outcome"][1]
    assert cases()[0] == 0


def test_a_model_named_like_the_test_cases_is_not_overwritten(capsys, tmp_path):
    path = tmp_path / "junit.xml"
    path.write_text(SWING.format(step=0.002, limit=""))
    status, _, err = run(capsys, "run", path, "--output", tmp_path)
    assert status == 2
    assert "the output would overwrite the input file" in err
    assert path.read_text().startswith("<mujoco")
