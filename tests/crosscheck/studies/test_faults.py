"""Planted faults: which are found, what is blamed, and what cannot be observed."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import ball_scenes
import numpy as np
import pytest
from command_line import EXAMPLE, run
from elements import JOINTS
from mechanisms import GRAVITY, pendulum

from crosscheck.engines.registry import ENGINES, OPTIONAL, NotInstalledError, choose
from crosscheck.library import load
from crosscheck.report.page import write_report
from crosscheck.studies.faults import find as finding
from crosscheck.studies.faults import injection
from crosscheck.studies.faults.catalog import FAULT_SIZES, Fault, catalog, max_faults_of_kind
from crosscheck.studies.faults.find import (
    READING,
    REFUSED,
    SMALLEST_REQUIRED,
    Detection,
    FaultFree,
    FaultResult,
    FaultSearch,
    find_fault,
    find_faults,
)
from crosscheck.studies.faults.report import (
    Count,
    count_detected,
    count_detected_by_motion,
    detects_enough,
    finding_lines,
    report,
)
from crosscheck.support.errors import CrosscheckError
from newton_euler import Armature, Body, JointSpring, Mechanism, Scene
from newton_euler.errors import MechanismError
from newton_euler.model.joint_kinds import Fixed

KINDS = {
    "mass",
    "center of mass",
    "inertia entry",
    "frame of inertia",
    "joint point",
    "closure point",
    "axis direction",
    "gravity",
    "gain",
    "damping",
    "actuator reference",
    "quaternion order",
    "missing body",
    "swapped bodies",
    "axis sign",
    "joint type",
    "missing closure",
    "velocity term",
}


ALL = (*ENGINES, *OPTIONAL)
"""Names of all engines of this project."""


def engine_named(name):
    """Return an engine; skip the test if it is not installed."""
    try:
        (engine,) = choose([name])
    except NotInstalledError as error:
        pytest.skip(str(error))
    return engine


def compared_with(engine):
    """Return the default engines and the engine."""
    return list({each.name: each for each in (*ENGINES.values(), engine)}.values())


@pytest.fixture(scope="module")
def example():
    return load(str(EXAMPLE))


@pytest.fixture(scope="module")
def own(example):
    return FaultFree(example)


@pytest.fixture(scope="module")
def found(example):
    return find_faults(example, lambda message: None, sizes=(1e-1, 1e-4)).found


@pytest.mark.slow
def test_faults_of_every_kind_are_found_and_blamed(found):
    assert {f.fault.kind for f in found} == KINDS
    assert {f.engine for f in found} == set(ENGINES)
    count = count_detected(found)
    assert count.total > 100
    assert count.detected == count.located == count.total


@pytest.mark.parametrize("name", ALL)
def test_a_fault_of_each_kind_is_located_in_each_engine(example, name):
    engine = engine_named(name)
    few = {fault.kind: fault for fault in catalog(example, (1e-2,))}  # the last one of each kind
    free = FaultFree(example, compared_with(engine))
    assert few.keys() == KINDS
    found = [find_fault(fault, engine, free) for fault in few.values()]
    assert {each.detection.outlier for each in found} == {name}
    assert [each.fault.name for each in found if not each.located] == []


@pytest.mark.slow
def test_motion_alone_finds_them_too(found):
    """Nine of ten are placed as well; what is not is a body taken for a joint at it, or the other way."""
    count = count_detected_by_motion(found)
    assert count.total > 80
    assert count.detected == count.total
    assert count.located > 0.9 * count.total


@pytest.mark.slow
def test_what_no_motion_shows(found):
    """A body that turns about its y axis alone feels the y column of its inertia and no other entry."""
    hidden = {
        (f.fault.element, f.fault.detail)
        for f in found
        if f.fault.kind == "inertia entry" and not f.observable
    }
    # the crank and the rocker turn about y; the ball at the elbow lets the coupler turn about all axes
    assert hidden == {(body, entry) for body in ("crank", "rocker") for entry in ("xx", "xz", "zz")}


@pytest.mark.parametrize(("gravity", "observable"), [((0.0, 0.0, 0.0), False), (GRAVITY, True)])
def test_the_mass_of_a_body_fixed_to_the_ground(gravity, observable):
    """It does nothing but weigh on its joint; the model shows it."""
    swinging = pendulum()
    stone = Body("stone", 2.0, [0.0, 0.0, 3.0], np.eye(3))
    held = Fixed("held", "ground", "stone", [0.0, 0.0, 3.0])
    mechanism = Mechanism([*swinging.mechanism.bodies, stone], [*swinging.mechanism.joints, held])
    scene = Scene("held", mechanism, 1.0, 0.1, gravity)
    fault = Fault("mass", "stone", "", 0.1, injection.mass("stone", 0.1), frozenset({"stone"}))
    result = find_fault(fault, ENGINES["mujoco"], FaultFree(scene))
    assert result.observable == observable
    assert (result.detection.level, result.detection.where) == ("model", "stone")
    assert (result.detection_by_motion is not None) == observable


@pytest.mark.parametrize(
    ("scene", "closing"),
    [
        # engines cut this loop at another ball than newton_euler, as that ball has a spring
        (ball_scenes.two_ball_loop(loaded="at_c"), {"at_b"}),
        (JOINTS["rods"], {"coupler", "stay"}),  # of another length
    ],
)
def test_points_of_closures_in_each_engine(scene, closing):
    faults = [fault for fault in catalog(scene, (1e-2,)) if fault.kind == "closure point"]
    assert {fault.element for fault in faults} == closing
    free = FaultFree(scene)
    for engine in ENGINES.values():
        result = find_fault(faults[0], engine, free)
        assert result.located
        assert result.detection.level in ("model", REFUSED)


def test_an_open_closure_is_refused_or_seen(example, own):
    (fault,) = (f for f in catalog(example, (1e-6,)) if f.kind == "closure point" and f.detail == "y")
    refused = find_fault(fault, ENGINES["pinocchio"], own)
    assert refused.detection.level == REFUSED
    planted = find_fault(fault, ENGINES["mujoco"], own)
    assert planted.detection.quantity == "joint points, m"
    assert planted.detection_by_motion.quantity == "loop-closure error, rel"
    size = example.mechanism.size
    assert planted.detection.value == pytest.approx(1e-6 * size, rel=1e-6)  # coordinates of 1 m hold 1e-16
    for result in (refused, planted):
        assert result.located
        assert result.located_by_motion
        assert result.detection.where == fault.element


@pytest.mark.parametrize("kind", ["gain", "damping", "armature"])
def test_springs_and_armatures_are_told_from_bodies(kind):
    """By motion alone: what the engine's forces leave over is what the joint's element could do."""
    scene = replace(pendulum(), forces=(JointSpring("pivot", 3.0, 0.5),), armatures=(Armature("pivot", 0.3),))
    (fault,) = (f for f in catalog(scene, (1e-3,)) if f.kind == kind)
    sound = FaultFree(scene)
    for name in ENGINES:
        result = find_fault(fault, ENGINES[name], sound)
        assert result.detection.level == "dynamics"
        assert result.located
        assert not replace(result, fault=replace(fault, expected=frozenset({"ground"}))).located


@pytest.mark.parametrize("name", ALL)
def test_a_dropped_velocity_term_is_found_at_its_hinge(name):
    """omega x axis v turns the axis of all hinges but the first, before which nothing turns."""
    scene, engine = load("chain"), engine_named(name)
    free = FaultFree(scene, compared_with(engine))
    found = {
        fault.element: find_fault(fault, engine, free)
        for fault in catalog(scene, ())
        if fault.kind == "velocity term" and fault.element in ("hinge_0", "hinge_2")
    }
    assert not found["hinge_0"].is_detectable
    assert found["hinge_2"].located
    assert found["hinge_2"].located_by_motion
    assert found["hinge_2"].detection.level == "dynamics"
    assert found["hinge_2"].detection.value > 1e-3  # of the largest force: as much as the term itself does


def test_what_a_smaller_fault_does_is_not_unobservable(monkeypatch, example):
    """It does the same, less: below round-off it is missed."""
    faults = [a_fault(size).fault for size in (1e-1, 1e-6)]
    results = {fault.size: a_fault(fault.size, observable=fault.size == 1e-1) for fault in faults}
    monkeypatch.setattr(finding, "catalog", lambda scene, sizes: faults)
    monkeypatch.setattr(finding, "find_fault", lambda fault, engine, own: results[fault.size])
    assert [f.observable for f in find_faults(example, lambda message: None).found] == [True, True]
    results[1e-1] = replace(results[1e-1], observable=False)
    assert [f.observable for f in find_faults(example, lambda message: None).found] == [False, False]


@pytest.mark.parametrize("name", ["tracker", "four_bar", "slider_crank", "stewart"])
def test_catalogs(name):
    scene = load(name)
    faults = catalog(scene)
    assert len({fault.name for fault in faults}) == len(faults)
    for size in (*FAULT_SIZES, None):
        of_size = [fault.kind for fault in faults if fault.size == size]
        assert max(of_size.count(kind) for kind in set(of_size)) <= max_faults_of_kind(
            len(scene.mechanism.bodies)
        )
    if name != "stewart":  # of whose 78 entries some are planted
        entries = [f for f in faults if f.kind == "inertia entry" and f.size == FAULT_SIZES[0]]
        assert len(entries) == 6 * (len(scene.mechanism.bodies) - 1)
    for fault in faults[:: len(faults) // 20]:
        # open closures, and thin bodies whose inertia is no longer positive
        refusable = fault.kind in ("closure point", "inertia entry")
        assert refusal(fault, scene) in ((None, fault.element) if refusable else (None,))


def refusal(fault, scene):
    """What a mechanism refuses a fault for."""
    try:
        fault.inject(scene)
    except MechanismError as error:
        return error.element.split("'")[1]
    return None


def a_fault(size=1e-4, **values):
    fault = Fault("mass", "bar", "", size, lambda scene: scene, frozenset({"bar"}))
    sighting = Detection("model", "mass, rel", (), 1e-4, 1e-12, "bar", outlier="mujoco")
    return FaultResult(
        fault,
        "mujoco",
        **{"detection": sighting, "detection_by_motion": sighting, "observable": True} | values,
    )


def search_of(*found):
    return FaultSearch(found, ("mujoco",), {})


def test_shares_count_what_can_be_found():
    unseen = a_fault(detection=None, detection_by_motion=None)
    in_another = a_fault(
        detection=Detection("model", "mass, rel", (), 1e-4, 1e-12, "bar", outlier="pinocchio")
    )
    elsewhere = a_fault(detection=Detection("model", "mass, rel", (), 1e-4, 1e-12, "other", outlier="mujoco"))
    nothing = a_fault(detection=None, detection_by_motion=None, observable=False)
    assert count_detected([a_fault(), unseen, elsewhere, nothing]) == Count(3, 2, 1)
    assert count_detected([a_fault(), in_another]) == Count(2, 2, 1)
    assert count_detected_by_motion([a_fault(), unseen, elsewhere, nothing]) == Count(3, 2, 2)
    many = [a_fault()] * 99
    assert detects_enough(search_of(*many, elsewhere, nothing))
    assert not detects_enough(search_of(*many[:9], elsewhere))  # nine of ten
    assert not detects_enough(search_of(*many, unseen))
    small = search_of(*many, replace(unseen, fault=replace(unseen.fault, size=1e-5)))
    assert detects_enough(small)
    assert not detects_enough(replace(small, smallest=0.0))


def test_misses_are_listed():
    unseen = a_fault(detection=None, detection_by_motion=None)
    nothing = a_fault(detection=None, detection_by_motion=None, observable=False)
    first, second, hidden = finding_lines(search_of(a_fault(), unseen, nothing))
    assert first.startswith("missed: mass of bar by 0.0001, in mujoco: ")
    assert second.endswith(first)
    assert hidden.startswith("not observable")
    assert hidden.endswith(": mass bar")
    (line,) = finding_lines(search_of(nothing), every=False)
    assert line.startswith("not observable")
    assert "1 fault" in line
    lost = a_fault(
        detection=None,
        detection_by_motion=None,
        model_difference=Detection("model", "inertia, rel", (), 1e-6, 1e-12, "bar"),
    )
    (line,) = finding_lines(search_of(lost))
    assert line.startswith("missed: mass of bar by 0.0001, in mujoco: mujoco's own model")
    assert "inertia, rel 1.0e-06 at bar" in line


def test_engines_have_to_agree_without_a_fault(example, monkeypatch):
    engine = ENGINES["mujoco"]

    def wrong(scene):
        return engine.systems(injection.mass("crank", 1e-3)(scene))

    monkeypatch.setitem(finding.ENGINES, "mujoco", replace(engine, systems=wrong))
    with pytest.raises(CrosscheckError, match=r"'four_bar'.*'model'"):
        find_faults(example, lambda message: None)


@pytest.mark.slow
def test_the_command_writes_what_a_page_shows(capsys, tmp_path, monkeypatch):
    few = catalog(load(str(EXAMPLE)), (1e-1, 1e-3))[::12]
    monkeypatch.setattr(finding, "catalog", lambda scene, sizes: few)
    for engines in (tuple(ENGINES), ("pinocchio",)):
        options = ("--engines", ",".join(engines), "--output", tmp_path)
        status, out, _ = run(capsys, "faults", EXAMPLE, *options)
        assert status == 0
        written = json.loads((tmp_path / "faults.json").read_text())
        assert written["holds"]
        assert [entry["kind"] for entry in written["faults"]] == [fault.kind for fault in few]
        assert {entry["engine"] for entry in written["faults"]} == set(written["engines"]) == set(engines)
        assert written["faults"][0]["seen"]["where"] == "crank"
        assert written["report"]["verdict"] in out
        assert "by motion alone" in out
    page = write_report(tmp_path, lambda _: None).path.read_text()
    assert written["report"]["verdict"] in page
    assert all(fault.name in page for fault in few)


def test_the_command_tells_what_is_missed(capsys, tmp_path, monkeypatch):
    search = replace(
        search_of(a_fault(detection=None, detection_by_motion=None)), left_out={"pinocchio": "no such joint"}
    )
    monkeypatch.setattr("crosscheck.studies.faults.find.find_faults", lambda *_, **__: search)
    status, out, _ = run(capsys, "faults", EXAMPLE, "--output", tmp_path)
    assert status == 1
    assert "missed: mass of bar by 0.0001, in mujoco: smaller than the tolerances" in out
    assert re.search("pinocchio.*no such joint", out)


def test_the_table_has_a_row_per_kind_and_size():
    of_mass, other = a_fault(), a_fault(1e-5, detection=None)
    sizes = [["by 0.0001", *"111111"], ["by 1e-05", *"100111"]]
    found = report("bar", search_of(of_mass, other), 1.0)
    assert found.parts[0].rows == found.summary[0].rows == [["mass", *"211222"], *sizes]
    assert report("bar", search_of(of_mass), 1.0).summary[0].rows == sizes[:1]  # no kind with misses
    reading = FaultSearch((replace(of_mass, engine=READING),), (READING,), {}, smallest=0.0)
    assert report("bar", reading, 1.0).parts[0].rows[0] == ["mass", "1", "1", "0"]
    assert report("bar", reading, 1.0).verdict.startswith("bar: of 1 faults in the import")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tracker", "four_bar", "slider_crank"])
def test_all_faults_of_a_scene(name):
    """All down to 1e-4 found, each blamed on the engine that has it, 95 % on the very element.

    Smaller ones are found if an engine has them.
    """
    found = find_faults(load(name), lambda message: None).found
    large = [f for f in found if f.fault.size is None or f.fault.size >= SMALLEST_REQUIRED]
    for engine in ENGINES:
        seen = [f for f in large if f.engine == engine and f.detection]
        assert len(seen) >= 30
        assert not [(f.fault.name, f.detection) for f in seen if f.detection.outlier != engine]
    count, motion = count_detected(large), count_detected_by_motion(large)
    assert count.total > 200
    assert count.detected == count.total
    assert count.located >= 0.95 * count.total
    assert motion.detected == motion.total
    assert motion.located >= 0.9 * motion.total
    assert all(f.model_difference for f in found if f.is_detectable and f.detection is None)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_all_faults_of_a_scene_in_one_engine(name):
    """As `crosscheck faults four_bar --engines NAME`: all down to 1e-4 found, and located in the engine."""
    engine_named(name)
    search = find_faults(load("four_bar"), lambda message: None, names=[name])
    assert search.engines == (name,)
    assert not search.left_out
    large = [f for f in search.found if f.fault.size is None or f.fault.size >= SMALLEST_REQUIRED]
    count, motion = count_detected(large), count_detected_by_motion(large)
    assert count.total > 400
    assert count.located == count.detected == count.total
    assert motion.total > 300
    # the order of two quaternions has no effect on absolute coordinates
    assert motion.detected >= motion.total - 2
    assert motion.located > 0.9 * motion.total
