"""What a finer run excuses: errors that fall are settled, others fail or are not judged."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import pendulum
from verdicts import figure, verdicts

from crosscheck.compare.check import POSES, not_judged
from crosscheck.compare.crosscheck import crosscheck as run_crosscheck
from crosscheck.engines.registry import ENGINES
from crosscheck.report.output import write
from crosscheck.report.page import write_report
from crosscheck.report.render import terminal
from crosscheck.report.run import report
from newton_euler.model.trajectory import IntegrationError


def test_refinement_excuses_no_more_than_a_hundredth():
    scene = replace(pendulum(), duration=0.2)
    own = ENGINES["newton_euler"]

    def elsewhere(scene):
        run = own.simulate(scene)
        return replace(run, position=run.position + 1.0)

    rows = verdicts(scene, [own, replace(ENGINES["pinocchio"], simulate=elsewhere)])
    row = figure(rows, "trajectories", "positions, m", "newton_euler", "pinocchio")
    assert not row.agrees
    assert row.tolerance < 0.05


@pytest.mark.parametrize("length", [0.2, 30.0])
def test_lengths_are_held_to_the_reach_of_the_mechanism_and_angles_to_a_radian(length):
    scene = replace(pendulum(length), duration=0.1)
    engines = [ENGINES["newton_euler"], ENGINES["pinocchio"]]
    rows = verdicts(scene, engines)
    positions, orientations = (figure(rows, "trajectories", q, *(e.name for e in engines)) for q in POSES)
    share = sum(engine.trajectory_error for engine in engines)
    # the bar's center is half of its length from the hinge; less than 1 m counts as that
    assert positions.tolerance == pytest.approx(max(1.0, 0.5 * length) * share, rel=1e-12)
    assert orientations.tolerance == pytest.approx(share, rel=1e-12)


def shifted(run, far):
    """A run whose positions are further along x than they are, m, by as much at all times."""
    return replace(run, position=run.position + np.array([far, 0.0, 0.0]))


def off(engine, far, finer):
    """newton_euler's runs under another name, `far` off and `finer` in a finer run, m."""
    own = ENGINES["newton_euler"]
    return replace(
        ENGINES[engine],
        simulate=lambda scene: replace(shifted(own.simulate(scene), far), engine=engine),
        refined=lambda scene: replace(shifted(own.refined(scene), finer), engine=engine),
    )


@pytest.mark.parametrize(
    ("far", "finer", "settled"),
    [
        (1e-5, 2.5e-6, True),  # order 2
        (1e-5, 5e-6, True),  # order 1
        (1e-5, 7e-6, True),  # below three quarters: what it is off is within four times the change
        (1e-5, 8e-6, None),  # the change explains no more than 0.8 of it: fails, as a wrong model would
        (1e-5, -1e-5, False),  # the change explains it and it is as far off
        (1e-5, -1.5e-5, False),
        (1e-9, -1e-9, True),  # within what engines may be off anyway
    ],
)
def test_an_error_that_does_not_fall_excuses_nothing(far, finer, settled):
    scene = replace(pendulum(), duration=0.1)
    engines = [ENGINES["newton_euler"], off("mujoco", far, finer)]
    rows = verdicts(scene, engines)
    row = figure(rows, "trajectories", "positions, m", "newton_euler", "mujoco")
    # 1e-11: what newton_euler's own runs differ by
    assert row.value == pytest.approx(far, abs=1e-11)
    assert (row.agrees, not row.judged) == (settled is not None, settled is False)
    assert row.unconverged == ("mujoco" if settled is False else "")
    others = [row for row in rows if row.unconverged and row.quantity != "positions, m"]
    assert others == []
    more = (
        "; 1 more check is not judged: a finer run of mujoco reduces the difference too little"
        if settled is False
        else ""
    )
    assert not_judged(rows) == more


def positions_unsettled(rows):
    """The engine for which the positions of two runs are not judged, or "", by the names of the two."""
    positions = [row for row in rows if (row.level, row.quantity) == ("trajectories", "positions, m")]
    return {row.between: row.unconverged for row in positions}


def test_a_run_that_does_not_converge_is_told_from_the_one_it_is_compared_with():
    """Three engines: errors of the second that hide what the first gains are not the first's."""
    scene = replace(pendulum(), duration=0.1)
    rows = verdicts(scene, [off("pinocchio", 7e-6, 7e-8), off("mujoco", 8e-6, 2e-6)])
    assert not [row for row in rows if row.unconverged]
    rows = verdicts(
        scene, [off("newton_euler", 1e-6, 1e-8), off("mujoco", -8e-6, 1e-5), off("pinocchio", 0, 0)]
    )
    assert positions_unsettled(rows) == {
        ("newton_euler", "mujoco"): "mujoco",
        ("newton_euler", "pinocchio"): "",
        ("mujoco", "pinocchio"): "mujoco",
    }


def test_engines_that_are_not_judged_with_one_are_with_another():
    """Two that come to one place, neither much nearer to a third."""
    scene = replace(pendulum(), duration=0.1)
    rows = verdicts(
        scene, [off("newton_euler", -2e-4, -2.4e-4), off("mujoco", 8e-5, 2e-5), off("pinocchio", 7e-5, 2e-5)]
    )
    assert positions_unsettled(rows) == {
        ("newton_euler", "mujoco"): "mujoco",
        ("newton_euler", "pinocchio"): "pinocchio",
        ("mujoco", "pinocchio"): "",
    }


def test_runs_are_refined_once_whatever_figures_need_them():
    """And one that stops is not tried again."""
    scene, calls = replace(pendulum(), duration=0.1), Counter()

    def counted(engine):
        def simulate(scene):
            # the quickest engine's error is asked for first, and is enough
            return replace(engine.simulate(scene), wall_time=0.0 if engine.name == "mujoco" else 1.0)

        def refined(scene):
            calls[engine.name] += 1
            if engine.name == "newton_euler":
                raise IntegrationError(0.05, "too many steps")
            return engine.refined(scene)

        return replace(engine, simulate=simulate, refined=refined)

    engines = [off("newton_euler", 0, 0), off("mujoco", -1e-5, 1e-5), off("pinocchio", 0, 0)]
    rows = verdicts(scene, [counted(engine) for engine in engines])
    assert [row.unconverged for row in rows if row.unconverged] == ["mujoco", "mujoco"]
    assert calls == {"newton_euler": 1, "mujoco": 1, "pinocchio": 1}


def test_what_is_not_judged_is_said_in_the_verdict_tables_and_pages(tmp_path):
    scene = replace(pendulum(), duration=0.1)
    engines = [ENGINES["newton_euler"], off("pinocchio", 1e-5, -1e-5)]
    result = run_crosscheck(scene, engines, lambda _: None, "pendulum.yaml", {})
    assert result.outcome == "AGREE"
    assert "checks; 1 more check is not judged: a finer run of pinocchio reduces" in result.verdict
    found = report(result)
    write(result, found, tmp_path, tmp_path / "pendulum.rrd", "pendulum")
    page = write_report(tmp_path, lambda _: None).path
    assert "1.0e-05 not judged" in page.read_text()
    assert "1.0e-05 not judged" in terminal(found.parts)


def test_round_off_that_does_not_fall_is_converged():
    """Of newton_euler's drift, which projection takes down to round-off above what it usually is."""
    scene = replace(pendulum(), duration=0.1)
    own = ENGINES["newton_euler"]

    def opened(run, far):
        return replace(run, constraint_violation=np.full_like(run.constraint_violation, far))

    for far, finer, unsettled in ((3e-13, 5e-13, ""), (3e-12, 5e-12, "newton_euler")):
        engine = replace(
            own,
            simulate=lambda scene, far=far: opened(own.simulate(scene), far),
            refined=lambda scene, finer=finer: opened(own.refined(scene), finer),
        )
        row = figure(verdicts(scene, [engine]), "drift", "constraint violation, m or rad", "newton_euler")
        assert row.agrees
        assert row.unconverged == unsettled
