"""The pytest fixture for users' own suites, run as they run it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy.fft  # noqa: F401
import pytest

import crosscheck.regress.run  # noqa: F401
import urdf.dynamics  # noqa: F401  # these: native modules cannot be imported anew

pytest_plugins = ["pytester"]

LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"

SUITE = """
    import dataclasses
    import mujoco
    from crosscheck.engines.registry import ENGINES

    def wrong(scene):
        bodies = list(scene.mechanism.bodies)
        bodies[2] = dataclasses.replace(bodies[2], mass=1.001 * bodies[2].mass)
        mechanism = type(scene.mechanism)(bodies, scene.mechanism.joints)
        return dataclasses.replace(scene, mechanism=mechanism, initial_state=None)

    def test_arm(crosscheck):
        crosscheck("arm.xml", key="go", duration=0.05).assert_agrees()

    def test_accurate(crosscheck):
        arm = crosscheck("arm.xml", ["newton_euler", "mujoco"], key="go", duration=0.05)
        arm.assert_accurate(0.2, opening=1e-2)
        arm.assert_accurate(1e-3)

    def test_odd(crosscheck, monkeypatch):
        good = ENGINES["mujoco"]
        systems = lambda scene: good.systems(wrong(scene))
        odd = dataclasses.replace(good, systems=systems, soft_constraints=None)
        monkeypatch.setitem(ENGINES, "mujoco", odd)
        crosscheck("arm.xml", key="go", duration=0.05).assert_agrees()

    def test_spec(crosscheck):
        spec = mujoco.MjSpec.from_file("arm.xml")
        crosscheck(spec, ["newton_euler"], key="go", duration=0.05).assert_unchanged()

    def test_guarded(crosscheck):
        crosscheck("arm.xml", ["newton_euler"], key="go", duration=0.05).assert_unchanged()

    def test_ball(crosscheck):
        crosscheck("ball.xml", ["newton_euler"], duration=0.3).assert_unchanged()

    def test_reduced(crosscheck):
        crosscheck("ball.xml", ["newton_euler"], duration=0.3).assert_unchanged(allow_reduced=True)

    def test_missing(crosscheck):
        crosscheck("leg.xml")

    def test_misspelt(crosscheck):
        crosscheck("arm.xml", ["mujuco"])
"""


FALLING_BALL = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body name="ball" pos="0 0 0.3"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>"""
"""The ball touches the plane at 0.2 s: sqrt(2 (0.3 m - 0.1 m) / 9.81 m/s^2)."""


@pytest.fixture
def suite(pytester):
    """A user's suite with its models beside it."""
    (pytester.path / "arm.xml").write_text(LINKAGE.read_text())
    (pytester.path / "ball.xml").write_text(FALLING_BALL)
    pytester.makepyfile(SUITE)
    return pytester


def run(suite, *arguments):
    """Run it in this process, without other plugins, which would be imported anew each time."""
    return suite.runpytest_inprocess("--disable-plugin-autoload", "-p", "crosscheck", *arguments)


@pytest.mark.slow
def test_models_that_agree_pass_and_others_name_the_engine_and_keep_the_recording(suite):
    done = suite.runpytest_subprocess("-k", "arm or odd")
    done.assert_outcomes(passed=1, failed=1)
    text = done.stdout.str()
    assert "DISAGREE: mujoco differs; newton_euler, pinocchio and the file agree within " in text
    assert "at level 'model': mass, rel: 0.001 > 1e-12, worst at coupler: newton_euler " in text
    recording = re.search(r"look: crosscheck view (\S+)", text)
    assert recording is not None
    assert Path(recording[1]).is_file()


def test_a_run_with_a_large_error_fails_with_cause_and_fix(suite):
    done = run(suite, "-k", "accurate")
    done.assert_outcomes(failed=1)
    text = done.stdout.str()
    assert "INACCURATE: errors of the run with your settings: relative " in text
    for part in ("your settings", "cause "):
        assert part in text
    assert re.search(r'fix +\w+="', text), "an attribute to change"
    recording = re.search(r"look: crosscheck view (\S+)", text)
    assert recording is not None
    assert Path(recording[1]).is_file()
    assert "crosscheck/verdict.py" not in text


def test_what_cannot_be_checked_fails_in_one_line(suite):
    done = run(suite, "-k", "missing or misspelt")
    done.assert_outcomes(failed=2)
    text = done.stdout.str()
    assert "\nleg.xml: cannot be read: No such file or directory\n" in text
    assert "\nunknown engine 'mujuco'; did you mean 'mujoco'? " in text
    assert "crosscheck/verdict.py" not in text


@pytest.mark.slow
def test_a_baseline_is_stored_on_demand_and_compared_with(suite):
    done = run(suite, "-k", "guarded")
    done.assert_outcomes(failed=1)
    assert "arm.baseline.json; pytest --crosscheck-update REASON stores it" in done.stdout.str()
    stored = run(suite, "-k", "guarded", "--crosscheck-update", "as delivered")
    stored.assert_outcomes(passed=1)
    run(suite, "-k", "guarded").assert_outcomes(passed=1)
    model = suite.path / "arm.xml"
    model.write_text(model.read_text().replace("0.3 0 0.15", "0.3003 0 0.15"))
    done = run(suite, "-k", "guarded")
    done.assert_outcomes(failed=1)
    text = done.stdout.str()
    assert re.search(r"model: mass, kg +coupler +0\.2958", text)
    assert "linkage: MOVED: " in text
    recording = re.search(r"look: crosscheck view (\S+)", text)
    assert recording is not None
    assert Path(recording[1]).is_file()
    assert (Path(recording[1]).parent / "junit.xml").is_file()


@pytest.mark.slow
def test_a_baseline_of_a_reduced_model_fails_as_the_command_does(suite):
    run(suite, "-k", "test_ball", "--crosscheck-update", "as delivered").assert_outcomes(passed=1)
    run(suite, "-k", "test_reduced").assert_outcomes(passed=1)
    done = run(suite, "-k", "test_ball")
    done.assert_outcomes(failed=1)
    assert "QUIET ON A REDUCED MODEL; to accept: " in done.stdout.str()


@pytest.mark.slow
def test_a_baseline_of_a_model_in_memory_is_beside_the_test(suite):
    run(suite, "-k", "spec", "--crosscheck-update", "as made").assert_outcomes(passed=1)
    assert (suite.path / "linkage.baseline.json").is_file()
    run(suite, "-k", "spec").assert_outcomes(passed=1)
