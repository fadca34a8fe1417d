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
from crosscheck.library import REFERENCE_QUANTITIES, SCENES, load
from crosscheck.library.free_top import CASES
from crosscheck.library.references import reference_values
from newton_euler.model.euler_parameters import rotations

G = 9.81
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


@cache
def exact_run(name, **options):
    """At the tolerance of the comparison with reference values; round-off takes over below."""
    return newton_euler.simulate(load(name, **options), rtol=1e-13, atol=1e-15)


def figure(name, run, quantity):
    return REFERENCE_QUANTITIES[name][quantity](run)


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


# Every reference value


KNOWN = [
    pytest.param(name, known, id=f"{name}-{known.quantity}-{known.time:g}-{list(known.options.values())}")
    for name in REFERENCE_QUANTITIES
    if name != "four_bar"  # in test_scene_families.py, to what is left after passing flat bars
    for known in reference_values(name)
]


@pytest.mark.parametrize(("name", "known"), KNOWN)
def test_reference_values_to_ten_digits(name, known):
    run = exact_run(name, **known.options)
    n = int(np.argmin(abs(run.time - known.time)))
    assert run.time[n] == pytest.approx(known.time, abs=1e-12)
    # components of one vector are as exact as its largest; all of them are 1e-4 to 1e3 of it
    assert figure(name, run, known.quantity)[n] == pytest.approx(
        known.value, rel=1e-10, abs=1e-14 + known.uncertainty
    )


def test_every_quantity_has_reference_values():
    assert REFERENCE_QUANTITIES.keys() <= SCENES.keys()
    for name, quantities in REFERENCE_QUANTITIES.items():
        assert {known.quantity for known in reference_values(name)} == set(quantities)


@pytest.mark.parametrize(
    "known", [k for k in reference_values("andrews") if k.published], ids=lambda k: k.quantity
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
        # 326 steps of 1e-13; the largest is a tension of 29 N
        assert figure("pendulum", run, quantity) == pytest.approx(values, abs=326e-13)
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
