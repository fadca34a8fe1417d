"""Readings of model files against the files' own models: faults planted in them are found and named."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from mjcf_models import model, reading
from urdf_files import joint, link, robot

import urdf
from crosscheck.engines import ENGINES
from crosscheck.run import crosscheck
from crosscheck.studies.faults.misreadings import misreadings
from crosscheck.studies.faults.reading import find_in_reading
from mjcf.accounts import unaccounted
from mjcf.errors import MjcfError
from mjcf.reading.actuators import Actuators, Affine
from mjcf.reading.bodies import Bodies
from mjcf.reading.loops import Loops
from mjcf.reading.start import Start
from newton_euler.equations.relative import Relative
from newton_euler.errors import VerificationError
from newton_euler.model.forces import JointSpring
from newton_euler.model.mechanism import Body
from newton_euler.verification.import_report import ImportReport
from newton_euler.verification.verify import check, verify
from urdf.errors import UrdfError
from urdf.read import _scene as urdf_scene
from urdf.read import read as read_urdf
from urdf.reading.source import read_loops
from urdf.reading.start import Mimic
from urdf.reading.start import Start as UrdfStart

BOX = '<geom type="box" size="0.1 0.2 0.05" pos="{0}"/>'

ZOO = model(
    '<body name="crank"><joint name="a" axis="0 1 0" damping="0.02" armature="0.01"/>'
    f'{BOX.format("0.05 0 0.2")}<body name="coupler" pos="0.1 0 0.4"><joint name="b" axis="0 1 0"/>'
    f'{BOX.format("0.4 0 0.15")}<site name="tip" pos="0.4 0.1 0.2"/></body></body>'
    '<body name="rocker" pos="1 0 0"><joint name="d" axis="0 1 0" stiffness="3" springref="20"/>'
    f"{BOX.format('-0.05 0 0.35')}</body>"
    '<body name="base" pos="0 2 1" quat="0.8 0.2 -0.4 0.4"><freejoint name="root"/>'
    f'{BOX.format("0.1 0 0.1")}<site name="hook" pos="0.1 0.2 0.1"/>'
    '<body name="leg" pos="0.3 0 0" gravcomp="0.4"><joint name="ball" type="ball" stiffness="2" '
    f'damping="0.3" armature="0.02"/>{BOX.format("0 0.1 -0.4")}'
    '<body name="foot" pos="0 0 -0.6"><joint name="p" axis="1 0 0" damping="0.4" armature="0.03"/>'
    f'<joint name="q" axis="0 1 0" pos="0.03 0 0.05"/>{BOX.format("0.1 0 -0.1")}'
    '<body name="toe" pos="0.2 0 0"><joint name="r" type="slide" axis="1 0 0.2" stiffness="50" damping="2"/>'
    f'{BOX.format("0.1 0 0")}<body name="nail" pos="0.2 0 0"><joint name="s" axis="0 0 1"/>'
    f"{BOX.format('0.1 0.05 0')}</body></body></body></body></body>",
    '<equality><connect name="c" body1="coupler" body2="rocker" anchor="0.8 0 0.3"/>'
    '<joint name="geared" joint1="s" joint2="p" polycoef="0 -2 0 0 0"/><tendon name="summed" tendon1="sum"/>'
    "</equality>"
    '<tendon><spatial name="cord" stiffness="30" damping="1" springlength="0.5"><site site="tip"/>'
    '<site site="hook"/></spatial><fixed name="sum"><joint joint="p" coef="1"/><joint joint="q" coef="0.7"/>'
    '<joint joint="r" coef="3"/></fixed></tendon>'
    '<actuator><motor name="m" joint="a" gear="3" ctrlrange="-1 1"/><position name="servo" joint="q" kp="20" '
    'kv="2" gear="0.5"/><velocity name="speed" joint="r" kv="4"/><motor name="thrust" site="hook" '
    'gear="1 2 3 0.1 0.2 0.3"/></actuator>',
    '<compiler angle="radian"/>',
)
"""Each kind of element that a scene can hold; no control acts at the start."""


LARGER = ("doubled", "halved", "negated", "by 0.1")
"""Faults of values that a millionth is planted in as well."""

SEVERAL = ("exchanged", "permuted", "taken for", " as ", "dropped")
"""Faults that are seen at what depends on the element too, or at another one that acts like it."""


def test_every_fault_that_moves_something_is_found_and_named(tmp_path: Path) -> None:
    report = reading(tmp_path, ZOO).report
    faults = [f for f in misreadings(report.originals[-1][1]) if not any(x in f.detail for x in LARGER)]
    found = find_in_reading(report, lambda _: None, faults)
    assert len(found) > 200
    assert not [outcome.fault.name for outcome in found if outcome.missed]
    simple = [each for each in found if not any(x in each.fault.detail for x in SEVERAL)]
    assert not [
        (outcome.fault.name, outcome.where)
        for outcome in simple
        if outcome.figure and not outcome.named and not outcome.fault.kind.startswith("point")
    ]
    # points of free joints and slides, points along hinges, and signs of axes that nothing acts on, are no
    # faults of motion, nor is the kind of a joint in a flat loop
    idle = {(outcome.fault.element, outcome.fault.kind) for outcome in found if not outcome.moves}
    assert {kind for _, kind in idle} <= {"joint point", "axis", "joint type", "mass and inertia", "offset"}
    assert {element for element, kind in idle if kind == "axis"} <= {"b", "d", "root"}
    assert {outcome.fault.kind for outcome in found} >= {
        "mass", "inertia", "frame", "center of mass", "axis", "joint point", "equality", "gear", "gravity",
        "armature", "offset", "joint type", "joint", "mass and inertia", "stiffness of PD", "damping of PD",
        "target of PD", "feedforward of PD", "stiffness of JointSpring", "damping of JointSpring",
        "rest of JointSpring", "stiffness of BallSpring", "damping of BallSpring", "rest of BallSpring",
        "stiffness of PointSpring", "damping of PointSpring", "rest_length of PointSpring",
        "point_on_first of PointSpring", "point_on_second of PointSpring", "force of Wrench",
        "torque of Wrench", "point of Wrench", "frame of Wrench",
    }  # fmt: skip


@pytest.mark.parametrize("name", ENGINES)
def test_every_engine_has_what_the_file_says(name: str, tmp_path: Path) -> None:
    for original, scene in reading(tmp_path, ZOO).report.originals:
        figures = list(verify(original, ENGINES[name].systems(scene)[0]))
        assert len(figures) == 24
        assert not [figure for figure in figures if not figure.agrees]


def scaled_gain(self: Any, actuator: int, element: str, affine: Any = Actuators._affine) -> Affine | None:
    law = affine(self, actuator, element)
    return Affine(*(0.5 * x for x in law)) if law and element.endswith("'m'") else law


def heavier(self: Any, root: int, path: str, body: Any = Bodies._body) -> Body:
    made: Body = body(self, root, path)
    return replace(made, mass=2.0 * made.mass)


def nothing(*_: object) -> None:
    return None


@pytest.mark.parametrize(
    ("of", "method", "fault", "named"),
    [
        (Actuators, "_affine", scaled_gain, "actuator 'm'.*actuators, rel"),
        (Bodies, "_body", heavier, "crank.*mass, rel"),
        (Loops, "_add_closure", nothing, "elements unaccounted for"),
        (Loops, "_couple", nothing, "elements unaccounted for"),
    ],
    ids=["half a gain at control 0", "twice all masses", "no connects", "no gears"],
)
def test_a_reader_at_fault_is_refused(
    of: type, method: str, fault: Any, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(of, method, fault)
    with pytest.raises(MjcfError, match=f"model.xml: .*{named}"):
        reading(tmp_path, ZOO)


LIMITED = model(
    f'<body><joint name="a" axis="0 1 0" actuatorfrcrange="-9 9"/>{BOX.format("0.1 0 0")}</body>',
    '<tendon><fixed name="t" actuatorfrcrange="0 8"><joint joint="a" coef="1"/></fixed></tendon><actuator>'
    '<general name="slow" joint="a" dyntype="filter" dynprm="0.05" gainprm="5"/>'
    '<motor name="m" joint="a" forcerange="-7 7"/><motor name="pull" tendon="t"/></actuator>'
    '<keyframe><key ctrl="1 0 0" act="0"/></keyframe>',
)
"""Each limit of forces, and an actuator whose activation goes to 1."""


@pytest.mark.parametrize("exercise", [False, True])
def test_dynamics_of_actuators_that_are_lost_are_found(
    exercise: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert reading(tmp_path, LIMITED, exercise=exercise).report.originals[0][0].unaccounted == ()
    monkeypatch.setattr(
        Actuators, "_activation", lambda self, k: float(self._data.act[0]) if k == 0 else self._control(k)
    )
    with pytest.raises(MjcfError, match=r"'slow': its activation, which does not rest: .* unaccounted"):
        reading(tmp_path, LIMITED, exercise=exercise)


@pytest.mark.parametrize(
    ("element", "lost"),
    [
        ("actuator 'm'", "limit of the force"),
        ("actuator 'pull'", "limit of its tendon"),
        ("joint 'a'", "limit of actuator forces"),
    ],
)
def test_limits_of_forces_that_are_lost_are_found(
    element: str, lost: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def left_out(self: Any, element: str, why: str, topic: str = "", **rest: Any) -> None:
        if topic != lost:
            kept(self, element, why, topic, **rest)

    kept = ImportReport.left_out
    monkeypatch.setattr(ImportReport, "left_out", left_out)
    with pytest.raises(MjcfError, match=f"{element}: {lost}: .* elements unaccounted for"):
        reading(tmp_path, LIMITED)


COMPENSATED = model(
    '<body gravcomp="1"><joint name="a" axis="0 1 0" actuatorgravcomp="true" actuatorfrcrange="-99 99"/>'
    f"{BOX.format('0.1 0 0')}</body>",
    '<actuator><position name="servo" joint="a" kp="3" kv="1" forcerange="-9 9"/></actuator>',
)
"""A limit that counts more than the control law."""


@pytest.mark.parametrize("exercise", [False, True])
@pytest.mark.parametrize(
    ("of", "method", "fault", "named"),
    [
        (Actuators, "_others", lambda *_: "", "joint 'a'"),
        (Actuators, "_limited", None, "actuator 'servo'"),
    ],
    ids=["gravity compensation", "half of a force"],
)
def test_limits_are_watched_of_the_forces_that_the_file_has(
    of: type,
    method: str,
    fault: Any,
    named: str,
    exercise: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert reading(tmp_path, COMPENSATED, exercise=exercise)

    def half(
        self: Any, k: int, element: str, law: Affine, moments: Any, kept: Any = Actuators._limited
    ) -> Any:
        return law, kept(self, k, element, Affine(*(0.5 * x for x in law)), moments)[1]

    monkeypatch.setattr(of, method, fault or half)
    with pytest.raises(MjcfError, match=f"{named}: .*limits of forces, rel"):
        reading(tmp_path, COMPENSATED, exercise=exercise)


POSE = "0 0 0 0.2 2 1 0.8 0.2 -0.4 0.4 1 0 0 0 0.1 0.2 -0.08 -0.2"

SPEEDS = "0 0 0 1 0 0 0 2 0 0 0 3 1 2 -0.8 -2"

STARTS = ZOO.replace(
    "</actuator>",
    f'</actuator><keyframe><key name="still" qpos="{POSE}"/>'
    f'<key name="moving" qpos="{POSE}" qvel="{SPEEDS}"/></keyframe>',
)


def other_key(self: Any, key: str | None, place: Any = Start._place) -> str:
    place(self, "qpos0" if key == "still" else "still")
    return str(key)


@pytest.mark.parametrize(
    ("key", "figure"), [("still", "start, sizes or rad"), ("moving", "velocities at the start")]
)
def test_a_start_that_is_not_that_of_the_file_is_refused(
    key: str, figure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert any(line.startswith("verified") for line in reading(tmp_path, STARTS, key=key).report.start)
    monkeypatch.setattr(Start, "_place", other_key)
    with pytest.raises(MjcfError, match=f"the scene is not what the file says: {figure}"):
        reading(tmp_path, STARTS, key=key)


APART = model(
    f'<body name="crank"><joint name="a" axis="0 1 0"/>{BOX.format("0 0 0.1")}'
    f'<body name="coupler" pos="0 0 0.2"><joint name="b" axis="0 1 0"/>{BOX.format("0.25 0 0.05")}'
    f'</body></body><body name="rocker" pos="0.5 0 0"><joint name="c" axis="0 1 0"/>{BOX.format("0 0 0.15")}'
    f'</body><body name="pendulum" pos="2 0 0"><joint name="p" axis="0 1 0"/>{BOX.format("0.1 0 0")}</body>',
    '<equality><connect name="loop" body1="coupler" body2="rocker" anchor="0.5 0 0.1"/></equality>'
    '<keyframe><key name="open" qpos="0.3 0 0 0.2" qvel="1 1 1 3"/></keyframe>',
)
"""A pendulum, and a four-bar far from closed with velocities that its loop does not let be."""


@pytest.mark.parametrize(
    ("which", "element", "shift", "figure"),
    [
        ("qpos", 3, 1e-9, "joint 'p': .*start, sizes or rad"),
        ("qpos", 0, 1e-6, "joint '.': .*start, sizes or rad"),
        ("qvel", 3, 1e-9, "joint 'p': .*velocities at the start"),
        ("qvel", 0, 1e-6, "joint '.': .*velocities at the start"),
    ],
)
def test_loops_that_a_start_closes_hide_no_fault_of_it(
    which: str, element: int, shift: float, figure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert any(line.startswith("verified") for line in reading(tmp_path, APART).report.start)

    def moved(self: Any, key: str | None, place: Any = Start._place) -> str:
        found: str = place(self, key)
        getattr(self.data, which)[element] += shift
        return found

    monkeypatch.setattr(Start, "_place", moved)
    with pytest.raises(MjcfError, match=figure):
        reading(tmp_path, APART)


def test_what_drives_an_exercised_reading_is_that_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the amplitude of a force, which is 0 at the start."""
    of_control = Actuators._of_control
    monkeypatch.setattr(Actuators, "_of_control", lambda self, k, share: of_control(self, k, 0.5 * share))
    with pytest.raises(MjcfError, match="the scene is not what the file says: actuators, rel"):
        reading(tmp_path, ZOO, exercise=True)


def test_an_equality_that_is_reported_and_not_there_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def told(self: Any, index: int) -> None:
        self._report.exactly(self._start.equality(index), "carried over")

    monkeypatch.setattr(Loops, "_add_closure", told)
    with pytest.raises(MjcfError, match=r"equality 'c': .*motions free in the scene alone"):
        reading(tmp_path, ZOO)


def test_the_command_line_shows_what_the_library_refuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bodies, "_body", heavier)
    path = tmp_path / "model.xml"
    path.write_text(ZOO.split('<body name="base"')[0] + "</worldbody></mujoco>")
    options = ("--set", "duration=0.1", "--output", tmp_path / "out", "--engines", "newton_euler,mujoco")
    status, out, _ = run(capsys, "run", path, *options)
    assert status == 1
    assert "each engine against" in out
    assert "at level 'reading': mass, rel: 1 > 1e-12" in out
    status, _, error = run(capsys, "convert", path, tmp_path / "scene.yaml")
    assert status == 2
    assert "the scene is not what the file says: mass, rel: 1 > 1e-12" in error


def test_an_equilibrium_with_nothing_beside_round_off_is_no_fault(tmp_path: Path) -> None:
    """Springs at rest and no gravity: accelerations of round-off beside others of exactly 0."""
    text = ZOO.replace('springref="20"', "").replace(
        '<compiler angle="radian"/>', '<option gravity="0 0 0"/>'
    )
    report = reading(tmp_path, text.replace('gravcomp="0.4"', "")).report
    assert any(line.startswith("verified") for line in report.start)


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
    (original, scene), *_ = reading(tmp_path, TILTED.format(tilt)).report.originals
    wrong = replace(scene, forces=(JointSpring("a", damping=1.0 + 1e-5),))
    (failing, *_) = (figure for figure in verify(original, Relative(wrong)) if not figure.agrees)
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


@pytest.mark.parametrize("gap", [1e-6, 1e-5, 1e-4, 4e-4])
def test_offsets_that_loops_keep_hide_no_fault(gap: float, tmp_path: Path) -> None:
    """Faults of a millionth are seen, in the same figures, as they are with the loop closed."""
    seen = []
    for each in (0.0, gap):
        report = reading(tmp_path, offset(each)).report
        (line,) = (line for line in report.start if line.startswith("verified"))
        faults = [
            f for f in misreadings(report.originals[-1][1]) if "1e-6" in f.detail or "1e-06" in f.detail
        ]
        found = find_in_reading(report, lambda _: None, faults)
        seen.append([(outcome.fault.name, outcome.figure) for outcome in found if outcome.figure])
        assert float(line.split(" to ")[1].split()[0]) < 1e-10
    assert len(seen[0]) > 30
    assert seen[0] == seen[1]


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
            " but for motions, which no state tells to better than ",
            "at 4 more, next to singular configurations or with noise in loops, little shows",
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
    rigid = [engine for engine in ENGINES.values() if engine.soft_start is None]
    result = crosscheck(found.scene, rigid, lambda _: None, "tilted", {}, found.report)
    assert result.agrees
    assert ("; motions are not verified against the file: no state tells them" in result.verdict) == told


def test_loops_that_close_nowhere_far_away_are_moved_a_little(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("newton_euler.verification.original.ATTEMPTS", 0)
    (original, _), *_ = reading(tmp_path, stretched(1e-4)).report.originals
    _, near = original.samples
    assert 0.0 < np.max(np.abs(original.difference(original.start, near.q))) < 0.1
    monkeypatch.setattr("newton_euler.verification.original.NEAR", ())
    (line,) = (x for x in reading(tmp_path, stretched(1e-4)).report.start if x.startswith("verified"))
    assert line.endswith("; loops close nowhere but at the start")


def test_tolerances_are_those_of_the_line(tmp_path: Path) -> None:
    """Of all figures of motions at a state; forces and mass properties have none that is larger."""
    report = reading(tmp_path, ZOO).report
    (line,) = (line for line in report.start if line.startswith("verified"))
    loosest = float(line.split(" to ")[1].split()[0])
    for original, scene in report.originals:
        figures = [f for f in verify(original, Relative(scene)) if f.quantity.endswith(("rel", "rad", "1/s"))]
        # inertias are known to as many digits less as places in the world cost; the line has one digit
        assert max(f.tolerance for f in figures if f.quantity != "inertia, rel") <= 1.5 * loosest


def test_every_element_has_to_be_accounted_for(tmp_path: Path) -> None:
    text = ZOO.replace('name="r" type="slide"', 'name="r" type="slide" range="-1 1" frictionloss="2"')
    report = reading(tmp_path, text).report
    original, _ = report.originals[0]
    assert original.unaccounted == ()
    kept = ImportReport()
    kept.entries = [
        entry for entry in report.entries if "'r'" not in entry.element and "'c'" not in entry.element
    ]
    missing = set(unaccounted(original._model, original._roots, kept))  # type: ignore[attr-defined]
    assert missing == {"joint 'r'", "joint 'r': limits", "joint 'r': dry friction", "equality 'c'"}


GEARED = robot(
    link("a"), link("b"), link("c"),
    joint("one", "revolute", "base", "a", '<dynamics damping="0.3"/>'),
    joint("two", "revolute", "a", "b", '<mimic joint="one" multiplier="0.5" offset="0.3"/>'),
    joint("three", "prismatic", "b", "c", '<dynamics damping="2"/>'),
)  # fmt: skip


def test_faults_in_the_reading_of_a_urdf_are_found_and_named(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(GEARED)
    report = read_urdf(path).report
    found = find_in_reading(report, lambda _: None)
    assert not [outcome.fault.name for outcome in found if outcome.missed]
    assert not [
        (outcome.fault.name, outcome.where) for outcome in found if outcome.figure and not outcome.named
    ]
    assert {outcome.fault.kind for outcome in found} >= {"mass", "axis", "gear", "damping of JointSpring"}


def test_a_urdf_that_is_not_read_right_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urdf.read._springs", lambda *_: iter(()))
    path = tmp_path / "robot.urdf"
    path.write_text(GEARED)
    with pytest.raises(UrdfError, match="the scene is not what the file says: dampers, rel: 1 > "):
        read_urdf(path)


def started(self: Any, mimics: Any, mimicked: Any = UrdfStart._mimicked) -> Any:
    moved = mimicked(self, mimics)
    moved[-1] += 2.0
    return moved


def shifted(self: Any, joint: Any, mimic: Any, init: Any = Mimic.__init__) -> None:
    init(self, joint, mimic)
    self.offset += 0.1


@pytest.mark.parametrize(
    ("where", "fault", "named"),
    [
        ("urdf.reading.start.Start._mimicked", started, "joint 'three': .*start, sizes or rad"),
        ("urdf.read.Mimic.__init__", shifted, "mimic of joint 'two': .*loops open at the start"),
    ],
    ids=["a joint elsewhere", "another offset"],
)
def test_the_start_of_a_urdf_is_that_of_the_file(
    where: str, fault: Any, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(GEARED)
    read_urdf(path)
    monkeypatch.setattr(where, fault)
    with pytest.raises(UrdfError, match=named):
        read_urdf(path)


def fewer(path: str, text: str) -> Any:
    loops = read_loops(path, text)
    return replace(loops, closed_loop=loops.closed_loop[:-1], type=loops.type[:-1])


def lighter(*args: Any) -> Any:
    *others, gravity = args
    return urdf_scene(*others, [0.5 * x for x in gravity])


@pytest.mark.parametrize(
    ("where", "fault", "named"),
    [
        ("urdf.read.read_loops", fewer, "closed_loop .*: elements unaccounted for"),
        ("urdf.read._scene", lighter, "gravity: .*gravity, rel"),
    ],
    ids=["one loop fewer", "half of gravity"],
)
def test_the_original_of_a_urdf_has_its_own_loops_and_gravity(
    where: str, fault: Any, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(urdf.__file__).parent / "tracker.urdf"
    monkeypatch.setattr(where, fault)
    with pytest.raises(UrdfError, match=named):
        read_urdf(path, path.with_name("tracker.loops.yaml"))


def test_an_error_keeps_its_values(tmp_path: Path) -> None:
    report = reading(tmp_path, ZOO).report
    original, scene = report.originals[0]
    other = ImportReport()
    other.originals = [(original, replace(scene, gravity=np.array([0.0, 0.0, -9.8])))]
    with pytest.raises(VerificationError) as caught:
        check(other)
    assert (caught.value.where, caught.value.quantity) == ("gravity", "gravity, rel")
    assert caught.value.value > caught.value.tolerance


def test_verification_shares_nothing_with_the_readers() -> None:
    for package, module in (("mjcf", "original"), ("mjcf", "accounts"), ("urdf", "original")):
        path = Path(__file__).parents[3] / package / f"{module}.py"
        imported = {
            node.module for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)
        }
        assert not [name for name in imported if name and f"{package}.reading" in name]
