"""Import the equality constraints of a compiled MuJoCo model, for `mjcf.reader`.

A `connect` or `weld` becomes a joint that closes a loop. An equality of joints becomes a gear or another
coupling, or holds one joint at its start. An equality of a straight tendon becomes a rod of constant length,
an equality of a fixed tendon (a weighted sum of joint coordinates) becomes a coupling.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.loops import closure_ends, fixed_tendon_weights
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
"""Last words of the report's entry for every imported equality; "here" is the scene."""


class Loops:
    """Imported loop closures and couplings of joints.

    Attributes:
        joints: joints from connects, welds and tendons of constant length.
        couplings: couplings from equalities of joint coordinates.
        held_motions: constant prescribed motions, of joint coordinates that an equality holds at the start.
    """

    def __init__(self, start: ModelAtStart, bodies: Bodies, joints: Joints, report: ImportReport) -> None:
        """Import and report all equalities.

        Args:
            start: MuJoCo's model and data at the start state.
            bodies: imported bodies.
            joints: imported joints of the tree.
            report: report that receives one entry for each equality.
        """
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints, self._report = bodies, joints, report
        self.joints: list[Joint] = []
        self.couplings: list[JointCoupling] = []
        self.held_motions: list[PrescribedMotion] = []
        self._taken = [joint.name for joint in joints.joints]
        flag = "constraint" if start.disabled("CONSTRAINT") else "equality"
        for index in range(self._model.neq):
            if start.disabled("EQUALITY"):
                why = f'<flag {flag}="disable"/>: the constraint is not applied'
                report.left_out(start.equality(index), why, switched_off=True)
            elif not self._model.eq_active0[index]:
                why = 'active="false": the constraint is not applied'
                report.left_out(start.equality(index), why, switched_off=True)
            else:
                self._add(index)

    def _name(self, index: int) -> str:
        """Return a new name for the joint or coupling of an equality, and reserve the name."""
        wanted_name = self._model.equality(index).name
        # in exported files, `mjcf.write` puts the kind of the coupling in front of the name
        for coupling in (Gear, PolynomialCoupling):
            wanted_name = wanted_name.removeprefix(f"{coupling.kind} ")
        name = unique_name(wanted_name, f"equality_{index}", self._taken)
        self._taken.append(name)
        return name

    def _leave_out(self, index: int, why: str, moves_nothing: bool = False) -> None:
        """Report an equality as left out of the scene."""
        self._report.left_out(self._start.equality(index), why, moves_nothing=moves_nothing)

    def _add(self, index: int) -> None:
        """Import equality number `index`."""
        match mujoco.mjtEq(self._model.eq_type[index]):
            case mujoco.mjtEq.mjEQ_CONNECT | mujoco.mjtEq.mjEQ_WELD:
                self._add_closure(index)
            case mujoco.mjtEq.mjEQ_JOINT:
                self._add_joint(index)
            case mujoco.mjtEq.mjEQ_TENDON:
                self._add_tendon(index)
            case kind:
                self._leave_out(
                    index, f"scenes have no counterpart of {kind.name.removeprefix('mjEQ_').lower()}"
                )

    def _add_closure(self, index: int) -> None:
        """Add the joint of a connect or weld: a spherical joint, or a fixed joint."""
        numbers, (point_on_first, _) = closure_ends(self._model, self._data, index)
        first, second = (self._bodies.names[k] for k in numbers)
        if first == second:
            self._leave_out(index, f"both its bodies are parts of {first!r}", moves_nothing=True)
            return
        is_weld = self._model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD
        holds_rotation = is_weld and self._model.eq_data[index, TORQUE_SCALE_INDEX] != 0.0
        kind = Fixed if holds_rotation else Spherical
        name = self._name(index)
        # The joint uses the point on the first body for both bodies. The point on the second body differs
        # from it by the rounding of the file, and the bodies stay where the file has them.
        self.joints.append(kind(name, first, second, point_on_first))
        self._report.imported(
            self._start.equality(index), f"{kind.kind} joint {name!r}, {HELD_RIGIDLY}", is_soft_in_file=True
        )

    def _add_joint(self, index: int) -> None:
        """Add the coupling of an equality of joints, y - y0 = p(x - x0), see MuJoCo's `polycoef`.

        y is the coordinate of the follower, x of the driver, and p a polynomial of degree 4. y0 and x0 are
        the coordinates in qpos0. Without a driver, the follower is held. The constant of p is not needed:
        coordinates of the scene are zero at the start, where the equality is satisfied.
        """
        model = self._model
        first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        if first not in self._joints.coordinate_keys:
            self._leave_out(index, "it couples joints other than hinges and slides")
            return
        polynomial = model.eq_data[index][:5]  # coefficients in ascending order
        follower = self._joints.coordinate_keys[first]
        if second < 0:
            self._couple(index, follower, driver=None, ratio=0.0)
            return
        driver = self._joints.coordinate_keys[second]
        qpos_index = int(model.jnt_qposadr[second])
        driver_at_start = float(self._data.qpos[qpos_index] - model.qpos0[qpos_index])
        if not np.any(polynomial[2:]):
            self._couple(index, follower, driver, ratio=float(polynomial[1]))
            return
        coefficients = tuple(np.trim_zeros(polynomial[1:], "b").tolist())
        name = self._name(index)
        (driver_joint, driver_index), (follower_joint, follower_index) = driver, follower
        in_file_coordinates = PolynomialCoupling(
            name, driver_joint, follower_joint, coefficients, driver_index, follower_index
        )
        # the file counts coordinates from qpos0, the scene from the start, where x - x0 is `driver_at_start`
        self.couplings.append(in_file_coordinates.from_zero(driver_at_start))
        self._report.imported(
            self._start.equality(index), f"polynomial coupling {name!r}, {HELD_RIGIDLY}", is_soft_in_file=True
        )

    def _couple(self, index: int, follower: Key, driver: Key | None, ratio: float) -> None:
        """Add a gear, follower = ratio * driver; hold the follower if there is no driver or the ratio is 0.

        Args:
            index: number of the equality.
            follower: name of the joint, and number of the coordinate within the joint.
            driver: name of the joint, and number of the coordinate, or None.
            ratio: derivative of the follower by the driver.
        """
        follower_joint, follower_index = follower
        if driver is None or ratio == 0.0:
            self.held_motions.append(PrescribedMotion(follower_joint, Polynomial((0.0,)), follower_index))
            counterpart = f"joint {follower_joint!r} held, {HELD_RIGIDLY}"
        else:
            name = self._name(index)
            driver_joint, driver_index = driver
            gear = Gear(name, driver_joint, follower_joint, ratio, driver_index, follower_index)
            self.couplings.append(gear)
            counterpart = f"gear {name!r} of ratio {ratio:.6g}, {HELD_RIGIDLY}"
        self._report.imported(self._start.equality(index), counterpart, is_soft_in_file=True)

    def _add_tendon(self, index: int) -> None:
        """Add an equality of tendons: a rod for a straight tendon, a coupling for fixed tendons."""
        model = self._model
        tendons = [int(t) for t in (model.eq_obj1id[index], model.eq_obj2id[index]) if t >= 0]
        polynomial = model.eq_data[index][:5]  # of the equality L1 = p(L2), coefficients in ascending order
        # one straight tendon: a rod
        ends = straight_tendon_ends(self._start, tendons[0])
        if ends and len(tendons) == 1:
            (first, point_on_first), (second, point_on_second) = ends
            names = self._bodies.names[first], self._bodies.names[second]
            if names[0] == names[1]:
                self._leave_out(index, f"both its ends are parts of {names[0]!r}", moves_nothing=True)
                return
            name = self._name(index)
            self.joints.append(Rod(name, *names, point_on_first, point_on_second=point_on_second))
            self._report.imported(
                self._start.equality(index), f"rod {name!r}, {HELD_RIGIDLY}", is_soft_in_file=True
            )
            return
        # one or two fixed tendons
        weights = fixed_tendon_weights(self._model, tendons[0])
        others = fixed_tendon_weights(self._model, tendons[1]) if len(tendons) == 2 else {}
        if weights is None or others is None:
            self._leave_out(
                index, "it couples tendons that are neither straight nor sums of joint coordinates"
            )
            return
        if np.any(polynomial[2:]):
            self._leave_out(index, "it couples tendons by a nonlinear polynomial")
            return
        # L1 - c L2 is constant, with c = polynomial[1]; both lengths are weighted sums of coordinates
        weight_of_joint = dict(weights)
        for joint, weight in others.items():
            weight_of_joint[joint] = weight_of_joint.get(joint, 0.0) - polynomial[1] * weight
        terms = [(self._joints.coordinate_keys[k], w) for k, w in weight_of_joint.items() if w != 0.0]
        if len(terms) == 1:
            ((held, _),) = terms
            self._couple(index, held, driver=None, ratio=0.0)
        elif len(terms) == 2:
            # follower_weight x_follower + driver_weight x_driver is constant
            (follower, follower_weight), (driver, driver_weight) = terms
            self._couple(index, follower, driver, ratio=-driver_weight / follower_weight)
        elif terms:
            name = self._name(index)
            joint_number_weight = tuple((*key, weight) for key, weight in terms)
            self.couplings.append(LinearCoupling(name, joint_number_weight))
            counterpart = f"coupling {name!r} of {len(terms)} joint coordinates, {HELD_RIGIDLY}"
            self._report.imported(self._start.equality(index), counterpart, is_soft_in_file=True)
        else:
            self._leave_out(index, "its weights are zero", moves_nothing=True)


def straight_tendon_ends(
    start: ModelAtStart, tendon: int
) -> tuple[tuple[int, Array], tuple[int, Array]] | None:
    """Return MuJoCo's body and the point (3,) of both ends of a tendon that is one line between two sites.

    Points are in m, world frame. The result is None for all other tendons.
    """
    model = start.model
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    if count != 2 or np.any(model.wrap_type[first : first + 2] != mujoco.mjtWrap.mjWRAP_SITE):
        return None
    site_1, site_2 = model.wrap_objid[first : first + 2]
    bodies, points = model.site_bodyid, start.data.site_xpos
    return (int(bodies[site_1]), points[site_1].copy()), (int(bodies[site_2]), points[site_2].copy())
