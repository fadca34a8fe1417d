"""Readings verified where loops are nearly redundant, keep offsets, or close nowhere but at the start."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mjcf_models import BOX, model, reading

import urdf
from crosscheck.compare.check import LEVELS_OF_EQUATIONS, LEVELS_OF_RUNS
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.engines.registry import ENGINES
from crosscheck.studies.faults.find import find_in_reading
from crosscheck.studies.faults.misreadings import misreadings
from crosscheck.verdict import check
from mjcf.errors import MjcfError
from mjcf.reading.start import ModelAtStart
from newton_euler.equations.relative import Relative
from newton_euler.model.forces import JointSpring
from newton_euler.reading.verify import verify

TILTED = model(
    '<body name="crank"><joint name="a" axis="0 1 0" damping="1"/><inertial pos="0 0 0.1" mass="1" '
    'diaginertia=".01 .01 .01"/><body name="coupler" pos="0 0 0.2"><joint name="b" axis="0 1 0"/>'
    '<inertial pos="0.2 0 0" mass="1" diaginertia=".01 .01 .01"/><body name="rocker" pos="0.4 0 0">'
    '<joint name="c" axis="0 1 {0}"/><inertial pos="0 0 -0.1" mass="1" diaginertia=".01 .01 .01"/></body>'
    '</body></body><body name="base" pos="0.4 0 0"><joint name="d" axis="0 1 0"/><inertial pos="0 0 0.01" '
    'mass="1" diaginertia=".01 .01 .01"/></body>',
    '<equality><weld name="w" body1="rocker" body2="base"/></equality>',
)


@pytest.mark.parametrize("tilt", ["0", "1e-12", "1e-10", "1e-9", "1e-8", "1e-7"])
def test_nearly_redundant_rows_pass_whatever_is_decided_of_them(tilt: str, tmp_path: Path) -> None:
    """A planar four-bar with one hinge out of the plane; a damper that is off is found all the same."""
    (reference, scene), *_ = reading(tmp_path, TILTED.format(tilt)).report.references
    wrong = replace(scene, forces=(JointSpring("a", damping=1.0 + 1e-5),))
    (failing, *_) = (figure for figure in verify(reference, Relative(wrong)) if not figure.agrees)
    assert (failing.quantity, failing.where) == ("dampers, rel", "joint 'a': damping")


def offset(gap: float) -> str:
    """A planar four-bar whose connect is out of the plane by a gap, m."""
    return model(
        '<body name="crank"><joint name="a" axis="0 1 0" damping="1" armature="0.01"/>'
        f'{BOX.format("0 0 0.1")}<body name="coupler" pos="0 0 0.2"><joint name="b" axis="0 1 0"/>'
        f"{BOX.format('0.25 0 0.05')}"
        '<site name="p" pos="0.5 0 0.1"/></body></body>'
        f'<body name="rocker" pos="0.5 0 0"><joint name="c" axis="0 1 0"/>{BOX.format("0 0 0.15")}'
        f'<site name="q" pos="0 {gap} 0.3"/></body>',
        '<equality><connect name="loop" site1="p" site2="q"/></equality>'
        '<actuator><position name="servo" joint="a" kp="20" kv="2"/></actuator>',
    )


@pytest.mark.slow
def test_offsets_that_loops_keep_hide_no_fault(tmp_path: Path) -> None:
    """Faults of a millionth are seen, in the same figures, as they are with the loop closed."""
    seen = []
    for each in (0.0, 1e-6, 4e-4):
        report = reading(tmp_path, offset(each)).report
        (line,) = (line for line in report.start if line.startswith("verified"))
        faults = [
            f
            for f in misreadings(report.references[-1][1])
            if f.size == 1e-6 or "1e-6" in f.detail or "1e-06" in f.detail
        ]
        found = find_in_reading(report, lambda _: None, faults).found
        seen.append(
            [(outcome.fault.name, outcome.detection.quantity) for outcome in found if outcome.detection]
        )
        assert float(line.split(" to ")[1].split()[0]) < 1e-10
    assert len(seen[0]) > 30
    assert seen[0] == seen[1] == seen[2]


def far_open(angles: str, beside: str = "") -> str:
    """A chain of links of 0.3, 0.4 and 0.35 m. Only the straight chain reaches where its end is held.

    Other bodies may be beside it.
    """
    links = (
        '<body name="a"><joint name="ja" axis="0 1 0"/>{0}<body name="b" pos="0.3 0 0">'
        '<joint name="jb" axis="0 1 0"/>{0}<body name="c" pos="0.4 0 0"><joint name="jc" axis="0 1 0"/>{0}'
        "</body></body></body>"
    ).format(BOX.format("0.15 0 0"))
    loop = '<equality><connect body1="c" body2="world" anchor="0.35 0 0"/></equality>'
    return model(links + beside, f'{loop}<keyframe><key name="bent" qpos="{angles}"/></keyframe>')


@pytest.mark.filterwarnings("ignore::newton_euler.errors.NearlyRedundantWarning")
@pytest.mark.parametrize(
    "angles",
    [
        "0.57 -0.97 -0.65",
        "0.82 -1.38 -2.75",
        pytest.param("-2.9 1.88 2.48", marks=pytest.mark.slow),
        pytest.param("2.14 -2.8 1.38", marks=pytest.mark.slow),
    ],
)
def test_loops_that_close_near_a_singular_configuration_are_not_misread(angles: str, tmp_path: Path) -> None:
    """Newton's steps halve the error there: two solvers stop at different configurations, or branches."""
    path = tmp_path / "bent.xml"
    path.write_text(far_open(angles), encoding="utf-8")
    verdict = check(str(path), ["newton_euler", "pinocchio"], key="bent", duration=0.01)
    failing = [each for each in verdict.checks if each.level == "reading" and not each.agrees]
    assert not failing


@pytest.mark.filterwarnings("ignore::newton_euler.errors.NearlyRedundantWarning")
def test_a_loop_that_stalls_hides_no_wrong_start_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pendulum = f'<body pos="2 0 0"><joint name="p" axis="0 1 0"/>{BOX.format("0.1 0 0")}</body>'
    text = far_open("0.57 -0.97 -0.65 0.2", pendulum)
    (line,) = (x for x in reading(tmp_path, text, key="bent").report.start if x.startswith("verified"))
    limited = line.partition("; ")[2]
    assert all(f"joint '{name}'" in limited for name in ("ja", "jb", "jc"))
    assert "joint 'p'" not in limited

    def moved(self: Any, key: str | None, place: Any = ModelAtStart._place) -> str:
        found: str = place(self, key)
        self.data.qpos[3] += 1e-6
        return found

    monkeypatch.setattr(ModelAtStart, "_place", moved)
    with pytest.raises(MjcfError, match=r"joint 'p': .*start, sizes or rad"):
        reading(tmp_path, text, key="bent")


def stretched(gap: float) -> str:
    """Three links of 1 m across 3 m less a gap, the middle one level: they move by the root of the gap."""
    run = 0.5 * (2.0 - gap)
    tip = f"{run!r} 0 {float(np.sqrt(1.0 - run**2))!r}"
    return model(
        f'<body><joint axis="0 1 0"/>{BOX.format("0.3 0 0.01")}<body name="middle" pos="{tip}"><joint '
        f'axis="0 1 0"/>{BOX.format("0.3 0 0.02")}</body></body><body name="last" pos="{3.0 - gap!r} 0 0">'
        f'<joint axis="0 1 0"/>{BOX.format("-0.2 0 0.03")}</body>',
        '<equality><connect body1="middle" body2="last" anchor="1 0 0"/></equality>',
    )


TRUSS = model(
    f'<body name="a"><joint axis="0 1 0"/>{BOX.format(".3 0 0")}</body>'
    f'<body name="b" pos="1 0 0"><joint axis="0 1 0"/>{BOX.format("-.2 0 .4")}</body>',
    '<equality><connect body1="a" body2="b" anchor="0.5 0 0.8"/></equality>',
)


@pytest.mark.parametrize(
    ("text", "said", "limited"),
    [
        (stretched(1e-4), " at 4 moving states in ", ""),
        (
            stretched(1e-7),
            " except for motions, known at no state to better than ",
            "4 more states are next to singular configurations or have rounded loops, and test little",
        ),
        (TRUSS, " at 1 state in ", "nothing can move"),
    ],
    ids=["a little room", "hardly any", "none"],
)
def test_the_line_tells_what_few_states_show(text: str, said: str, limited: str, tmp_path: Path) -> None:
    (line,) = (line for line in reading(tmp_path, text).report.start if line.startswith("verified"))
    assert said in line
    assert line.partition("; ")[2] == limited


@pytest.mark.parametrize(("tilt", "told"), [("1e-4", True), ("0", False)])
def test_a_verdict_says_that_no_state_tells_motions(tilt: str, told: bool, tmp_path: Path) -> None:
    found = reading(tmp_path, TILTED.format(tilt), duration=0.02, verified=False)
    rigid = [engine for engine in ENGINES.values() if engine.soft_constraints is None]
    result = crosscheck(found.scene, rigid, lambda _: None, "tilted", {}, found.report)
    assert result.outcome.passes()
    assert (
        "; motions are not verified against the file: too inaccurate at every tested state" in result.verdict
    ) == told


def test_loops_that_close_nowhere_far_away_are_moved_a_little(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("newton_euler.reading.reference.MAX_SAMPLE_TRIES", 0)
    (reference, _), *_ = reading(tmp_path, stretched(1e-4)).report.references
    _, near = reference.samples
    assert 0.0 < np.max(np.abs(reference.difference(reference.start, near.q))) < 0.1
    monkeypatch.setattr("newton_euler.reading.reference.NEARBY_AMPLITUDES", ())
    (line,) = (x for x in reading(tmp_path, stretched(1e-4)).report.start if x.startswith("verified"))
    assert line.endswith("; loops close at the start alone")


def light(name: str, mass: float, moment: float) -> str:
    """A link with a moment of inertia that is the same about all axes."""
    moments = " ".join(f'{axis}="{moment}"' for axis in ("ixx", "iyy", "izz"))
    inertia = f'<mass value="{mass}"/><inertia {moments} ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><origin xyz="0 0 0"/>{inertia}</inertial></link>'


def hinge(parent: str, child: str, xyz: str, axis: str, more: str = "") -> str:
    return (
        f'<joint name="to_{child}" type="continuous"><origin xyz="{xyz}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>{more}</joint>'
    )


def hand(mimic: float) -> str:
    """A humanoid's trunk, arm and hand, whose 15 finger links of 2 mg follow the wrist by a factor."""
    parts = [light("trunk", 50.0, 0.5), light("arm", 0.5, 1e-3), light("palm", 2e-6, 1.1e-9)]
    parts += [hinge("trunk", "arm", "0 0.2 0.3", "0 1 0"), hinge("arm", "palm", "0.3 0 0", "1 0 0")]
    follows = f'<mimic joint="to_palm" multiplier="{mimic}"/>'
    for finger in range(5):
        links = ["palm", *(f"finger_{finger}_{k}" for k in range(3))]
        for before, link in pairwise(links):
            offset = f"0.014 {0.01 * finger if before == 'palm' else 0.0} 0"
            parts += [light(link, 2e-6, 1.1e-9), hinge(before, link, offset, "0 1 0", follows)]
    return f'<robot name="hand">{"".join(parts)}</robot>'


def test_mimics_of_very_light_links_are_held_to_what_an_elimination_leaves_of_them(tmp_path: Path) -> None:
    """An error of 1e-9 in a factor is found in positions, one of 1e-8 (50 tolerances) in accelerations."""
    path = tmp_path / "hand.urdf"
    path.write_text(hand(0.9999))
    (reference, scene), *_ = urdf.read(path, base="free").report.references
    assert all(figure.agrees for figure in verify(reference, Relative(scene)))
    for error, quantity in (
        (1e-9, "loop-closure error, sizes or rad"),
        (1e-8, "accelerations across loops, rel"),
    ):
        path.write_text(hand(0.9999 + error))
        wrong = urdf.read(path, base="free").scene
        failing = [figure for figure in verify(reference, Relative(wrong)) if not figure.agrees]
        assert quantity in {figure.quantity for figure in failing}


FOLDED = model(
    '<body><joint axis="0 1 0"/><inertial pos="0 0 0.2" mass="1" diaginertia=".01 .01 .01"/>'
    '<body pos="0 0 0.5"><joint axis="0 1 0"/><inertial pos="0 0 0.2" mass="1" diaginertia=".01 .01 .01"/>'
    '<body pos="0 0 0.4"><joint axis="0 1 0"/><inertial pos="0 0 -0.1" mass="1" diaginertia=".01 .01 .01"/>'
    '<body name="tip" pos="0 0 -0.3"><joint axis="0 1 0"/>'
    '<inertial pos="0 0 0.1" mass="1" diaginertia=".01 .01 .01"/></body></body></body></body>',
    '<equality><connect body1="tip" anchor="0 0 0.2"/></equality>',
)
"""Four bars in a line whose end is held: they start in a singular configuration."""


@pytest.mark.slow
def test_a_file_that_starts_in_a_singular_configuration_is_read_and_compared(tmp_path: Path) -> None:
    """No start velocities either: those that are free there begin no motion."""
    path = tmp_path / "model.xml"
    path.write_text(FOLDED)
    verdict = check(path, duration=0.1)
    (said,) = (line for line in verdict.crosscheck.mapping.start if line.startswith("excited: "))
    assert "the start is a singular configuration" in said
    assert verdict.outcome is Outcome.AGREE_AT_RANDOM_STATES_ONLY
    assert {figure.level for figure in verdict.checks} >= {*LEVELS_OF_EQUATIONS, *LEVELS_OF_RUNS}
