"""Scenes that grow: rows of four-bar windows against their closed form, chains, and what size costs."""

from __future__ import annotations

import gc
import sys
from dataclasses import replace

import numpy as np
import pytest
from command_line import check_refused
from command_line import run as run_command
from scipy.special import ellipj, ellipk

import newton_euler
import urdf
from crosscheck.library import REFERENCE_QUANTITIES, load
from crosscheck.library.references import reference_values
from crosscheck.studies.stress.configurations import with_flat_start
from crosscheck.studies.stress.runs import with_duration
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.relative import Relative
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.spanning_tree import SpanningTree

GRAVITY = 9.81


def closed_form(windows, t):
    """Position and velocity (n, 2) of the top of the first bar at the times t.

    Equal rods that stay parallel: M theta'' = P sin(theta), theta clockwise from upright, with
    theta(0) = 0, theta'(0) = 1 rad/s; it passes over the top, so theta = pi + 2 am(w t - K(m) | m).
    """
    inertia = (windows + 1) / 3.0 + windows
    c = GRAVITY * ((windows + 1) / 2.0 + windows) / inertia
    w, m = np.sqrt(c + 0.25), c / (c + 0.25)
    _, _, dn, am = ellipj(w * np.asarray(t) - ellipk(m), m)
    theta, rate = np.pi + 2.0 * am, 2.0 * w * dn
    direction = np.array([np.sin(theta), np.cos(theta)])
    return direction.T, (rate * np.array([direction[1], -direction[0]])).T


def top_of(run, bar):
    """Position and velocity (n, 2) of the top of a bar, from its foot."""
    body = run.body_names.index(f"bar_{bar}")
    foot = np.array([bar, 0.0])
    return 2.0 * (run.position[:, body, :2] - foot), 2.0 * run.linear_velocity[:, body, :2]


@pytest.fixture(scope="module", params=[2, 40])
def windows_run(request):
    """N and two seconds of N windows: a revolution and, on its way, the bars flat twice."""
    scene = replace(load("four_bar", N=request.param), duration=2.0)
    return request.param, newton_euler.simulate(scene, rtol=1e-13, atol=1e-15)


def test_the_closed_form_is_the_reference():
    for known in reference_values("four_bar"):
        position, velocity = closed_form(known.options["N"], known.time)
        at = dict(zip(("B0_x", "B0_y", "B0_vx", "B0_vy"), (*position, *velocity), strict=True))
        at["bar_omega_cw"] = np.linalg.norm(velocity)
        # m is within 0.03 of 1, where scipy's functions lose a digit
        assert at[known.quantity] == pytest.approx(known.value, abs=1e-13)


@pytest.mark.slow
def test_reference_values(windows_run):
    windows, run = windows_run
    for known in (known for known in reference_values("four_bar") if known.options["N"] == windows):
        found = REFERENCE_QUANTITIES["four_bar"][known.quantity](run)[np.argmin(abs(run.time - known.time))]
        # 65 steps of 1e-13, most of it in phase; near flat bars 1e-14 over (angle from flat)^2
        assert found == pytest.approx(known.value, rel=1e-10, abs=1e-11)


def test_every_window_stays_a_parallelogram(windows_run):
    windows, run = windows_run
    expected = closed_form(windows, run.time)
    for bar in (0, 1, windows):
        position, velocity = top_of(run, bar)
        assert position == pytest.approx(expected[0], abs=1e-10)  # as above; a fold is off by 1
        assert velocity == pytest.approx(expected[1], abs=1e-8)  # outputs next to flat bars
    couplers = [k for k, name in enumerate(run.body_names) if name.startswith("coupler")]
    assert len(couplers) == windows
    assert abs(run.angular_velocity[:, couplers]).max() < 1e-8  # as the velocities
    energy = run.kinetic_energy + run.potential_energy
    assert abs(energy - energy[0]).max() < 1e-11 * abs(run.potential_energy).max()  # second order in both


@pytest.mark.parametrize("windows", [1, 2, 5])
def test_windows_are_cut_at_their_balls(windows):
    mechanism = load("four_bar", N=windows).mechanism
    assert (len(mechanism.bodies), len(mechanism.joints)) == (2 * windows + 2, 3 * windows + 1)
    tree = SpanningTree(mechanism)
    assert [mechanism.joint_names[k] for k in tree.cuts] == [f"ball_{k}" for k in range(windows)]
    assert tree.nv == 2 * windows + 1
    system = Relative(load("four_bar", N=windows))
    upright = system.phi_jacobian(np.zeros(tree.nq))
    assert np.linalg.matrix_rank(upright) == 2 * windows
    flat = np.zeros(tree.nq)
    for kept in tree.joints:
        turned = mechanism.joint_names[kept.joint].startswith("pivot")
        flat[kept.q] = -np.pi / 2 if turned else np.pi / 2
    assert abs(system.phi(flat)).max() < 1e-15
    # one row along x for each window remains, and N + 1 freedoms; sines of pi/2 are good to 1e-16
    assert np.linalg.matrix_rank(system.phi_jacobian(flat), tol=1e-12) == windows


def test_a_chain_is_an_open_tree_that_leaves_its_plane():
    scene = load("chain", N=3)
    system = Relative(scene)
    assert (system.nv, len(system.phi_units)) == (3, 0)
    run = newton_euler.simulate(scene)
    tip = run.position[-1, -1]
    assert tip[2] < -0.5
    assert abs(tip[1]) > 0.1
    energy = run.kinetic_energy + run.potential_energy
    assert energy == pytest.approx(0.0, abs=1e-7)  # rtol 1e-10 of 60 J


def lines_run(action):
    """Lines of Python that an action runs: what it costs, without a clock."""
    count = 0

    def trace(frame, event, argument):
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    gc.collect()
    gc.disable()  # a collection would run finalizers of objects of other tests, and count their lines
    sys.settrace(trace)
    try:
        action()
    finally:
        sys.settrace(before)
        gc.enable()
    return count


@pytest.mark.slow
@pytest.mark.parametrize("name", ["four_bar", "chain"])
def test_making_a_scene_costs_in_proportion_to_its_size(name):
    def make(size):
        made = load(name, N=size).mechanism
        mechanism = Mechanism(made.bodies, made.joints[::-1])  # the ground's joint last
        SpanningTree(mechanism)
        for body in range(len(mechanism.bodies)):
            mechanism.shapes(body)

    make(1)  # imports and caches
    # four times the size; anything done for each pair of bodies would make it 5 to 16 times
    assert lines_run(lambda: make(200)) < 4.2 * lines_run(lambda: make(50))


@pytest.mark.parametrize("value", ["0", "1001", "-3", "2.5", "two", "", "1e2", "٣", 0, 1001, 2.0])
def test_sizes_that_are_refused(value):
    message = rf"N of scene 'four_bar' is {value!r}; choose a whole number from 1 to 1000"
    with pytest.raises(CrosscheckError) as caught:
        load("four_bar", N=value)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("name", "options", "found", "needed"),
    [
        ("tracker_on_boat", {"poses": "boat.csv", "roll": 0.15}, "roll", "poses=boat.csv; needed: no poses"),
        ("tracker_wind", {"wind": "steady", "seed": 1}, "seed", "wind=steady; needed: wind=turbulent"),
        ("tracker_computed_torque", {"delay": 0}, "delay", "period=0.0; needed: another period"),
        (
            "tracker_computed_torque",
            {"controller": "pd", "mass_error": "0.1"},
            "mass_error",
            "controller=pd; needed: controller=computed_torque",
        ),
    ],
)
def test_options_without_effect_are_refused(name, options, found, needed):
    with pytest.raises(CrosscheckError) as caught:
        load(name, **options)
    assert str(caught.value) == f"{found} of scene {name!r} has no effect with {needed}"


def test_sizes_from_text_and_from_python():
    assert len(load("four_bar", N="3").mechanism.bodies) == len(load("four_bar", N=3).mechanism.bodies) == 8
    assert len(load("four_bar").mechanism.bodies) == 6
    assert len(load("chain").mechanism.bodies) == 6
    assert len(load("chain", N=1000).mechanism.bodies) == 1001


def test_sizes_on_the_command_line(capsys, tmp_path):
    check_refused(
        capsys, tmp_path, "four_bar", "--set", "N=0",
        message="N of scene 'four_bar' is '0'; choose a whole number from 1 to 1000",
    )  # fmt: skip
    check_refused(capsys, tmp_path, "chain", "--set", "n=2", message="unknown option 'n' of scene 'chain'")
    _, out, _ = run_command(capsys, "list")
    assert "four_bar: " in out
    assert "    --set N=1..1000  [default: 2]\n" in out
    assert "    --set N=1..1000  [default: 5]\n" in out
    assert "--set panel_inertia=realisable|literal  [default: realisable]" in out
    assert "--set speed=0..60 m/s  [default: 10]" in out
    assert "--set delay=0..10 periods  [default: 0]" in out


@pytest.mark.parametrize("windows", [1, 2, 10])
def test_windows_pass_flat_ten_times(windows):
    """A singular configuration costs no digits, and the branch is kept all along."""
    scene = replace(load("four_bar", N=windows), outputs=frozenset({"velocities"}))
    run = newton_euler.simulate(scene, rtol=1e-13, atol=1e-15)
    exact = closed_form(windows, run.time)
    for bar in range(windows + 1):
        position, velocity = top_of(run, bar)
        # round-off at ten passages, in phase over 10 s at 5 rad/s: for rtol from 0.7e-13 to 1.5e-13 runs are
        # off by 3e-11 to 5e-9, and which one by how much is a matter of last digits
        assert np.abs(position - exact[0]).max() < 5e-9
        assert np.abs(velocity - exact[1]).max() < 2e-8  # outputs within 1e-4 rad of flat
    assert run.settings["rejected"] < 0.5 * run.settings["steps"]


@pytest.mark.parametrize(
    ("windows", "simulate"),
    [
        *((n, newton_euler.simulate) for n in (1, 2)),
        pytest.param(10, newton_euler.simulate, marks=pytest.mark.slow),
        *((n, urdf.simulate) for n in (1, 2)),
    ],
)
def test_windows_start_flat(windows, simulate):
    """From a singular configuration, where the constraints in use cannot be told from its own Jacobian."""
    scene = with_flat_start(with_duration(load("four_bar", N=windows), 2.0, 50), windows)
    run = simulate(scene)
    bars = run.position[:, 1 : windows + 2] - np.array([[k, 0.0, 0.0] for k in range(windows + 1)])
    assert np.abs(bars - bars[:, :1]).max() < 1e-8  # parallel; another branch is off by 1
    assert np.ptp(bars[:, 0, 0]) > 0.5  # and all the way round


@pytest.mark.slow
@pytest.mark.parametrize("windows", [1, 2, 10, 40])
def test_a_hundred_seconds_of_windows(windows):
    scene = replace(load("four_bar", N=windows), duration=100.0, outputs=frozenset({"energy"}))
    run = newton_euler.simulate(scene)
    bars = run.position[:, 1 : windows + 2] - np.array([[k, 0.0, 0.0] for k in range(windows + 1)])
    assert np.abs(bars - bars[:, :1]).max() < 1e-7  # parallel, as only one of the two branches is
    energy = run.kinetic_energy + run.potential_energy
    assert np.abs(energy - energy[0]).max() < 1e-7 * run.kinetic_energy.max()  # 1,400 steps of 1e-10
