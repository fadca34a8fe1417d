"""Loops that two files cut at different joints, and bodies in halves: the robots are the same."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Quantity, Standing
from crosscheck.differences.motion import Likeness
from newton_euler.scalars import Array

POINTS = {"O1": (0.0, 0.0), "A": (0.05, 0.2), "B": (0.5, 0.3), "O2": (0.55, 0.0)}
"""Pins of a four-bar linkage: x and z, m."""

MIDDLE = (0.275, 0.25)
"""Point of the coupler at which it is cut in halves, x and z, m."""

PINS = {
    "O1": ("world", "crank"),
    "A": ("crank", "coupler"),
    "B": ("coupler", "rocker"),
    "O2": ("rocker", "world"),
}
"""Bodies that each pin connects."""

BARS = {
    "crank": [("O1", "A", 0.3)],
    "coupler": [("A", "M", 0.4), ("M", "B", 0.4)],
    "rocker": [("B", "O2", 0.5)],
}
"""Rods of each body: both ends, and mass, kg."""


def linkage(cut: str, halves: bool = False, names: tuple[str, str] = ("", ""), **numbers: str) -> str:
    """Return the MJCF of the linkage, whose tree of joints is cut at a pin.

    Args:
        cut: name of the pin that is a loop; "M" for the weld of the halves of the coupler.
        halves: whether the coupler is cut in halves, which a weld or a fixed body holds together.
        names: words to replace in the text, and their replacement.
        numbers: further attributes of each joint, by its name.
    """
    places = {name: np.array([x, 0.0, z]) for name, (x, z) in (POINTS | {"M": MIDDLE}).items()}
    bars, pins = dict(BARS), dict(PINS)
    if halves:
        bars["coupler"], bars["half"] = BARS["coupler"][:1], BARS["coupler"][1:]
        pins |= {"B": ("half", "rocker"), "M": ("coupler", "half")}
    origins = {"world": np.zeros(3)}

    def point(place: Array) -> str:
        return " ".join(f"{value:.12g}" for value in place)

    def bodies(parent: str, at: Array) -> str:
        found = ""
        for pin, ends in pins.items():
            for inner, outer in (ends, ends[::-1]):
                if inner == parent and outer not in origins and pin != cut:
                    origins[outer] = place = places[pin]
                    rods = "".join(
                        f'<geom type="capsule" size="0.01" mass="{mass}" '
                        f'fromto="{point(places[one] - place)} {point(places[two] - place)}"/>'
                        for one, two, mass in bars[outer]
                    )
                    joint = "" if pin == "M" else f'<joint name="{pin}" axis="0 1 0" {numbers.get(pin, "")}/>'
                    found += f'<body name="{outer}" pos="{point(place - at)}">{joint}{rods}'
                    found += f"{bodies(outer, place)}</body>"
        return found

    tree = bodies("world", np.zeros(3))
    first, second = pins[cut]
    other = "" if second == "world" else f'body2="{second}"'
    loop = f'<connect name="{cut}" body1="{first}" {other} anchor="{point(places[cut] - origins[first])}"/>'
    if cut == "M":
        loop = f'<weld name="M" body1="{first}" {other}/>'
    text = f"<mujoco><worldbody>{tree}</worldbody><equality>{loop}</equality></mujoco>"
    return text.replace(*names) if names[0] else text


def compared(folder: Path, first: str, second: str) -> crosscheck.Diff:
    paths = [folder / "first.xml", folder / "second.xml"]
    for path, text in zip(paths, (first, second), strict=True):
        path.write_text(text)
    return crosscheck.diff(*map(str, paths))


def accelerations(text: str) -> dict[str, Array]:
    """Return the accelerations at rest of the centers of mass, by MuJoCo with rigid constraints."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    rows = data.efc_J.reshape(-1, model.nv)
    system = np.block([[mass, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    right = np.concatenate([data.qfrc_smooth, np.zeros(len(rows))])
    found = np.linalg.lstsq(system, right, rcond=1e-10)[0][: model.nv]
    result = {}
    for number in range(1, model.nbody):
        columns = np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, columns, None, number)
        result[model.body(number).name] = columns @ found
    return result


@pytest.mark.parametrize(("one", "two"), [*combinations(PINS, 2)])
def test_loops_that_are_cut_at_other_joints_are_the_same(tmp_path, one, two):
    texts = linkage(one), linkage(two)
    first, second = map(accelerations, texts)
    for name in BARS:
        # condition of the equations times round-off
        assert first[name] == pytest.approx(second[name], rel=1e-9, abs=1e-9)
    found = compared(tmp_path, *texts)
    assert found.outcome is Outcome.SAME
    assert found.motion.likeness is Likeness.EQUAL
    (row,) = (row for row in found.comparison.rows if row.quantity is Quantity.LOOP_CUT)
    assert (row.first, row.second, row.standing) == (one, two, Standing.CONVENTION)


def test_a_difference_beside_another_cut_is_the_only_row(tmp_path):
    texts = linkage("O1"), linkage("B", names=('mass="0.5"', 'mass="0.55"'))
    found = compared(tmp_path, *texts)
    assert [(row.element, row.quantity) for row in found.differences] == [("rocker", Quantity.MASS)]
    assert found.differences[0].size == pytest.approx(0.1)
    first, second = map(accelerations, texts)
    changes = [np.linalg.norm(first[name] - second[name]) / np.linalg.norm(first[name]) for name in BARS]
    assert max(changes) > 1e-3 < found.motion.change


@pytest.mark.parametrize("number", ['damping="0.1"', 'stiffness="2"', 'armature="0.01"'])
def test_what_acts_at_a_joint_that_the_other_file_cuts_is_a_difference(tmp_path, number):
    texts = linkage("O1", A=number), linkage("A")
    found = compared(tmp_path, *texts)
    quantity = Quantity(number.partition("=")[0])
    assert [(row.element, row.quantity) for row in found.differences] == [("A", quantity)]
    assert found.motion.likeness is Likeness.DIFFERENT


@pytest.mark.parametrize("cut", ["O1", "A", "B", "O2"])
@pytest.mark.parametrize("order", [1, -1])
def test_halves_of_a_body_that_a_weld_holds_are_the_body(tmp_path, cut, order):
    texts = linkage(cut), linkage("M", halves=True)
    first, second = map(accelerations, texts)
    for name in ("crank", "rocker"):
        assert first[name] == pytest.approx(second[name], rel=1e-9, abs=1e-9)
    found = compared(tmp_path, *texts[::order])
    assert found.outcome is Outcome.SAME
    assert found.motion.likeness is Likeness.EQUAL


def test_a_body_in_halves_in_both_files(tmp_path):
    texts = linkage("M", halves=True), linkage("B", halves=True)
    assert compared(tmp_path, *texts).outcome is Outcome.SAME


def test_limits_of_a_joint_that_the_other_file_cuts_are_no_difference(tmp_path):
    found = compared(tmp_path, linkage("O1", A='range="-60 60"'), linkage("A"))
    assert found.outcome is Outcome.SAME
    (row,) = (row for row in found.comparison.rows if row.quantity is Quantity.LIMITS)
    assert (row.element, row.standing) == ("A", Standing.CONVENTION)


def test_first_and_second_body_of_a_loop_may_be_exchanged(tmp_path):
    text = linkage("B")
    exchanged = text.replace('body1="coupler" body2="rocker"', 'body1="rocker" body2="coupler"').replace(
        'anchor="0.45 0 0.1"', 'anchor="-0.05 0 0.3"'
    )
    assert exchanged != text
    assert compared(tmp_path, text, exchanged).outcome is Outcome.SAME
