"""Scenes of the library against closed forms and quadratures made here, over whole runs.

Angles of machines with one freedom are held against the time that energy says it takes to get there,
t = integral of sqrt(M / 2 (E - V)) over the angle.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import ellipj, ellipk, ellipkinc

import newton_euler
from crosscheck.references import known_figures
from crosscheck.scenes import FIGURES, SCENES, load
from crosscheck.scenes.free_top import CASES
from crosscheck.scenes.measure import position
from crosscheck.scenes.slider_crank import ROD_MOMENTS
from newton_euler.model.euler_parameters import rotations

G = 9.81
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


@cache
def exact_run(name, **options):
    """At the tolerance that known figures are held against; round-off takes over below."""
    return newton_euler.simulate(load(name, **options), rtol=1e-13, atol=1e-15)


def figure(name, run, quantity):
    return FIGURES[name][quantity](run)


def accumulated(function, ends):
    """Integral of a function from ends[0] to each of the ends, by Gauss's rule in between; (n,)."""
    middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
    parts = half * (function(middle[:, None] + half[:, None] * NODES) @ WEIGHTS)
    return np.concatenate([[0.0], np.cumsum(parts)])


def about(axis, angle):
    """(n, 3, 3) rotations about a coordinate axis, 0 to 2, by angles (n,)."""
    out = np.zeros((*np.shape(angle), 3, 3), dtype=np.asarray(angle).dtype)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., i, i] = out[..., j, j] = np.cos(angle)
    out[..., j, i], out[..., i, j] = np.sin(angle), -np.sin(angle)
    return out


# Every known figure


KNOWN = [
    pytest.param(name, known, id=f"{name}-{known.quantity}-{known.time:g}-{list(known.options.values())}")
    for name in FIGURES
    if name != "four_bar"  # in test_scene_families.py, to what is left after passing flat bars
    for known in known_figures(name)
]


@pytest.mark.parametrize(("name", "known"), KNOWN)
def test_known_figures_to_ten_digits(name, known):
    run = exact_run(name, **known.options)
    n = int(np.argmin(abs(run.time - known.time)))
    assert run.time[n] == pytest.approx(known.time, abs=1e-12)
    # components of one vector are as exact as its largest; all of them are 1e-4 to 1e3 of it
    assert figure(name, run, known.quantity)[n] == pytest.approx(
        known.value, rel=1e-10, abs=1e-14 + known.uncertainty
    )


def test_every_scene_with_figures_has_references_for_all_of_them():
    assert FIGURES.keys() <= SCENES.keys()
    for name, figures in FIGURES.items():
        assert {known.quantity for known in known_figures(name)} == set(figures)


@pytest.mark.parametrize(
    "known", [k for k in known_figures("andrews") if k.published], ids=lambda k: k.quantity
)
def test_andrews_published_solution(known):
    """The Test Set's solver had a tolerance, and its digits end there."""
    exponent = known.published.replace("e", "E")
    assert float(exponent) == pytest.approx(known.value, rel=1e-7, abs=1e-10)


def test_governor_published_maximum():
    """The problem's published curve, every 0.1 s for 10 s, has its maximum at 0.743 m."""
    run = newton_euler.simulate(replace(load("flyball_governor"), output_period=0.1))
    assert figure("flyball_governor", run, "s").max() == pytest.approx(0.743, abs=5e-4)  # as printed


# Closed forms


def test_pendulum_swings_as_elliptic_functions_say():
    """Amplitude of a right angle: sin(phi / 2) = -k sn(w t + K | k^2), k^2 = 1/2, phi from hanging."""
    run = exact_run("pendulum")
    w, m = np.sqrt(G), 0.5
    sn, cn, dn, _ = ellipj(w * run.time + ellipk(m), m)
    sine, cosine = -2.0 * np.sqrt(m) * sn * dn, dn**2 - m * sn**2  # of phi
    rate = -2.0 * np.sqrt(m) * w * cn
    expected = {
        "x": sine, "y": -cosine, "vx": cosine * rate, "vy": sine * rate, "bar_tension": G * cosine + rate**2,
    }  # fmt: skip
    for quantity, values in expected.items():
        # 326 steps of 1e-13 and growth in proportion to time; the largest is a tension of 29 N
        assert figure("pendulum", run, quantity) == pytest.approx(values, abs=1e-11)
    assert run.kinetic_energy + run.potential_energy == pytest.approx(0.0, abs=1e-11)


def top_spin(case, time):
    """(n, 3) angular velocity in the body frame; Landau and Lifshitz, Mechanics, eqs (37.8) to (37.10)."""
    moments, start = (np.array(x) for x in CASES[case])
    i1, i2, i3 = moments
    e, l2 = float(moments @ start**2), float(np.sum((moments * start) ** 2))  # twice the energy, L^2
    amplitudes = np.sqrt(
        [
            (e * i3 - l2) / (i1 * (i3 - i1)),
            (e * i3 - l2) / (i2 * (i3 - i2)),
            (l2 - e * i1) / (i3 * (i3 - i1)),
        ]
    ) * [1.0, np.sign(i3 - i2), 1.0]
    m = (i2 - i1) * (e * i3 - l2) / ((i3 - i2) * (l2 - e * i1))
    pace = np.sqrt((i3 - i2) * (l2 - e * i1) / (i1 * i2 * i3))
    phase = ellipkinc(np.arctan2(start[1] / amplitudes[1], start[0] / amplitudes[0]), m)
    sn, cn, dn, _ = ellipj(pace * time + phase, m)
    return amplitudes * np.stack([cn, sn, dn], axis=-1)


def top_rotation(case, time):
    """(n, 3, 3): with L along a third axis, R = R_z(psi) R_x(theta) R_z(phi), psi by quadrature."""
    moments = np.array(CASES[case][0])

    def precession(t):
        momentum = moments * top_spin(case, t)
        across = np.sum(momentum[..., :2] ** 2 / moments[:2], axis=-1)
        return np.linalg.norm(momentum, axis=-1) * across / np.sum(momentum[..., :2] ** 2, axis=-1)

    momentum = moments * top_spin(case, time)
    theta = np.arctan2(np.hypot(momentum[:, 0], momentum[:, 1]), momentum[:, 2])
    phi = np.arctan2(momentum[:, 0], momentum[:, 1])
    found = about(2, accumulated(precession, time)) @ about(0, theta) @ about(2, phi)
    return found[0].T @ found


@pytest.mark.parametrize("case", CASES)
def test_free_top_turns_as_elliptic_functions_say(case):
    run = exact_run("free_top", case=case)
    spin = np.stack([figure("free_top", run, f"omega_{c}") for c in "xyz"], axis=1)
    # next to the separatrix errors grow e^5.8 times in 10 s and scipy's functions lose a digit at m = 1
    allowed = 1e-10 if case == "dzhanibekov" else 1e-11
    assert spin == pytest.approx(top_spin(case, run.time), abs=allowed)
    assert rotations(run.quaternion[:, 1]) == pytest.approx(top_rotation(case, run.time), abs=allowed)


def test_heavy_top_nods_as_elliptic_functions_say():
    """u = com_z obeys u'^2 = (1 - u^2)(alpha - beta u) - (b - a u)^2, from the upper turning point u = 0.

    There alpha = b^2, and u is a factor of the cubic. H. Goldstein, Classical Mechanics, section 5.7.
    """
    run = exact_run("heavy_top")
    moment = 0.234375 + 15.0
    a, b, beta = 0.46875 * 150.0 / moment, -4.61538, 2.0 * 15.0 * G / moment
    linear, constant = b**2 + a**2, 2.0 * a * b - beta
    high = (linear + np.sqrt(linear**2 - 4.0 * beta * constant)) / (2.0 * beta)
    low = constant / (beta * high)
    assert low == pytest.approx(-0.99999999999973779144, abs=1e-15)
    m = low / (low - high)
    half_period = ellipk(m) / (0.5 * np.sqrt(beta * (high - low)))
    assert 2.0 * half_period == pytest.approx(0.74520694761676905573, abs=1e-15)

    def height(t):
        _, cn, dn, _ = ellipj(0.5 * np.sqrt(beta * (high - low)) * t, m)
        return low * (1.0 - (cn / dn) ** 2)

    def turning(t):
        u = height(t)
        return (b - a * u) / (1.0 - u**2)

    # 1366 steps at 150 rad/s of spin
    assert figure("heavy_top", run, "com_z") == pytest.approx(height(run.time), abs=1e-10)
    early = run.time < 0.3  # hanging at 0.373 s it turns by half a revolution in no time
    angle = 0.5 * np.pi + accumulated(turning, run.time[early])
    radius = np.sqrt(1.0 - height(run.time[early]) ** 2)
    assert figure("heavy_top", run, "com_x")[early] == pytest.approx(radius * np.cos(angle), abs=1e-10)
    assert figure("heavy_top", run, "com_y")[early] == pytest.approx(radius * np.sin(angle), abs=1e-10)


# One freedom, by quadrature


def bricard_motion(phi):
    """Points P2 to P6 and bars' rotations, (n, 5, 3) and (n, 5, 3, 3), for the angle of P1's hinge.

    Three-fold symmetry: the hinges at P1, P3, P5 turn by phi, those at P2, P4, P6 by psi, and the motion
    from one bar to the next but one is a third of a turn: its trace sin(phi) + sin(psi) + sin(phi)
    sin(psi) is zero.
    """
    psi = np.arcsin(-np.sin(phi) / (1.0 + np.sin(phi)))
    point, turn = np.zeros((*phi.shape, 3)), np.broadcast_to(np.eye(3), (*phi.shape, 3, 3))
    points, turns = [], []
    for axis, angle, bar in zip(
        (1, 2, 0, 1, 2), (phi, psi, phi, psi, phi), ((0, 1), (1, -1), (2, 1), (0, -1), (1, 1)), strict=True
    ):
        turn = turn @ about(axis, angle)
        point = point + bar[1] * turn[..., bar[0]]
        points.append(point)
        turns.append(turn)
    return np.stack(points, axis=-2), np.stack(turns, axis=-3)


def bricard_energies(phi):
    """Potential energy and M with kinetic energy M phidot^2 / 2, (n,); derivatives by complex steps."""
    step = 1e-30
    points, turns = bricard_motion(phi + 1j * step)
    start = np.concatenate([np.zeros_like(points[..., :1, :]), points[..., :-1, :]], axis=-2)
    centers = 0.5 * (start + points)
    velocity = centers.imag / step
    spin = np.swapaxes(turns.real, -1, -2) @ (turns.imag / step)
    omega = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
    axial, across = 0.01 / 6.0, 1.01 / 12.0
    moments = across - (across - axial) * np.eye(3)[[0, 1, 2, 0, 1]]
    mass = np.sum(velocity**2, axis=(-1, -2)) + np.sum(moments * omega**2, axis=(-1, -2))
    return G * np.sum(centers.real[..., 1], axis=-1), mass


def bricard_time(phi):
    """Time (n,) from rest at phi = 0 to angles in (0, pi], increasing.

    Over w with phi = pi (1 - cos w) / 2, which takes the speed's square roots out of both ends.
    """
    start = bricard_energies(np.zeros(1))[0]

    def pace(w):
        potential, mass = bricard_energies(0.5 * np.pi * (1.0 - np.cos(w)))
        return np.sqrt(mass / (2.0 * (start - potential))) * 0.5 * np.pi * np.sin(w)

    return accumulated(pace, np.concatenate([[0.0], np.arccos(1.0 - 2.0 * phi / np.pi)]))[1:]


PERIOD = 2.0 * 2.495855756844361936


def test_bricard_falls_as_energy_says():
    ends = np.linspace(0.0, np.pi, 50)[1:]
    # potential energies of 20 J next to rest differ by 1e-6 J and less
    assert bricard_time(ends)[-1] == pytest.approx(0.5 * PERIOD, abs=1e-11)
    run = exact_run("bricard")
    swing = (run.time > 0.0) & (run.time < 2.49)
    phi = figure("bricard", run, "q1")[swing]
    assert np.all(np.diff(phi) > 0.0)
    # angles to 1e-12 over rates of 0.02 rad/s at least, next to rest
    assert bricard_time(phi) == pytest.approx(run.time[swing], abs=1e-10)
    back = (run.time > 2.50) & (run.time < 4.98)  # the same way up again
    returned = figure("bricard", run, "q1")[back][::-1]
    assert bricard_time(returned) == pytest.approx(PERIOD - run.time[back][::-1], abs=1e-10)
    points = bricard_motion(phi)[0]
    assert position(run, "bar_2", np.array([0.0, -0.5, 0.0]))[swing] == pytest.approx(points[:, 1], abs=1e-11)
    assert points[:, 4] == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(phi), 1)), abs=1e-14)


def slider_crank_energies(theta, moments):
    """Slider's x, potential energy and M, (n,); the rod's spin follows from the universal joint.

    Its angular velocity has no part across both axes of the joint, x and b, b across x and the rod.
    """
    pin = np.stack([0.0 * theta, 0.1 - 0.08 * np.sin(theta), 0.12 + 0.08 * np.cos(theta)], axis=-1)
    pin_rate = np.stack([0.0 * theta, -0.08 * np.cos(theta), -0.08 * np.sin(theta)], axis=-1)
    x = np.sqrt(0.09 - np.sum(pin**2, axis=-1))
    x_rate = -np.sum(pin * pin_rate, axis=-1) / x
    ex = np.array([1.0, 0.0, 0.0])
    along = (x[..., None] * ex - pin) / 0.3
    along_rate = (x_rate[..., None] * ex - pin_rate) / 0.3
    b = np.cross(along, ex)
    b /= np.linalg.norm(b, axis=-1, keepdims=True)
    omega = np.cross(along, along_rate)
    across = np.cross(ex, b)
    spin = -np.sum(omega * across, axis=-1) / np.sum(along * across, axis=-1)
    omega = omega + spin[..., None] * along
    axes = (along, b, np.cross(along, b))
    rod = sum(j * np.sum(omega * axis, axis=-1) ** 2 for j, axis in zip(moments, axes, strict=True))
    center_rate = 0.5 * (pin_rate + x_rate[..., None] * ex)
    crank = 1e-4 + 0.12 * 0.04**2
    mass = crank + 0.5 * np.sum(center_rate**2, axis=-1) + rod + 2.0 * x_rate**2
    height = 0.12 * (0.12 + 0.04 * np.cos(theta)) + 0.5 * 0.5 * pin[..., 2]
    return x, G * height, mass


@pytest.mark.parametrize(
    ("variant", "revolution"), [("A", 0.5788974396007104049605307), ("B", 0.6004967349250973638903414)]
)
def test_slider_crank_turns_as_energy_says(variant, revolution):
    moments = ROD_MOMENTS[variant]
    _, potential, mass = slider_crank_energies(np.zeros(1), moments)
    energy = potential + 0.5 * mass * 6.0**2

    def pace(theta):
        _, potential, mass = slider_crank_energies(theta, moments)
        return np.sqrt(mass / (2.0 * (energy - potential)))

    assert accumulated(pace, np.linspace(0.0, 2.0 * np.pi, 30))[-1] == pytest.approx(revolution, abs=1e-14)
    run = exact_run("slider_crank", variant=variant)
    theta = figure("slider_crank", run, "crank_angle")
    assert theta[-1] > 50.0  # whole turns are counted
    # 1600 steps of 1e-13, and rates of 5 rad/s at least
    assert accumulated(pace, theta) == pytest.approx(run.time, abs=1e-11)
    x, _, mass = slider_crank_energies(theta, moments)
    assert figure("slider_crank", run, "slider_x") == pytest.approx(x, abs=1e-13)
    assert figure("slider_crank", run, "crank_omega") == pytest.approx(1.0 / pace(theta), abs=1e-10)
