"""The odd one out: planted faults and made-up figures, and who is blamed for what."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from command_line import EXAMPLE
from verdicts import verdicts

import mjcf
import newton_euler
import urdf
from crosscheck.compare.check import FILE, LEVELS_OF_EQUATIONS, LEVELS_OF_RUNS, READING, Check
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.levels import compare_equations
from crosscheck.compare.momentum import momentum_check
from crosscheck.compare.outlier import diagnose
from crosscheck.compare.result import diagnosed
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine_runs import Stop, collecting_errors
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.studies.faults import find as finding
from crosscheck.studies.faults import injection
from crosscheck.studies.faults.catalog import catalog
from crosscheck.studies.faults.misreadings import misreadings
from newton_euler.codegen.cache import CACHE_VARIABLE
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.redundancy import NearlyRedundant
from newton_euler.equations.relative import Relative
from newton_euler.errors import NewtonEulerError
from newton_euler.model.control import PD
from newton_euler.model.forces import JointSpring, PointSpring
from newton_euler.reading.excitation import random_states
from newton_euler.reading.import_report import ImportReport
from newton_euler.runs.assemble import initial_state

LINKAGE = EXAMPLE.parent / "linkage.xml"

NAMES = tuple(ENGINES)
NE, MJ, PIN = NAMES
RIGID = [replace(engine, soft_constraints=None) for engine in ENGINES.values()]
"""Without MuJoCo's softness, which only informs."""


def row(level, between, value, tolerance=1.0, quantity="a"):
    return Check(level, quantity, tuple(between), value, tolerance, "bar")


def pairs(level, *values, quantity="a"):
    """Figures of the three pairs of engines; more than 1 fails."""
    between = ((NE, MJ), (NE, PIN), (MJ, PIN))
    return [row(level, pair, value, quantity=quantity) for pair, value in zip(between, values, strict=True)]


# Made-up figures


@pytest.mark.parametrize(
    ("values", "outlier", "agree"),
    [((5.0, 0.3, 6.0), MJ, (NE, PIN)), ((5.0, 6.0, 0.3), NE, (MJ, PIN)), ((0.3, 5.0, 6.0), PIN, (NE, MJ))],
)
def test_who_parts_from_two_that_agree_is_odd(values, outlier, agree):
    rows = [*pairs("model", 0.1, 0.1, 0.1, quantity="b"), *pairs("model", *values)]
    (found,) = diagnose(NAMES, rows)
    assert (found.outlier, found.agree, found.fault) == (outlier, agree, "model")
    assert (found.within, found.everywhere) == (0.3, True)
    assert (found.level, found.quantity, found.where) == ("model", "a", "bar")
    assert found.value == 5.0
    assert found.who == f"{outlier} differs; {' and '.join(agree)} agree within 3e-01 (all checks)"
    assert found.fault_text == f"{outlier}'s model is wrong"


@pytest.mark.parametrize(
    ("level", "fault"),
    [
        *((level, "model") for level in LEVELS_OF_EQUATIONS),
        *((level, "integration") for level in LEVELS_OF_RUNS),
    ],
)
def test_models_and_integrations_are_told_apart(level, fault):
    (found,) = diagnose(NAMES, pairs(level, 5.0, 0.5, 5.0))
    assert (found.outlier, found.fault) == (MJ, fault)


WRIST = NearlyRedundant("wrist", 6e-5, "redundant")


@pytest.mark.parametrize(
    ("level", "literal", "nearly", "fault"),
    [
        ("trajectories", {MJ: 1e-7}, WRIST, "redundancy"),
        ("trajectories", {PIN: 1e-7}, WRIST, "integration"),
        ("trajectories", {MJ: 1e-7}, WRIST._replace(singular_value=1e-9), "integration"),
        ("trajectories", {MJ: 1e-4, PIN: 1e-7}, WRIST, "integration"),
        ("dynamics", {MJ: 1e-7}, WRIST, "model"),
    ],
    ids=["felt", "by another engine", "too little to feel", "felt by a stiffer engine alone", "by no run"],
)
def test_noise_that_soft_constraints_alone_take_as_it_is_is_no_fault_of_an_engine(
    level, literal, nearly, fault
):
    (found,) = diagnose(NAMES, pairs(level, 5.0, 0.5, 5.0), (), literal, [nearly])
    assert (found.outlier, found.fault) == (MJ, fault)
    if fault == "redundancy":
        assert found.fault_text == (
            "what each makes of nearly redundant constraints is the difference: "
            "joint 'wrist': singular value 6.0e-05, taken redundant"
        )


def test_all_that_part_pairwise_are_named():
    (found,) = diagnose(NAMES, pairs("dynamics", 2.0, 3.0, 4.0))
    assert (found.outlier, found.differing, found.within) == ("", NAMES, None)
    assert found.who == f"{NE}, {MJ} and {PIN} all differ from each other"
    assert not found.fault_text


def test_what_the_others_part_in_later_is_told_too():
    rows = [*pairs("model", 5.0, 0.5, 5.0), row("dynamics", (NE, PIN), 3.0)]
    first, then = diagnose(NAMES, rows)
    assert (first.outlier, first.within, first.everywhere) == (MJ, 0.5, False)
    assert first.who == f"{MJ} differs; {NE} and {PIN} agree within 5e-01 (level 'model')"
    assert then.who == f"{NE} and {PIN} differ, and no third engine decides which is right"


def test_two_engines_are_told_apart_by_what_else_is_known():
    apart = row("model", (NE, MJ), 5.0)
    (found,) = diagnose((NE, MJ), [apart])
    assert (found.outlier, found.who) == (
        "",
        f"{NE} and {MJ} differ, and no third engine decides which is right",
    )
    balance = row("energy", (MJ,), 5.0, quantity="momentum balance, rel")
    (found,) = diagnose((NE, MJ), [apart, balance])
    assert (found.outlier, found.decided_by) == (MJ, "momentum balance, rel")
    assert found.who == f"{MJ} differs; its own momentum balance, rel fails"
    both = replace(balance, between=(NE,))
    assert diagnose((NE, MJ), [apart, balance, both])[0].outlier == ""


def test_how_a_run_went_is_no_evidence_about_models():
    """Soft constraints of a right model drift; a balance of momenta says nothing of steps."""
    drift, balance = row("drift", (MJ,), 5.0), row("energy", (NE,), 5.0, quantity="momentum balance, rel")
    (found,) = diagnose((NE, MJ), [row("model", (NE, MJ), 5.0), drift])
    assert found.outlier == ""
    first, _ = diagnose((NE, MJ), [row("trajectories", (NE, MJ), 5.0), drift, balance])
    assert (first.outlier, first.fault, first.decided_by) == (MJ, "integration", "a")


def test_one_of_two_is_odd_that_is_far_from_a_third_whose_tolerance_is_wide():
    wide = row("trajectories", (NE, MJ), 0.2), row("trajectories", (MJ, PIN), 5.0, 10.0)
    rows = [*wide, row("trajectories", (NE, PIN), 5.0)]
    (found,) = diagnose(NAMES, rows)
    assert (found.outlier, found.decided_by) == (PIN, "nearness")
    near = [replace(wide[0], value=0.8), *rows[1:]]
    (found,) = diagnose(NAMES, near)
    assert found.who == f"{NE} and {PIN} differ; {MJ} agrees with both"


@pytest.mark.parametrize(
    ("ends", "outlier"),
    [({}, MJ), ({PIN: 0.24}, ""), ({NE: 0.92}, ""), ({MJ: 0.92}, ""), ({MJ: 0.9, NE: 0.9, PIN: 0.9}, MJ)],
)
def test_a_run_that_stopped_decides_nothing_about_later_times(ends, outlier):
    """The third is near to one of two until it stops; what the two do later is beyond its checks."""
    rows = [
        row("trajectories", (NE, MJ), 5.0),
        row("trajectories", (NE, PIN), 0.01),
        row("trajectories", (MJ, PIN), 0.5),
    ]
    (found,) = diagnose(NAMES, rows, ends=ends)
    assert (found.outlier, found.fault) == (outlier, "integration" if outlier else "")
    if not outlier:
        assert found.differing == (NE, MJ)
        assert found.agree == ()
        assert found.who.endswith("no third engine decides which is right")


def test_stops_of_a_comparison_end_the_runs_of_the_diagnosis():
    rows = [
        row("trajectories", (NE, MJ), 5.0),
        row("trajectories", (NE, PIN), 0.01),
        row("trajectories", (MJ, PIN), 0.5),
    ]
    scene, engines = load("pendulum"), list(ENGINES.values())
    (complete,) = diagnosed(scene, engines, rows, (), [Stop("energy", "a part that is no engine")])
    (stopped,) = diagnosed(scene, engines, rows, (), [Stop(PIN, "steps too small", 0.24)])
    (not_started,) = diagnosed(scene, engines, rows, (), [Stop(PIN, "refused")])
    assert [each.outlier for each in (complete, stopped, not_started)] == [MJ, "", ""]


@pytest.mark.parametrize(("ends", "outlier"), [({}, MJ), ({MJ: 0.9}, MJ), ({NE: 0.9}, "")])
def test_what_an_engine_fails_after_the_other_has_stopped_is_no_evidence(ends, outlier):
    rows = [row("trajectories", (NE, MJ), 5.0), row("energy", (NE,), 0.1), row("energy", (MJ,), 5.0)]
    assert diagnose((NE, MJ), rows, ends=ends)[0].outlier == outlier


def test_ends_of_runs_do_not_matter_for_equations():
    wide = row("dynamics", (NE, MJ), 0.2), row("dynamics", (MJ, PIN), 5.0, 10.0)
    (found,) = diagnose(NAMES, [*wide, row("dynamics", (NE, PIN), 5.0)], ends={MJ: 0.1})
    assert (found.outlier, found.decided_by) == (PIN, "nearness")


def test_an_engine_that_fails_by_itself_is_odd():
    rows = [*pairs("trajectories", 0.1, 0.1, 0.1), *(row("drift", (name,), 0.1) for name in (NE, PIN))]
    (found,) = diagnose(NAMES, [*rows, row("drift", (MJ,), 5.0)])
    assert (found.outlier, found.agree, found.fault) == (MJ, (NE, PIN), "integration")
    (found,) = diagnose(NAMES, [*rows[:-1], row("drift", (PIN,), 5.0), row("drift", (MJ,), 5.0)])
    assert found.who == f"{MJ} and {PIN} fail by themselves"


def test_the_formulation_that_the_others_do_not_share_is_odd():
    rel, cart = "relative", "cartesian"
    rows = [
        row("dynamics", (NE, MJ), 5.0),  # the worse of the two
        row("dynamics", (NE, PIN), 5.0),
        row("dynamics", (MJ, PIN), 0.1),
        row("dynamics", (rel, cart), 5.0),
        *(row("dynamics", (rel, name), 0.2) for name in (MJ, PIN)),
        *(row("dynamics", (cart, name), 5.0) for name in (MJ, PIN)),
    ]
    (found,) = diagnose(NAMES, rows)
    assert (found.outlier, found.agree) == (cart, (rel, MJ, PIN))
    assert found.summary()["engine"] == NE
    assert found.fault_text == "newton_euler's cartesian formulation's model is wrong"
    rows[4] = replace(rows[4], value=5.0)
    rows[5] = replace(rows[5], value=5.0)
    assert diagnose(NAMES, rows)[0].outlier == NE  # neither agrees with anybody
    (alone,) = diagnose((NE,), [rows[3], row("energy", (cart,), 5.0, quantity="momentum balance, rel")])
    assert alone.outlier == cart


def from_file(*values):
    return [row(READING, (name, FILE), value) for name, value in zip(NAMES, values, strict=True)]


def test_the_reading_is_to_blame_only_for_what_all_engines_share():
    agreed = pairs("model", 0.1, 0.1, 0.1)
    (found,) = diagnose(NAMES, [*from_file(5.0, 5.0, 5.0), *agreed])
    assert (found.outlier, found.fault, found.agree) == (FILE, "reading", NAMES)
    assert found.who == f"the file differs; {NE}, {MJ} and {PIN} agree within 1e-01 (all checks)"
    (found,) = diagnose(NAMES, [*from_file(0.1, 5.0, 0.1), *pairs("model", 5.0, 0.1, 5.0)])
    assert (found.outlier, found.level, found.fault) == (MJ, READING, "model")
    first, then = diagnose(NAMES, [*from_file(5.0, 5.0, 5.0), *pairs("model", 5.0, 0.1, 5.0)])
    assert (first.outlier, first.level) == (MJ, "model")
    assert (then.outlier, then.agree) == (FILE, (NE, PIN))
    (found,) = diagnose((NE,), from_file(5.0, 0.0, 0.0)[:1])
    assert found.who == f"{NE} and the file differ, and no other engine decides which is right"


def test_figures_that_hold_or_only_inform_blame_nobody():
    informing = replace(row("drift", (MJ,), 5.0), judged=False)
    assert diagnose(NAMES, [*pairs("model", 0.1, 0.1, 0.1), informing]) == ()


# Faults planted in the model of one engine


@cache
def right(scene_name):
    """A scene and the engines' systems at some of its states, as they should be."""
    scene = load(scene_name)
    states = States(scene, (initial_state(scene), *random_states(scene, finding.RANDOM_STATES)))
    return {engine.name: [Samples(s, states) for s in engine.systems(scene)] for engine in RIGID}


def with_fault(scene_name, fault, name):
    """Who is blamed for a fault in one engine, and by which figure."""
    samples = dict(right(scene_name))
    states = samples[NE][0].states
    if name == NE:
        systems = ENGINES[NE].systems(fault.inject(states.scene))
    else:
        systems = (finding._with_fault(fault, ENGINES[name], states.scene),)
    samples[name] = [Samples(system, states) for system in systems]
    rows = []
    with collecting_errors("comparing equations", []):  # without a joint there are no balances
        for found in compare_equations(RIGID, samples):
            rows.append(found)  # not all at once: those before an error are kept
    return diagnose(NAMES, rows)


def check_blamed(found, name):
    assert (found[0].outlier, found[0].fault) == (name, "model")
    assert found[0].agree == tuple(other for other in NAMES if other != name)
    # what two right models differ by is round-off times conditions below 1e3
    assert found[0].within < 1e-9
    assert len(found) == 1


FEW = ("mass", "joint point", "axis direction", "gravity", "gain")


@pytest.mark.parametrize("name", NAMES)
def test_a_planted_fault_is_blamed_on_its_engine(name):
    faults = catalog(load(str(EXAMPLE)), (1e-4,))
    for fault in [next(fault for fault in faults if fault.kind == kind) for kind in FEW]:
        check_blamed(with_fault(str(EXAMPLE), fault, name), name)


def more_damping(self, at, force=PD.at_joint):
    return force(self, at) - 0.01 * self.damping * self.measure(at)[1]


def warmer(self, at, force=JointSpring.at_joint):
    return 1.01 * force(self, at)


DRIVEN = """<mujoco><worldbody><body><joint name="h" axis="0 1 0" stiffness="3" springref="20"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/><body pos="0.3 0 0"><joint name="k" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></body></worldbody>
<actuator><position joint="k" kp="2" kv="0.1"/></actuator></mujoco>"""


@pytest.mark.parametrize(("law", "force"), [(PD, more_damping), (JointSpring, warmer)])
def test_a_law_that_newton_euler_gets_wrong_is_blamed_on_it(law, force, tmp_path, monkeypatch):
    """Neither Pinocchio's side nor the verification of the file evaluates laws as newton_euler does."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))  # others would get the wrong law from theirs
    path = tmp_path / "driven.xml"
    path.write_text(DRIVEN)
    found = mjcf.read(path, duration=0.02, excitation=True, verified=False)
    monkeypatch.setattr(law, "at_joint", force)
    result = crosscheck(found.scene, list(ENGINES.values()), lambda _: None, "driven", {}, found.report)
    (first,) = result.diagnosis
    assert (first.outlier, first.fault) == (NE, "model")
    assert first.agree == (MJ, PIN, FILE)


@pytest.mark.parametrize("other", [MJ, PIN])
@pytest.mark.parametrize(
    ("scene_name", "kind", "method"),
    [("tracker", PD, "at_joint"), ("andrews", PointSpring, "force_on_first")],
)
def test_of_two_engines_the_one_with_wrong_forces_is_blamed(
    scene_name, kind, method, other, tmp_path, monkeypatch
):
    """The balance of momentum, which settles it, works forces out apart from newton_euler's equations."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    scene = load(scene_name)
    right = getattr(kind, method)
    monkeypatch.setattr(kind, method, lambda self, *of: 1.01 * right(self, *of))
    states = States(scene, (initial_state(scene), *random_states(scene, finding.RANDOM_STATES)))
    engines = [engine for engine in RIGID if engine.name in (NE, other)]
    samples = {engine.name: [Samples(s, states) for s in engine.systems(scene)] for engine in engines}
    rows = [
        *compare_equations(engines, samples),
        *(momentum_check(name, samples[name][0]) for name in samples),
    ]
    (found,) = diagnose((NE, other), rows)
    assert (found.outlier, found.fault) == (NE, "model")


def misread(fault, found):
    """A whole crosscheck of what was read with a fault, which all engines share, against the file."""
    report = ImportReport()
    report.entries, report.start = found.report.entries, found.report.start
    report.references = [(reference, fault.inject(scene)) for reference, scene in found.report.references]
    return crosscheck(fault.inject(found.scene), list(ENGINES.values()), lambda _: None, "x", {}, report)


@pytest.mark.slow
def test_thirty_faults_in_the_reading_are_blamed_on_it():
    found = mjcf.read(LINKAGE, duration=0.05, output_period=0.01, excitation=True, verified=False)
    faults = list(misreadings(found.report.references[-1][1]))
    blamed = 0
    for k in np.linspace(0, len(faults) - 1, 40).round().astype(int):
        try:
            result = misread(faults[k], found)
        except NewtonEulerError:  # an open closure: refused
            continue
        if result.agrees:  # what turns about y alone feels nothing of its other moments of inertia
            continue
        first, *others = result.diagnosis
        assert (first.outlier, first.level, first.fault) == (FILE, READING, "reading"), faults[k].name
        assert first.agree == NAMES
        assert not others
        assert "the file differs; at level 'reading': " in result.verdict  # engines are not compared after it
        assert "; the reading of the file is wrong (" in result.verdict
        blamed += 1
    assert blamed >= 30


@pytest.mark.parametrize(("wrong", "name"), [(Relative, "relative"), (Cartesian, "cartesian")])
def test_a_fault_of_one_formulation_is_blamed_on_it(wrong, name):
    """Whichever agrees with the other engines is right; with none, whichever balances momenta."""
    samples = dict(right(str(EXAMPLE)))
    states = samples[NE][0].states
    faulty = wrong(injection.mass("coupler", 1e-4)(states.scene))
    samples[NE] = [Samples(faulty, states) if isinstance(s.system, wrong) else s for s in samples[NE]]
    for engines in (RIGID, RIGID[:2], RIGID[:1]):
        found = diagnose([engine.name for engine in engines], list(compare_equations(engines, samples)))
        assert found[0].outlier == name, engines


# Faults of integration, at runs of one model


@cache
def short():
    return replace(load(str(EXAMPLE)), duration=0.3, output_period=0.05)


REPEATED = [
    replace(
        engine, simulate=cache(engine.simulate), refined=cache(engine.refined), systems=cache(engine.systems)
    )
    for engine in RIGID
]


def changed(name, simulate):
    """All engines, one of them with other runs, whose finer ones are no finer."""
    return [
        replace(engine, simulate=simulate, refined=simulate) if engine.name == name else engine
        for engine in REPEATED
    ]


def with_run(name, simulate):
    """Who is blamed for the runs of one engine."""
    return diagnose(NAMES, verdicts(short(), changed(name, simulate), states=1))


COARSE = {
    "newton_euler": lambda scene: newton_euler.simulate(scene, rtol=1e-4, atol=1e-6),
    "mujoco": lambda scene: mjcf.simulate(scene, timestep=0.01),
    "pinocchio": lambda scene: urdf.simulate(scene, rtol=1e-3, atol=1e-5),
}


@pytest.mark.parametrize("name", NAMES)
def test_too_coarse_a_run_is_a_fault_of_integration(name):
    (first, *_) = with_run(name, COARSE[name])
    assert (first.outlier, first.level, first.fault) == (name, "trajectories", "integration")
    assert first.agree == tuple(other for other in NAMES if other != name)
    assert first.fault_text == f"{name}'s integration is at fault"


def test_joints_that_drift_are_a_fault_of_integration():
    def drifting(scene):
        run = REPEATED[0].simulate(scene)
        return replace(run, constraint_violation=run.constraint_violation + 1e-6)

    (found,) = with_run("newton_euler", drifting)
    assert (found.outlier, found.level, found.fault) == ("newton_euler", "drift", "integration")


def test_softness_is_a_fault_of_integration():
    (found, *_) = with_run("mujoco", lambda scene: mjcf.simulate(scene, timestep=1e-3, solref=[0.05, 1.0]))
    assert (found.outlier, found.level, found.fault) == ("mujoco", "trajectories", "integration")


@pytest.mark.parametrize(("soft", "fault"), [({"mujoco": 1e-7}, "resolution"), ({}, "integration")])
def test_a_soft_run_that_its_own_finer_one_changes_by_more_is_not_resolved(soft, fault):
    """The difference is of a step that is too large, or of constraints that resist each other."""

    def row(between, value, detail=""):
        return Check("energy", "energy balance error, rel", between, value, 1e-2, "0.01 s", detail=detail)

    rows = [row((name,), 1e-9) for name in ("newton_euler", "pinocchio")]
    rows.append(row(("mujoco",), 5.0, "mujoco's own run changes by 3 when refined"))
    (found,) = diagnose(NAMES, rows, soft_engines=soft)
    assert (found.outlier, found.fault) == ("mujoco", fault)


def test_an_engine_that_diverges_is_named_beside_what_the_others_say():
    def diverging(scene):
        return mjcf.simulate(scene, timestep=0.05, solref=[-1e9, -1e-9])

    found = crosscheck(short(), changed("mujoco", diverging), lambda _: None, "x", {})
    (stop,) = [stop for stop in found.unfinished if stop.what == "mujoco"]
    assert stop.time is not None
    assert found.verdict.startswith("UNFINISHED: mujoco: MuJoCo diverged at t = ")
    said = "as far as compared mujoco differs; newton_euler and pinocchio agree within "
    assert said in found.verdict
    held = [row for row in found.checks if row.between == ("newton_euler", "pinocchio")]
    assert {row.level for row in held} >= {"model", "trajectories", "energy"}
    assert all(row.agrees for row in held)
