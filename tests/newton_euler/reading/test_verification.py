"""Readings of model files against the files' own models: faults planted in them are found and named."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from mjcf_models import BOX, model, reading

from crosscheck.engines.registry import ENGINES
from crosscheck.studies.faults.find import find_in_reading
from crosscheck.studies.faults.misreadings import misreadings
from mjcf.errors import MjcfError
from mjcf.reading.actuators import Actuators, Affine
from mjcf.reading.bodies import Bodies
from mjcf.reading.loops import Loops
from mjcf.reading.start import ModelAtStart
from mjcf.report_audit import unaccounted
from newton_euler.equations.relative import Relative
from newton_euler.errors import VerificationError
from newton_euler.model.mechanism import Body
from newton_euler.reading.import_report import ImportReport
from newton_euler.reading.verify import verify, verify_report

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


@pytest.mark.slow
def test_every_fault_that_moves_something_is_found_and_named(tmp_path: Path) -> None:
    """One of each kind in each element; `crosscheck faults --reading` plants all."""
    report = reading(tmp_path, ZOO).report
    faults = [
        f
        for f in misreadings(report.references[-1][1])
        if f.size != 0.1 and not any(x in f.detail for x in LARGER)
    ]
    first = {(fault.element, fault.kind): fault for fault in reversed(faults)}
    found = find_in_reading(report, lambda _: None, [*first.values()]).found
    assert len(found) > 100
    assert not [outcome.fault.name for outcome in found if outcome.is_detectable and not outcome.detection]
    simple = [each for each in found if not any(x in each.fault.detail for x in SEVERAL)]
    assert not [
        (outcome.fault.name, outcome.detection.where)
        for outcome in simple
        if outcome.detection and not outcome.located and not outcome.fault.kind.startswith("point")
    ]
    # points of free joints and slides, points along hinges, and signs of axes that nothing acts on, are no
    # faults of motion, nor is the kind of a joint in a flat loop
    idle = {(outcome.fault.element, outcome.fault.kind) for outcome in found if not outcome.observable}
    axes, bodies = {"axis direction", "axis sign"}, {"swapped bodies", "inertia entry"}
    assert {kind for _, kind in idle} <= {"joint point", "joint type", "offset", *axes, *bodies}
    assert {element for element, kind in idle if kind in axes} <= {"b", "d", "root"}
    assert {outcome.fault.kind for outcome in found} >= {
        "mass", "inertia entry", "frame of inertia", "center of mass", "axis direction", "axis sign",
        "joint point", "closure point", "equality", "gear", "gravity",
        "armature", "offset", "joint type", "joint", "swapped bodies", "missing body",
        "stiffness of PD", "damping of PD",
        "target of PD", "feedforward of PD", "stiffness of JointSpring", "damping of JointSpring",
        "rest of JointSpring", "stiffness of BallSpring", "damping of BallSpring", "rest of BallSpring",
        "stiffness of PointSpring", "damping of PointSpring", "rest_length of PointSpring",
        "point_on_first of PointSpring", "point_on_second of PointSpring", "force of Wrench",
        "torque of Wrench", "point of Wrench", "frame of Wrench",
    }  # fmt: skip


@pytest.mark.parametrize("name", ENGINES)
def test_every_engine_has_what_the_file_says(name: str, tmp_path: Path) -> None:
    for reference, scene in reading(tmp_path, ZOO).report.references:
        figures = list(verify(reference, ENGINES[name].systems(scene)[0]))
        assert len(figures) == 24
        assert not [figure for figure in figures if not figure.agrees]


def scaled_gain(
    self: Any, actuator: int, element: str, affine: Any = Actuators._affine_force
) -> Affine | None:
    law = affine(self, actuator, element)
    return Affine(*(0.5 * x for x in law)) if law and element.endswith("'m'") else law


def heavier(self: Any, root: int, path: str, body: Any = Bodies._body) -> Body:
    made: Body = body(self, root, path)
    return replace(made, mass=2.0 * made.mass)


def nothing(*_: object, **__: object) -> None:
    return None


def told(self: Any, index: int) -> None:
    self._report.imported(self._start.equality(index), "carried over")


def steady(self: Any, actuator: int) -> float:
    return float(self._data.act[0]) if actuator == 0 else self._control(actuator)


def half_of_it(
    self: Any, k: int, element: str, law: Affine, moments: Any, kept: Any = Actuators._report_limits
) -> None:
    kept(self, k, element, Affine(*(0.5 * x for x in law)), moments)


LIMITED = model(
    f'<body><joint name="a" axis="0 1 0" actuatorfrcrange="-9 9"/>{BOX.format("0.1 0 0")}</body>',
    '<tendon><fixed name="t" actuatorfrcrange="0 8"><joint joint="a" coef="1"/></fixed></tendon><actuator>'
    '<general name="slow" joint="a" dyntype="filter" dynprm="0.05" gainprm="5"/>'
    '<motor name="m" joint="a" forcerange="-7 7"/><motor name="pull" tendon="t"/></actuator>'
    '<keyframe><key ctrl="1 0 0" act="0"/></keyframe>',
)
"""Each limit of forces, and an actuator whose activation goes to 1."""

BORNE = model(
    '<body gravcomp="1"><joint name="a" axis="0 1 0" actuatorgravcomp="true" actuatorfrcrange="-99 99"/>'
    f"{BOX.format('0.1 0 0')}</body>",
    '<actuator><position name="servo" joint="a" kp="3" kv="1" forcerange="-9 9"/></actuator>',
)
"""A limit that counts more than the control law."""


@pytest.mark.parametrize("excitation", [False, True])
@pytest.mark.parametrize(
    ("text", "method", "fault", "named"),
    [
        (ZOO, (Actuators, "_affine_force"), scaled_gain, "actuator 'm'.*actuators, rel"),
        (ZOO, (Bodies, "_body"), heavier, "crank.*mass, rel"),
        (ZOO, (Loops, "_add_closure"), nothing, "elements unaccounted for"),
        (ZOO, (Loops, "_couple"), nothing, "elements unaccounted for"),
        (ZOO, (Loops, "_add_closure"), told, "equality 'c': .*motions free in the scene alone"),
        (LIMITED, (Actuators, "_activation"), steady, "'slow': its activation changes: .* unaccounted"),
        (BORNE, (Actuators, "_other_forces"), lambda *_: "", "joint 'a': .*limits of forces, rel"),
        (BORNE, (Actuators, "_report_limits"), half_of_it, "actuator 'servo': .*limits of forces, rel"),
    ],
    ids=[
        "half a gain at control 0", "twice all masses", "no connects", "no gears", "a connect only said",
        "dynamics", "gravity compensation", "half of a force that is watched",
    ],
)  # fmt: skip
def test_a_reader_at_fault_is_refused(
    text: str,
    method: tuple[type, str],
    fault: Any,
    named: str,
    excitation: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reading(tmp_path, text, excitation=excitation)
    monkeypatch.setattr(*method, fault)
    with pytest.raises(MjcfError, match=f"model.xml: .*{named}"):
        reading(tmp_path, text, excitation=excitation)


POSE = "0 0 0 0.2 2 1 0.8 0.2 -0.4 0.4 1 0 0 0 0.1 0.2 -0.08 -0.2"

SPEEDS = "0 0 0 1 0 0 0 2 0 0 0 3 1 2 -0.8 -2"

STARTS = ZOO.replace(
    "</actuator>",
    f'</actuator><keyframe><key name="still" qpos="{POSE}"/>'
    f'<key name="moving" qpos="{POSE}" qvel="{SPEEDS}"/></keyframe>',
)


def other_key(self: Any, key: str | None, place: Any = ModelAtStart._place) -> str:
    place(self, "qpos0" if key == "still" else "still")
    return str(key)


@pytest.mark.parametrize(
    ("key", "figure"), [("still", "start, sizes or rad"), ("moving", "velocities at the start")]
)
def test_a_start_that_is_not_that_of_the_file_is_refused(
    key: str, figure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert any(line.startswith("verified") for line in reading(tmp_path, STARTS, key=key).report.start)
    monkeypatch.setattr(ModelAtStart, "_place", other_key)
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

    def moved(self: Any, key: str | None, place: Any = ModelAtStart._place) -> str:
        found: str = place(self, key)
        getattr(self.data, which)[element] += shift
        return found

    monkeypatch.setattr(ModelAtStart, "_place", moved)
    with pytest.raises(MjcfError, match=figure):
        reading(tmp_path, APART)


def test_the_command_line_shows_what_the_library_refuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bodies, "_body", heavier)
    path = tmp_path / "model.xml"
    path.write_text(ZOO.split('<body name="base"')[0] + "</worldbody></mujoco>")
    options = ("--set", "duration=0.1", "--output", tmp_path / "out", "--engines", "newton_euler,mujoco")
    status, out, _ = run(capsys, "run", path, *options)
    assert status == 1
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


def test_tolerances_are_those_of_the_line(tmp_path: Path) -> None:
    """Of all figures of motions at a state; forces and mass properties have none that is larger."""
    report = reading(tmp_path, ZOO).report
    (line,) = (line for line in report.start if line.startswith("verified"))
    loosest = float(line.split(" to ")[1].split()[0])
    for reference, scene in report.references:
        figures = [
            f for f in verify(reference, Relative(scene)) if f.quantity.endswith(("rel", "rad", "1/s"))
        ]
        # inertias are known to as many digits less as places in the world cost; the line has one digit
        assert max(f.tolerance for f in figures if f.quantity != "inertia, rel") <= 1.5 * loosest


def test_every_element_has_to_be_accounted_for(tmp_path: Path) -> None:
    text = ZOO.replace('name="r" type="slide"', 'name="r" type="slide" range="-1 1" frictionloss="2"')
    report = reading(tmp_path, text).report
    reference, _ = report.references[0]
    assert reference.unaccounted == ()
    kept = ImportReport()
    kept.entries = [
        entry for entry in report.entries if "'r'" not in entry.element and "'c'" not in entry.element
    ]
    missing = set(unaccounted(reference._model, reference._roots, kept))  # type: ignore[attr-defined]
    assert missing == {"joint 'r'", "equality 'c'"}


def test_an_error_keeps_its_values(tmp_path: Path) -> None:
    report = reading(tmp_path, ZOO).report
    reference, scene = report.references[0]
    other = ImportReport()
    other.references = [(reference, replace(scene, gravity=np.array([0.0, 0.0, -9.8])))]
    with pytest.raises(VerificationError) as caught:
        verify_report(other)
    assert (caught.value.where, caught.value.quantity) == ("gravity", "gravity, rel")
    assert caught.value.value > caught.value.tolerance


def test_verification_shares_nothing_with_the_readers() -> None:
    modules = (
        "mjcf/reference.py",
        "mjcf/report_audit.py",
        "urdf/reference.py",
        "urdf/pinocchio_reference.py",
    )
    for module in modules:
        tree = ast.parse((Path(__file__).parents[3] / module).read_text())
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        package = module.partition("/")[0]
        assert not [name for name in imported if name and f"{package}.reading" in name]
