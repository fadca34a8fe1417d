"""Import equality constraints of a compiled model as joints, couplings and held joints."""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.loops import closure_ends
from mjcf.reading.bodies import Bodies
from mjcf.reading.joints import Joints
from mjcf.reading.start import TORQUE_SCALE_INDEX, ModelAtStart
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling, PolynomialCoupling
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Fixed, Rod, Spherical
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.reading.import_report import ImportReport, unique_name
from newton_euler.scalars import Array

HELD_RIGIDLY = "rigid here, soft in MuJoCo by solref and solimp"


class Loops:
    """Imported loop closures and couplings of joints.

    Attributes:
        joints: joints from connects, welds and tendons of constant length.
        gears: couplings from equalities of joint coordinates.
        held: prescribed motions of joints that an equality holds.
    """

    def __init__(self, start: ModelAtStart, bodies: Bodies, joints: Joints, report: ImportReport) -> None:
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints, self._report = bodies, joints, report
        self.joints: list[Joint] = []
        self.gears: list[JointCoupling] = []
        self.held: list[PrescribedMotion] = []
        self._taken = [joint.name for joint in joints.joints]
        flags = [flag for flag in ("EQUALITY", "CONSTRAINT") if start.disabled(flag)]
        for index in range(self._model.neq):
            if flags:
                why = f'<flag {flags[0].lower()}="disable"/>: the constraint is not applied'
                report.left_out(start.equality(index), why, switched_off=True)
            elif not self._model.eq_active0[index]:
                why = 'active="false": the constraint is not applied'
                report.left_out(start.equality(index), why, switched_off=True)
            else:
                self._add(index)

    def _name(self, index: int) -> str:
        own = self._model.equality(index).name
        for kind in (Gear, PolynomialCoupling):  # prefixes of `mjcf.write`
            own = own.removeprefix(f"{kind.kind} ")
        name = unique_name(own, f"equality_{index}", self._taken)
        self._taken.append(name)
        return name

    def _leave(self, index: int, why: str, moves_nothing: bool = False) -> None:
        self._report.left_out(self._start.equality(index), why, moves_nothing=moves_nothing)

    def _add(self, index: int) -> None:
        match mujoco.mjtEq(self._model.eq_type[index]):
            case mujoco.mjtEq.mjEQ_CONNECT | mujoco.mjtEq.mjEQ_WELD:
                self._add_closure(index)
            case mujoco.mjtEq.mjEQ_JOINT:
                self._add_joint(index)
            case mujoco.mjtEq.mjEQ_TENDON:
                self._add_tendon(index)
            case kind:
                self._leave(index, f"scenes have no counterpart of {kind.name.removeprefix('mjEQ_').lower()}")

    def _add_closure(self, index: int) -> None:
        numbers, (p, _) = closure_ends(self._model, self._data, index)
        first, second = (self._bodies.names[k] for k in numbers)
        if first == second:
            self._leave(index, f"both its bodies are parts of {first!r}", moves_nothing=True)
            return
        turns = self._model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD
        weld = turns and self._model.eq_data[index, TORQUE_SCALE_INDEX] != 0.0
        kind = Fixed if weld else Spherical
        name = self._name(index)
        # one point for both bodies: the scene keeps the offset that the digits of the file leave
        self.joints.append(kind(name, first, second, p))
        self._report.imported(self._start.equality(index), f"{kind.kind} joint {name!r}, {HELD_RIGIDLY}")

    def _add_joint(self, index: int) -> None:
        model = self._model
        first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        if first not in self._joints.coordinate_keys:
            self._leave(index, "it couples joints other than hinges and slides")
            return
        polynomial = model.eq_data[index][:5]
        follower = self._joints.coordinate_keys[first]
        if second < 0:
            self._couple(index, follower, None, 0.0, HELD_RIGIDLY)
            return
        driver = self._joints.coordinate_keys[second]
        place = int(model.jnt_qposadr[second])
        x = float(self._data.qpos[place] - model.qpos0[place])
        if not np.any(polynomial[2:]):
            self._couple(index, follower, driver, float(polynomial[1]), HELD_RIGIDLY)
            return
        coefficients = tuple(np.trim_zeros(polynomial[1:], "b").tolist())
        name = self._name(index)
        file = PolynomialCoupling(name, driver[0], follower[0], coefficients, driver[1], follower[1])
        self.gears.append(file.from_zero(x))
        self._report.imported(self._start.equality(index), f"polynomial coupling {name!r}, {HELD_RIGIDLY}")

    def _couple(self, index: int, follower: Key, driver: Key | None, ratio: float, how: str) -> None:
        """Add a gear, or a held joint if there is no driver."""
        if driver is None or ratio == 0.0:
            self.held.append(PrescribedMotion(follower[0], Polynomial((0.0,)), follower[1]))
            how_kept = f"joint {follower[0]!r} held, {how}"
        else:
            name = self._name(index)
            self.gears.append(Gear(name, driver[0], follower[0], ratio, driver[1], follower[1]))
            how_kept = f"gear {name!r} of ratio {ratio:.6g}, {how}"
        self._report.imported(self._start.equality(index), how_kept)

    def _add_tendon(self, index: int) -> None:
        """Add an equality of tendons: a rod for a straight tendon, a coupling for sums of coordinates."""
        model = self._model
        tendons = [int(t) for t in (model.eq_obj1id[index], model.eq_obj2id[index]) if t >= 0]
        polynomial = model.eq_data[index][:5]
        ends = straight_tendon_ends(self._start, tendons[0])
        if ends and len(tendons) == 1:
            (first, p), (second, q) = ends
            names = self._bodies.names[first], self._bodies.names[second]
            if names[0] == names[1]:
                self._leave(index, f"both its ends are parts of {names[0]!r}", moves_nothing=True)
                return
            name = self._name(index)
            self.joints.append(Rod(name, *names, p, point_on_second=q))
            self._report.imported(self._start.equality(index), f"rod {name!r}, {HELD_RIGIDLY}")
            return
        weights = fixed_tendon_weights(self._start, tendons[0])
        others = fixed_tendon_weights(self._start, tendons[1]) if len(tendons) == 2 else {}
        if weights is None or others is None:
            self._leave(index, "it couples tendons that are neither straight nor sums of joint coordinates")
            return
        if np.any(polynomial[2:]):
            self._leave(index, "it couples tendons by a nonlinear polynomial")
            return
        # the weighted sum of joint coordinates that the equality keeps constant
        total = dict(weights)
        for joint, weight in others.items():
            total[joint] = total.get(joint, 0.0) - polynomial[1] * weight
        terms = [(self._joints.coordinate_keys[k], w) for k, w in total.items() if w != 0.0]
        if len(terms) == 1:
            self._couple(index, terms[0][0], None, 0.0, HELD_RIGIDLY)
        elif len(terms) == 2:
            (follower, own), (driver, other) = terms
            self._couple(index, follower, driver, -other / own, HELD_RIGIDLY)
        elif terms:
            name = self._name(index)
            self.gears.append(LinearCoupling(name, tuple((*key, weight) for key, weight in terms)))
            how_kept = f"coupling {name!r} of {len(terms)} joint coordinates, {HELD_RIGIDLY}"
            self._report.imported(self._start.equality(index), how_kept)
        else:
            self._leave(index, "its weights are zero", moves_nothing=True)


def straight_tendon_ends(
    start: ModelAtStart, tendon: int
) -> tuple[tuple[int, Array], tuple[int, Array]] | None:
    """Return body and point of both ends of a straight tendon between two sites; None for others."""
    model = start.model
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    if count != 2 or np.any(model.wrap_type[first : first + 2] != mujoco.mjtWrap.mjWRAP_SITE):
        return None
    one, two = model.wrap_objid[first : first + 2]
    bodies, points = model.site_bodyid, start.data.site_xpos
    return (int(bodies[one]), points[one].copy()), (int(bodies[two]), points[two].copy())


def fixed_tendon_weights(start: ModelAtStart, tendon: int) -> dict[int, float] | None:
    """Return joints and weights of a fixed tendon, a sum of joint coordinates; None for others."""
    model = start.model
    rows = slice(int(model.tendon_adr[tendon]), int(model.tendon_adr[tendon] + model.tendon_num[tendon]))
    if np.any(model.wrap_type[rows] != mujoco.mjtWrap.mjWRAP_JOINT):
        return None
    weights: dict[int, float] = {}
    for joint, weight in zip(model.wrap_objid[rows], model.wrap_prm[rows], strict=True):
        weights[int(joint)] = weights.get(int(joint), 0.0) + float(weight)
    return weights
